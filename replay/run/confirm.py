"""The audit of a results file repeated, from the file alone, and with it everything that the file claims.

A claim is a verdict, a number of an audit, a metric, or a status: `improved` says that the audit passes, that the path
keeps the required clearance, and that J is lower.
"""

import dataclasses
import math
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import Any

from optim.audit.checks import audit_path
from optim.audit.report import AuditReport
from optim.model.metrics import Metrics, metrics
from optim.model.problem import Problem
from replay.base.errors import ReplayError
from replay.run.results import gains, lacks_clearance, path_from_document, require_outline
from replay.run.stored import problem_of

_AGREEMENT = 1e-6
"""By which a stored number may differ from the recomputed one, absolute below 1, relative above [-]: another machine
adds in another order."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Verdict:
    """The audit of one path of a results file, repeated, beside what the file says of it."""

    name: str
    """Of the method; "recorded" for the recorded path."""
    report: AuditReport
    """From the file's vehicle, scene and paths alone."""
    differences: tuple[str, ...]
    """What the file claims and the repeated audit does not confirm, one line each."""

    @property
    def confirmed(self) -> bool:
        """Whether everything that the file claims holds."""
        return not self.differences


def audit_results(document: Mapping[str, Any]) -> list[Verdict]:
    """Repeat the audit of the recorded path and of every method's, and compare with all that the document claims.

    A stored verdict "not passed" that is confirmed is no difference; `report.passed` says whether a path is sound.
    Raises ReplayError (E_RESULTS) for what is no results document.
    """
    require_outline(document, "document")
    problem = _problem(document)
    recorded = _audit_recorded_again(document)
    stored = document.get("recorded_audit")
    differences = [
        *(_disagreements(stored, recorded) if stored else ()),
        *_wrong_metrics(document.get("recorded_metrics") or {}, _measured(problem, document["recorded"])),
    ]
    verdicts = [Verdict(name="recorded", report=recorded, differences=tuple(differences))]
    for method in document["methods"]:
        report = _audit_again(document, method["path"], _stored_objective(method["metrics"]))
        measured = _measured(problem, method["path"])
        differences = [
            *_disagreements(method["audit"], report),
            *_wrong_metrics(method["metrics"], measured),
            *_unfounded(method, report, document, recorded),
            *_too_close(method, problem, measured),
        ]
        verdicts.append(Verdict(name=method["name"], report=report, differences=tuple(differences)))
    return verdicts


def _problem(document: Mapping[str, Any]) -> Problem | None:
    """The problem that the document states; None where its vehicle, scene or recorded path cannot be one."""
    try:
        return problem_of(document)
    except ReplayError:
        return None


def _measured(problem: Problem | None, path: Mapping[str, Any]) -> Metrics | None:
    """The metrics of a path; None where it or the problem cannot be used, which the audit tells by itself."""
    if problem is None:
        return None
    try:
        return metrics(problem.vehicle, problem.scene, path_from_document(path), problem.weights)
    except (ReplayError, ValueError):
        return None


def _stored_objective(stored: Any) -> Any:
    return stored.get("objective") if isinstance(stored, Mapping) else None


def _audit_again(document: Mapping[str, Any], path: Mapping[str, Any], objective: Any) -> AuditReport:
    vehicle, scene, recorded = document["vehicle"], document["scene"], document["recorded"]
    return audit_path(vehicle, scene, recorded, path, document["weights"], objective)


def _audit_recorded_again(document: Mapping[str, Any]) -> AuditReport:
    report = _audit_again(document, document["recorded"], _stored_objective(document.get("recorded_metrics")))
    if "recorded_metrics" in document:
        return report
    return _audit_again(document, document["recorded"], _recomputed_objective(report))  # it claims no objective


def _disagreements(stored: Any, report: AuditReport) -> Iterator[str]:
    """Where a stored report differs from the repeated one. A stored one may have fewer checks."""
    if not isinstance(stored, Mapping) or stored.get("passed") is not report.passed:
        found = "; ".join(report.failures) or "passed"
        yield f"the stored audit does not say {'passed' if report.passed else 'not passed'}; repeated: {found}"
    checks = stored.get("checks") if isinstance(stored, Mapping) else None
    for name, check in checks.items() if isinstance(checks, Mapping) else ():
        again = report.checks.get(name)
        if again is None or not isinstance(check, Mapping) or again.passed is not check.get("passed"):
            yield f"the stored check {str(name)[:40]!r} is not confirmed: {again.sentence if again else 'not made'}"
            continue
        yield from _other_numbers(f"the stored check {name!r}: ", check.get("values"), again.values)
        yield from _other_numbers(f"the stored check {name!r}: limit of ", check.get("limits"), again.limits)


def _wrong_metrics(stored: Any, measured: Metrics | None) -> Iterator[str]:
    found = {} if measured is None else dataclasses.asdict(measured)
    yield from _other_numbers("the stored metric ", stored, found)


def _other_numbers(where: str, stored: Any, found: Mapping[str, float]) -> Iterator[str]:
    """Each number that is stored and found otherwise. A file may hold fewer; null stands for what is not finite."""
    for name, value in stored.items() if isinstance(stored, Mapping) else ():
        if name in found and not _agree(value, found[name]):
            yield f"{where}{name} is {_shown(value)}, recomputed {_shown(found[name])}"


def _agree(stored: Any, found: float) -> bool:
    if not math.isfinite(found):
        return stored is None or stored == found
    if isinstance(stored, bool) or not isinstance(stored, int | float):
        return False
    return abs(stored - found) <= _AGREEMENT * max(1.0, abs(found))


def _shown(value: Any) -> str:
    return f"{value:.9g}" if isinstance(value, int | float) else str(value)[:40]


def _unfounded(
    method: Mapping[str, Any], report: AuditReport, document: Mapping[str, Any], recorded: AuditReport
) -> Iterator[str]:
    """What is wrong with a method's status."""
    if method["status"] != "improved":
        if method["path"] != document["recorded"]:
            yield f"the status is {method['status']!r}, but the path is not the recorded one"
        return
    if not report.passed:
        yield "the status is 'improved', but the audit does not pass"
    before, after = (_recomputed_objective(audited) for audited in (recorded, report))
    if recorded.passed and not gains(before, after):
        yield f"the status is 'improved', but J is {after:.9g} and the recorded path's {before:.9g}"


def _too_close(method: Mapping[str, Any], problem: Problem | None, measured: Metrics | None) -> Iterator[str]:
    """Whether a path that is called improved lacks clearance."""
    if problem is None or measured is None or method["status"] != "improved":
        return
    if lacks_clearance(problem, measured):
        found, required = measured.min_clearance, problem.required_clearance
        yield f"the status is 'improved', but the path's clearance is {found:.4f} m, required {required:.4f} m"


def _recomputed_objective(report: AuditReport) -> float:
    check = report.checks.get("objective")
    return check.values["recomputed"] if check else math.nan
