"""Public scenarios as sites: scenes that others test their parking planners on, described anew in our terms.

What is taken is geometry: outlines, starts and goals; the licences named here are those of the files that state it.
What was changed is said with each source; along the lane, the start is turned to its way. Scenes for cars are given
a trailer or enlarged to the size of a truck.
"""

import math
from collections.abc import Mapping
from types import MappingProxyType
from typing import Any, Final, NamedTuple

from optim.model.vehicle import Vehicle
from optim.planning.protocol import Area
from optim.steering.flat import Flat
from tools.corpus.site import Block, Grid, Shapes, Site

Points = tuple[tuple[float, float], ...]
_UP = math.pi / 2

TRAILER_ASTAR = "github.com/AtsushiSakai/HybridAStarTrailer, examples: rows of points closed into blocks, made longer"
FREESPACE = (
    "github.com/autowarefoundation/autoware_universe, planning/autoware_freespace_planning_algorithms/test:"
    " the car is given a trailer, start and goals moved to make room for it"
)
TPCAP = "github.com/libai1943/TPCAP_demo_Python, BenchmarkCases: enlarged 3.63 times, a car's length to a truck's"

ASTAR_TRUCK = Vehicle(
    wheelbase=3.7,
    truck_front=4.5,
    truck_rear=1.0,
    truck_width=2.6,
    hitch_to_axle=8.0,
    trailer_front=1.0,
    trailer_rear=9.0,
    trailer_width=2.6,
    max_steer=0.6,
)
CAR_WITH_TRAILER = Vehicle(
    wheelbase=3.0,
    truck_front=4.0,
    truck_rear=1.5,
    truck_width=2.0,
    hitch_to_axle=3.2,
    trailer_front=0.5,
    trailer_rear=4.4,
    trailer_width=1.8,
    max_steer=0.6,
    max_hitch=0.9,
)


class Ends(NamedTuple):
    """Trailer axle x, y [m] and heading [rad] of a straight combination at start and goal."""

    start: tuple[float, float, float]
    goal: tuple[float, float, float]


def _rectangle(x0: float, y0: float, x1: float, y1: float) -> Points:
    return ((x0, y0), (x1, y0), (x1, y1), (x0, y1))


def _site(number: int, title: str, blocks: tuple[Points, ...], ends: Ends, planner: str, **fields: Any) -> Site:
    return Site(
        name=f"public_{number:02d}",
        title=title,
        special="",
        obstacles=tuple(Block(points=points) for points in blocks),
        start=Flat(*ends.start, 0.0),
        goal=Flat(*ends.goal, 0.0),
        map=Grid(resolution=0.2) if number % 2 else Shapes(),
        has_trailer_path=True,
        spacing=0.3,
        cusps=(0, 12),
        length=(5.0, 400.0),
        seed=100 * number,
        noise=700 + number,
        planner=planner,
        **fields,
    )


def _perpendicular(number: int, planner: str, x: float, y: float, heading: float) -> Site:
    """Backing into a slot 8 m wide and 19 m deep."""
    blocks = (
        _rectangle(-38.0, 15.0, 38.0, 16.0),
        _rectangle(-38.0, -15.0, -4.0, 4.0),
        _rectangle(4.0, -15.0, 38.0, 4.0),
        _rectangle(-4.0, -16.0, 4.0, -15.0),
    )
    l_t = ASTAR_TRUCK.hitch_to_axle
    start = (x - l_t * math.cos(heading), y - l_t * math.sin(heading), heading)
    return _site(
        number,
        "slot across a lane",
        blocks,
        Ends(start, (0.0, -l_t, _UP)),
        planner,
        bounds=(-38.0, -16.0, 38.0, 16.0),
        areas=(
            Area(box=(-34.0, 5.0, 34.0, 14.0), weight=2.0),
            Area(box=(-3.0, -10.0, 3.0, 10.0), heading=_UP, spread=0.6),
        ),
        vehicle=ASTAR_TRUCK,
        source=TRAILER_ASTAR,
        licence="MIT",
    )


def _parallel(number: int, planner: str) -> Site:
    """A slot 20 m long and 5 m deep along a lane 10 m wide."""
    blocks = (
        _rectangle(-40.0, 15.0, 40.0, 16.0),
        _rectangle(-40.0, 0.0, -10.0, 5.0),
        _rectangle(10.0, 0.0, 40.0, 5.0),
        _rectangle(-10.0, -1.0, 10.0, 0.0),
    )
    l_t = ASTAR_TRUCK.hitch_to_axle
    return _site(
        number,
        "slot along a lane",
        blocks,
        Ends((-15.0 - l_t, 8.0, 0.0), (1.0 - l_t, 3.0, 0.0)),
        planner,
        bounds=(-40.0, -1.0, 40.0, 16.0),
        areas=(
            Area(box=(-36.0, 6.0, 36.0, 14.0), weight=2.0),
            Area(box=(-9.0, 2.0, 9.0, 10.0), heading=0.0, spread=0.7),
        ),
        vehicle=ASTAR_TRUCK,
        source=TRAILER_ASTAR,
        licence="MIT",
    )


def _freespace(number: int, planner: str, x: float) -> Site:
    """A car with a trailer, backed into a bay of a small car park."""
    blocks = (
        _rectangle(8.0, 9.0, 28.0, 9.5),
        *(_rectangle(left, 22.0, left + 2.75, 27.5) for left in (10.0, 13.5, 20.0)),
        _rectangle(10.0, 10.0, 12.75, 15.5),
        _rectangle(0.0, 0.0, 30.0, 2.0),
        _rectangle(0.0, 28.0, 30.0, 30.0),
        _rectangle(0.0, 2.0, 2.0, 28.0),
        _rectangle(28.0, 2.0, 30.0, 28.0),
    )
    return _site(
        number,
        "bay of a car park",
        blocks,
        Ends((5.5, 5.0, _UP), (x, 26.3, -_UP)),
        planner,
        bounds=(0.0, 0.0, 30.0, 30.0),
        areas=(Area(box=(3.0, 4.0, 27.0, 24.0), weight=2.0), Area(box=(x - 1.0, 17.0, x + 1.0, 26.0), heading=-_UP)),
        vehicle=CAR_WITH_TRAILER,
        source=FREESPACE,
        licence="Apache-2.0",
    )


_TPCAP_BLOCKS: Final[Mapping[int, tuple[Points, ...]]] = MappingProxyType(
    {
        1: (
            ((-97.1, -79.6), (-46.6, -59.4), (-49.2, -52.9), (-99.7, -73.0)),
            ((-24.0, -50.4), (26.6, -30.2), (24.0, -23.7), (-26.6, -43.9)),
            ((-94.2, -85.8), (27.7, -40.7), (22.8, -32.9), (-96.8, -80.8)),
        ),
        2: (
            ((31.0, -80.1), (-6.6, -40.7), (-18.9, -52.4), (18.7, -91.8)),
            ((-14.1, -32.8), (-51.7, 6.6), (-64.0, -5.1), (-26.4, -44.5)),
            ((-77.7, -20.0), (-10.7, -91.5), (5.9, -80.3), (-64.8, -6.9)),
        ),
        10: (
            ((-16.7, 19.7), (-24.8, 18.5), (-12.9, 5.2), (8.3, 12.0)),
            ((12.4, -72.6), (36.2, -55.0), (11.0, -39.4), (-1.8, -71.0)),
            ((60.7, 27.7), (51.4, 31.1), (49.9, 20.9), (54.0, 5.7), (79.8, -0.2)),
            ((60.1, 40.9), (61.9, 41.8), (56.9, 48.5), (34.2, 60.6), (31.6, 27.7)),
            ((18.3, 12.3), (49.1, -6.2), (56.4, 4.5), (44.0, 17.6), (28.9, 16.6)),
        ),
    }
)


def _tpcap(number: int, planner: str, case: int, ends: Ends, bounds: tuple[float, float, float, float]) -> Site:
    """One of the cases of the trajectory planning competition of 2022, for a truck."""
    x0, y0, x1, y1 = bounds
    x, y, heading = ends.goal
    return _site(
        number,
        f"competition case {case}",
        _TPCAP_BLOCKS[case],
        ends,
        planner,
        bounds=bounds,
        areas=(
            Area(box=(x0 + 4.0, y0 + 4.0, x1 - 4.0, y1 - 4.0), weight=2.0),
            Area(box=(x - 12.0, y - 12.0, x + 12.0, y + 12.0), heading=heading, spread=1.0),
        ),
        source=TPCAP,
        licence="BSD-2-Clause",
    )


_ALL: Final = (
    _perpendicular(1, "Hybrid A*", 14.0, 10.0, 0.0),
    _perpendicular(2, "CL-RRT", -20.0, 6.0, 0.0),
    _perpendicular(3, "Hybrid A*", -20.0, 12.0, math.pi),
    _parallel(4, "CL-RRT"),
    _freespace(5, "Hybrid A*", 18.1),
    _tpcap(6, "CL-RRT", 1, Ends((-58.2, -49.0, 0.2), (-41.4, -53.5, 0.379)), (-88.0, -83.0, -12.0, -20.0)),
    _tpcap(7, "CL-RRT", 2, Ends((-32.1, 2.3, -0.99), (-20.2, -46.1, 0.761)), (-62.0, -76.0, 9.0, 32.0)),
    _tpcap(8, "Hybrid A*", 10, Ends((4.3, 20.5, -3.973), (44.8, -59.6, -6.117)), (-25.0, -89.0, 74.0, 50.0)),
)
PUBLIC: Final[Mapping[str, Site]] = MappingProxyType({site.name: site for site in _ALL})
"""Sites of public scenarios by the names of their logs."""
