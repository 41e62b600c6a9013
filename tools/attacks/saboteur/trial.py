"""One audit of one spoiled claim, with all checks and with one of them switched off."""

import contextlib
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

import optim.audit.checks as audit
import optim.audit.data as audit_data
from tools.attacks.saboteur import alone, forged
from tools.attacks.saboteur.claims import KINDS, Claim, Kind, as_json, copied

__all__ = ["KINDS", "Kind", "Outcome", "alone", "forged", "passes_without", "report_of", "spoiled", "trial"]
READING = {"finite": ("_require_finite",), "structure": ("_require_gear", "_require_simple")}
"""Functions that refuse a document by these names; the others can only be left out as entries of the table."""
MOST_DRAWS = 200


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of one spoiled claim."""

    rejected: bool
    by_name: bool
    """The check that is meant to notice did."""
    passes_without: bool | None
    """With that check switched off it passes; None for kinds that others see too."""
    failed: tuple[str, ...]


def trial(kind: Kind, claims: list[Claim], seed: int) -> Outcome:
    """Spoil one of the claims, audit it; for a kind seen by one check alone, again without that check."""
    claim = spoiled(kind, claims, seed)
    report = report_of(claim, audit.ALL)
    return Outcome(
        rejected=not report.passed,
        by_name=kind.check in report.failed,
        passes_without=passes_without(claim, kind.check) if kind.alone else None,
        failed=report.failed,
    )


def spoiled(kind: Kind, claims: list[Claim], seed: int) -> Claim:
    """A claim with damage of a kind, as a file would hold it; which of `claims` follows from the seed."""
    rng = np.random.default_rng([seed, *kind.name.encode()])
    for _ in range(MOST_DRAWS):
        claim = copied(claims[int(rng.integers(len(claims)))])
        if kind.damage(claim, rng):
            return as_json(claim if kind.check == "objective" else _restated(claim))
    raise ValueError(f"{kind.name!r} can be done to none of the claims")


def _restated(claim: Claim) -> Claim:
    """The claim with the right J of its path, where it has one: the saboteur does not give himself away by J."""
    with contextlib.suppress(audit_data.Unreadable), np.errstate(all="ignore"):
        track = audit_data.read_path(as_json(claim["path"]), "path")
        claim["reported_objective"] = audit._recomputed(track, claim["weights"])
    return claim


def report_of(claim: Claim, checks: tuple[str, ...]) -> audit.AuditReport:
    """The audit of a claim by some checks."""
    about = audit._Claim(claim["recorded"], claim["weights"], claim["reported_objective"])
    document = audit._Document(claim["vehicle"], claim["scene"], claim["path"], about)
    return audit._audit(document, audit.Tolerances(), checks)


def passes_without(claim: Claim, check: str) -> bool:
    """Whether an audit without that check accepts the claim."""
    if check not in READING:
        return report_of(claim, tuple(name for name in audit.ALL if name != check)).passed
    with _accepting(*READING[check]):
        return report_of(claim, audit.ALL).passed


@contextlib.contextmanager
def _accepting(*names: str) -> Iterator[None]:
    """The reading of documents without these refusals."""
    kept = {name: getattr(audit_data, name) for name in names}
    accept: Callable[..., Any] = lambda *_: None  # noqa: E731
    try:
        for name in names:
            setattr(audit_data, name, accept)
        yield
    finally:
        for name, function in kept.items():
            setattr(audit_data, name, function)
