"""Figures that decide whether a result is worse than before, and their tolerances.

Correctness is compared tightly, in absolute terms; quality loosely enough for another machine's rounding; counters of
work to a hundredth. Wall time is never compared with a stored figure: it depends on what else the machine does.
"""

from dataclasses import dataclass
from typing import Literal

from replay.base.schemas.baseline import Figures
from replay.base.schemas.log import MethodResult
from replay.base.schemas.results import AuditDocument
from replay.base.schemas.values import Scalar, known
from replay.base.schemas.verdicts import Verdict

Direction = Literal["lower", "higher", "exact"]

STATUSES = ("failed", "kept", "improved")
"""The worst first."""
ENOUGH_CLEARANCE = 0.5
"""Clearance above which more does not count [m]: a path may pass a far obstacle at any distance."""


@dataclass(frozen=True, kw_only=True)
class Figure:
    """One figure of a result, and its tolerance."""

    key: str
    """Field of `Figures`."""
    value: Scalar
    unit: str = "-"
    direction: Direction
    """Which way is better; exact: any other value is worse."""
    rel_tol: float = 0.0
    """Relative to the value before [-]."""
    abs_tol: float = 0.0
    """In the figure's unit; both tolerances are added."""

    def verdict(self, before: Scalar) -> Verdict:
        """Compare with the value before; "new" where there was none."""
        if before is None:
            return "new" if self.value is not None else "same"
        if self.value is None:
            return "worse"
        if self.key == "status":
            return _ordered(_rank(self.value) - _rank(before), 0.0)
        if isinstance(self.value, (str, bool)) or isinstance(before, (str, bool)):
            return "same" if self.value == before else ("better" if self.value is True else "worse")
        gain = self.value - before if self.direction == "higher" else before - self.value
        tolerance = self.abs_tol + self.rel_tol * abs(before)
        if self.direction == "exact":
            return "same" if abs(gain) <= tolerance else "worse"
        return _ordered(gain, tolerance)


def _ordered(gain: float, tolerance: float) -> Verdict:
    if gain < -tolerance:
        return "worse"
    return "better" if gain > tolerance else "same"


def _rank(status: Scalar) -> int:
    return STATUSES.index(status) if isinstance(status, str) and status in STATUSES else 0


def figures_of(result: MethodResult) -> list[Figure]:
    """The figures of a method's result that are compared."""
    metrics, audit = result.metrics, result.audit
    clearance = known(metrics.min_clearance)
    enough = ENOUGH_CLEARANCE if clearance is None else min(clearance, ENOUGH_CLEARANCE)
    defect, defect_sum = _position(audit, "defect"), _position(audit, "defect_sum")
    work = (("evaluations", result.work.evaluations), ("iterations", result.work.iterations))
    return [
        Figure(key="status", value=result.status, direction="higher"),
        Figure(key="audit", value=None if audit is None else audit.passed, direction="higher"),
        Figure(key="min_clearance", value=enough, unit="m", direction="higher", abs_tol=1e-3),
        Figure(key="defect", value=defect, unit="m", direction="lower", abs_tol=1e-5),
        Figure(key="defect_sum", value=defect_sum, unit="m", direction="lower", abs_tol=1e-4),
        Figure(key="objective", value=known(metrics.objective), direction="lower", rel_tol=1e-3),
        Figure(key="cusps", value=known(metrics.cusps), direction="lower"),
        *(Figure(key=key, value=n, direction="lower", rel_tol=0.01) for key, n in work if n is not None),
    ]


def _position(audit: AuditDocument | None, name: str) -> float | None:
    """The position error that a check measured [m]."""
    check = None if audit is None else audit.checks.get(name)
    return None if check is None else check.values.get("position_m")


def stored(result: MethodResult) -> Figures:
    """The figures of a result as a baseline keeps them."""
    values: dict[str, Scalar] = {figure.key: figure.value for figure in figures_of(result)}
    return Figures(**values)  # pyright: ignore[reportArgumentType] - each has the type of its field
