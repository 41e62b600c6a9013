"""The results file, schema `replay.results/1`: a run as plain data, and the audit repeated from that data alone.

Beyond the fields of the schema a document holds, additively: `weights` (of the objective, which the audit
recomputes), `scene.boundary` (the map's outline or null), `recorded_metrics` and `recorded_audit`,
`methods[].rejected` (the audit of a path that was turned down), `read.lost`, `tool.python`, and, where the command
line made the run, `tool.reading` and `tool.limits`: with them, it can be repeated exactly.
"""

import dataclasses
import enum
import importlib.metadata
import json
import math
import os
import platform
from collections.abc import Iterator, Mapping
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import numpy as np

from optim.audit import AuditReport, audit_path
from optim.path import Path, Segment
from optim.scene import Scene
from replay.errors import ReplayError
from replay.files import atomic_write
from replay.strict_json import JsonError, read_json

if TYPE_CHECKING:
    from replay.run import MethodRun, Run

SCHEMA = "replay.results/1"
RESULTS_ERROR = "E_RESULTS"
DISTRIBUTION = "truck-trailer-replay"
PACKAGES = ("numpy", "scipy", "numba", "shapely", "zstandard", "lz4", "rerun-sdk")
"""Distributions whose versions a document holds: what can change a number or a file."""
COLUMNS = ("s", "x", "y", "theta", "alpha", "phi")
LARGEST_FILE = 512 * 2**20
"""A results file may not be larger [bytes]; a path of 100 m takes about 0.2 MB."""
LEAST_GAIN = 1e-9
"""Relative gain in J that "improved" claims at least where the recorded path passes the audit too [-]: rounding alone
reaches 1e-12."""


def to_document(run: "Run", settings: Mapping[str, Any] | None = None) -> dict[str, Any]:
    """A run as plain data; what is not finite becomes None when it is written.

    `settings` are options beside those of the methods: `reading` and `limits`, under `tool`.
    """
    case, problem = run.case, run.case.problem
    return {
        "schema": SCHEMA,
        "log": {"path": os.fspath(case.log), "sha256": case.sha256, "case": case.name},
        "tool": tool() | {"options": run.options, "seed": run.seed} | dict(settings or {}),
        "vehicle": dataclasses.asdict(problem.vehicle),
        "scene": scene_to_document(problem.scene, problem.margin),
        "weights": dataclasses.asdict(problem.weights),
        "recorded": path_to_document(problem.recorded),
        "recorded_metrics": run.recorded_metrics,
        "recorded_audit": run.recorded_audit,
        "read": dataclasses.asdict(case.read),
        "methods": [_method(method) for method in run.methods],
    }


def scene_to_document(scene: Scene, margin: float | None = None) -> dict[str, Any]:
    """A scene as plain data: polygons and boundary as lists of [x, y] in metres."""
    return {
        "polygons": [np.asarray(polygon).tolist() for polygon in scene.polygons],
        "boundary": None if scene.boundary is None else np.asarray(scene.boundary).tolist(),
        "frame": scene.frame,
        "margin": margin,
    }


def path_to_document(path: Path) -> dict[str, Any]:
    """A path as plain data; every float exactly."""
    segments = [
        {"direction": int(segment.direction)} | {key: getattr(segment, key).tolist() for key in COLUMNS}
        for segment in path.segments
    ]
    return {"segments": segments}


def path_from_document(document: Mapping[str, Any]) -> Path:
    """The inverse of `path_to_document`. ReplayError (E_RESULTS) where the data are no path."""
    try:
        return Path(
            tuple(
                Segment(direction=segment["direction"], **{key: np.array(segment[key], float) for key in COLUMNS})
                for segment in document["segments"]
            )
        )
    except (KeyError, TypeError, ValueError, IndexError, AttributeError) as error:
        raise ReplayError(RESULTS_ERROR, f"not a path: {type(error).__name__}: {error}") from error


def write_results(path: str | os.PathLike[str], document: Mapping[str, Any]) -> None:
    """Write a document atomically: UTF-8, sorted keys, null for what is not finite, floats so that they come back.

    Raises ReplayError (E_WRITE) where the file cannot be written.
    """
    text = json.dumps(plain(document), sort_keys=True, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    # A file name that is no valid UTF-8 reaches us with lone surrogates; in JSON these are escapes.
    content = text.encode("utf-8", errors="backslashreplace") + b"\n"
    with atomic_write(path) as temporary:
        temporary.write_bytes(content)


def read_results(path: str | os.PathLike[str]) -> dict[str, Any]:
    """Read a results file from anywhere. What its paths and numbers are worth is `audit_results`' business.

    Raises ReplayError (E_RESULTS), one line, for what is no file, too large, no strict JSON (see `strict_json`), of
    another schema, or lacks a field.
    """
    try:
        document = read_json(path, LARGEST_FILE)
    except JsonError as error:
        expected = "" if os.fspath(path).endswith(".json") else "; expected a results file, STEM.results.json"
        raise ReplayError(RESULTS_ERROR, f"{os.fspath(path)}: {error}{expected}") from None
    _require_outline(document, os.fspath(path))
    return document


_OUTLINE: Mapping[str, type] = {
    "log": dict,
    "tool": dict,
    "vehicle": dict,
    "scene": dict,
    "weights": dict,
    "recorded": dict,
    "methods": list,
}
_METHOD_OUTLINE: Mapping[str, type] = {
    "name": str,
    "status": str,
    "path": dict,
    "metrics": dict,
    "audit": dict,
}
_STATUSES = ("improved", "kept", "failed")


def _require_outline(document: Any, source: str) -> None:
    """ReplayError (E_RESULTS) unless the document has the schema's fields, and in them the right types."""
    wrong = _wrong_with(document)
    if wrong:
        raise ReplayError(RESULTS_ERROR, f"{source}: no {SCHEMA} file: {wrong}")


def _wrong_with(document: Any) -> str | None:
    if not isinstance(document, dict):
        return f"holds a {type(document).__name__}, expected an object"
    if document.get("schema") != SCHEMA:
        return f"schema is {str(document.get('schema'))[:60]!r}"
    wrong = _wrong_fields(document, _OUTLINE, "")
    if wrong:
        return wrong
    for i, method in enumerate(document["methods"]):
        if not isinstance(method, dict):
            return f"methods[{i}] is a {type(method).__name__}, expected an object"
        wrong = _wrong_fields(method, _METHOD_OUTLINE, f"methods[{i}].")
        if wrong:
            return wrong
        if method["status"] not in _STATUSES:
            return f"methods[{i}].status is {method['status'][:60]!r}, expected one of {', '.join(_STATUSES)}"
    names = [method["name"] for method in document["methods"]]
    return "two methods have one name" if len(set(names)) < len(names) else None


def _wrong_fields(data: Mapping[str, Any], outline: Mapping[str, type], where: str) -> str | None:
    for key, kind in outline.items():
        if key not in data:
            return f"{where}{key} is missing"
        if not isinstance(data[key], kind):
            return f"{where}{key} is a {type(data[key]).__name__}, expected a {kind.__name__}"
    return None


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
    """Repeat the audit of the recorded path and of every method's, and compare with the stored verdicts.

    A stored verdict "not passed" that is confirmed is no difference; `report.passed` says whether a path is sound.
    Raises ReplayError (E_RESULTS) for what is no results document.
    """
    _require_outline(document, "document")
    recorded = _audit_recorded_again(document)
    stored = document.get("recorded_audit")
    verdicts = [
        Verdict(name="recorded", report=recorded, differences=tuple(_disagreements(stored, recorded)) if stored else ())
    ]
    for method in document["methods"]:
        report = _audit_again(document, method["path"], _stored_objective(method["metrics"]))
        differences = [*_disagreements(method["audit"], report), *_unfounded(method, report, document, recorded)]
        verdicts.append(Verdict(name=method["name"], report=report, differences=tuple(differences)))
    return verdicts


def _stored_objective(metrics: Any) -> Any:
    return metrics.get("objective") if isinstance(metrics, Mapping) else None


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
        passed = check.get("passed") if isinstance(check, Mapping) else None
        if again is None or again.passed is not passed:
            yield f"the stored check {str(name)[:40]!r} is not confirmed: {again.sentence if again else 'not made'}"


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
    if recorded.passed and not after < before * (1.0 - LEAST_GAIN):
        yield f"the status is 'improved', but J is {after:.9g} and the recorded path's {before:.9g}"


def _recomputed_objective(report: AuditReport) -> float:
    check = report.checks.get("objective")
    return check.values["recomputed"] if check else math.nan


def _method(method: "MethodRun") -> dict[str, Any]:
    fields = ("name", "status", "stop", "reason", "metrics", "audit", "iterations", "wall_s", "history", "rejected")
    return {name: getattr(method, name) for name in fields} | {"path": path_to_document(method.path)}


def tool() -> dict[str, Any]:
    """Which program made a document."""
    versions = {name: installed_version(name) for name in PACKAGES}
    return {"version": installed_version(DISTRIBUTION), "packages": versions, "python": platform.python_version()}


def installed_version(distribution: str) -> str | None:
    """The version of a distribution; None where it is not installed."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None


def plain(value: Any) -> Any:
    """Data as JSON can hold them: NumPy's numbers and arrays as Python's, what is not finite as None."""
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, enum.Enum):
        return plain(value.value)
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"results: {type(value).__name__} has no place in a document")
