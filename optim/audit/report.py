"""Result of the audit: named checks with the numbers that decided them, and the report that holds them."""

import math
from collections.abc import Mapping
from dataclasses import dataclass

from optim.audit.data import Array, Place
from optim.audit.motion import BODIES


@dataclass(frozen=True, kw_only=True)
class Check:
    """The outcome of one check. The names in `values` and `limits` end in their units."""

    passed: bool
    sentence: str
    """What was found and its limit, as a sentence."""
    values: Mapping[str, float]
    limits: Mapping[str, float]
    """Limits of the values that decide."""
    place: Place | None = None
    """Place where it is worst."""

    def __repr__(self) -> str:
        return f"Check({'passed' if self.passed else 'failed'}: {self.sentence})"

    @property
    def deciding(self) -> str | None:
        """Name of the value nearest to its limit, or farthest beyond; where a body is at the place, of that body's.

        None for a check without a limit.
        """
        body = "" if self.place is None or self.place.body is None else self.place.body
        names = [
            name for name in self.limits if name.startswith(body) and not math.isnan(self.values.get(name, math.nan))
        ]
        return max(names, key=self._used, default=None)

    @property
    def value(self) -> float:
        """The deciding value, in the unit that its name ends in; NaN for a check without a limit."""
        return math.nan if self.deciding is None else self.values[self.deciding]

    def _used(self, name: str) -> float:
        limit = self.limits[name]
        return self.values[name] / limit if limit else self.values[name]


@dataclass(frozen=True, kw_only=True)
class AuditReport:
    """The outcome of an audit."""

    checks: Mapping[str, Check]
    """All checks that could be made, by name."""
    complete: bool
    """False when damage left some checks without sense; the report has not passed then."""

    def __repr__(self) -> str:
        checks = f"{len(self.checks)} checks"
        if self.passed:
            return f"AuditReport(passed, {checks})"
        return f"AuditReport(failed: {', '.join(self.failed) or 'incomplete'}, of {checks})"

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
        """Failures, one line for each check that did not pass."""
        return tuple(f"{name}: {self.checks[name].sentence}" for name in self.failed)

    def __getattr__(self, name: str) -> Check:
        """The check of that name, as in `report.clearance.value`; AttributeError where it was not made."""
        checks: Mapping[str, Check] = self.__dict__.get("checks", {})
        if name not in checks:
            raise AttributeError(f"no check {name!r} was made; there are {', '.join(checks)}")
        return checks[name]

    def __dir__(self) -> list[str]:
        return [*super().__dir__(), *self.checks]


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
