"""Running one method on one problem: timed, limited in time, its failure turned into words."""

import math
import pathlib
import time
import traceback
from collections.abc import Callable, Generator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Self

from numba.core import event

from optim.model.method import Method
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Result
from replay.run.limits import Limits


@dataclass(frozen=True, eq=False, kw_only=True)
class Solved:
    """What came of a method."""

    result: Result | None
    """None where it failed, or ran out of time."""
    out_of_time: bool = False
    error: str = ""
    """One line; empty unless it failed."""
    traceback: str = ""
    """Traceback of an exception, for developers."""
    wall_s: float
    """Wall time, without compiling [s]."""
    compile_s: float
    """Time that went into compiling kernels [s]."""


OnStart = Callable[[str], None]
"""Called with the name of a method that begins."""
OnNamedIterate = Callable[[str, Iterate], None]
"""Called with a method's name and its iterate."""
SolveEach = Callable[[Problem, Mapping[str, Method], OnStart, OnNamedIterate], Generator[tuple[str, Solved]]]
"""Run methods, each by itself, reporting their iterates; outcomes by name, in the order in which methods end.
Whatever a method does wrong comes back as `Solved.error`."""


class OutOfTime(BaseException):
    """Raised through a method that has used up its time; no method may catch it by catching Exception."""


class _Compiling(event.Listener):
    """Measures the time for which kernels are compiled; reports when compiling begins and ends."""

    def __init__(self, report: Callable[[bool], None], clock: Callable[[], float]) -> None:
        """`by_clock` is measured with `clock`; `total` is wall time."""
        self.report, self.clock = report, clock
        self.total, self.by_clock, self._depth, self._began = 0.0, 0.0, 0, (0.0, 0.0)

    def on_start(self, event: event.Event) -> None:
        del event
        self._depth += 1
        if self._depth == 1:
            self._began = time.perf_counter(), self.clock()
            self.report(True)

    def on_end(self, event: event.Event) -> None:
        del event
        self._depth -= 1
        if self._depth == 0:
            self.total += time.perf_counter() - self._began[0]
            self.by_clock += self.clock() - self._began[1]
            self.report(False)


def solve(
    problem: Problem,
    method: Method,
    on_iterate: OnIterate,
    *,
    time_limit: float = math.inf,
    by_processor: bool = False,
    on_compiling: Callable[[bool], None] = lambda _: None,
) -> Solved:
    """Run a method in this process.

    After `time_limit` [s], compiling not counted, the next iterate ends it, and there is no result; with
    `by_processor` that is processor time of this process. `on_compiling` is called with True
    when compiling begins and False when it ends.
    """
    clock = time.process_time if by_processor else time.perf_counter
    compiling = _Compiling(on_compiling, clock)
    started, by_clock = time.perf_counter(), clock()

    def spent() -> float:
        return time.perf_counter() - started - compiling.total

    def watched(iterate: Iterate) -> None:
        on_iterate(iterate)
        if clock() - by_clock - compiling.by_clock > time_limit:
            raise OutOfTime

    result, late, error, trace = None, False, "", ""
    with event.install_listener("numba:compile", compiling):
        try:
            result = method.solve(problem, watched)
        except OutOfTime:
            late = True
        except Exception as caught:  # a border: whatever a method does wrong is its own failure, and recorded
            message = " ".join(str(caught).split())
            error = f"{type(caught).__name__}: {message}" if message else type(caught).__name__
            error += f" ({_place(caught)})"
            trace = traceback.format_exc()
    return Solved(
        result=result, out_of_time=late, error=error, traceback=trace, wall_s=spent(), compile_s=compiling.total
    )


def _place(error: BaseException) -> str:
    """File, with the folder that it is in, and line where an exception was raised."""
    last = traceback.extract_tb(error.__traceback__)[-1]
    return f"{'/'.join(pathlib.PurePath(last.filename).parts[-2:])}:{last.lineno}"


class InTurn:
    """Runs methods in this process, one after the other; a `SolveEach`, and a context manager as `Workers` is."""

    def __init__(self, limits: Limits) -> None:
        """The time limit ends a method at its next iterate; there is no memory limit."""
        self.limits = limits

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None: ...

    def __call__(
        self, problem: Problem, methods: Mapping[str, Method], on_start: OnStart, on_iterate: OnNamedIterate
    ) -> Generator[tuple[str, Solved]]:
        """Run the methods, as `solve_in_turn`."""
        return solve_in_turn(problem, methods, on_start, on_iterate, time_limit=self.limits.time_s)


def solve_in_turn(
    problem: Problem,
    methods: Mapping[str, Method],
    on_start: OnStart,
    on_iterate: OnNamedIterate,
    *,
    time_limit: float = math.inf,
) -> Generator[tuple[str, Solved]]:
    """Run methods in this process, one after the other, each for `time_limit` [s] at most; a `SolveEach`."""
    for name, method in methods.items():
        on_start(name)
        yield name, solve(problem, method, partial(on_iterate, name), time_limit=time_limit)
