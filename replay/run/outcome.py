"""What came of a case: the outcome of each method, and of the run as a whole."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from optim.audit.report import AuditReport
from optim.model.metrics import Metrics
from optim.model.path import Path
from optim.model.result import Iterate, IterateRecord, Picture
from replay.run.case import Case
from replay.run.limits import Limits

Status = Literal["improved", "kept", "failed"]

MOST_ITERATES: Final = 400
"""Iterates kept for playing back, at most; the first and the last accepted one always are."""
EQUAL: Final = 1e-6
"""Relative difference in J by which no path is better than another [-]."""
AS_GOOD: Final = 1e-3
"""Relative difference in J that nobody would notice [-]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MethodRun:
    """What one method made of a case. `path` is the recorded one unless `status` is "improved"."""

    name: str
    status: Status
    """improved: passed by the audit, and of less J than a recorded path that passes it too; kept: nothing better was
    found; failed: an error."""
    stop: str
    """The method's own word, a value of `optim.model.result.Stop`."""
    reason: str
    """One sentence for the user; of whatever decided the status."""
    path: Path
    metrics: Metrics
    """Of `path`."""
    audit: AuditReport
    """Of `path`."""
    iterations: int
    wall_s: float
    """Time that the method took [s]; neither the audit nor compilation is included."""
    history: tuple[IterateRecord, ...]
    """Scalars of every iterate, also of rejected trials."""
    iterates: tuple[Iterate, ...]
    """The accepted ones, for playing back; thinned evenly to at most `MOST_ITERATES`."""
    rejected: AuditReport | None = None
    """The audit of the path that the method gave, if that audit did not pass."""
    rejected_path: Path | None = None
    """That path, for drawing where it fails."""
    picture: Picture | None = None
    """What the method works on besides the path, for drawing."""
    compile_s: float = 0.0
    """Time that went into compiling kernels [s]; once on each machine, and again after a change of the code."""
    traceback: str = ""
    """Of an exception, for developers."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """A case and what each method made of it."""

    case: Case
    recorded_metrics: Metrics
    recorded_audit: AuditReport
    methods: tuple[MethodRun, ...]
    options: Mapping[str, Mapping[str, Any]]
    """Of each method by its name: option -> value; of a chain, each part's."""
    seed: int = 0
    """Noted, not used: seeds are options of the methods."""
    limits: Limits | None = None
    """Limits that the methods had; None where unknown."""

    @property
    def best(self) -> MethodRun | None:
        """The improved path of least J, of equal ones that of the method named first; None if none improved."""
        improved = [run for run in self.methods if run.status == "improved"]
        least = min((run.metrics.objective for run in improved), default=math.inf)
        return next((run for run in improved if run.metrics.objective <= least * (1.0 + EQUAL)), None)

    @property
    def as_good(self) -> list[MethodRun]:
        """Other improved paths, whose J is the best one's but for what nobody would notice."""
        best, improved = self.best, [run for run in self.methods if run.status == "improved"]
        most = math.inf if best is None else best.metrics.objective * (1.0 + AS_GOOD)
        return [run for run in improved if run is not best and run.metrics.objective <= most]

    @property
    def fell_short(self) -> bool:
        """Whether a method failed, or gave a path that the audit rejected."""
        return any(run.status == "failed" or run.rejected is not None for run in self.methods)
