"""Methods with faults, for the tests of regression runs. In a module of their own: other processes import it."""

import dataclasses
import os
import signal
from dataclasses import dataclass

from optim.methods.ddp.method import Ddp
from optim.model.problem import Problem
from optim.model.result import OnIterate, Result, ignore


def is_one_of(problem: Problem, lengths: tuple[float, ...]) -> bool:
    """Whether the recorded path has one of these lengths [m], to a tenth: how a fault knows its logs."""
    return any(abs(problem.recorded.length - length) < 0.1 for length in lengths)


@dataclass(frozen=True, kw_only=True)
class Worse:
    """Weighs the steering rate otherwise on some logs, so that what it finds is a little worse by the true J."""

    lengths: tuple[float, ...]
    factor: float

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        if is_one_of(problem, self.lengths):
            weights = dataclasses.replace(problem.weights, rate=self.factor * problem.weights.rate)
            problem = dataclasses.replace(problem, weights=weights)
        return Ddp().solve(problem, on_iterate)


@dataclass(frozen=True, kw_only=True)
class Loose:
    """Keeps less clearance than required."""

    by: float
    """[m]"""

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        return Ddp().solve(dataclasses.replace(problem, margin=problem.margin - self.by), on_iterate)


@dataclass(frozen=True, kw_only=True)
class Crashes:
    """Ends its process on some logs."""

    lengths: tuple[float, ...]

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        if is_one_of(problem, self.lengths):
            os.kill(os.getpid(), signal.SIGSEGV)
        return Ddp().solve(problem, on_iterate)


@dataclass(frozen=True, kw_only=True)
class Poison:
    """Ends the process that so much as unpacks it."""

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        raise AssertionError

    def __reduce__(self) -> tuple[object, ...]:
        return os.kill, (0, signal.SIGKILL)  # the process's whole group, which is its own
