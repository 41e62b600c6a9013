"""A run rebuilt from its results document: enough to draw and to compare it. Iterates and the map are not stored."""

import contextlib
import math
import pathlib
from collections.abc import Iterator, Mapping
from typing import Any

import numpy as np

from optim.model.objective import Weights
from optim.model.problem import Problem
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
        recorded_audit=_audit(document["recorded_audit"]),
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
        audit=_audit(stored["audit"]),
        iterations=int(stored.get("iterations") or 0),
        wall_s=_number(stored.get("wall_s")),
        history=[_row(row) for row in stored.get("history") or ()],
        iterates=(),
        rejected=None if stored.get("rejected") is None else _audit(stored["rejected"]),
    )


def _audit(stored: Mapping[str, Any]) -> dict[str, Any]:
    """A report as `AuditReport.to_dict` gives it."""
    checks = {name: _check(check) for name, check in (stored.get("checks") or {}).items()}
    return {**stored, "passed": bool(stored.get("passed")), "checks": checks}


def _check(stored: Mapping[str, Any]) -> dict[str, Any]:
    numbers = {
        part: {name: None if value is None else float(value) for name, value in (stored.get(part) or {}).items()}
        for part in ("values", "limits")
    }
    said = {"passed": bool(stored.get("passed")), "sentence": str(stored.get("sentence"))}
    return {**said, **numbers, "place": None if stored.get("place") is None else _place(stored["place"])}


def _place(stored: Mapping[str, Any]) -> dict[str, Any]:
    kinds = {"segment": int, "s": float, "body": str, "polygon": int}
    return {name: kind(stored[name]) for name, kind in kinds.items() if stored.get(name) is not None}


def _metrics(stored: Mapping[str, Any]) -> dict[str, float]:
    """JSON has no infinity: a clearance of null is that of an empty scene. Those that came later may be missing."""
    empty = {"min_clearance": math.inf}
    found = {name: _number(value, empty.get(name, math.nan)) for name, value in stored.items()}
    for name in ("objective", "length", "cusps"):
        if not math.isfinite(found[name]):
            raise ValueError(f"{name} is {found[name]}, expected a number")
    return {**found, "min_clearance": found["min_clearance"]}


def _row(stored: Mapping[str, Any]) -> dict[str, Any]:
    """One iterate's scalars."""
    residuals = {str(name): _number(value) for name, value in (stored.get("residuals") or {}).items()}
    numbers = {name: _number(stored.get(name)) for name in ("objective", "violation", "trust_region", "solver_s")}
    counted = {"iteration": int(stored["iteration"]), "accepted": bool(stored.get("accepted", True))}
    return {**stored, **numbers, **counted, "residuals": residuals}


def _number(value: Any, absent: float = math.nan) -> float:
    return absent if value is None else float(value)
