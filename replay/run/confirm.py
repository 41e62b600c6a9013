"""The audit of a results file repeated, from the file alone, and with it everything that the file claims.

A claim is a verdict, a number of an audit, a metric, or a status: `improved` says that the audit passes, that the path
keeps the required clearance, and that J is lower.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

import msgspec
import numpy as np

from optim.audit.checks import audit_path
from optim.audit.report import AuditReport
from optim.model.metrics import UNITS, Metrics, metrics
from optim.model.problem import Problem
from replay.base.documents import Number
from replay.base.errors import ReplayError
from replay.base.schemas.results import AuditDocument, MethodDocument, MetricsDocument, ResultsDocument
from replay.run.judge import gains, lacks_clearance
from replay.run.plain import path_from_document
from replay.run.stored import problem_of

_AGREEMENT = 1e-6
"""Largest difference of a stored number from the recomputed one, absolute below 1, relative above [-]: another machine
adds in another order."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Confirmation:
    """The audit of one path of a results file, repeated, beside what the file says of it."""

    name: str
    """Name of the method; "recorded" for the recorded path."""
    report: AuditReport
    """The repeated audit: it reads only the file's vehicle, scene and paths."""
    differences: tuple[str, ...]
    """Claims of the file that the repeated audit does not confirm, one line each."""

    @property
    def confirmed(self) -> bool:
        """Whether everything that the file claims holds."""
        return not self.differences


def audit_results(document: ResultsDocument) -> list[Confirmation]:
    """Repeat the audit of the recorded path and of every method's, and compare with all that the document claims.

    A stored verdict "not passed" that is confirmed is not a difference; `report.passed` says whether a path is sound.
    """
    with np.errstate(all="ignore"):  # absurd numbers overflow; the audit rejects them
        return _confirmations(document)


def _confirmations(document: ResultsDocument) -> list[Confirmation]:
    problem = _problem(document)
    recorded = _audit_recorded_again(document)
    stored = document.recorded_audit
    differences = [
        *(() if stored is msgspec.UNSET else _disagreements(stored, recorded)),
        *_wrong_metrics(document.recorded_metrics, _measured(problem, document.recorded)),
    ]
    found = [Confirmation(name="recorded", report=recorded, differences=tuple(differences))]
    for method in document.methods:
        report = _audit_again(document, method.path, _stored_objective(method.metrics))
        measured = _measured(problem, method.path)
        differences = [
            *_disagreements(method.audit, report),
            *_wrong_metrics(method.metrics, measured),
            *_unfounded(method, report, document, recorded),
            *_too_close(method, problem, measured),
        ]
        found.append(Confirmation(name=method.name, report=report, differences=tuple(differences)))
    return found


def _problem(document: ResultsDocument) -> Problem | None:
    """The problem that the document states; None where its vehicle, scene or recorded path cannot be one."""
    try:
        return problem_of(document)
    except ReplayError:
        return None


def _measured(problem: Problem | None, path: Mapping[str, Any]) -> Metrics | None:
    """The metrics of a path; None where it or the problem cannot be used, which the audit reports by itself."""
    if problem is None:
        return None
    try:
        return metrics(problem.vehicle, problem.scene, path_from_document(path), problem.weights)
    except (ReplayError, ValueError):
        return None


def _stored_objective(stored: MetricsDocument | msgspec.UnsetType) -> float | None:
    objective = None if stored is msgspec.UNSET else stored.objective
    return None if objective is msgspec.UNSET else objective


def _audit_again(document: ResultsDocument, path: Mapping[str, Any], objective: float | None) -> AuditReport:
    return audit_path(document.vehicle, document.scene, document.recorded, path, document.weights, objective)


def _audit_recorded_again(document: ResultsDocument) -> AuditReport:
    report = _audit_again(document, document.recorded, _stored_objective(document.recorded_metrics))
    if document.recorded_metrics is not msgspec.UNSET:
        return report
    return _audit_again(document, document.recorded, _recomputed_objective(report))  # it claims no objective


def _disagreements(stored: AuditDocument, report: AuditReport) -> Iterator[str]:
    """Differences of a stored report from the repeated one. A stored one may have fewer checks."""
    if stored.passed is not report.passed:
        found = "; ".join(report.failures) or "passed"
        yield f"the stored audit does not say {'passed' if report.passed else 'not passed'}; repeated: {found}"
    for name, check in stored.checks.items():
        again = report.checks.get(name)
        if again is None or again.passed is not check.passed:
            yield f"the stored check {name[:40]!r} is not confirmed: {again.sentence if again else 'not made'}"
            continue
        yield from _other_numbers(f"the stored check {name!r}: ", check.values, again.values)
        yield from _other_numbers(f"the stored check {name!r}: limit of ", check.limits, again.limits)


def _wrong_metrics(stored: MetricsDocument | msgspec.UnsetType, measured: Metrics | None) -> Iterator[str]:
    if stored is msgspec.UNSET or measured is None:
        return
    claims = {name: value for name in UNITS if (value := getattr(stored, name)) is not msgspec.UNSET}
    yield from _other_numbers("the stored metric ", claims, dataclasses.asdict(measured))


def _other_numbers(where: str, stored: Mapping[str, Number], found: Mapping[str, float]) -> Iterator[str]:
    """Each number that is stored and found otherwise. A file may hold fewer; null stands for what is not finite."""
    for name, value in stored.items():
        if name in found and not _agree(value, found[name]):
            yield f"{where}{name} is {_shown(value)}, recomputed {_shown(found[name])}"


def _agree(stored: Number, found: float) -> bool:
    if not math.isfinite(found):
        return stored is None
    return stored is not None and abs(stored - found) <= _AGREEMENT * max(1.0, abs(found))


def _shown(value: Number) -> str:
    return "null" if value is None else f"{value:.9g}"


def _unfounded(
    method: MethodDocument, report: AuditReport, document: ResultsDocument, recorded: AuditReport
) -> Iterator[str]:
    """Contradictions of a method's status."""
    if method.status != "improved":
        if method.path != document.recorded:
            yield f"the status is {method.status!r}, but the path is not the recorded one"
        return
    if not report.passed:
        yield "the status is 'improved', but the audit does not pass"
    before, after = (_recomputed_objective(audited) for audited in (recorded, report))
    if recorded.passed and not gains(before, after):
        yield f"the status is 'improved', but J is {after:.9g} and the recorded path's {before:.9g}"


def _too_close(method: MethodDocument, problem: Problem | None, measured: Metrics | None) -> Iterator[str]:
    """Whether a path that is called improved lacks clearance."""
    if problem is None or measured is None or method.status != "improved":
        return
    if lacks_clearance(problem, measured):
        found, required = measured.min_clearance, problem.required_clearance
        yield f"the status is 'improved', but the path's clearance is {found:.4f} m, required {required:.4f} m"


def _recomputed_objective(report: AuditReport) -> float:
    check = report.checks.get("objective")
    return check.values["recomputed"] if check else math.nan
