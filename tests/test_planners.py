"""Every planner: its paths pass the audit, the same seed gives the same path, and it ends where there is none."""

from dataclasses import asdict

import numpy as np
import pytest

from optim.audit import audit_recorded
from optim.path import Path
from optim.scene import make_scene
from optim.steering.flat import Flat
from optim.vehicle import Vehicle, state_from_flat
from replay.results import path_to_document, scene_to_document
from tools.corpus.rrt import Search
from tools.corpus.site import Area, Wall
from tools.planners.exact_tree import ExactTree
from tools.planners.hybrid import HybridAStar, way_round
from tools.planners.protocol import Planner, Task

VEHICLE = Vehicle()
OUTLINE = [[-40.0, -20.0], [40.0, -20.0], [40.0, 20.0], [-40.0, 20.0]]
PLANNERS: dict[str, Planner] = {
    "tree": ExactTree(),
    "hybrid": HybridAStar(table_half=5),
}
BOUNDED: dict[str, Planner] = {
    "tree": ExactTree(search=Search(max_iterations=40)),
    "hybrid": HybridAStar(table_half=5, max_nodes=2000),
}


def make_task(low: float) -> Task:
    """From one side to the other of a wall that begins at `low`."""
    walls = Wall(points=((0.0, -20.0), (0.0, low)), width=1.0).parts()
    return Task(
        vehicle=VEHICLE,
        scene=make_scene(walls, boundary=OUTLINE),
        start=Flat(-24.0, 0.0, 0.0, 0.05),
        goal=Flat(14.0, 3.0, 0.4, 0.0),
        areas=[Area(box=(-25.0, -14.0, 25.0, 14.0))],
        margin=0.3,
    )


def samples(path: Path) -> np.ndarray:
    return np.column_stack([path.samples.states, path.samples.phi])


@pytest.mark.parametrize("name", PLANNERS)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_plan_passes_the_audit_and_ends_where_asked(name: str, seed: int) -> None:
    task = make_task(-3.0)
    plan = PLANNERS[name].plan(task, seed)
    assert plan is not None
    report = audit_recorded(asdict(VEHICLE), scene_to_document(task.scene), path_to_document(plan.path))
    assert report.passed, report.failures
    ends, _ = state_from_flat(VEHICLE, np.array([task.start, task.goal]))
    np.testing.assert_allclose(plan.path.start, ends[0], atol=1e-9)
    np.testing.assert_allclose(plan.path.goal[[0, 1, 3]], ends[1, [0, 1, 3]], atol=1e-6)
    assert np.cos(plan.path.goal[2] - ends[1, 2]) == pytest.approx(1.0)
    assert plan.nodes[0] == 0.0
    assert plan.nodes[-1] == pytest.approx(plan.path.length)
    assert (np.diff(plan.nodes) > 0.0).all()


@pytest.mark.parametrize("name", PLANNERS)
def test_the_same_seed_gives_the_same_path_and_another_seed_another(name: str) -> None:
    task = make_task(1.0)
    first, again, other = (PLANNERS[name].plan(task, seed) for seed in (5, 5, 6))
    assert first is not None
    assert again is not None
    assert other is not None
    assert (samples(first.path) == samples(again.path)).all()
    assert not np.array_equal(samples(first.path), samples(other.path))


@pytest.mark.parametrize("name", BOUNDED)
def test_a_planner_ends_where_there_is_no_way_or_no_time(name: str) -> None:
    assert BOUNDED[name].plan(make_task(20.0), 0) is None
    assert PLANNERS[name].plan(make_task(20.0), 0, time_limit=0.0) is None


def test_the_way_round_obstacles_is_as_long_as_the_plane_asks() -> None:
    task = make_task(10.0)
    field, (x0, y0, size) = way_round(task)
    ends, _ = state_from_flat(VEHICLE, np.array([task.start, task.goal]))
    (start, goal), corner = ends[:, :2], np.array([0.0, 10.0])
    direct = np.hypot(*(goal - start))
    least = np.hypot(*(corner - start)) + np.hypot(*(goal - corner))
    i, j = int((start[0] - x0) / size), int((start[1] - y0) / size)
    assert direct < least - 2.0 < field[i, j] < 1.09 * least + 4.0
    assert field[int((0.0 - x0) / size), int((0.0 - y0) / size)] == np.inf, "inside the wall"
