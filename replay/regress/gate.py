"""What decides whether a result is worse than before: the metrics that are compared, and how closely.

Correctness is compared tightly, in absolute terms; quality loosely enough for another machine's rounding; counters of
work to a hundredth. Wall time is never compared with a stored figure: it depends on what else the machine does.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

Value = float | str | bool | None
Direction = Literal["lower", "higher", "exact"]

STATUSES = ("failed", "kept", "improved")
"""The worst first."""
ENOUGH_CLEARANCE = 0.5
"""Clearance beyond which more is no better [m]: a path may pass a far obstacle as it likes."""


@dataclass(frozen=True, kw_only=True)
class Metric:
    """One figure of a result, and how far it may be from the baseline's."""

    key: str
    value: Value
    unit: str
    direction: Direction
    """Which way is better; exact: no other value will do."""
    rel_tol: float = 0.0
    """Relative to the value before [-]."""
    abs_tol: float = 0.0
    """In the metric's unit; both tolerances are added."""

    def verdict(self, before: Value) -> str:
        """same, better, worse, or new where there is no value to compare with."""
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


def _ordered(gain: float, tolerance: float) -> str:
    if gain < -tolerance:
        return "worse"
    return "better" if gain > tolerance else "same"


def _rank(status: Value) -> int:
    return STATUSES.index(status) if status in STATUSES else 0


def metrics_of(method: Mapping[str, Any]) -> list[Metric]:
    """What is compared of a method's result, an entry of a log's document."""
    metrics = method.get("metrics") or {}
    audit = method.get("audit") or {}
    work = method.get("work") or {}
    clearance = metrics.get("min_clearance")
    enough = ENOUGH_CLEARANCE if clearance is None else min(clearance, ENOUGH_CLEARANCE)
    found = [
        Metric(key="status", value=method.get("status"), unit="-", direction="higher"),
        Metric(key="audit", value=audit.get("passed"), unit="-", direction="higher"),
        Metric(key="min_clearance", value=enough, unit="m", direction="higher", abs_tol=1e-3),
        Metric(key="defect", value=_check(audit, "defect"), unit="m", direction="lower", abs_tol=1e-5),
        Metric(key="defect_sum", value=_check(audit, "defect_sum"), unit="m", direction="lower", abs_tol=1e-4),
        Metric(key="objective", value=metrics.get("objective"), unit="-", direction="lower", rel_tol=1e-3),
        Metric(key="cusps", value=metrics.get("cusps"), unit="-", direction="lower"),
    ]
    counters = [Metric(key=k, value=v, unit="-", direction="lower", rel_tol=0.01) for k, v in sorted(work.items())]
    return found + counters


def _check(audit: Mapping[str, Any], name: str) -> Value:
    check = (audit.get("checks") or {}).get(name) or {}
    return (check.get("values") or {}).get("position_m")
