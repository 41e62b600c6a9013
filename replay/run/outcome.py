"""Outcome of a case: of each method, and of the run as a whole."""

import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal

from optim.audit.report import AuditReport
from optim.model.metrics import UNITS, Metrics
from optim.model.path import Path
from optim.model.result import Iterate, IterateRecord, Picture
from optim.numerics.arrays import data_frame
from replay.base.errors import unknown
from replay.base.numbers import count
from replay.base.style import Style, styles
from replay.run.case import Case
from replay.run.limits import Limits
from replay.run.plot import Drawn, plot

Status = Literal["improved", "kept", "failed"]

MOST_ITERATES: Final = 400
"""Iterates kept for playing back, at most; the first and the last accepted one always are."""
EQUAL: Final = 1e-6
"""Relative difference in J below which paths count as equally good [-]."""
AS_GOOD: Final = 1e-3
"""Relative difference in J that nobody would notice, for `as_good` [-]."""


_RECORDED: Final = (0.4, 0.4, 0.4)
"""Darker than in recordings: plots are on white paper."""


def shape_of(metrics: Metrics) -> str:
    """Length and gear changes in words."""
    return f"{metrics.length:.2f} m, {count(metrics.cusps, 'gear change')}"


def _unit(style: Style) -> tuple[float, float, float]:
    red, green, blue = (part / 255 for part in style.colour)
    return red, green, blue


@dataclass(frozen=True, eq=False, kw_only=True)
class MethodRun:
    """Outcome of one method on a case. `path` is the recorded one unless `status` is "improved"."""

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
    """Metrics of `path`."""
    audit: AuditReport
    """Audit of `path`."""
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
    """The rejected path, for drawing where it fails."""
    picture: Picture | None = None
    """Shapes that the method works on, drawn beside the path."""
    compile_s: float = 0.0
    """Time that went into compiling kernels [s]; once on each machine, and again after a change of the code."""
    traceback: str = ""
    """Traceback of an exception, for developers."""

    def __repr__(self) -> str:
        found = f"{shape_of(self.metrics)}, {self.wall_s:.2f} s"
        return f"MethodRun({self.name!r}: {self.status}, J {self.metrics.objective:.2f}, {found})"


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """A case and what each method made of it."""

    case: Case
    recorded_metrics: Metrics
    recorded_audit: AuditReport
    methods: tuple[MethodRun, ...]
    options: Mapping[str, Mapping[str, Any]]
    """Options of each method by its name; of a chain, those of each part."""
    seed: int = 0
    """Noted, not used: seeds are options of the methods."""
    limits: Limits | None = None
    """Limits that the methods had; None where unknown."""

    def __repr__(self) -> str:
        found = ", ".join(f"{method.name} {method.status}" for method in self.methods) or "no methods"
        best = "" if self.best is None else f" → {self.best.metrics.objective:.2f} by {self.best.name}"
        return f"Run({self.case.name!r}: J {self.recorded_metrics.objective:.2f}{best}; {found})"

    def __getitem__(self, name: str) -> MethodRun:
        """Outcome of the method of that name. Raises KeyError."""
        found = next((method for method in self.methods if method.name == name), None)
        if found is None:
            raise KeyError(unknown("method", str(name), [method.name for method in self.methods]))
        return found

    def __iter__(self) -> Iterator[MethodRun]:
        return iter(self.methods)

    def __contains__(self, name: object) -> bool:
        return any(method.name == name for method in self.methods)

    def plot(self, *names: str) -> Any:
        """Draw the map, the recorded path and those of the methods named, by default the best one's, with signals.

        A `matplotlib.figure.Figure`, to be shown or saved. Raises ImportError where matplotlib is not installed.
        """
        shown = [self[name] for name in names] if names else [method for method in (self.best,) if method is not None]
        looks = styles(method.name for method in shown)
        label = f"recorded: J {self.recorded_metrics.objective:.2f}"
        paths = [Drawn(label=label, colour=_RECORDED, path=self.case.problem.recorded, width=2.5)]
        for method in shown:
            label = f"{method.name}: J {method.metrics.objective:.2f}"
            paths.append(Drawn(label=label, colour=_unit(looks[method.name]), path=method.path))
        return plot(self.case.name, self.case.problem, paths)

    def to_dataframe(self) -> Any:
        """The recorded path and each method as a row, metrics in SI units: a DataFrame of pandas, else of polars.

        Raises ImportError where neither is installed.
        """
        runs = (None, *self.methods)
        metrics = [self.recorded_metrics if run is None else run.metrics for run in runs]
        audits = [self.recorded_audit if run is None else run.audit for run in runs]
        return data_frame(
            {
                "path": ["recorded" if run is None else run.name for run in runs],
                "status": ["recorded" if run is None else run.status for run in runs],
                **{name: [getattr(each, name) for each in metrics] for name in UNITS},
                "audit_passed": [audit.passed for audit in audits],
                "iterations": [0 if run is None else run.iterations for run in runs],
                "wall_s": [math.nan if run is None else run.wall_s for run in runs],
            }
        )

    @property
    def best(self) -> MethodRun | None:
        """The improved path of least J, of equal ones that of the method named first; None if none improved."""
        improved = [run for run in self.methods if run.status == "improved"]
        least = min((run.metrics.objective for run in improved), default=math.inf)
        return next((run for run in improved if run.metrics.objective <= least * (1.0 + EQUAL)), None)

    @property
    def as_good(self) -> list[MethodRun]:
        """Other improved paths, equally good: within `AS_GOOD` of the best J."""
        best, improved = self.best, [run for run in self.methods if run.status == "improved"]
        most = math.inf if best is None else best.metrics.objective * (1.0 + AS_GOOD)
        return [run for run in improved if run is not best and run.metrics.objective <= most]

    @property
    def fell_short(self) -> bool:
        """Whether a method failed, or gave a path that the audit rejected."""
        return any(run.status == "failed" or run.rejected is not None for run in self.methods)
