"""A run rebuilt from its results document: enough to draw and to compare it. Iterates and the map are not stored."""

import contextlib
import math
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any

import msgspec

from optim.audit.data import Place
from optim.audit.report import AuditReport, Check
from optim.model.metrics import UNITS, Metrics
from optim.model.objective import Weights
from optim.model.problem import Problem
from optim.model.result import IterateRecord
from optim.model.vehicle import Vehicle
from replay.base.documents import DocumentError, Number, convert
from replay.base.errors import ReplayError
from replay.base.schemas.results import (
    AuditDocument,
    CheckDocument,
    IterateDocument,
    MethodDocument,
    MetricsDocument,
    ReadDocument,
    ResultsDocument,
    ToolDocument,
)
from replay.run.case import Case, ReadReport
from replay.run.limits import Limits
from replay.run.outcome import MethodRun, Run
from replay.run.plain import RESULTS_ERROR, path_from_document, scene_from_document


def run_of(document: ResultsDocument, source: str) -> Run:
    """The run of a results document. ReplayError (E_RESULTS) where a field cannot be used."""
    with _rebuilt(f"{source}: its run"):
        return _run(document)


@contextlib.contextmanager
def _rebuilt(what: str) -> Iterator[None]:
    try:
        yield
    except ReplayError as error:
        raise ReplayError(error.code, f"{what} cannot be rebuilt: {error.message}") from error
    except (DocumentError, ValueError, IndexError) as error:
        raise ReplayError(RESULTS_ERROR, f"{what} cannot be rebuilt: {' '.join(str(error).split())}") from error


def _run(document: ResultsDocument) -> Run:
    tool, log = document.tool, document.log
    problem = _problem(document)
    case = Case(
        name=log.case,
        log=pathlib.Path(log.path),
        sha256=log.sha256,
        problem=problem,
        read=_read(document.read),
        map=None,
        frame=problem.scene.frame,
        reading=None if tool.reading is msgspec.UNSET else tool.reading,
    )
    if document.recorded_metrics is msgspec.UNSET or document.recorded_audit is msgspec.UNSET:
        raise ValueError("recorded_metrics and recorded_audit are needed, and one is missing")
    return Run(
        case=case,
        recorded_metrics=_metrics(document.recorded_metrics, "recorded_metrics"),
        recorded_audit=_audit(document.recorded_audit),
        methods=tuple(_method(method, f"methods[{k}]") for k, method in enumerate(document.methods)),
        options=tool.options,
        seed=tool.seed,
        limits=_limits(tool),
    )


def _limits(tool: ToolDocument) -> Limits | None:
    if tool.limits is msgspec.UNSET:
        return None
    return Limits(time_s=_number(tool.limits.time_s, math.inf), memory_mib=tool.limits.memory_mib)


def problem_of(document: ResultsDocument) -> Problem:
    """The problem that a results document states. ReplayError (E_RESULTS) where a field cannot be used."""
    with _rebuilt("its problem"):
        return _problem(document)


def _problem(document: ResultsDocument) -> Problem:
    scene, margin = scene_from_document(document.scene)
    return Problem(
        vehicle=convert(document.vehicle, Vehicle, "vehicle", exact=True),
        scene=scene,
        recorded=path_from_document(document.recorded),
        margin=margin,
        weights=convert(document.weights, Weights, "weights", exact=True),
    )


def _read(stored: ReadDocument) -> ReadReport:
    return ReadReport(
        poses=stored.poses,
        hitch=stored.hitch,
        max_deviation_m=_number(stored.max_deviation_m),
        max_deviation_rad=_number(stored.max_deviation_rad),
        rms_deviation_m=_number(stored.rms_deviation_m),
        rms_deviation_rad=_number(stored.rms_deviation_rad),
        goal_hitch_sigma=_number(stored.goal_hitch_sigma),
        notes=stored.notes,
        lost=stored.lost,
    )


def _method(stored: MethodDocument, at: str) -> MethodRun:
    return MethodRun(
        name=stored.name,
        status=stored.status,
        stop=stored.stop,
        reason=stored.reason,
        path=path_from_document(stored.path),
        metrics=_metrics(stored.metrics, f"{at}.metrics"),
        audit=_audit(stored.audit),
        iterations=stored.iterations,
        wall_s=_number(stored.wall_s),
        history=tuple(_record(record) for record in stored.history),
        iterates=(),
        rejected=None if stored.rejected is None else _audit(stored.rejected),
    )


def _audit(stored: AuditDocument) -> AuditReport:
    """A report that says "not passed" although none of its checks failed counts as incomplete."""
    checks = {name: _check(check) for name, check in stored.checks.items()}
    complete = stored.passed if stored.complete is msgspec.UNSET else stored.complete
    unexplained = not stored.passed and all(check.passed for check in checks.values())
    return AuditReport(checks=checks, complete=complete and not unexplained)


def _check(stored: CheckDocument) -> Check:
    values, limits = _numbers(stored.values), _numbers(stored.limits)
    return Check(passed=stored.passed, sentence=stored.sentence, values=values, limits=limits, place=_place(stored))


def _place(stored: CheckDocument) -> Place | None:
    place = stored.place
    if place is None or place.s is None:
        return None
    body = None if place.body is msgspec.UNSET else place.body
    polygon = None if place.polygon is msgspec.UNSET else place.polygon
    return Place(segment=place.segment, s=place.s, body=body, polygon=polygon)


def _metrics(stored: MetricsDocument, at: str) -> Metrics:
    """A clearance of null is that of an empty scene. Metrics that came later may be missing, and are NaN."""
    found: dict[str, Any] = {
        name: None if (value := getattr(stored, name)) is msgspec.UNSET else value for name in UNITS
    }
    for name in ("objective", "length", "cusps"):
        if found[name] is None:
            raise ValueError(f"{at}.{name} is missing or null, expected a number")
    if stored.min_clearance is msgspec.UNSET:
        raise ValueError(f"{at}.min_clearance is missing")
    cusps, free = found.pop("cusps"), _number(found.pop("min_clearance"), math.inf)
    return Metrics(**{name: _number(value) for name, value in found.items()}, cusps=cusps, min_clearance=free)


def _record(stored: IterateDocument) -> IterateRecord:
    names = ("objective", "violation", "step", "trust_region", "solver_s")
    return IterateRecord(
        iteration=stored.iteration,
        accepted=stored.accepted,
        residuals=_numbers(stored.residuals),
        **{name: _number(getattr(stored, name)) for name in names},
    )


def _numbers(stored: Mapping[str, Number]) -> dict[str, float]:
    return {name: _number(value) for name, value in stored.items()}


def _number(value: Number, absent: float = math.nan) -> float:
    return absent if value is None else value
