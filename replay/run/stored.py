"""A run rebuilt from its results document: enough to draw and to compare it. Iterates and the map are not stored."""

import contextlib
import math
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from optim.audit.report import AuditReport
from optim.model.metrics import UNITS, Metrics
from optim.model.objective import Weights
from optim.model.problem import Problem
from optim.model.result import IterateRecord
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import frozen
from replay.base.errors import ReplayError
from replay.run.case import Case, ReadReport
from replay.run.judge import MethodRun, Run
from replay.run.results import RESULTS_ERROR, path_from_document


def run_of(document: Mapping[str, Any], source: str) -> Run:
    """The run of a results document that `read_results` has read. ReplayError (E_RESULTS) where a field is no good."""
    with _rebuilt(f"{source}: its run"):
        return _run(document)


@contextlib.contextmanager
def _rebuilt(what: str) -> Iterator[None]:
    try:
        yield
    except (KeyError, TypeError, ValueError, AttributeError, IndexError, OverflowError) as error:
        why = f"{type(error).__name__}: {' '.join(str(error).split())}"
        raise ReplayError(RESULTS_ERROR, f"{what} cannot be rebuilt: {why}") from error


def _run(document: Mapping[str, Any]) -> Run:
    problem, log, tool = _problem(document), document["log"], document["tool"]
    case = Case(
        name=str(log["case"]),
        log=pathlib.Path(str(log["path"])),
        sha256=str(log["sha256"]),
        problem=problem,
        read=_read(document.get("read") or {}),
        map=None,
        frame=problem.scene.frame,
    )
    return Run(
        case=case,
        recorded_metrics=_metrics(document["recorded_metrics"]),
        recorded_audit=AuditReport.from_dict(document["recorded_audit"]),
        methods=tuple(_method(method) for method in document["methods"]),
        options=dict(tool.get("options") or {}),
        seed=int(tool.get("seed") or 0),
    )


def problem_of(document: Mapping[str, Any]) -> Problem:
    """The problem that a results document states. ReplayError (E_RESULTS) where a field is no good."""
    with _rebuilt("its problem"):
        return _problem(document)


def _problem(document: Mapping[str, Any]) -> Problem:
    scene = document["scene"]
    return Problem(
        vehicle=Vehicle(**document["vehicle"]),
        scene=Scene(
            polygons=tuple(frozen(np.array(polygon, float)) for polygon in scene["polygons"]),
            boundary=None if scene.get("boundary") is None else frozen(np.array(scene["boundary"], float)),
            frame=str(scene.get("frame") or ""),
        ),
        recorded=path_from_document(document["recorded"]),
        margin=float(scene.get("margin") or 0.0),
        weights=Weights(**document["weights"]),
    )


def _read(stored: Mapping[str, Any]) -> ReadReport:
    return ReadReport(
        poses=int(stored.get("poses") or 0),
        hitch=stored.get("hitch") or "reconstructed",
        max_deviation_m=_number(stored.get("max_deviation_m")),
        max_deviation_rad=_number(stored.get("max_deviation_rad")),
        rms_deviation_m=_number(stored.get("rms_deviation_m"), 0.0),
        rms_deviation_rad=_number(stored.get("rms_deviation_rad"), 0.0),
        goal_hitch_sigma=_number(stored.get("goal_hitch_sigma"), 0.0),
        notes=tuple(map(str, stored.get("notes") or ())),
        lost=bool(stored.get("lost")),
    )


def _method(stored: Mapping[str, Any]) -> MethodRun:
    return MethodRun(
        name=stored["name"],
        status=stored["status"],
        stop=str(stored.get("stop")),
        reason=str(stored.get("reason")),
        path=path_from_document(stored["path"]),
        metrics=_metrics(stored["metrics"]),
        audit=AuditReport.from_dict(stored["audit"]),
        iterations=int(stored.get("iterations") or 0),
        wall_s=_number(stored.get("wall_s")),
        history=tuple(_record(record) for record in stored.get("history") or ()),
        iterates=(),
        rejected=None if stored.get("rejected") is None else AuditReport.from_dict(stored["rejected"]),
    )


def _metrics(stored: Mapping[str, Any]) -> Metrics:
    """JSON has no infinity: a clearance of null is that of an empty scene. Those that came later may be missing."""
    for name in ("objective", "length", "cusps"):
        if not math.isfinite(_number(stored[name])):
            raise ValueError(f"{name} is {_number(stored[name])}, expected a number")
    special = ("cusps", "min_clearance")
    found = {name: _number(stored.get(name)) for name in UNITS if name not in special}
    free = _number(stored["min_clearance"], math.inf)
    return Metrics(**found, cusps=int(stored["cusps"]), min_clearance=free)


def _record(stored: Mapping[str, Any]) -> IterateRecord:
    residuals = {str(name): _number(value) for name, value in (stored.get("residuals") or {}).items()}
    names = ("objective", "violation", "step", "trust_region", "solver_s")
    numbers = {name: _number(stored.get(name)) for name in names}
    counted = {"iteration": int(stored["iteration"]), "accepted": bool(stored.get("accepted", True))}
    return IterateRecord(**numbers, **counted, residuals=residuals)


def _number(value: Any, absent: float = math.nan) -> float:
    return absent if value is None else float(value)
