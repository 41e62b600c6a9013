"""The sites of the corpus away from a dock: parking along a kerb, turning in a narrow yard, cluttered lots."""

import math

import numpy as np

from optim.model.vehicle import Vehicle
from optim.planning.protocol import Area, place
from optim.steering.flat import Flat
from tools.corpus.site import Box, Grid, Obstacle, Shapes, Site, Wall
from tools.corpus.yards import backed_up, parked_combination, parked_trailer

CITY = Vehicle(
    wheelbase=3.4,
    truck_front=4.6,
    truck_rear=0.9,
    truck_width=2.5,
    hitch_to_axle=5.6,
    trailer_front=1.2,
    trailer_rear=8.4,
    trailer_width=2.5,
)
"""A truck with a short city trailer."""

LONG = Vehicle(hitch_to_axle=12.036, trailer_front=1.4, trailer_rear=14.6)
"""The combination that the author of the methods' source used."""


def parallel_01() -> Site:
    """A gap along a kerb between two parked combinations."""
    obstacles: list[Obstacle] = [Wall(points=((-48.0, 0.0), (48.0, 0.0)), width=0.3, kind="kerb")]
    obstacles += parked_combination(12.9, 1.9, 0.0)
    obstacles += parked_combination(-31.0, 1.85, 0.0)
    obstacles += [
        Box(x=38.5, y=1.8, length=4.7, width=1.9, height=1.5, kind="car"),
        Wall(points=((-48.0, 18.5), (48.0, 18.5)), width=0.3, kind="kerb"),
        Box(x=-34.0, y=17.2, length=4.5, width=1.8, height=1.5, kind="car"),
        Box(x=-2.0, y=17.1, length=4.8, width=1.9, height=1.6, kind="car"),
        Box(x=9.0, y=17.2, length=4.3, width=1.8, height=1.5, kind="car"),
        Box(x=27.0, y=16.9, length=7.2, width=2.3, height=2.9, kind="van"),
    ]
    return Site(
        name="parallel_01",
        title="gap along a kerb",
        special="start with a bent hitch; poses with stamps",
        obstacles=tuple(obstacles),
        bounds=(-48.0, -0.2, 48.0, 18.7),
        start=Flat(-38.0, 9.0, 0.12, -0.02),
        goal=backed_up(-9.4, 1.9, 0.0),
        areas=(
            Area(box=(-36.0, 4.0, 36.0, 14.0), spread=0.7, weight=2.0),
            Area(box=(-12.0, 1.8, 22.0, 10.0), spread=0.6, weight=2.0),
        ),
        map=Shapes(),
        pose=(0.0, 55.0, -0.8),
        has_stamps=True,
        cusps=(2, 5),
        length=(50.0, 120.0),
        seed=120,
        noise=120,
    )


def parallel_02() -> Site:
    """A gap along a warehouse, reached through a gate."""
    obstacles: list[Obstacle] = [
        Box(x=0.0, y=-3.0, length=64.0, width=6.0, height=8.0, kind="building"),
        Box(x=16.6, y=1.7, length=9.0, width=2.5, kind="truck"),
        Box(x=-15.6, y=1.75, length=12.0, width=2.5, kind="truck"),
        Wall(points=((-32.0, 22.0), (-22.0, 22.0))),
        Wall(points=((-13.0, 22.0), (32.0, 22.0), (32.0, 0.0))),
        Box(x=21.0, y=19.5, length=6.1, width=2.44, yaw=0.08, height=2.6, kind="container"),
        Box(x=4.5, y=20.0, length=2.4, width=1.6, yaw=0.4, height=1.2, kind="pallets"),
        Box(x=-28.0, y=18.0, length=4.5, width=1.8, yaw=1.4, height=1.5, kind="car"),
    ]
    return Site(
        name="parallel_02",
        title="gap along a warehouse, through a gate",
        special="short city trailer; origin turned; no planner nodes; hitch angle not logged",
        obstacles=tuple(obstacles),
        bounds=(-32.0, -6.0, 32.2, 44.0),
        start=Flat(-17.5, 36.0, -math.pi / 2, 0.0),
        goal=backed_up(-6.0, 2.0, 0.0, CITY),
        areas=(
            Area(box=(-26.0, 4.0, 28.0, 18.0), weight=2.0),
            Area(box=(-8.0, 1.8, 18.0, 12.0), spread=0.7, weight=2.0),
            Area(box=(-20.0, 16.0, -15.0, 34.0), heading=-math.pi / 2, spread=0.4, weight=0.6),
        ),
        map=Grid(resolution=0.2, yaw=-0.7, speckles=20, unknown=(Box(x=10, y=34, length=42, width=18),)),
        vehicle=CITY,
        pose=(-20.0, -20.0, -0.7),
        has_trailer_path=False,
        has_path_nodes=False,
        cusps=(5, 5),
        length=(50.0, 130.0),
        seed=199,
        noise=140,
    )


def yard_01() -> Site:
    """Turning round in a narrow yard."""
    obstacles: list[Obstacle] = [
        Wall(points=((-30.0, 3.0), (-30.0, 0.0), (34.0, 0.0), (34.0, 31.0), (-30.0, 31.0), (-30.0, 15.0))),
        Box(x=-17.0, y=29.0, length=13.6, width=2.55, kind="trailer"),
        Box(x=29.0, y=3.2, length=6.1, width=2.44, yaw=0.3, height=2.6, kind="container"),
        Box(x=30.5, y=27.8, length=3.0, width=3.0, yaw=0.7, height=3.0, kind="tank"),
        Box(x=-4.0, y=1.4, length=4.5, width=1.8, height=1.5, kind="car"),
        Box(x=1.6, y=1.4, length=4.5, width=1.8, height=1.5, kind="car"),
        Box(x=-30.0, y=9.0, length=0.4, width=12.4, height=0.6, bottom=5.0, kind="beam"),
    ]
    return Site(
        name="yard_01",
        title="turning round in a narrow yard",
        special="a beam above the gate; no planner nodes; hitch angle not logged",
        obstacles=tuple(obstacles),
        bounds=(-46.0, -0.2, 34.2, 31.2),
        start=Flat(-36.0, 9.0, 0.0, 0.0),
        goal=Flat(-12.0, 21.5, math.pi, 0.0),
        areas=(Area(box=(-28.0, 3.0, 31.0, 28.0), weight=1.0),),
        map=Shapes(),
        pose=(17.0, -9.0, 0.6),
        has_trailer_path=False,
        has_path_nodes=False,
        cusps=(4, 5),
        length=(60.0, 130.0),
        seed=170,
        noise=160,
    )


def yard_02() -> Site:
    """Round the corner of an L-shaped yard, and backwards into its end."""
    obstacles: list[Obstacle] = [
        Wall(points=((-38.0, 0.0), (20.0, 0.0), (20.0, 50.0)), width=0.4, kind="wall"),
        Wall(points=((-38.0, 24.0), (-6.0, 24.0), (-4.0, 26.0), (-4.0, 50.0)), width=0.4, kind="wall"),
        Wall(points=((-4.0, 50.0), (20.0, 50.0)), width=0.4, kind="wall"),
        Wall(points=((-38.0, 0.0), (-38.0, 24.0)), width=0.4, kind="wall"),
        parked_trailer(1.1, 49.0, -math.pi / 2),
        Box(x=17.4, y=3.0, length=3.0, width=2.0, yaw=0.5, height=1.5, kind="skip"),
        Box(x=-20.0, y=21.6, length=6.1, width=2.44, height=2.6, kind="container"),
        Box(x=16.9, y=27.0, length=2.4, width=2.4, yaw=0.2, height=1.4, kind="pallets"),
    ]
    return Site(
        name="yard_02",
        title="round the corner of a narrow yard",
        special="cells of 0.25 m, walls slanted in the grid; start with a bent hitch",
        obstacles=tuple(obstacles),
        bounds=(-38.2, -0.2, 20.2, 50.2),
        start=Flat(-30.0, 7.0, 0.1, 0.03),
        goal=backed_up(7.6, 48.6, -math.pi / 2),
        areas=(
            Area(box=(-30.0, 4.0, 16.0, 20.0), weight=2.0),
            Area(box=(-1.0, 4.0, 16.0, 44.0), heading=-math.pi / 2, spread=1.0, weight=2.0),
        ),
        map=Grid(resolution=0.25, yaw=0.2, speckles=20),
        pose=(60.0, 8.0, 0.55),
        cusps=(2, 5),
        length=(50.0, 130.0),
        clearance=0.2,
        seed=234,
        noise=180,
    )


def lot_01() -> Site:
    """A lot full of containers and cars at all angles."""
    things = (
        (-13.0, 8.0, 12.2, 2.44, 0.5), (-7.0, 23.0, 6.1, 2.44, -0.7), (8.0, 10.0, 6.1, 2.44, 1.1),
        (25.0, 5.0, 12.2, 2.44, 0.2), (2.0, 42.0, 12.2, 2.44, -0.15), (-24.0, 28.0, 4.5, 1.8, 0.9),
        (-27.0, 36.0, 4.6, 1.9, 0.2), (33.0, 21.0, 4.5, 1.8, 1.3), (8.0, 27.0, 1.0, 1.0, 0.4),
        (-14.0, 40.0, 1.0, 1.0, 0.0), (-2.0, 3.0, 2.4, 1.2, 0.8),
    )  # fmt: skip
    slot = math.radians(235.0)  # between two containers, nose out
    beside = [place(np.array([[6.6, side]]), (28.0, 43.0, slot))[0].tolist() for side in (-3.3, 3.4)]
    things += tuple((round(x, 3), round(y, 3), 12.2, 2.44, slot) for x, y in beside)
    obstacles: list[Obstacle] = [
        Box(x=x, y=y, length=a, width=b, yaw=yaw, height=2.6, kind="container") for x, y, a, b, yaw in things
    ]
    return Site(
        name="lot_01",
        title="cluttered lot",
        special="cells of 0.1 m, obstacles slanted in the grid",
        obstacles=tuple(obstacles),
        bounds=(-36.0, -2.0, 38.0, 50.0),
        start=Flat(-28.0, 14.0, 0.1, 0.0),
        goal=backed_up(28.0, 43.0, slot),
        areas=(
            Area(box=(-32.0, 2.0, 34.0, 46.0), weight=2.0),
            Area(box=(0.0, 8.0, 30.0, 38.0), heading=slot, spread=1.0, weight=1.5),
        ),
        map=Grid(resolution=0.1, speckles=30),
        pose=(-8.0, -30.0, 0.0),
        cusps=(2, 5),
        length=(50.0, 130.0),
        seed=211,
        noise=200,
    )


def lot_02() -> Site:
    """A lot of container rows for a long trailer."""
    rows = [(-22.0, 12.0), (-9.0, 12.0), (-22.0, 14.6), (18.0, 11.0), (31.0, 11.0), (18.0, 13.6), (-20.0, 44.0)]
    obstacles: list[Obstacle] = [
        Box(x=x, y=y, length=12.2, width=2.44, yaw=0.0, height=2.6, kind="container") for x, y in rows
    ]
    obstacles += [
        Box(x=8.0, y=44.0, length=12.2, width=2.44, yaw=0.15, height=5.2, kind="container"),
        Box(x=31.0, y=40.0, length=6.1, width=2.44, yaw=1.1, height=2.6, kind="container"),
        Box(x=-38.0, y=29.0, length=0.6, width=0.6, height=8.0, kind="mast"),
        Box(x=2.0, y=30.0, length=0.6, width=0.6, height=8.0, kind="mast"),
        Wall(points=((-46.0, 0.0), (44.0, 0.0), (44.0, 56.0), (-46.0, 56.0)), kind="fence"),
    ]
    return Site(
        name="lot_02",
        title="container lot",
        special="hitch to axle 12.036 m; a container taken away before; no planner nodes; hitch angle not logged",
        obstacles=tuple(obstacles),
        bounds=(-62.0, -0.2, 44.2, 56.2),
        start=Flat(-50.0, 22.0, 0.0, 0.0),
        goal=backed_up(4.6, 2.5, math.pi / 2, LONG),
        areas=(
            Area(box=(-40.0, 18.0, 38.0, 50.0), weight=2.0),
            Area(box=(-8.0, 14.0, 18.0, 44.0), heading=math.pi / 2, spread=1.0, weight=2.0),
        ),
        map=Shapes(removed=(Box(x=4.6, y=12.5, length=12.2, width=2.44, height=2.6, kind="container"),)),
        vehicle=LONG,
        pose=(250.0, 75.0, -2.2),
        has_trailer_path=False,
        has_path_nodes=False,
        cusps=(1, 5),
        length=(70.0, 130.0),
        seed=222,
        noise=220,
    )
