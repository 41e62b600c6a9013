"""Every planner: its paths pass the audit, the same seed gives the same path, and it ends where there is none."""

from dataclasses import asdict
from functools import partial

import numpy as np
import pytest

from optim.audit.checks import audit_recorded
from optim.model.flat_map import state_from_flat
from optim.model.path import Path
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle
from optim.planning.closed_loop import ClosedLoopRrt
from optim.planning.drive_kernels import drive
from optim.planning.hybrid import HybridAStar, way_round
from optim.planning.lookup import lookup_table
from optim.planning.protocol import Area, Planner, PlanningProblem
from optim.planning.rrt import Rrt
from optim.steering.flat import Flat
from replay.run.plain import path_to_document, scene_to_document
from tools.corpus.site import Wall

VEHICLE = Vehicle()
OUTLINE = [[-40.0, -20.0], [40.0, -20.0], [40.0, 20.0], [-40.0, 20.0]]
small_table = partial(lookup_table, half=5)
PLANNERS: dict[str, Planner] = {
    "tree": Rrt(),
    "closed loop": ClosedLoopRrt(table=small_table),
    "hybrid": HybridAStar(table=small_table),
}
BOUNDED: dict[str, Planner] = {
    "tree": Rrt(max_iterations=40),
    "closed loop": ClosedLoopRrt(table=small_table, max_iterations=60),
    "hybrid": HybridAStar(table=small_table, max_nodes=2000),
}


def make_problem(low: float) -> PlanningProblem:
    """From one side to the other of a wall that begins at `low`."""
    walls = Wall(points=((0.0, -20.0), (0.0, low)), width=1.0).parts()
    return PlanningProblem(
        vehicle=VEHICLE,
        scene=make_scene(walls, boundary=OUTLINE),
        start=Flat(-24.0, 0.0, 0.0, 0.05),
        goal=Flat(14.0, 3.0, 0.4, 0.0),
        areas=[Area(box=(-25.0, -14.0, 25.0, 14.0))],
        margin=0.3,
    )


def samples(path: Path) -> np.ndarray:
    return np.column_stack([path.samples.states, path.samples.phi])


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANNERS)
@pytest.mark.parametrize("seed", [1, 2])
def test_a_plan_passes_the_audit_and_ends_where_asked(name: str, seed: int) -> None:
    problem = make_problem(-3.0)
    plan = PLANNERS[name].plan(problem, seed)
    assert plan is not None
    report = audit_recorded(asdict(VEHICLE), scene_to_document(problem.scene), path_to_document(plan.path))
    assert report.passed, report.failures
    ends, _ = state_from_flat(VEHICLE, np.array([problem.start, problem.goal]))
    np.testing.assert_allclose(plan.path.start, ends[0], atol=1e-9)
    np.testing.assert_allclose(plan.path.goal[[0, 1, 3]], ends[1, [0, 1, 3]], atol=1e-6)
    assert np.cos(plan.path.goal[2] - ends[1, 2]) == pytest.approx(1.0)
    assert plan.nodes[0] == 0.0
    assert plan.nodes[-1] == pytest.approx(plan.path.length)
    assert (np.diff(plan.nodes) > 0.0).all()


@pytest.mark.slow
@pytest.mark.parametrize("name", PLANNERS)
def test_the_same_seed_gives_the_same_path_and_another_seed_another(name: str) -> None:
    problem = make_problem(1.0)
    first, again, other = (PLANNERS[name].plan(problem, seed) for seed in (5, 5, 6))
    assert first is not None
    assert again is not None
    assert other is not None
    assert (samples(first.path) == samples(again.path)).all()
    assert not np.array_equal(samples(first.path), samples(other.path))


@pytest.mark.parametrize("name", BOUNDED)
def test_a_planner_ends_where_there_is_no_way_or_no_time(name: str) -> None:
    assert BOUNDED[name].plan(make_problem(20.0), 0) is None
    assert PLANNERS[name].plan(make_problem(20.0), 0, give_up=lambda: True) is None


def test_the_way_round_obstacles_is_as_long_as_the_plane_asks() -> None:
    problem = make_problem(10.0)
    field, (x0, y0, size) = way_round(problem)
    ends, _ = state_from_flat(VEHICLE, np.array([problem.start, problem.goal]))
    (start, goal), corner = ends[:, :2], np.array([0.0, 10.0])
    direct = np.hypot(*(goal - start))
    least = np.hypot(*(corner - start)) + np.hypot(*(goal - corner))
    i, j = int((start[0] - x0) / size), int((start[1] - y0) / size)
    assert direct < least - 2.0 < field[i, j] < 1.09 * least + 4.0
    assert field[int((0.0 - x0) / size), int((0.0 - y0) / size)] == np.inf, "inside the wall"


def driven(gear: int, offset: float, turn: float, alpha: float, spare: float = 1.0) -> tuple[np.ndarray, np.ndarray]:
    """States and steering of a closed-loop drive of 60 m along the x axis from beside it."""
    heading = turn - alpha if gear < 0 else turn
    l_t = VEHICLE.hitch_to_axle
    start = np.array([0.0, offset, heading, alpha])
    far = (gear * 200.0, 0.0, 0.0)
    options = ClosedLoopRrt()
    look = options.look_ahead if gear > 0 else options.look_behind
    law = (look * l_t, options.settle * l_t, 0.6 * VEHICLE.max_kappa, spare * VEHICLE.max_steer)
    limits = (VEHICLE.max_hitch, VEHICLE.max_steer_rate)
    s, states, phi = np.empty(602), np.empty((602, 4)), np.empty(602)
    count = drive(start, 0.0, False, float(gear), far, 60.0, 0.1, law, limits, VEHICLE.kinematics, s, states, phi)
    return states[:count], phi[:count]


@pytest.mark.parametrize("gear", [1, -1])
@pytest.mark.parametrize(("offset", "turn", "alpha"), [(3.0, 0.0, 0.0), (-2.0, 0.4, 0.3), (0.0, -0.5, -0.5)])
def test_the_controller_brings_the_combination_to_its_line_in_either_gear(
    gear: int, offset: float, turn: float, alpha: float
) -> None:
    states, phi = driven(gear, offset, turn, alpha)
    assert len(states) == 601
    heading = states[:, 2] + states[:, 3]
    axle = states[:, 1] - VEHICLE.hitch_to_axle * np.sin(heading)
    assert abs(states[-1, 3]) < 0.05, "the hitch has settled"
    assert abs(heading[-1]) < 0.04
    assert abs(axle[-1]) < 0.2
    assert np.abs(np.diff(phi)).max() <= 0.1 * VEHICLE.max_steer_rate + 1e-12
    assert np.abs(phi).max() <= VEHICLE.max_steer


def test_without_the_controller_a_reverse_drive_folds_up() -> None:
    states, _ = driven(-1, 0.0, 0.0, 0.1, spare=0.0)  # steering stays straight
    assert len(states) < 400
    assert abs(states[-1, 3]) > 0.9 * VEHICLE.max_hitch
