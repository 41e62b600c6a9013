"""The look-up table of distances: what it holds, between its nodes, its symmetries, and its file."""

import math
from pathlib import Path

import numpy as np
import pytest

from optim.model.vehicle import Vehicle
from optim.planning.lookup import BEND, CELL, HEADINGS, Table, build_table, exact_length, node_pose
from optim.steering.flat import Flat
from tools.corpus.tables import kept_table

VEHICLE = Vehicle()
HALF = 4
LONGEST = 96.0
ORIGIN = Flat(0.0, 0.0, 0.0, 0.0)


@pytest.fixture(scope="module")
def folder(tmp_path_factory: pytest.TempPathFactory) -> Path:
    return tmp_path_factory.mktemp("cache")


@pytest.fixture(scope="module")
def table(folder: Path) -> Table:
    return kept_table(VEHICLE, HALF, folder)


def random_pair(rng: np.random.Generator, bend: float) -> tuple[Flat, Flat]:
    reach = 0.95 * HALF * CELL * VEHICLE.hitch_to_axle
    k0, k1 = rng.integers(-1, 2, 2) * bend
    x, y = rng.uniform(-reach, reach, 2)
    return Flat(0.0, 0.0, 0.0, k0), Flat(x, y, rng.uniform(-math.pi, math.pi), k1)


def placed(flat: Flat, x: float, y: float, yaw: float) -> Flat:
    c, s = math.cos(yaw), math.sin(yaw)
    return Flat(x + c * flat.x - s * flat.y, y + s * flat.x + c * flat.y, flat.theta + yaw, flat.kappa)


def test_the_grid_is_scaled_by_the_vehicle(table: Table) -> None:
    assert table.cell == CELL * VEHICLE.hitch_to_axle
    assert table.bend == pytest.approx(BEND * VEHICLE.max_kappa)
    assert table.values.shape == (3, 3, 2 * HALF + 1, HALF + 1, HEADINGS)
    assert 0.2 < np.isfinite(table.values).mean() < 1.0


def test_at_its_nodes_the_table_says_what_the_local_planner_says(table: Table) -> None:
    rng, connected = np.random.default_rng(0), 0
    for _ in range(300):
        a, b, i, j, k = (int(rng.integers(n)) for n in table.values.shape)
        x, y, heading = node_pose(HALF, table.cell, i, j, k)
        start, end = Flat(0.0, 0.0, 0.0, (a - 1) * table.bend), Flat(x, y, heading, (b - 1) * table.bend)
        exact = exact_length(VEHICLE, start, end, LONGEST)
        connected += math.isfinite(exact)
        # the last bit of a heading of half a turn decides on which side a loop is driven
        assert table.values[a, b, i, j, k] == pytest.approx(exact, abs=0.006) or abs(heading) > 3.14
    assert 100 < connected < 300


def test_between_its_nodes_the_table_is_off_by_less_than_a_cell(table: Table) -> None:
    rng, errors, unknown = np.random.default_rng(1), [], 0
    for _ in range(600):
        start, end = random_pair(rng, table.bend)
        about, exact = table.forward(start, end), exact_length(VEHICLE, start, end, LONGEST)
        if math.isfinite(about) and math.isfinite(exact):
            errors.append(abs(about - exact))
        unknown += math.isfinite(about) != math.isfinite(exact)
    assert len(errors) > 300
    assert np.median(errors) < 0.5 * table.cell
    # beside a jump from one kind of connection to another, both are right half a cell further
    assert np.quantile(errors, 0.75) < table.cell
    assert unknown < 0.15 * 600


def test_the_table_is_symmetric_where_the_mathematics_says_so(table: Table) -> None:
    rng = np.random.default_rng(2)
    asymmetric = 0
    for _ in range(200):
        start, end = random_pair(rng, table.bend)
        mirrored = [Flat(f.x, -f.y, -f.theta, -f.kappa) for f in (start, end)]
        assert table.forward(*mirrored) == pytest.approx(table.forward(start, end))
        assert table.reverse(end, start) == table.forward(start, end)
        assert table.distance(start, end) == table.distance(end, start)
        moved = [placed(flat, 70.0, -30.0, 1.3) for flat in (start, end)]
        assert table.forward(*moved) == pytest.approx(table.forward(start, end), abs=1e-6)
        turned = [Flat(f.x, f.y, f.theta + math.pi, -f.kappa) for f in (end, start)]
        asymmetric += table.forward(*turned) != pytest.approx(table.forward(start, end), abs=0.1)
    assert asymmetric > 20, "a path turned end to end is another path: the truck leads on one of the two only"


def test_beyond_the_grid_and_where_nothing_is_known_there_is_still_a_distance(table: Table) -> None:
    assert table.distance(ORIGIN, Flat(100.0, 0.0, 0.0, 0.0)) == pytest.approx(100.0, abs=1.0)
    assert table.distance(ORIGIN, Flat(-100.0, 0.0, 0.0, 0.0)) == pytest.approx(100.0, abs=1.0)
    rng = np.random.default_rng(3)
    for _ in range(200):
        start, end = random_pair(rng, table.bend)
        assert math.hypot(end.x, end.y) - table.cell < table.distance(start, end) < 60.0


def test_a_table_is_read_back_from_its_file_and_not_for_another_vehicle(table: Table, folder: Path) -> None:
    (path,) = folder.glob("lookup-*.npy")
    before = path.stat().st_mtime_ns
    kept_table.cache_clear()
    again = kept_table(VEHICLE, HALF, folder)
    assert (again.values == table.values).all()
    assert (again.values == build_table(VEHICLE, HALF).values).all()
    assert path.stat().st_mtime_ns == before
    kept_table(Vehicle(max_steer=0.5), 2, folder)
    assert len(list(folder.glob("lookup-*.npy"))) == 2
