"""Result of a method. Its claims are not trusted: `optim.audit.checks` decides."""

import enum
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, fields
from types import MappingProxyType

from optim.model.path import Path
from optim.numerics.arrays import Array, Bool, BoolArray, Float64


class Stop(enum.Enum):
    """Reason why a method stopped; users read the value."""

    CONVERGED = "converged"
    ITERATION_LIMIT = "iteration limit"
    TIME_LIMIT = "time limit"
    STALLED = "stalled"
    INFEASIBLE = "infeasible"
    FAILED = "failed"


@dataclass(frozen=True, eq=False, kw_only=True)
class Picture:
    """Shapes that a method works on, drawn beside the path."""

    points: Float64[Array, "N 2"]
    """Points that it moves [m]. Shape (N, 2)."""
    anchored: Bool[BoolArray, " N"]
    """Mask of the points that it held in place. Shape (N,)."""
    cost_map: Float64[Array, "rows columns"]
    """Cost of a point at a node of the grid [-]. Shape (rows, columns)."""
    origin: tuple[float, float]
    """The node cost_map[0, 0] [m]."""
    resolution: float
    """Distance between neighbouring nodes [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class IterateRecord:
    """The scalars of an iterate: what a history keeps of every one."""

    iteration: int
    objective: float
    """J of the iterate [-]."""
    violation: float = 0.0
    """Largest violation of a constraint, in the method's own scaling; 0 for methods that stay feasible."""
    step: float = 0.0
    """Size of the step that led here: m of path replaced, or the method's own norm."""
    residuals: Mapping[str, float] = field(default_factory=lambda: MappingProxyType({}))
    """Residuals that decide convergence, by name, each divided by its tolerance [-]: converged when all are <= 1."""
    accepted: bool = True
    """False for a rejected trial step; the path is the trial's then, and may violate anything."""
    trust_region: float = math.nan
    """Radius relative to the first one [-]; NaN for methods without a trust region."""
    solver_s: float = math.nan
    """Time inside a foreign solver for this iterate, as that solver says [s]; NaN for methods without one."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Iterate(IterateRecord):
    """A path on the way to the result, or a rejected trial, as the recording plays it back."""

    path: Path

    @property
    def record(self) -> IterateRecord:
        """The iterate without its path."""
        return IterateRecord(**{field.name: getattr(self, field.name) for field in fields(IterateRecord)})


@dataclass(frozen=True, eq=False, kw_only=True)
class Result:
    """The outcome of one method on one problem."""

    path: Path
    stop: Stop
    reason: str
    """One sentence for the user."""
    iterations: int
    """Number of iterations in the method's own counting, rejected ones included."""
    picture: Picture | None = None
    """Drawing of a method that moves points through a map of costs."""


OnIterate = Callable[[Iterate], None]


def ignore(_: Iterate) -> None:
    """The `OnIterate` that does nothing."""
