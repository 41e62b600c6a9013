"""Successive convexification: the statement, the loop's ends, and what it finds."""

import dataclasses
import importlib.util
import pathlib

import numpy as np
import pytest
from scenes import random_problem

from optim.knots.transcription import defects, knots_of, objective_of
from optim.methods.nlp.method import Nlp
from optim.methods.scp.linearisation import Scales, convex_factor, linearise
from optim.methods.scp.method import Scp
from optim.methods.scp.restoration import hitch_excess, rate_excess, restore
from optim.methods.scp.statement import LINEAR, bucket, statement
from optim.methods.scp.subproblem import KnotLimits, Penalty, parameter_values, solve_subproblem
from optim.model.objective import objective
from optim.model.path import Path, segment_from_states
from optim.model.problem import Problem, path_clearance
from optim.model.result import Stop
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle
from replay.logs import read_cases

FULL = pathlib.Path(__file__).resolve().parent.parent / "recordings" / "full"


def _near(problem: Problem):
    knots = knots_of(problem.vehicle, problem.recorded, 0.35)
    scales = Scales.of(problem.vehicle, problem.weights, 0.35)
    zeros = np.zeros((len(knots.h), 4))
    limits = KnotLimits(np.full((len(knots.phi), 2), problem.required_clearance), 0.0035, 0.7)
    return (
        linearise(problem, knots, scales, zeros, 1.5),
        scales,
        limits,
        Penalty(1e4, zeros, np.zeros(knots.phi.shape + (2,))),
    )


def _blocked(problem: Problem) -> Problem:
    """A wall across the middle of the way, where nothing leads round it."""
    samples = problem.recorded.samples
    x, y, theta, _ = samples.states[len(samples.s) // 2]
    along, across = np.array([np.cos(theta), np.sin(theta)]), np.array([-np.sin(theta), np.cos(theta)])
    corners = [np.array([x, y]) + a * along + b * across for a, b in ((-1, -60), (1, -60), (1, 60), (-1, 60))]
    return dataclasses.replace(problem, scene=make_scene([np.array(corners)]))


def test_the_data_for_the_solver_are_those_that_cvxpy_makes_itself():
    import cvxpy as cp

    problem = random_problem(1)
    near, scales, limits, penalty = _near(problem)
    stated = statement(bucket(len(near.knots.phi)))
    values = parameter_values(stated.num_knots, problem.vehicle, near, scales, limits, penalty, 1.0)
    ours = stated.data(values)
    for name, parameter in stated.parameters.items():
        parameter.value = values[name]
    theirs, _, _ = stated.problem.get_problem_data(cp.CLARABEL)
    assert abs(ours.A - theirs["A"]).max() <= 1e-12
    assert abs(ours.P - theirs["P"]).max() <= 1e-12
    np.testing.assert_allclose(ours.b, theirs["b"], atol=1e-12)
    np.testing.assert_allclose(ours.q, theirs["c"], atol=1e-12)
    assert stated.problem.is_dpp()


def test_the_objective_that_is_compiled_has_no_parameters_so_that_long_paths_fit_into_memory():
    stated = statement(32)
    assert not stated.curved.objective.parameters()
    assert {parameter.name() for parameter in stated.problem.objective.parameters()} == set(LINEAR.values())


def test_the_step_and_its_multipliers_are_those_of_another_solver_by_way_of_cvxpy():
    problem = random_problem(1)
    near, scales, limits, penalty = _near(problem)
    step = solve_subproblem(problem.vehicle, near, scales, limits, penalty, 0.5, "clarabel", 60.0)
    other = solve_subproblem(problem.vehicle, near, scales, limits, penalty, 0.5, "osqp", 60.0)
    assert step.status == "optimal"
    assert step.reach <= 0.5 + 1e-6
    assert other.status == "optimal"
    for name in ("q", "phi", "h", "nu", "r", "multipliers"):
        np.testing.assert_allclose(getattr(step, name), getattr(other, name), atol=1e-3, err_msg=name)
    assert np.abs(step.multipliers).max() > 1.0


def test_a_factor_keeps_a_convex_matrix_and_makes_another_one_convex():
    rng = np.random.default_rng(0)
    matrix = rng.normal(size=(20, 5, 5))
    convex = matrix @ matrix.transpose(0, 2, 1) + np.eye(5)
    factor = convex_factor(convex)
    np.testing.assert_allclose(factor.transpose(0, 2, 1) @ factor, convex, atol=1e-9)
    assert np.abs(np.tril(factor, -1)).max() == 0.0
    factor = convex_factor(convex - 5.0 * np.eye(5))
    assert np.linalg.eigvalsh(factor.transpose(0, 2, 1) @ factor).min() > 0.0


def test_virtual_control_vanishes_and_every_residual_ends_below_its_tolerance():
    told: list = []
    Scp(removals=0).solve(random_problem(0), told.append)
    last = [iterate for iterate in told if iterate.accepted and iterate.residuals][-1]
    assert last.residuals["defect"] <= 1.0
    assert last.residuals["clearance"] <= 1.0


@pytest.mark.parametrize("seed", [0, 1, 2])
def test_without_obstacles_both_ways_to_the_optimum_agree(seed):
    problem = dataclasses.replace(random_problem(seed), scene=make_scene([]))
    values = [
        objective(method.solve(problem).path, problem.weights) for method in (Scp(tolerance=1e-8, removals=0), Nlp())
    ]
    assert values[0] == pytest.approx(values[1], rel=1e-4)


@pytest.mark.parametrize("name", ["scp", "nlp"])
def test_a_map_far_from_the_origin_changes_nothing(name):
    method = {"scp": Scp(removals=0), "nlp": Nlp()}[name]
    problem = random_problem(3)
    offset = np.array([1e6, -1e6, 0.0, 0.0])
    far = Path(
        tuple(segment_from_states(s.direction, s.s, s.states + offset, s.phi) for s in problem.recorded.segments)
    )
    scene = make_scene([polygon + offset[:2] for polygon in problem.scene.polygons])
    here, there = method.solve(problem), method.solve(dataclasses.replace(problem, recorded=far, scene=scene))
    assert here.stop is there.stop
    assert objective(there.path, problem.weights) == pytest.approx(objective(here.path, problem.weights), rel=1e-3)


def _enlarged(problem: Problem, factor: float) -> Problem:
    """The same manoeuvre in another unit of length; past the sizes that `Vehicle` accepts from people."""
    per_length = {"max_steer": 1.0, "max_hitch": 1.0, "max_steer_rate": 1.0 / factor}
    vehicle = object.__new__(Vehicle)
    for field in dataclasses.fields(Vehicle):
        value = getattr(problem.vehicle, field.name) * per_length.get(field.name, factor)
        object.__setattr__(vehicle, field.name, value)
    w = problem.weights
    weights = dataclasses.replace(w, length=w.length / factor, steer=w.steer / factor, rate=w.rate * factor)
    unit = np.array([factor, factor, 1.0, 1.0])
    segments = (
        segment_from_states(s.direction, s.s * factor, s.states * unit, s.phi) for s in problem.recorded.segments
    )
    scene = make_scene([polygon * factor for polygon in problem.scene.polygons])
    recorded, margin = Path(tuple(segments)), problem.margin * factor
    return dataclasses.replace(problem, vehicle=vehicle, weights=weights, recorded=recorded, scene=scene, margin=margin)


def _at_knots(name: str, problem: Problem, unit: float):
    """What a method at knots ends with, before anything is sampled (at 0.1 m, whatever the unit)."""
    spacing = 0.35 * unit
    method = Scp(spacing=spacing) if name == "scp" else Nlp(spacing=spacing, reach=3.0 * unit)
    knots = knots_of(problem.vehicle, problem.recorded, spacing)
    required = np.full((len(knots.phi), 2), problem.required_clearance)
    return method.at_knots(problem)(knots, required, lambda knots, make: None)


@pytest.mark.parametrize("name", ["scp", "nlp"])
def test_the_unit_of_length_changes_nothing(name):
    problem = random_problem(0)
    large = _enlarged(problem, 1e3)
    here, there = _at_knots(name, problem, 1.0), _at_knots(name, large, 1e3)
    assert here.stop is Stop.CONVERGED
    assert there.stop is Stop.CONVERGED
    expected = objective_of(here.knots, problem.weights)
    assert objective_of(there.knots, large.weights) == pytest.approx(expected, rel=1e-4)


def test_a_correction_brings_hitch_angles_and_steering_rates_back_within_their_limits():
    problem = random_problem(3)
    recorded = knots_of(problem.vehicle, problem.recorded, 0.35)
    vehicle = dataclasses.replace(
        problem.vehicle,
        max_hitch=0.95 * float(np.abs(recorded.states[1:-1, 3]).max()),
        max_steer_rate=0.95 * float((np.abs(np.diff(recorded.phi))[recorded.gear != 0] / 0.35).max()),
    )
    problem = dataclasses.replace(problem, vehicle=vehicle)
    near, scales, limits, _ = _near(problem)
    knots, left = recorded, []
    for _ in range(6):
        excess = np.concatenate([hitch_excess(vehicle, knots), rate_excess(vehicle, knots)])
        left.append(max(float(excess.max()), float(np.abs(defects(vehicle, knots)[0]).max())))
        knots = restore(problem, knots, near.factor, scales, limits)
    assert left[0] > 1e-2
    assert min(left) < 1e-6
    np.testing.assert_array_equal(knots.states[[0, -1]], recorded.states[[0, -1]])


@pytest.mark.parametrize("log", ["narrow_02", "cluttered_01", "public_08"])
def test_where_there_is_little_room_or_a_limit_is_in_the_way_a_better_path_is_found_too(log):
    (case,) = read_cases(FULL / f"{log}.mcap")
    result = Scp(removals=0).solve(case.problem)
    assert result.stop is Stop.CONVERGED, result.reason
    weights = case.problem.weights
    assert objective(result.path, weights) < 0.9 * objective(case.problem.recorded, weights)


@pytest.mark.parametrize("limit", [5, 20])
def test_a_loop_that_may_not_converge_gives_back_its_best_sound_point(limit):
    (case,) = read_cases(FULL / "narrow_02.mcap")
    result = Scp(removals=0, max_iterations=limit).solve(case.problem)
    assert objective(result.path, case.problem.weights) < objective(case.problem.recorded, case.problem.weights)


@pytest.mark.parametrize("name", ["scp", "nlp"])
def test_a_way_that_is_blocked_is_infeasible_and_the_recorded_path_is_kept(name):
    method = {"scp": Scp(removals=0), "nlp": Nlp(spacing=0.7)}[name]  # coarse: IPOPT takes 24 s at 0.35 m
    problem = _blocked(random_problem(2))
    result = method.solve(problem)
    assert result.stop is Stop.INFEASIBLE, result.reason
    assert result.path is problem.recorded
    assert "no clear and drivable path" in result.reason


@pytest.mark.parametrize("name", ["scp", "nlp"])
def test_limits_of_iterations_and_time_end_a_solution_with_their_own_word(name):
    kinds = {"scp": Scp, "nlp": Nlp}
    problem = random_problem(2)
    few = kinds[name](max_iterations=1).solve(problem)
    assert few.stop is Stop.ITERATION_LIMIT
    short = kinds[name](time_limit=1e-3).solve(problem)
    assert short.stop is Stop.TIME_LIMIT
    assert "time" in short.reason


def test_a_solver_that_is_not_there_is_a_failure_with_its_name():
    if importlib.util.find_spec("piqp") is not None:
        pytest.skip("PIQP is installed here")
    problem = random_problem(2)
    result = Scp(solver="piqp").solve(problem)
    assert result.stop is Stop.FAILED
    assert "PIQP" in result.reason
    assert result.path is problem.recorded


@pytest.mark.parametrize(
    ("option", "value"), [("spacing", 0.0), ("solver", "mosek"), ("weight", -1.0), ("removals", -1)]
)
def test_options_out_of_range_are_refused_with_what_was_expected(option, value):
    with pytest.raises(ValueError, match=f"scp: {option} is .*, expected"):
        Scp(**{option: value})


def test_a_recorded_path_that_collides_is_no_measure_for_one_that_keeps_clear():
    # 40 m straight ahead are the least J there is, but a post in the middle overlaps the bodies by 35 mm
    s = np.linspace(0.0, 40.0, 401)
    straight = segment_from_states(1, s, np.column_stack([s, 0 * s, 0 * s, 0 * s]), 0 * s)
    post = np.array([[16.0, 1.24], [16.4, 1.24], [16.4, 3.0], [16.0, 3.0]])
    problem = Problem(vehicle=Vehicle(), scene=make_scene([post]), recorded=Path((straight,)))
    assert problem.recorded_clearance < -0.03
    result = Scp().solve(problem)
    assert path_clearance(problem.vehicle, problem.scene, result.path) >= problem.required_clearance - 1e-6
    assert objective(result.path, problem.weights) > 40.0
