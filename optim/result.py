"""What a method gives back. Its word is not believed: `optim.audit` decides."""

import enum
from collections.abc import Callable
from dataclasses import dataclass

from optim.path import Path


class Stop(enum.Enum):
    """Why a method stopped; the value is what the user reads."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit"
    TIME_LIMIT = "time limit"
    STALLED = "stalled"
    INFEASIBLE = "infeasible"
    FAILED = "failed"


@dataclass(frozen=True, eq=False, kw_only=True)
class Iterate:
    """An accepted iterate, as the recording plays it back."""

    iteration: int
    path: Path
    objective: float
    """J of the iterate [-]."""
    violation: float = 0.0
    """Largest violation of a constraint, in the method's own scaling; 0 for methods that stay feasible."""
    step: float = 0.0
    """Size of the step that led here: m of path replaced, or the method's own norm."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Result:
    """The outcome of one method on one problem."""

    path: Path
    stop: Stop
    reason: str
    """One sentence for the user."""
    iterations: int


OnIterate = Callable[[Iterate], None]


def ignore(_: Iterate) -> None:
    """The `OnIterate` that does nothing."""
