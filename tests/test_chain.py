"""A chain keeps what every method promises; the recorded path sets the requirement from the first part to the last."""

import dataclasses

import numpy as np
import pytest
from scenes import random_problem

from optim.audit.checks import audit_path
from optim.methods.chain import Chain, named
from optim.methods.shortcut import Shortcut
from optim.model.objective import objective
from optim.model.problem import Problem, path_clearance
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from replay.run.plain import path_to_document, scene_to_document

TWICE = Chain(
    parts=(("shortcut", Shortcut(variant="deterministic")), ("shortcut", Shortcut(tries=150))),
)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Told:
    """A method that notes its problem, announces its start and a trial, and returns the path it began with."""

    problems: list[Problem] = dataclasses.field(default_factory=list)
    stop: Stop = Stop.CONVERGED

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        self.problems.append(problem)
        for k in (0, 1, 2):
            on_iterate(Iterate(iteration=k, path=problem.initial, objective=1.0, accepted=k == 0))
        return Result(path=problem.initial, stop=self.stop, reason="Told.", iterations=2)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Restores:
    """A method that gives back the recorded path whatever it began with."""

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        for k, path in enumerate((problem.initial, problem.recorded)):
            on_iterate(Iterate(iteration=k, path=path, objective=objective(path, problem.weights)))
        return Result(path=problem.recorded, stop=Stop.STALLED, reason="Undone.", iterations=1)


@pytest.mark.parametrize("seed", range(6))
def test_a_chain_keeps_the_requirement_of_the_recorded_path_and_is_no_worse_than_its_first_part(seed: int) -> None:
    problem = random_problem(seed, num_blocks=14)
    result = TWICE.solve(problem)
    report = audit_path(
        dataclasses.asdict(problem.vehicle),
        scene_to_document(problem.scene),
        path_to_document(problem.recorded),
        path_to_document(result.path),
        dataclasses.asdict(problem.weights),
        objective(result.path, problem.weights),
    )
    assert report.passed, report.failures
    assert path_clearance(problem.vehicle, problem.scene, result.path) >= problem.required_clearance - 1e-4
    first = TWICE.parts[0][1].solve(problem)
    assert objective(result.path, problem.weights) <= objective(first.path, problem.weights)


def test_a_chain_gives_the_same_result_again() -> None:
    one, other = (TWICE.solve(random_problem(3)) for _ in range(2))
    np.testing.assert_array_equal(one.path.samples.states, other.path.samples.states)
    assert (one.stop, one.reason, one.iterations) == (other.stop, other.reason, other.iterations)


@pytest.mark.parametrize("seed", [4, 5])
def test_iterates_are_numbered_on_from_the_recorded_path_to_the_result(seed: int) -> None:
    problem, iterates = random_problem(seed), []
    result = TWICE.solve(problem, iterates.append)
    numbers = [iterate.iteration for iterate in iterates]
    assert numbers[0] == 0
    assert numbers == sorted(set(numbers))
    assert numbers[-1] <= result.iterations
    assert iterates[0].path is problem.recorded
    assert iterates[-1].path is result.path
    assert [iterate.objective for iterate in iterates] == sorted((i.objective for i in iterates), reverse=True)


def test_a_later_part_begins_with_the_earlier_result_and_is_asked_for_the_same_clearance() -> None:
    problem, second = random_problem(1), Told()
    shortcut = Shortcut(variant="deterministic")
    Chain(parts=(("shortcut", shortcut), ("told", second))).solve(problem)
    (given,) = second.problems
    expected = shortcut.solve(problem).path
    np.testing.assert_array_equal(given.initial.samples.states, expected.samples.states)
    assert given.recorded is problem.recorded
    assert given.required_clearance == problem.required_clearance


def test_where_the_earlier_part_changed_nothing_the_path_is_still_the_recorded_one() -> None:
    problem, second = random_problem(1), Told()
    Chain(parts=(("told", Told()), ("again", second))).solve(problem)
    assert second.problems[0].start is None, "the log's nodes are known of the recorded path only"


def test_trials_are_told_as_such_and_what_a_part_begins_with_is_told_once() -> None:
    iterates: list[Iterate] = []
    result = Chain(parts=(("a", Told()), ("b", Told()))).solve(random_problem(1), iterates.append)
    assert [(iterate.iteration, iterate.accepted) for iterate in iterates] == [
        (0, True),
        (1, False),
        (2, False),
        (3, False),
        (4, False),
    ]
    assert result.iterations == 4
    assert result.reason == "a: Told. (converged); b: Told. (converged)"


def test_a_part_that_makes_the_path_worse_does_not_spoil_the_chain() -> None:
    problem, iterates = random_problem(2), []
    shortcut = Shortcut(variant="deterministic")
    result = Chain(parts=(("shortcut", shortcut), ("restores", Restores()))).solve(problem, iterates.append)
    assert objective(result.path, problem.weights) == objective(shortcut.solve(problem).path, problem.weights)
    assert iterates[-1].path is result.path
    assert iterates[-1].iteration == result.iterations
    assert result.stop is Stop.STALLED


def test_a_part_that_fails_ends_the_chain() -> None:
    last = Told()
    result = Chain(parts=(("a", Told(stop=Stop.FAILED)), ("b", last))).solve(random_problem(1))
    assert result.stop is Stop.FAILED
    assert result.reason == "a: Told. (failed)"
    assert not last.problems


def test_a_chain_is_known_by_the_names_of_its_parts() -> None:
    methods = {"shortcut": Shortcut(tries=7), "told": Told()}
    assert named("shortcut", methods) is methods["shortcut"]
    chain = named("shortcut+told+shortcut", methods)
    assert isinstance(chain, Chain)
    assert [name for name, _ in chain.parts] == ["shortcut", "told", "shortcut"]
    assert all(method is methods[name] for name, method in chain.parts)
    with pytest.raises(KeyError, match="tld"):
        named("shortcut+tld", methods)


def test_one_method_is_no_chain() -> None:
    with pytest.raises(ValueError, match=r"chain: parts is \['told'\], expected two or more"):
        Chain(parts=(("told", Told()),))
