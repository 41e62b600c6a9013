import dataclasses

import numpy as np
import pytest
import shapely
from scenes import random_problem
from shapely.geometry.base import BaseGeometry

from optim.methods.shortcut import Shortcut
from optim.model.objective import objective
from optim.model.path import Path, Segment, roll_out_segment
from optim.model.problem import Problem, path_clearance
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle, body_corners

VEHICLE = Vehicle()
BOTH = pytest.mark.parametrize("variant", ["random", "deterministic"])


def _straight(start: float, end: float) -> Segment:
    s = np.linspace(0.0, abs(end - start), 101)
    return roll_out_segment(VEHICLE, np.array([start, 0.0, 0.0, 0.0]), 1 if end > start else -1, s, np.zeros(101))


def _needless_cusps() -> Problem:
    """Forward 20 m, back 10 m, forward 20 m, all on one line."""
    path = Path((_straight(0, 20), _straight(20, 10), _straight(10, 30)))
    return Problem(vehicle=VEHICLE, scene=make_scene([]), recorded=path)


@BOTH
def test_needless_gear_changes_disappear(variant):
    result = Shortcut(variant=variant).solve(_needless_cusps())
    assert result.path.num_cusps == 0
    assert result.path.length == pytest.approx(30.0, abs=1e-3)
    np.testing.assert_allclose(result.path.goal, [30.0, 0.0, 0.0, 0.0], atol=1e-9)


@BOTH
@pytest.mark.parametrize("cost", ["objective", "trailer_length"])
def test_every_accepted_iterate_lowers_the_chosen_cost(variant, cost):
    problem = random_problem(1)
    values = []

    def note(iterate):
        path = iterate.path
        values.append(path.trailer_length if cost == "trailer_length" else objective(path, problem.weights))

    Shortcut(variant=variant, cost=cost, tries=300).solve(problem, note)
    assert len(values) > 1
    assert (np.diff(values) < 1e-6).all()


@BOTH
def test_ends_and_joints_are_exact(variant):
    problem = random_problem(2)
    path = Shortcut(variant=variant).solve(problem).path
    np.testing.assert_array_equal(path.start, problem.recorded.start)
    turns = (path.goal - problem.recorded.goal) / (2 * np.pi)
    np.testing.assert_allclose(turns, np.round(turns), atol=1e-12)
    for before, after in zip(path.segments, path.segments[1:], strict=False):
        np.testing.assert_array_equal(before.states[-1], after.states[0])


@BOTH
def test_the_steering_stays_continuous_within_a_segment(variant):
    problem = random_problem(3)
    for segment in Shortcut(variant=variant).solve(problem).path.segments:
        rate = np.abs(np.diff(segment.phi) / np.diff(segment.s))
        assert rate.max() <= VEHICLE.max_steer_rate * 1.001


def test_without_obstacles_the_deterministic_variant_connects_start_and_goal_at_once():
    problem = dataclasses.replace(_needless_cusps(), nodes=np.array([0.0, 20.0, 30.0]))
    iterates = []
    result = Shortcut(variant="deterministic").solve(problem, iterates.append)
    assert result.iterations == 1  # B starts at the goal
    assert len(iterates) == 2


def test_the_deterministic_variant_uses_the_nodes_of_the_log():
    problem = random_problem(4)
    few = dataclasses.replace(problem, nodes=np.array([0.0, problem.recorded.length]))
    many = dataclasses.replace(problem, nodes=np.linspace(0.0, problem.recorded.length, 20))
    tries = [Shortcut(variant="deterministic").solve(p).iterations for p in (few, many)]
    assert tries[0] == 1
    assert tries[1] > 1


def test_intervals_that_are_straight_enough_are_skipped():
    problem = random_problem(5)
    untouched = Shortcut(min_curvature=1.0).solve(problem)
    assert untouched.path is problem.recorded


def test_the_seed_decides_which_intervals_are_tried():
    problem = random_problem(6, num_blocks=12)
    paths = [Shortcut(tries=300, seed=seed).solve(problem).path for seed in (0, 1, 0)]
    assert len({path.length for path in paths}) == 2
    assert paths[0].length == paths[2].length


@BOTH
@pytest.mark.parametrize("seed", [0, 1, 4, 6])
def test_an_obstacle_in_the_way_is_not_cut_through(variant, seed):
    problem = dataclasses.replace(random_problem(seed), scene=make_scene([]))
    method = Shortcut(variant=variant, tries=1000)
    free = method.solve(problem).path
    recorded = _swept(problem.recorded).buffer(0.3)
    ground = _swept(free).difference(recorded)
    spot = max(shapely.get_parts(ground), key=shapely.area).representative_point()
    post = shapely.get_coordinates(spot.buffer(0.1, quad_segs=2))[:-1]
    blocked = dataclasses.replace(problem, scene=make_scene([post]))
    assert path_clearance(VEHICLE, blocked.scene, free) < 0.0
    result = method.solve(blocked).path
    assert path_clearance(VEHICLE, blocked.scene, result) >= blocked.required_clearance - 1e-4
    assert blocked.required_clearance == pytest.approx(0.1)


def _swept(path: Path) -> BaseGeometry:
    return shapely.union_all(shapely.polygons(body_corners(VEHICLE, path.samples.states).reshape(-1, 4, 2)))


def test_no_more_room_is_asked_for_than_the_recorded_path_has():
    wall = np.array([[22.0, 1.3], [26.0, 1.3], [26.0, 6.0], [22.0, 6.0]])
    problem = dataclasses.replace(_needless_cusps(), scene=make_scene([wall]))
    assert problem.required_clearance == pytest.approx(0.025, abs=1e-3)
    assert Shortcut().solve(problem).path.length == pytest.approx(30.0, abs=1e-3)


@pytest.mark.parametrize(
    ("field", "value"), [("variant", "best"), ("cost", "time"), ("tries", -1), ("spacing", 0.2), ("interval", 0.0)]
)
def test_an_option_out_of_range_is_named(field, value):
    with pytest.raises(ValueError, match=f"shortcut: {field} is"):
        Shortcut(**{field: value})
