"""Differential dynamic programming as a method: what it reaches, and what it says when it does not."""

import dataclasses
import pathlib
import re

import numpy as np
import pytest
from paths import random_path
from scenes import random_problem

from optim.methods.ddp.backward import Trajectory
from optim.methods.ddp.method import Ddp
from optim.methods.ddp.source import source_model
from optim.model.kinematics import rk4_step
from optim.model.objective import objective
from optim.model.path import Path
from optim.model.problem import Problem, path_clearance
from optim.model.result import Iterate, Result, Stop
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle
from replay.logs import read_cases

LOGS = pathlib.Path(__file__).resolve().parent.parent / "recordings"


def _solved(problem: Problem, **options) -> tuple[Result, float]:
    result = Ddp(**options).solve(problem)
    return result, objective(result.path, problem.weights)


def _assert_drivable(problem: Problem, path: Path) -> None:
    """Ends exact, every interval as the kinematics have it, every limit kept."""
    vehicle = problem.vehicle
    np.testing.assert_array_equal(path.start, problem.recorded.start)
    np.testing.assert_array_equal(path.goal, problem.recorded.goal)
    for segment in path.segments:
        assert np.diff(segment.s).max() <= 0.1 + 1e-9
        assert np.abs(segment.phi).max() <= vehicle.max_steer
        assert (np.abs(np.diff(segment.phi)) <= vehicle.max_steer_rate * np.diff(segment.s) * (1 + 1e-9)).all()
        for k in range(segment.num_samples - 1):
            x, phi, h = segment.states[k], segment.phi, segment.s[k + 1] - segment.s[k]
            half = rk4_step(vehicle, x, phi[k], 0.5 * (phi[k] + phi[k + 1]), 0.5 * h, segment.direction)
            end = rk4_step(vehicle, half, 0.5 * (phi[k] + phi[k + 1]), phi[k + 1], 0.5 * h, segment.direction)
            np.testing.assert_allclose(end, segment.states[k + 1], rtol=0, atol=2e-6)
    if np.abs(problem.recorded.samples.states[[0, -1], 3]).max() <= vehicle.max_hitch:
        assert max(np.abs(segment.alpha).max() for segment in path.segments) <= vehicle.max_hitch


def test_of_40_scenes_at_least_38_converge_to_drivable_clear_and_better_paths():
    converged = 0
    for seed in range(20, 60):
        problem = random_problem(seed, num_blocks=12)
        result, value = _solved(problem)
        if result.stop is not Stop.CONVERGED:
            assert result.path is problem.recorded
            continue
        converged += 1
        assert value < 0.95 * objective(problem.recorded, problem.weights), seed
        _assert_drivable(problem, result.path)
        assert path_clearance(problem.vehicle, problem.scene, result.path) >= problem.required_clearance - 1e-6
    assert converged >= 38


def test_a_reverse_segment_of_60_m_with_a_short_trailer_converges():
    # a hitch angle's error grows 5000-fold on the way: no open roll-out ends where it should
    vehicle = Vehicle(hitch_to_axle=7.0, trailer_rear=10.0)
    path = random_path(vehicle, (60.0,), -1, seed=3, spacing=0.1)
    problem = Problem(vehicle=vehicle, scene=make_scene([]), recorded=path)
    result, value = _solved(problem)
    assert result.stop is Stop.CONVERGED
    assert value < objective(path, problem.weights)
    _assert_drivable(problem, result.path)


@pytest.mark.parametrize("name", ["lot_01", "parallel_01", "yard_01"])
def test_needless_gear_changes_of_the_sample_logs_go(name):
    problem = read_cases(LOGS / f"{name}.mcap")[0].problem
    result, value = _solved(problem)
    assert result.stop is Stop.CONVERGED
    assert result.path.num_cusps < problem.recorded.num_cusps
    # successive convexification ends at 93.009, 60.453 and 62.328
    best = {"lot_01": 93.009, "parallel_01": 60.453, "yard_01": 62.328}[name]
    assert value <= 1.005 * best


def test_without_trials_the_segments_stay_that_do_not_vanish():
    problem = random_problem(106, num_blocks=14, lengths=(25.0, 30.0))
    kept, _ = _solved(problem, removals=0)
    gone, _ = _solved(problem, removals=4)
    assert gone.path.num_cusps <= kept.path.num_cusps
    assert kept.path.num_cusps == problem.recorded.num_cusps


@pytest.mark.parametrize("seed", [20, 21, 22])
def test_full_second_derivatives_and_gauss_newton_find_the_same_path(seed):
    problem = random_problem(seed, num_blocks=8)
    _, full = _solved(problem)
    _, gauss_newton = _solved(problem, hessian="gauss_newton", max_iterations=200)
    assert full == pytest.approx(gauss_newton, rel=2e-3)


def test_a_blocked_way_is_infeasible_and_the_reason_says_by_how_much():
    problem = random_problem(4)
    samples = problem.recorded.samples
    x, y, theta, _ = samples.states[len(samples.s) // 2]
    along, across = np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])
    corners = [np.array([x, y]) + a * along + b * across for a, b in ((-1, -60), (1, -60), (1, 60), (-1, 60))]
    result, _ = _solved(dataclasses.replace(problem, scene=make_scene([np.array(corners)])))
    assert result.stop is Stop.INFEASIBLE
    assert result.path is problem.recorded
    assert re.search(r"no path found keeps everything: .*[0-9] m of clearance are missing", result.reason), (
        result.reason
    )


def test_the_tests_of_convergence_are_told_and_end_below_their_limits():
    told: list[Iterate] = []
    result = Ddp().solve(random_problem(5), told.append)
    assert result.stop is Stop.CONVERGED
    assert set(told[-1].residuals) == {"projected gradient", "gap", "goal", "hitch angle", "clearance"}
    # a residual of five times its tolerance counts as feasible
    assert max(told[-1].residuals.values()) <= 5.0
    assert re.fullmatch(r"projected gradient \d\.\de-\d\d", result.reason)


def test_it_begins_with_the_start_that_another_method_gave():
    problem = random_problem(6)
    first, value = _solved(problem)
    again = dataclasses.replace(problem, start=first.path)
    second, better = _solved(again)
    assert better <= value
    assert second.iterations < first.iterations
    told: list[Iterate] = []
    Ddp().solve(again, told.append)
    assert told[0].path is first.path


def test_a_hitch_behind_the_axle_is_optimised_too():
    vehicle = Vehicle(hitch_offset=0.3)
    problem = random_problem(8, vehicle=vehicle)
    result, value = _solved(problem)
    assert value < objective(problem.recorded, problem.weights)
    _assert_drivable(problem, result.path)


def test_bang_bang_steering_keeps_its_rate():
    problem = random_problem(9)  # without costs of steering it is the length alone that counts
    weights = dataclasses.replace(problem.weights, rate=0.0, steer=0.0)
    problem = dataclasses.replace(problem, weights=weights)
    result, value = _solved(problem)
    assert value < objective(problem.recorded, problem.weights)
    _assert_drivable(problem, result.path)


def test_the_sources_weights_miss_the_goal_and_the_reason_says_by_how_much():
    problem = random_problem(3)
    told: list[Iterate] = []
    result = Ddp(variant="source").solve(problem, told.append)
    assert result.path is problem.recorded
    assert result.stop is Stop.INFEASIBLE
    assert "misses the goal by" in result.reason
    assert len(told) > 3
    assert told[-2].path is not problem.recorded


def test_the_sources_formulation_has_exact_derivatives():
    model, (states, controls) = source_model(random_problem(2, num_blocks=14), 0.5)
    states = states + 0.3 * np.random.default_rng(0).standard_normal(states.shape)
    _, e = model.expand(Trajectory(states, controls), False)
    lz, fz, step = e.lz.copy(), e.fz.copy(), 1e-6
    for k, j in [(0, 4), (3, 5), *((k, j) for k in (1, 20, len(controls) - 1) for j in range(6))]:
        ends = []
        for sign in (1.0, -1.0):
            x, u = states.copy(), controls.copy()
            (x if j < 4 else u)[k, j if j < 4 else j - 4] += sign * step
            cost, found = model.expand(Trajectory(x, u), False)
            ends.append((cost, found.gap[k].copy()))
        assert (ends[0][0] - ends[1][0]) / (2 * step) == pytest.approx(lz[k, j], abs=1e-5)
        np.testing.assert_allclose((ends[0][1] - ends[1][1]) / (2 * step), fz[k, :, j], atol=1e-7)


@pytest.mark.parametrize(
    ("option", "value"),
    [
        ("variant", "ilqr"),
        ("hessian", "none"),
        ("spacing", 0.0),
        ("coarse_spacing", 0.1),
        ("max_iterations", 0),
        ("goal_penalty", 0.0),
        ("goal_tolerance", 1e-3),
        ("clearance_tolerance", 0.0),
    ],
)
def test_options_out_of_their_range_are_refused_by_name(option, value):
    with pytest.raises(ValueError, match=f"ddp: {option} is"):
        Ddp(**{option: value})
