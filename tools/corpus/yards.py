"""The sites of the corpus where the trailer is backed to a building: bays straight and slanted, docks in alleys."""

import math

from optim.model.vehicle import Vehicle
from optim.planning.protocol import Area
from optim.steering.flat import Flat
from tools.corpus.site import Block, Box, Grid, Obstacle, Shapes, Site, Wall

TRAILER_LENGTH, TRAILER_WIDTH = 13.6, 2.55
_UP = math.pi / 2


def parked_trailer(x: float, y: float, yaw: float) -> Box:
    """A parked semi-trailer with the middle of its rear at (x, y)."""
    half = TRAILER_LENGTH / 2
    return Box(
        x=x + half * math.cos(yaw),
        y=y + half * math.sin(yaw),
        length=TRAILER_LENGTH,
        width=TRAILER_WIDTH,
        yaw=yaw,
        kind="trailer",
    )


def parked_combination(x: float, y: float, yaw: float) -> tuple[Box, Box]:
    """A parked trailer with its truck, the middle of the trailer's rear at (x, y)."""
    truck = Box(x=x + 14.0 * math.cos(yaw), y=y + 14.0 * math.sin(yaw), length=6.0, width=2.5, yaw=yaw, kind="truck")
    return parked_trailer(x, y, yaw), truck


def backed_up(x: float, y: float, yaw: float, vehicle: Vehicle | None = None) -> Flat:
    """The state of a straight combination whose trailer has the middle of its rear at (x, y)."""
    vehicle = vehicle or Vehicle()
    overhang = vehicle.trailer_rear - vehicle.hitch_to_axle
    return Flat(x + overhang * math.cos(yaw), y + overhang * math.sin(yaw), yaw, 0.0)


def bay_01() -> Site:
    """Reverse bay in a row of parked trailers at a dock wall."""
    obstacles: list[Obstacle] = [Box(x=-2.0, y=-0.6, length=76.0, width=1.2, height=7.0, kind="building")]
    obstacles += [parked_trailer(x, 0.5, _UP) for x in (-15.1, -7.5, -3.4, 7.45, 19.6)]
    obstacles += parked_combination(3.35, 0.4, _UP)
    obstacles += [
        Box(x=-2.0, y=42.1, length=76.0, width=0.2, height=2.4, kind="fence"),
        Box(x=36.1, y=20.5, length=0.2, width=43.4, height=2.4, kind="fence"),
        Box(x=14.6, y=36.9, length=12.2, width=2.44, yaw=0.12, height=2.6, kind="container"),
        Box(x=-21.5, y=16.4, length=2.4, width=2.4, yaw=0.5, height=1.2, kind="pallets"),
    ]
    return Site(
        name="bay_01",
        title="bay between parked trailers at a dock wall",
        special="the showcase",
        obstacles=tuple(obstacles),
        bounds=(-40.0, -1.2, 36.2, 42.2),
        start=Flat(-27.0, 26.0, 0.0, 0.0),
        goal=backed_up(0.0, 0.5, _UP),
        areas=(
            Area(box=(-30.0, 18.0, 32.0, 38.0), weight=2.0),
            Area(box=(-14.0, 12.0, 18.0, 34.0), heading=_UP, spread=1.0, weight=2.0),
        ),
        map=Shapes(),
        cusps=(1, 3),
        length=(62.0, 82.0),
        seed=7,
        noise=1,
    )


def bay_02() -> Site:
    """Reverse bay from its blind side, slanted in the map."""
    obstacles: list[Obstacle] = [Box(x=0.0, y=-0.6, length=66.0, width=1.2, height=7.0, kind="building")]
    obstacles += [parked_trailer(x, 0.45, _UP) for x in (-23.0, -14.9, -10.8, 3.45, 7.5, 15.9)]
    obstacles += parked_combination(-3.35, 0.45, _UP)
    obstacles += [
        Wall(points=((-33.0, 40.0), (33.0, 40.0))),
        Box(x=-17.0, y=35.4, length=4.6, width=1.9, yaw=0.05, height=1.6, kind="car"),
        Box(x=-11.6, y=35.6, length=4.4, width=1.8, yaw=-0.04, height=1.5, kind="car"),
        Box(x=24.0, y=13.0, length=6.1, width=2.44, yaw=1.2, height=2.6, kind="container"),
    ]
    return Site(
        name="bay_02",
        title="bay between parked trailers, from its blind side",
        special="slanted in the map; hitch angle not logged",
        obstacles=tuple(obstacles),
        bounds=(-33.0, -1.2, 33.0, 40.2),
        start=Flat(27.0, 27.0, math.pi, 0.0),
        goal=backed_up(0.05, 0.5, _UP),
        areas=(
            Area(box=(-28.0, 17.0, 28.0, 37.0), weight=2.0),
            Area(box=(-16.0, 12.0, 16.0, 33.0), heading=_UP, spread=1.0, weight=2.0),
        ),
        map=Grid(resolution=0.2, speckles=25),
        pose=(84.0, 31.5, 0.35),
        has_trailer_path=False,
        has_path_nodes=False,
        cusps=(1, 3),
        length=(50.0, 100.0),
        seed=22,
        noise=20,
    )


def _slanted_row(yaw: float, pitch: float, taken: tuple[int, ...]) -> list[Obstacle]:
    """Parked trailers in slanted bays along the wall y = 0; bay k has its rear at (k pitch, 1)."""
    return [parked_trailer(k * pitch, 1.0, yaw) for k in taken]


def angled_01() -> Site:
    """Slanted bay, entered in the easy direction."""
    yaw = math.radians(60.0)
    obstacles = _slanted_row(yaw, 4.85, (-5, -4, -2, -1, 1, 2, 4))
    obstacles += [
        Wall(points=((-40.0, -0.2), (40.0, -0.2)), width=0.4, kind="wall"),
        Wall(points=((-40.0, 36.0), (12.0, 36.0), (20.0, 32.0), (40.0, 32.0))),
        Box(x=-8.0, y=32.5, length=13.6, width=2.55, yaw=0.0, kind="trailer"),
        Block(points=((27.0, 8.0), (33.0, 8.0), (35.0, 11.0), (33.0, 15.0), (28.0, 14.0))),
    ]
    return Site(
        name="angled_01",
        title="slanted bay",
        special="LINE_STRIP walls, TRIANGLE_LIST building; hitch angle not logged",
        obstacles=tuple(obstacles),
        bounds=(-40.2, -0.4, 40.2, 36.2),
        start=Flat(-33.0, 21.0, 0.0, 0.0),
        goal=backed_up(0.0, 1.0, yaw),
        areas=(
            Area(box=(-30.0, 16.0, 34.0, 31.0), weight=2.0),
            Area(box=(-6.0, 10.0, 22.0, 30.0), heading=yaw, spread=0.9, weight=2.0),
        ),
        map=Shapes(),
        pose=(-12.5, 140.0, 0.0),
        has_trailer_path=False,
        cusps=(2, 4),
        length=(45.0, 110.0),
        seed=42,
        noise=40,
    )


def angled_02() -> Site:
    """Slanted bay, entered against its direction."""
    yaw = math.radians(118.0)
    obstacles = _slanted_row(yaw, 4.75, (-5, -3, -2, -1, 1, 2, 3))
    obstacles += [
        Box(x=0.0, y=-0.8, length=72.0, width=1.2, height=7.0, kind="building"),
        Box(x=-29.0, y=31.0, length=14.0, width=9.0, height=6.0, kind="building"),
        Wall(points=((-36.0, 44.0), (36.0, 44.0), (36.0, 0.0))),
        Box(x=20.0, y=36.0, length=8.0, width=2.5, yaw=0.6, kind="truck"),
    ]
    return Site(
        name="angled_02",
        title="slanted bay, against its direction",
        special="cells of 0.15 m, origin turned, unknown behind the buildings' faces",
        obstacles=tuple(obstacles),
        bounds=(-36.0, -1.4, 36.2, 44.2),
        start=Flat(-20.0, 20.5, 0.0, 0.0),
        goal=backed_up(0.0, 1.0, yaw),
        areas=(
            Area(box=(-26.0, 16.0, 32.0, 40.0), weight=2.0),
            Area(box=(-18.0, 12.0, 14.0, 36.0), heading=yaw, spread=0.9, weight=2.0),
        ),
        map=Grid(resolution=0.15, yaw=0.5, speckles=30, solid=False),
        pose=(5.0, 2.0, 0.5),
        has_stamps=True,
        cusps=(1, 2),
        length=(42.0, 58.0),
        seed=65,
        noise=60,
    )


def dock_01() -> Site:
    """Dock at the end of a long alley off a street."""
    obstacles: list[Obstacle] = [
        Box(x=-21.0, y=14.0, length=34.6, width=36.0, height=9.0, kind="building"),
        Box(x=20.9, y=14.0, length=34.6, width=36.0, height=9.0, kind="building"),
        Box(x=0.0, y=-2.0, length=7.6, width=4.0, height=7.0, kind="building"),
        Box(x=0.0, y=58.5, length=78.0, width=3.0, height=6.0, kind="building"),
        Box(x=12.0, y=55.6, length=4.6, width=1.9, height=1.5, kind="car"),
        Box(x=18.4, y=55.5, length=5.2, width=2.0, height=1.9, kind="car"),
        Box(x=-23.0, y=33.6, length=3.0, width=1.6, yaw=0.2, height=1.4, kind="skip"),
    ]
    return Site(
        name="dock_01",
        title="dock at the end of an alley",
        special="cells of 0.2 m; long reverse drive",
        obstacles=tuple(obstacles),
        bounds=(-38.0, -4.0, 38.0, 60.0),
        start=Flat(-31.0, 44.0, 0.0, 0.0),
        goal=backed_up(0.0, 0.5, _UP),
        areas=(
            Area(box=(-30.0, 35.0, 32.0, 53.0), weight=2.0),
            Area(box=(-1.5, 6.0, 1.5, 40.0), heading=_UP, spread=0.3, weight=1.0),
            Area(box=(-8.0, 30.0, 12.0, 48.0), heading=_UP, spread=1.2, weight=1.5),
        ),
        map=Grid(resolution=0.2, speckles=15, solid=False),
        pose=(-3.0, 11.0, -0.12),
        cusps=(1, 3),
        length=(70.0, 130.0),
        seed=81,
        noise=80,
    )


def dock_02() -> Site:
    """Dock behind a funnel of walls."""
    obstacles: list[Obstacle] = [
        Box(x=0.0, y=-0.5, length=9.0, width=1.0, height=6.0, kind="building"),
        Wall(points=((-4.2, 0.0), (-4.2, 17.0), (-9.0, 24.0), (-36.0, 24.0)), width=0.3, kind="wall"),
        Wall(points=((4.2, 0.0), (4.2, 16.0), (7.0, 22.0)), width=0.3, kind="wall"),
        Block(points=((7.0, 6.0), (34.0, 6.0), (34.0, 24.0), (11.0, 24.0), (7.0, 20.0))),
        Wall(points=((-36.0, 47.0), (34.0, 47.0))),
        Box(x=-24.0, y=43.5, length=13.6, width=2.55, yaw=0.03, kind="trailer"),
        Box(x=22.0, y=28.0, length=5.0, width=2.2, yaw=0.9, height=2.6, kind="container"),
        Box(x=0.0, y=1.2, length=8.1, width=2.4, height=1.4, bottom=4.6, kind="canopy"),
    ]
    return Site(
        name="dock_02",
        title="dock behind a funnel of walls",
        special="LINE_STRIP walls, TRIANGLE_LIST building, a canopy above the trailer",
        obstacles=tuple(obstacles),
        bounds=(-36.2, -1.0, 34.2, 47.2),
        start=Flat(28.0, 39.0, math.pi, 0.0),
        goal=backed_up(0.0, 0.4, _UP),
        areas=(
            Area(box=(-32.0, 27.0, 30.0, 44.0), weight=2.0),
            Area(box=(-1.5, 6.0, 1.5, 26.0), heading=_UP, spread=0.3, weight=0.7),
            Area(box=(-10.0, 20.0, 10.0, 40.0), heading=_UP, spread=1.2, weight=1.5),
        ),
        map=Shapes(),
        pose=(410.0, -265.0, 1.1),
        has_stamps=True,
        cusps=(1, 3),
        length=(55.0, 110.0),
        seed=100,
        noise=100,
    )
