"""The results file: a run as the document of `replay.base.schemas.results`, written and read."""

import dataclasses
import os
import platform
from collections.abc import Mapping
from typing import Any, Final

import msgspec

from optim.audit.report import AuditReport, Check
from optim.model.metrics import Metrics
from replay.base.documents import DocumentError, convert, read_json, to_bytes
from replay.base.errors import ReplayError
from replay.base.files import atomic_write
from replay.base.schemas.results import (
    SCHEMA,
    AuditDocument,
    CheckDocument,
    IterateDocument,
    LimitsDocument,
    LogDocument,
    MethodDocument,
    MetricsDocument,
    PlaceDocument,
    ReadDocument,
    ResultsDocument,
    ToolDocument,
)
from replay.base.versions import DISTRIBUTION, PACKAGES, installed_version
from replay.run.case import ReadReport
from replay.run.outcome import MethodRun, Run
from replay.run.plain import RESULTS_ERROR, path_to_document, scene_to_document

LARGEST_FILE: Final = 512 * 2**20
"""A results file may not be larger [bytes]; a path of 100 m takes about 0.2 MB."""


def to_document(run: Run) -> ResultsDocument:
    """A run as plain data; what is not finite becomes null when it is written."""
    case, problem = run.case, run.case.problem
    return ResultsDocument(
        schema=SCHEMA,
        log=LogDocument(path=os.fspath(case.log), sha256=case.sha256, case=case.name),
        tool=_tool(run),
        vehicle=dataclasses.asdict(problem.vehicle),
        scene=scene_to_document(problem.scene, problem.margin),
        weights=dataclasses.asdict(problem.weights),
        recorded=path_to_document(problem.recorded),
        recorded_metrics=metrics_document(run.recorded_metrics),
        recorded_audit=audit_document(run.recorded_audit),
        read=read_document(case.read),
        methods=tuple(_method(method) for method in run.methods),
    )


def _tool(run: Run) -> ToolDocument:
    limits = run.limits
    return msgspec.structs.replace(
        program(),
        options=run.options,
        seed=run.seed,
        reading=msgspec.UNSET if run.case.reading is None else run.case.reading,
        limits=msgspec.UNSET if limits is None else LimitsDocument(time_s=limits.time_s, memory_mib=limits.memory_mib),
    )


def program() -> ToolDocument:
    """Versions of the program and of its packages."""
    versions = {name: installed_version(name) for name in PACKAGES}
    return ToolDocument(version=installed_version(DISTRIBUTION), packages=versions, python=platform.python_version())


def _method(method: MethodRun) -> MethodDocument:
    return MethodDocument(
        name=method.name,
        status=method.status,
        stop=method.stop,
        reason=method.reason,
        path=path_to_document(method.path),
        metrics=metrics_document(method.metrics),
        audit=audit_document(method.audit),
        iterations=method.iterations,
        wall_s=method.wall_s,
        history=tuple(IterateDocument(**vars(record)) for record in method.history),
        rejected=None if method.rejected is None else audit_document(method.rejected),
    )


def metrics_document(metrics: Metrics) -> MetricsDocument:
    """Metrics as plain data."""
    return MetricsDocument(**dataclasses.asdict(metrics))


def audit_document(report: AuditReport) -> AuditDocument:
    """An audit as plain data."""
    checks = {name: _check(check) for name, check in report.checks.items()}
    return AuditDocument(passed=report.passed, complete=report.complete, checks=checks)


def _check(check: Check) -> CheckDocument:
    place = None
    if check.place is not None:
        place = PlaceDocument(**{name: value for name, value in vars(check.place).items() if value is not None})
    return CheckDocument(
        passed=check.passed, sentence=check.sentence, values=check.values, limits=check.limits, place=place
    )


def read_document(read: ReadReport) -> ReadDocument:
    """Findings from reading the log, as plain data."""
    return ReadDocument(**vars(read))


def write_results(path: str | os.PathLike[str], document: ResultsDocument) -> None:
    """Write a document atomically. Raises ReplayError (E_WRITE) where the file cannot be written."""
    content = to_bytes(document)
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def read_results(path: str | os.PathLike[str]) -> ResultsDocument:
    """Read a results file from anywhere. What its paths and numbers are worth is the business of `replay.run.confirm`.

    Raises ReplayError (E_RESULTS), one line that names the field, for anything but a results file.
    """
    try:
        return read_json(path, ResultsDocument, LARGEST_FILE)
    except DocumentError as error:
        expected = "" if os.fspath(path).endswith(".json") else "; expected a results file, STEM.results.json"
        raise ReplayError(RESULTS_ERROR, f"{os.fspath(path)}: {error}{expected}") from None


def results_of(data: Mapping[str, Any], source: str) -> ResultsDocument:
    """Plain data as a results document; `source` names where they come from. Raises ReplayError (E_RESULTS)."""
    try:
        return convert(data, ResultsDocument)
    except DocumentError as error:
        raise ReplayError(RESULTS_ERROR, f"{source}: {error}") from None
