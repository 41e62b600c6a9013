"""What a method's answer is worth is decided by J and the audit; its failures stay its own."""

import dataclasses
import io
import math
import pathlib

import numpy as np
import pytest
from numba import njit
from paths import straight
from rich.console import Console

from optim.methods.chain import Chain
from optim.model.objective import Weights
from optim.model.path import Path
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle
from replay.cli.tables import remarks, result_table, verdict
from replay.run.case import Case, ReadReport
from replay.run.judge import Interrupted, run_case
from replay.run.outcome import MOST_ITERATES

VEHICLE = Vehicle()
BLOCK = np.array([[0.0, 6.0], [4.0, 6.0], [4.0, 9.0], [0.0, 9.0]])


RECORDED = straight(10.0, -4.0, 6.0)  # the same ends as 12 m ahead
BETTER = straight(12.0)


def case(recorded: Path = RECORDED, weights: Weights | None = None, block: np.ndarray = BLOCK) -> Case:
    problem = Problem(vehicle=VEHICLE, scene=make_scene([block]), recorded=recorded, weights=weights or Weights())
    read = ReadReport(poses=2, hitch="reconstructed", max_deviation_m=0.0, max_deviation_rad=0.0)
    log = pathlib.Path("straight.mcap")
    return Case(name="straight/0", log=log, sha256="00" * 32, problem=problem, read=read, map=None, frame="map")


@dataclasses.dataclass(frozen=True, kw_only=True, eq=False)
class Answer:
    """A method that knows its answer."""

    path: Path
    stop: Stop = Stop.CONVERGED
    reason: str = "This is the answer."
    num_iterates: int = 1

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        for k in range(self.num_iterates):
            on_iterate(Iterate(iteration=k, path=self.path, objective=20.0 - k / self.num_iterates))
        return Result(path=self.path, stop=self.stop, reason=self.reason, iterations=self.num_iterates)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Raises:
    """A method that does not come to an answer."""

    error: BaseException

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        on_iterate(Iterate(iteration=0, path=problem.recorded, objective=20.0))
        raise self.error


@dataclasses.dataclass(frozen=True, kw_only=True)
class Tries:
    """A method that turns down two trials after each iterate, also at the end."""

    rounds: int = 4

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        for k in range(3 * self.rounds):
            residuals = {"defect": 1.0 / k} if k else {}
            path = problem.recorded if k % 3 == 0 else BETTER
            on_iterate(Iterate(iteration=k, path=path, objective=20.0, residuals=residuals, accepted=k % 3 == 0))
        return Result(path=problem.recorded, stop=Stop.STALLED, reason="Stuck.", iterations=3 * self.rounds)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Compiles:
    """A method that compiles a kernel of its own."""

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        one_more = njit(lambda x: x + 1.0)
        assert one_more(1.0) == 2.0
        return Result(path=problem.recorded, stop=Stop.CONVERGED, reason="Compiled.", iterations=0)


class AnswersNothing:
    """A method that breaks the protocol."""

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        return None  # pyright: ignore[reportReturnType]


def test_a_better_sound_path_counts_with_its_own_metrics_and_audit():
    run = run_case(case(), {"answer": Answer(path=BETTER)})
    (method,) = run.methods
    assert (method.status, method.stop, method.reason) == ("improved", "converged", "This is the answer.")
    assert method.path is BETTER
    assert method.metrics.length == pytest.approx(12.0)
    assert method.metrics.objective < run.recorded_metrics.objective
    assert method.audit.passed
    assert run.recorded_audit.passed
    assert method.rejected is None
    assert not run.fell_short
    assert run.best is method


@pytest.mark.parametrize(
    ("path", "check"),
    [(straight(11.0), "goal"), (Path(straight(2.0, 10.0).segments[1:]), "start"), (straight(12.0, weave=0.6), "steer")],
)
def test_a_path_that_the_audit_turns_down_is_replaced_by_the_recorded_one(path, check):
    run = run_case(case(), {"answer": Answer(path=path)})
    (method,) = run.methods
    assert method.status == "kept"
    assert check in method.reason
    assert method.path is RECORDED
    assert method.metrics == run.recorded_metrics
    assert method.audit == run.recorded_audit
    assert method.rejected is not None
    assert not method.rejected.passed
    assert not method.rejected.checks[check].passed
    assert run.fell_short
    assert run.best is None


def test_a_path_through_an_obstacle_is_turned_down_however_good_it_is():
    # the truck's front reaches 17 m on the recorded path, 18 m on the answer
    ahead = np.array([[17.5, -1.0], [30.0, -1.0], [30.0, 1.0], [17.5, 1.0]])
    run = run_case(case(block=ahead), {"answer": Answer(path=straight(13.0, -1.0))})
    (method,) = run.methods
    assert run.recorded_audit.passed
    assert method.status == "kept"
    assert "clearance" in method.reason
    assert method.path is RECORDED


def block_ahead(clear: float) -> np.ndarray:
    """What the truck's front comes within `clear` [m] of where the path reaches 13 m."""
    return np.array([[18.0 + clear, -1.0], [30.0, -1.0], [30.0, 1.0], [18.0 + clear, 1.0]])


def test_a_path_that_lacks_clearance_is_kept_out_although_it_collides_with_nothing():
    run = run_case(case(block=block_ahead(0.05)), {"answer": Answer(path=straight(13.0, -1.0))})
    (method,) = run.methods
    assert (method.status, method.path) == ("kept", RECORDED)
    assert method.reason == "Its path has 0.050 m of clearance, 0.100 m are required."
    assert run_case(case(block=block_ahead(0.1)), {"answer": Answer(path=straight(13.0, -1.0))}).best is not None


@pytest.mark.parametrize("path", [RECORDED, straight(10.0, -6.0, 8.0)], ids=["as good", "worse"])
def test_a_path_that_is_no_better_is_kept_out_without_blame(path):
    run = run_case(case(), {"answer": Answer(path=path)})
    (method,) = run.methods
    assert method.status == "kept"
    assert method.reason.startswith("Nothing better was found")
    assert method.path is RECORDED
    assert not run.fell_short


@pytest.mark.parametrize("error", [RuntimeError("no\nway"), ZeroDivisionError(), MemoryError("full")])
def test_a_method_that_raises_has_failed_and_the_next_one_runs(error):
    run = run_case(case(), {"first": Raises(error=error), "second": Answer(path=BETTER)})
    first, second = run.methods
    assert (first.status, first.stop) == ("failed", "failed")
    assert first.reason.startswith(type(error).__name__)
    assert "\n" not in first.reason
    assert "Traceback" in first.traceback
    assert first.path is RECORDED
    assert first.metrics == run.recorded_metrics
    assert first.iterations == len(first.iterates) == 1
    assert second.status == "improved"
    assert run.fell_short
    assert run.best is second


def test_a_method_that_gives_no_result_has_failed():
    (method,) = run_case(case(), {"nothing": AnswersNothing()}).methods
    assert method.status == "failed"
    assert method.path is RECORDED


def test_a_method_that_says_it_failed_is_believed():
    (method,) = run_case(case(), {"answer": Answer(path=BETTER, stop=Stop.FAILED, reason="No solver.")}).methods
    assert (method.status, method.reason) == ("failed", "No solver.")
    assert method.path is RECORDED


def test_a_path_without_a_finite_objective_has_failed():
    with np.errstate(over="ignore"):
        (method,) = run_case(case(weights=Weights(length=1e308)), {"answer": Answer(path=BETTER)}).methods
    assert method.status == "failed"
    assert "objective" in method.reason


def test_a_recorded_path_that_collides_is_reported_and_may_still_be_improved():
    # the recorded path drives into it on its detour; 12 m straight ahead stay clear
    ahead = np.array([[18.0, -1.0], [30.0, -1.0], [30.0, 1.0], [18.0, 1.0]])
    run = run_case(case(recorded=straight(14.0, -2.0), block=ahead), {"answer": Answer(path=BETTER)})
    assert not run.recorded_audit.passed
    assert run.methods[0].status == "improved"


def test_a_sound_path_is_better_than_a_recorded_one_that_is_not_whatever_its_cost():
    # the recorded path drives into it; the answer stays clear, but changes gear once more and is longer
    ahead = np.array([[18.0, -1.0], [30.0, -1.0], [30.0, 1.0], [18.0, 1.0]])
    answer = straight(10.0, -6.0, 8.0)
    run = run_case(case(recorded=straight(14.0, -2.0), block=ahead), {"answer": Answer(path=answer)})
    (method,) = run.methods
    assert method.status == "improved"
    assert method.path is answer
    assert method.audit.passed
    assert method.metrics.objective > run.recorded_metrics.objective
    assert method.reason.startswith("It passes the audit (J 34), which the recorded path (J 21) does not.")
    assert run.best is method
    assert "the recorded path fails the audit, answer's passes: J 34.00 instead of 21.00" in verdict(run)


@pytest.mark.parametrize("count", [1, 2, MOST_ITERATES - 1, MOST_ITERATES, MOST_ITERATES + 1, 5003])
def test_iterates_are_thinned_evenly_and_the_first_and_the_last_are_kept(count):
    (method,) = run_case(case(), {"answer": Answer(path=BETTER, num_iterates=count)}).methods
    numbers = [iterate.iteration for iterate in method.iterates]
    assert len(numbers) <= MOST_ITERATES
    assert len(numbers) >= min(count, MOST_ITERATES // 2)
    assert (numbers[0], numbers[-1]) == (0, count - 1)
    assert len(set(np.diff(numbers[:-1]).tolist())) <= 1
    assert [record.iteration for record in method.history] == list(range(count))


def test_history_keeps_all_of_an_iterate_but_its_path():
    (method,) = run_case(case(), {"tries": Tries()}).methods
    names = {field.name for field in dataclasses.fields(Iterate)} - {"path"}
    assert [set(vars(record)) for record in method.history] == [names] * 12
    assert method.history[2].residuals == {"defect": 0.5}
    assert [record.accepted for record in method.history] == [True, False, False] * 4
    assert math.isnan(method.history[0].solver_s)


def test_trials_that_were_turned_down_are_not_played_back():
    (method,) = run_case(case(), {"tries": Tries(rounds=3 * MOST_ITERATES)}).methods
    assert all(iterate.accepted for iterate in method.iterates)
    assert MOST_ITERATES / 2 <= len(method.iterates) <= MOST_ITERATES
    assert (method.iterates[0].iteration, method.iterates[-1].iteration) == (0, 9 * MOST_ITERATES - 3)


def test_a_method_without_iterates_is_no_problem():
    (method,) = run_case(case(), {"answer": Answer(path=BETTER, num_iterates=0)}).methods
    assert method.iterates == ()
    assert method.status == "improved"


def test_compilation_is_told_apart_from_the_time_of_the_method():
    compiles, answers = run_case(case(), {"compiles": Compiles(), "answers": Answer(path=BETTER)}).methods
    assert compiles.compile_s > max(compiles.wall_s, 0.01)
    assert answers.compile_s == 0.0
    assert answers.wall_s > 0.0


def test_callbacks_hear_each_method_by_name():
    heard: list[str] = []
    run_case(
        case(),
        {"one": Answer(path=BETTER, num_iterates=2), "two": Answer(path=BETTER)},
        on_iterate=lambda name, iterate: heard.append(f"{name} {iterate.iteration}"),
        on_start=lambda name: heard.append(f"{name} starts"),
    )
    assert heard == ["one starts", "one 0", "one 1", "two starts", "two 0"]


def test_an_interrupted_run_carries_what_was_finished():
    methods = {"done": Answer(path=BETTER), "hangs": Raises(error=KeyboardInterrupt()), "never": Answer(path=BETTER)}
    with pytest.raises(Interrupted) as caught:
        run_case(case(), methods)
    assert isinstance(caught.value, KeyboardInterrupt)
    assert [method.name for method in caught.value.run.methods] == ["done"]


def test_the_best_is_the_improved_path_of_least_objective():
    methods = {
        "worse": Answer(path=straight(11.0, -1.0, 2.0)),
        "best": Answer(path=BETTER),
        "failed": Raises(error=ValueError("x")),
    }
    run = run_case(case(), methods)
    assert [method.status for method in run.methods] == ["improved", "improved", "failed"]
    assert run.best is run.methods[1]


def test_of_equal_paths_the_first_is_the_best_whatever_took_longer_and_the_others_are_as_good():
    nearly = straight(12.0, weave=1e-5)
    methods = {"slow": Answer(path=nearly, num_iterates=200), "quick": Answer(path=BETTER), "same": Answer(path=nearly)}
    run = run_case(case(), methods)
    assert [method.status for method in run.methods] == ["improved"] * 3
    assert run.best is run.methods[0]
    assert [method.name for method in run.as_good] == ["quick", "same"]
    assert remarks(run)[-1] == "equally good (within 0.1 %): quick, same"


def test_it_is_said_whether_what_stands_is_safe():
    improved = run_case(case(block=block_ahead(0.3)), {"answer": Answer(path=straight(13.0, -1.0))})
    assert remarks(improved) == ["safe: it passes the audit, clearance 0.300 m (required 0.100 m)"]
    kept = run_case(case(), {"answer": Answer(path=RECORDED)})
    assert remarks(kept)[0].startswith("the recorded path stands: it passes the audit, clearance ")
    bent = run_case(case(straight(12.0, weave=0.6)), {"answer": Answer(path=straight(12.0, weave=0.6))})
    assert remarks(bent)[0].startswith("the recorded path stands: it does not pass the audit")


def test_options_and_seed_are_noted():
    run = run_case(case(), {"answer": Answer(path=BETTER, num_iterates=3), "nothing": AnswersNothing()}, seed=7)
    assert run.options["answer"]["num_iterates"] == 3
    assert run.options["nothing"] == {}
    assert run.seed == 7


def test_the_options_of_a_chain_are_those_of_its_parts():
    chain = Chain(parts=(("answer", Answer(path=RECORDED, num_iterates=2)), ("tries", Tries(rounds=5))))
    run = run_case(case(), {"answer+tries": chain})
    assert run.options["answer+tries"]["answer"]["num_iterates"] == 2
    assert run.options["answer+tries"]["tries"] == {"rounds": 5}


def test_the_table_of_a_run_fits_80_columns_and_says_how_each_path_fared():
    methods = {"shortcut": Answer(path=BETTER), "ddp": Raises(error=ValueError("x")), "scp": Answer(path=RECORDED)}
    run = run_case(case(), methods)
    out = io.StringIO()
    Console(file=out, width=80).print(result_table(run))
    lines = [line.rstrip() for line in out.getvalue().splitlines() if line.strip()]
    assert max(map(len, lines)) <= 80
    assert "…" not in out.getvalue()
    rows = {line.split()[0]: line.split() for line in lines[3:]}
    assert list(rows) == ["recorded", *methods]
    assert [rows[name][-1] for name in methods] == ["improved", "failed", "kept"]
    assert rows["shortcut"][1:4] == ["12.00", "12.00", "0"], "J, length, cusps"


def test_the_verdict_names_what_was_gained_and_admits_where_nothing_was():
    better = verdict(run_case(case(), {"answer": Answer(path=BETTER)}))
    assert better.startswith("straight/0: answer is 60.0% better: J 12.00 instead of 30.00")
    assert better.endswith("12.00 m instead of 20.00 m, 0 gear changes instead of 2")
    assert "nothing better" in verdict(run_case(case(), {"keeps": Answer(path=RECORDED)}))
