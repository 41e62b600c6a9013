"""What a contender is given and gives back, and how it is judged: by J and our audit, never by its own word."""

import time
from collections.abc import Callable
from dataclasses import dataclass

from optim.knots.transcription import Knots, path_of
from optim.model.objective import objective
from optim.model.path import Path
from optim.model.problem import Problem
from optim.model.result import OnIterate, Result, Stop, ignore
from replay.run.case import Case
from replay.run.judge import run_case

SPACING = 0.35
"""Distance between knots [m], for all who work at knots; that of ddp, nlp and scp."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Answer:
    """What a contender gives back. Its path is what counts; the rest is told beside."""

    path: Path | None
    """None where it has none."""
    word: str
    """The contender's own word."""
    iterations: int = 0
    build_s: float = 0.0
    """CPU time of stating the problem [s], part of the whole."""
    compile_s: float = 0.0
    """CPU time of a compiler [s], told apart and no part of the whole: our kernels are compiled before, too."""
    size: str = ""
    """Of the problem, in its own terms."""


Contender = Callable[[Problem], Answer]


@dataclass(frozen=True, kw_only=True)
class Verdict:
    """One contender on one log."""

    status: str
    """improved: better than the recorded path, and passed by the audit; else not."""
    objective: float
    """J of what it gave, sound or not; nan without a path."""
    cusps: int
    failures: tuple[str, ...]
    """Checks of the audit that did not pass."""
    cpu_s: float
    build_s: float
    compile_s: float
    iterations: int
    word: str
    size: str


def path_at(problem: Problem, knots: Knots) -> Path | None:
    """The path through knots, None where they are none: steps that are not positive."""
    if (knots.h[knots.gear != 0] <= 0.0).any():
        return None
    return path_of(problem.vehicle, knots, problem.recorded)


def measure(case: Case, contender: Contender) -> Verdict:
    """Solve once, CPU time of the process taken; then audit."""
    began = time.process_time()
    answer = contender(case.problem)
    told = {
        "cpu_s": time.process_time() - began - answer.compile_s,
        "build_s": answer.build_s,
        "compile_s": answer.compile_s,
        "iterations": answer.iterations,
        "word": answer.word,
        "size": answer.size,
    }
    if answer.path is None:
        return Verdict(status="failed", objective=float("nan"), cusps=-1, failures=("no path",), **told)
    status, failures = measure_path(case, answer.path)
    value = objective(answer.path, case.problem.weights)
    return Verdict(status=status, objective=value, cusps=answer.path.num_cusps, failures=failures, **told)


def measure_path(case: Case, path: Path) -> tuple[str, tuple[str, ...]]:
    """The audited status of a path, and the checks that it did not pass."""
    given = Given(Result(path=path, stop=Stop.CONVERGED, reason="", iterations=0))
    run = run_case(case, {"given": given}).methods[0]
    if run.rejected is None:
        return run.status, ()
    return run.status, run.rejected.failed


class Given:
    """A method that gives back a result that is there already, so that it is judged like any other's."""

    def __init__(self, result: Result) -> None:
        self.result = result

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        del problem, on_iterate
        return self.result
