"""What every method promises, whatever it does inside: each entry of METHODS, on many scenes."""

import dataclasses

import numpy as np
import pytest
from scenes import random_problem

from optim.audit.checks import audit_path
from optim.methods import METHODS
from optim.model.objective import objective
from optim.model.path import Path, roll_out_segment
from optim.model.problem import Problem, path_clearance
from optim.model.result import Result, Stop
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle
from replay.cli.options import options_of
from replay.run.plain import path_to_document

SEEDS = [*range(3), *(pytest.param(seed, marks=pytest.mark.slow) for seed in range(3, 8))]
every_method = pytest.mark.parametrize("name", METHODS)


def _solve(name: str, problem: Problem) -> tuple[Result, list]:
    iterates: list = []
    return METHODS[name].solve(problem, iterates.append), iterates


def _audit(problem: Problem, path: Path):
    return audit_path(
        dataclasses.asdict(problem.vehicle),
        {"polygons": [polygon.tolist() for polygon in problem.scene.polygons], "boundary": None},
        path_to_document(problem.recorded),
        path_to_document(path),
        dataclasses.asdict(problem.weights),
        objective(path, problem.weights),
    )


@every_method
@pytest.mark.parametrize("seed", SEEDS)
def test_a_result_passes_the_audit_and_is_no_worse_than_the_recorded_path(name, seed):
    problem = random_problem(seed)
    result, _ = _solve(name, problem)
    report = _audit(problem, result.path)
    assert report.passed, report.failures
    assert objective(result.path, problem.weights) <= objective(problem.recorded, problem.weights) + 1e-9


@every_method
@pytest.mark.parametrize("seed", SEEDS)
def test_a_result_keeps_the_required_clearance_between_samples_too(name, seed):
    problem = random_problem(seed, num_blocks=14)
    result, _ = _solve(name, problem)
    # 1e-4 m: the bound between samples is evaluated at other samples than the method's own
    assert path_clearance(problem.vehicle, problem.scene, result.path) >= problem.required_clearance - 1e-4


@every_method
def test_the_same_problem_gives_the_same_result(name):
    first, _ = _solve(name, random_problem(3))
    second, _ = _solve(name, random_problem(3))
    np.testing.assert_array_equal(first.path.samples.states, second.path.samples.states)
    np.testing.assert_array_equal(first.path.samples.phi, second.path.samples.phi)
    assert (first.stop, first.reason, first.iterations) == (second.stop, second.reason, second.iterations)


@every_method
def test_iterates_start_with_the_recorded_path_and_end_with_the_result(name):
    problem = random_problem(4)
    result, iterates = _solve(name, problem)
    numbers = [iterate.iteration for iterate in iterates]
    assert numbers[0] == 0
    assert numbers == sorted(set(numbers))
    accepted = [iterate for iterate in iterates if iterate.accepted]
    assert iterates[0] is accepted[0]
    assert iterates[0].path is problem.recorded
    assert accepted[-1].path is result.path
    assert accepted[-1].objective == pytest.approx(objective(result.path, problem.weights))
    assert isinstance(result.stop, Stop)
    assert result.reason
    assert "\n" not in result.reason


@every_method
def test_another_vehicle_and_other_weights_are_respected(name):
    problem = random_problem(5, vehicle=Vehicle(hitch_to_axle=12.036, trailer_rear=14.0))
    problem = dataclasses.replace(problem, weights=dataclasses.replace(problem.weights, rate=20.0, cusp=0.0))
    result, _ = _solve(name, problem)
    report = _audit(problem, result.path)
    assert report.passed, report.failures


@every_method
def test_a_scene_without_obstacles_is_solved(name):
    problem = dataclasses.replace(random_problem(6), scene=make_scene([]))
    result, _ = _solve(name, problem)
    assert _audit(problem, result.path).passed
    assert objective(result.path, problem.weights) < objective(problem.recorded, problem.weights)


@every_method
def test_a_recorded_path_through_an_obstacle_does_not_raise(name):
    problem = random_problem(7)
    middle = problem.recorded.samples.states[len(problem.recorded.samples.s) // 2, :2]
    block = middle + np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    problem = dataclasses.replace(problem, scene=make_scene([*problem.scene.polygons, block]))
    result, _ = _solve(name, problem)
    np.testing.assert_array_equal(result.path.start, problem.recorded.start)


@every_method
def test_a_straight_drive_stays_as_it_is(name):
    s = np.linspace(0.0, 20.0, 201)
    straight = Path((roll_out_segment(Vehicle(), np.zeros(4), 1, s, np.zeros(201)),))
    problem = Problem(vehicle=Vehicle(), scene=make_scene([]), recorded=straight)
    result, _ = _solve(name, problem)
    assert objective(result.path, problem.weights) == pytest.approx(20.0, abs=1e-3)


@every_method
def test_every_option_has_a_default_and_a_sentence_and_every_number_a_unit(name):
    method = METHODS[name]
    assert dataclasses.is_dataclass(method)
    assert type(method)() == method
    with pytest.raises(dataclasses.FrozenInstanceError):
        setattr(method, dataclasses.fields(method)[0].name, None)
    for option in options_of(method):
        assert option.doc, f"{name}: {option.name} has no docstring"
        is_number = not isinstance(getattr(method, option.name), (str, bool))
        assert bool(option.unit) == is_number, f"{name}: {option.name} has the unit {option.unit!r}"
