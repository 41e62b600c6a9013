"""Sites at random, class by class: as many yards of a kind as are wanted, each from its own number.

A site is drawn from its class, its number and a variant; where start or goal are not free, or the planner finds no
path within the class's ranges, the next variant is drawn. Vehicles, kinds of map, hitch angle logged or not, and
how the file is compressed take turns, so that each class has some of everything.
"""

import contextlib
import dataclasses
import math
import zlib
from collections.abc import Callable, Mapping
from types import MappingProxyType
from typing import Any, Final, Literal

import numpy as np

from optim.model.clearance import clearance
from optim.model.flat_map import state_from_flat
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle
from optim.planning.protocol import Area, place_flat
from optim.planning.rrt import Rrt
from optim.steering.flat import Flat
from tools.corpus.build import Built, build, build_with
from tools.corpus.read import vehicles
from tools.corpus.site import (
    Box,
    Grid,
    Obstacle,
    Shapes,
    Site,
    Wall,
    backed_up,
    footprints,
    ground,
    parked_trailer,
)

_TURNS: Final = ("default", "default", "source", "tractor", "default", "city", "source", "default")
_FREE = 0.6  # [m]: clearance of start and goal
_LITTLE = 0.1  # [m]: clearance to keep where there is no room for more
_UP = math.pi / 2
_RRT = Rrt(max_iterations=1000)


def vehicle_name(vehicle: Vehicle) -> str:
    """The name of a vehicle of the drawn sites."""
    return next(name for name, known in vehicles().items() if known == vehicle)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Draw:
    """What a class draws its site from."""

    rng: np.random.Generator
    number: int
    vehicle: Vehicle
    scale: float
    """Length of the combination over that of the default one: larger vehicles get larger yards."""


def open_ground(draw: Draw) -> Site:
    """Two to four obstacles on open ground."""
    rng, k = draw.rng, draw.scale
    boxes = _boxes(rng, int(rng.integers(2, 5)), (-26.0 * k, -20.0 * k, 26.0 * k, 20.0 * k), (3.0, 12.0))
    return Site(
        **_named("open", "open ground", draw),
        obstacles=tuple(boxes),
        bounds=(-42.0 * k, -34.0 * k, 42.0 * k, 34.0 * k),
        start=Flat(-24.0 * k, float(rng.uniform(-14.0, 14.0)), float(rng.uniform(-0.8, 0.8)), 0.0),
        goal=Flat(
            float(rng.uniform(4.0, 20.0)) * k, float(rng.uniform(-16.0, 16.0)), float(rng.uniform(-3.1, 3.1)), 0.0
        ),
        areas=(Area(box=(-34.0 * k, -26.0 * k, 34.0 * k, 26.0 * k)),),
        cusps=(0, 4),
        length=(30.0, 150.0 * k),
    )


def bay_in_a_row(draw: Draw) -> Site:
    """A bay between parked trailers at a dock wall."""
    rng, k = draw.rng, draw.scale
    deep = float(rng.uniform(38.0, 46.0)) * k
    obstacles: list[Obstacle] = [Box(x=0.0, y=-0.6, length=80.0 * k, width=1.2, height=7.0, kind="building")]
    gaps = [-float(rng.uniform(3.4, 4.1)), float(rng.uniform(3.4, 4.1))]
    places = [*gaps, gaps[0] - float(rng.uniform(3.6, 9.0)), gaps[1] + float(rng.uniform(3.6, 9.0))]
    obstacles += [parked_trailer(x, float(rng.uniform(0.3, 1.2)), _UP) for x in places]
    obstacles += _boxes(rng, 2, (-30.0 * k, deep - 8.0, 30.0 * k, deep - 1.0), (2.0, 8.0))
    obstacles.append(Wall(points=((-38.0 * k, deep), (38.0 * k, deep))))
    side = -1.0 if draw.number % 2 else 1.0
    return Site(
        **_named("constrained", "bay in a row", draw),
        obstacles=tuple(obstacles),
        bounds=(-44.0 * k, -1.2, 44.0 * k, deep + 0.2),
        start=Flat(side * 28.0 * k, float(rng.uniform(0.5, 0.7)) * deep, 0.0 if side < 0.0 else math.pi, 0.0),
        goal=backed_up(0.0, 0.6, _UP, draw.vehicle),
        areas=(
            Area(box=(-32.0 * k, 0.42 * deep, 32.0 * k, 0.9 * deep), weight=2.0),
            Area(box=(-14.0 * k, 12.0, 16.0 * k, 0.8 * deep), heading=_UP, spread=1.0, weight=2.0),
        ),
        cusps=(1, 4),
        length=(45.0, 140.0 * k),
    )


def narrow_alley(draw: Draw) -> Site:
    """A dock at the end of a short narrow alley."""
    width = float(draw.rng.uniform(5.6, 7.5))
    return _alley(draw, "narrow", "dock in a narrow alley", width, 14.0 * draw.scale)


def long_reverse(draw: Draw) -> Site:
    """A dock at the end of a long alley: most of the way is reversed."""
    width = float(draw.rng.uniform(8.5, 12.0))
    site = _alley(draw, "reverse", "dock at the end of a long alley", width, float(draw.rng.uniform(40.0, 52.0)))
    # a hitch angle that is not logged cannot be told from the truck's poses on so long a way: errors grow like exp(s/l)
    return dataclasses.replace(site, has_trailer_path=True)


def _alley(draw: Draw, kind: str, title: str, width: float, deep: float) -> Site:
    """An alley along x from its dock at 0 to a yard."""
    rng, k, half = draw.rng, draw.scale, width / 2.0
    side = 1.0 if draw.number % 2 else -1.0
    end, low, high = deep + 44.0 * k, -22.0 * k, 22.0 * k
    obstacles: list[Obstacle] = [
        Wall(points=((deep, low), (deep, -half), (0.0, -half), (0.0, half), (deep, half), (deep, high)), width=0.4),
        Wall(points=((deep, high), (end, high), (end, low), (deep, low)), kind="fence"),
    ]
    obstacles += _boxes(rng, 2, (deep + 6.0, low + 2.0, end - 4.0, high - 2.0), (2.0, 6.0))
    y = side * float(rng.uniform(4.0, 12.0)) * k
    return Site(
        **_named(kind, title, draw),
        obstacles=tuple(obstacles),
        bounds=(-0.4, low - 0.4, end + 0.4, high + 0.4),
        start=Flat(deep + 20.0 * k, y, side * _UP, 0.0),
        goal=backed_up(0.6, 0.0, 0.0, draw.vehicle),
        areas=(
            Area(box=(deep + 4.0, low + 4.0, end - 4.0, high - 4.0), weight=2.0),
            Area(box=(6.0, -0.2 * half, deep + 12.0, 0.2 * half), heading=0.0, spread=0.15, weight=2.0),
        ),
        cusps=(1, 5),
        length=(40.0, 190.0 * k),
    )


def cluttered_lot(draw: Draw) -> Site:
    """A lot full of things, mapped by a robot."""
    rng, k = draw.rng, draw.scale
    low = (-26.0 * k, -21.0 * k, 26.0 * k, 21.0 * k)
    obstacles: list[Obstacle] = list(_boxes(rng, int(rng.integers(8, 13)), low, (1.0, 6.0)))
    obstacles.append(Wall(points=((-40.0 * k, -28.0 * k), (40.0 * k, -28.0 * k), (40.0 * k, 28.0 * k))))
    site = Site(
        **_named("cluttered", "cluttered lot", draw),
        obstacles=tuple(obstacles),
        bounds=(-40.2 * k, -28.2 * k, 40.2 * k, 28.2 * k),
        start=Flat(-22.0 * k, float(rng.uniform(-14.0, 14.0)), float(rng.uniform(-0.5, 0.5)), 0.0),
        goal=Flat(
            float(rng.uniform(6.0, 22.0)) * k, float(rng.uniform(-15.0, 15.0)), float(rng.uniform(-3.1, 3.1)), 0.0
        ),
        areas=(Area(box=(-32.0 * k, -22.0 * k, 32.0 * k, 22.0 * k)),),
        cusps=(0, 5),
        length=(30.0, 170.0 * k),
    )
    grid = Grid(
        resolution=(0.2, 0.25, 0.15)[draw.number % 3],
        yaw=0.0 if draw.number % 2 else 0.4,
        speckles=20,
        solid=draw.number % 4 != 3,
    )
    return dataclasses.replace(site, map=grid, compression="zstd", is_chunked=True)


def turning_round(draw: Draw) -> Site:
    """Turning round in a yard that is little longer than the vehicle: many gear changes."""
    rng, k = draw.rng, draw.scale
    half_x, half_y = float(rng.uniform(26.0, 30.0)) * k, float(rng.uniform(17.0, 20.0)) * k
    corners = ((-half_x, -half_y), (half_x, -half_y), (half_x, half_y), (-half_x, half_y), (-half_x, -half_y))
    obstacles: list[Obstacle] = [Wall(points=corners, width=0.4, kind="wall")]
    obstacles += _boxes(rng, 2, (-half_x, half_y - 3.5, half_x, half_y - 0.5), (2.0, 5.0))
    return Site(
        **_named("cusps", "turning round in a small yard", draw),
        obstacles=tuple(obstacles),
        bounds=(-half_x - 0.2, -half_y - 0.2, half_x + 0.2, half_y + 0.2),
        start=Flat(float(rng.uniform(-6.0, -2.0)) * k, -0.45 * half_y, 0.0, 0.0),
        goal=Flat(float(rng.uniform(2.0, 6.0)) * k, float(rng.uniform(-0.2, 0.2)) * half_y, rng.uniform(1.2, 2.6), 0.0),
        areas=(Area(box=(-0.8 * half_x, -0.8 * half_y, 0.8 * half_x, 0.8 * half_y)),),
        cusps=(3, 9),
        length=(40.0, 220.0 * k),
    )


CLASSES: Final[Mapping[str, Callable[[Draw], Site]]] = MappingProxyType(
    {
        "open": open_ground,
        "constrained": bay_in_a_row,
        "narrow": narrow_alley,
        "cluttered": cluttered_lot,
        "reverse": long_reverse,
        "cusps": turning_round,
    }
)
"""Scene classes; a class's sites are NAME_01, NAME_02, ..."""
MOST_VARIANTS = 15
"""So many variants of a site are drawn before it counts as impossible."""
SEEDS_EACH = 6
"""Searches of the RRT on each of them."""


def build_drawn(kind: str, number: int) -> Built:
    """The first variant of a site for which the RRT finds a path. Raises RuntimeError where there is none."""
    return _first_built(kind, number, lambda site: build(site, _RRT, SEEDS_EACH))


def build_hard(kind: str, number: int, planner: str) -> Built:
    """As `build_drawn`, by another planner, and with less clearance to keep: room there is for no more.

    The cells of these sites' grids reach nearer to the backed-up trailer than what the RRT keeps.
    """
    changes: dict[str, Any] = {"planner": planner, "cusps": (0, 12), "clearance": _LITTLE}
    return _first_built(kind, number, lambda site: build_with(dataclasses.replace(site, **changes), 1))


def _first_built(kind: str, number: int, build_site: Callable[[Site], Built]) -> Built:
    """The first variant of a site that can be built. Raises RuntimeError where there is none."""
    for variant in range(MOST_VARIANTS):
        site = draw_site(kind, number, variant)
        if site is not None:
            with contextlib.suppress(RuntimeError):
                return build_site(site)
    raise RuntimeError(f"{kind}_{number:02d}: no path in {MOST_VARIANTS} variants")


def draw_site(kind: str, number: int, variant: int) -> Site | None:
    """A site of a class; None where start or goal are not free."""
    vehicle = vehicles()[_TURNS[number % len(_TURNS)]]
    reach = vehicle.truck_front + vehicle.trailer_rear
    rng = np.random.default_rng([zlib.crc32(kind.encode()), number, variant])
    scale = round(max(reach / 17.0, 0.8), 2)
    site = CLASSES[kind](Draw(rng=rng, number=number, vehicle=vehicle, scale=scale))
    return _rounded(site) if _ends_are_free(site) else None


def _named(kind: str, title: str, draw: Draw) -> dict[str, Any]:
    """The fields of a site that take turns."""
    n = draw.number
    compression: Literal["zstd", "lz4", "none"] = ("zstd", "lz4", "none", "zstd")[n % 4]
    is_noisy = n % 8 == 5
    return {
        "name": f"{kind}_{n:02d}",
        "title": title,
        "special": "2 cm of noise on the poses, every 0.5 m" if is_noisy else "",
        "map": Grid(resolution=0.2, speckles=6) if n % 2 else Shapes(),
        "vehicle": draw.vehicle,
        "pose": (
            float(draw.rng.integers(-90, 90)),
            float(draw.rng.integers(-90, 90)),
            round(draw.rng.uniform(-3, 3), 2),
        ),
        "has_trailer_path": n % 3 != 1 or is_noisy,
        "has_path_nodes": n % 5 != 2 and not is_noisy,
        "has_stamps": n % 4 == 1,
        "spacing": 0.5 if is_noisy else 0.3,
        "pose_noise": 0.02 if is_noisy else 0.0,
        "compression": compression,
        "is_chunked": n % 6 != 4,
        "seed": 1000 * n,
        "noise": 400 + n,
    }


def _boxes(
    rng: np.random.Generator, count: int, area: tuple[float, float, float, float], size: tuple[float, float]
) -> list[Box]:
    """Boxes at random in a rectangle."""
    kinds = ("container", "car", "pallets", "skip")
    return [
        Box(
            x=float(rng.uniform(area[0], area[2])),
            y=float(rng.uniform(area[1], area[3])),
            length=float(rng.uniform(*size)),
            width=float(rng.uniform(1.0, 2.6)),
            yaw=float(rng.uniform(-1.5, 1.5)),
            height=2.6,
            kind=kinds[int(rng.integers(len(kinds)))],
        )
        for _ in range(count)
    ]


def _ends_are_free(site: Site) -> bool:
    scene = make_scene(footprints(site), boundary=ground(site))
    flats = np.array([place_flat(flat, site.pose) for flat in (site.start, site.goal)])
    states, _ = state_from_flat(site.vehicle, flats)
    # a trailer that is backed up stands near the dock: the margin of the planner is what it needs
    return bool(clearance(scene, site.vehicle, states).min() >= min(_FREE, 2.0 * site.clearance))


def _rounded(site: Site) -> Site:
    """Numbers of obstacles and ends as a person would write them: the last bit of a sine decides nothing."""

    def rounded(obstacle: Obstacle) -> Obstacle:
        if isinstance(obstacle, Box):
            values = {key: round(getattr(obstacle, key), 2) for key in ("x", "y", "length", "width", "yaw")}
            return dataclasses.replace(obstacle, **values)
        if isinstance(obstacle, Wall):
            return dataclasses.replace(obstacle, points=tuple((round(x, 2), round(y, 2)) for x, y in obstacle.points))
        return obstacle

    ends = {key: Flat(*(round(value, 4) for value in getattr(site, key))) for key in ("start", "goal")}
    return dataclasses.replace(site, obstacles=tuple(map(rounded, site.obstacles)), **ends)
