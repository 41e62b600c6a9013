"""What the audit says: named checks with the numbers that decided them, and the report that holds them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any

from optim.audit.data import Array, Place
from optim.audit.motion import BODIES


@dataclass(frozen=True, kw_only=True)
class Check:
    """The outcome of one check. The names in `values` and `limits` end in their units."""

    passed: bool
    sentence: str
    """For people: what was found, and its limit."""
    values: Mapping[str, float]
    limits: Mapping[str, float]
    """Of those values that decide."""
    place: Mapping[str, float | int | str] | None = None
    """Where it is worst: `segment` (index), `s` (arc length in it [m]), `body`, `polygon` (index)."""

    def to_dict(self) -> dict[str, Any]:
        """Plain data; what is not finite becomes None."""
        parts = {"values": self.values, "limits": self.limits, "place": self.place}
        return {"passed": self.passed, "sentence": self.sentence, **{k: _plain(v) for k, v in parts.items()}}


@dataclass(frozen=True, kw_only=True)
class AuditReport:
    """The outcome of an audit."""

    checks: Mapping[str, Check]
    """All checks that could be made, by name."""
    complete: bool
    """False when damage left some checks without sense; the report has not passed then."""

    @property
    def passed(self) -> bool:
        """Whether every check was made, and passed."""
        return self.complete and all(check.passed for check in self.checks.values())

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the checks that did not pass."""
        return tuple(name for name, check in self.checks.items() if not check.passed)

    @property
    def failures(self) -> tuple[str, ...]:
        """What is wrong, one line for each check that did not pass."""
        return tuple(f"{name}: {self.checks[name].sentence}" for name in self.failed)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, as the results file stores it."""
        checks = {name: check.to_dict() for name, check in self.checks.items()}
        return {"passed": self.passed, "complete": self.complete, "checks": checks}


def at_most(what: str, quantities: Mapping[str, tuple[float, float, str]], place: Place | None = None) -> Check:
    """Every quantity, given as name: (value, limit, unit), at most its limit; NaN is not."""
    parts = [f"{name} {value:.6g} {unit} (limit {limit:.6g})" for name, (value, limit, unit) in quantities.items()]
    return Check(
        passed=all(value <= limit for value, limit, _ in quantities.values()),
        sentence=f"{what}: {', '.join(parts)}",
        values={f"{name}_{unit}": float(value) for name, (value, _, unit) in quantities.items()},
        limits={f"{name}_{unit}": float(limit) for name, (_, limit, unit) in quantities.items()},
        place=place,
    )


def at_least(what: str, values: Array, limit: float, place: Place) -> Check:
    """The smallest value of either body at least the limit; NaN is not."""
    least = values.min(axis=0)
    parts = ", ".join(f"{body} {value:.4f} m" for body, value in zip(BODIES, least, strict=True))
    return Check(
        passed=bool((least >= limit).all()),
        sentence=f"least swept {what}: {parts} (limit {limit:g})",
        values={f"{body}_m": float(value) for body, value in zip(BODIES, least, strict=True)},
        limits={f"{body}_m": limit for body in BODIES},
        place=place,
    )


def _plain(part: Mapping[str, Any] | None) -> dict[str, Any] | None:
    if part is None:
        return None
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in part.items()}
