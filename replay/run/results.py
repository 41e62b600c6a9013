"""The results file, schema `replay.results/1`: a run as plain data.

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
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any

import numpy as np

from optim.model.metrics import Metrics
from optim.model.path import Path, Segment
from optim.model.scene import Scene
from replay.base.errors import ReplayError
from replay.base.files import atomic_write
from replay.base.strict_json import JsonError, read_json

if TYPE_CHECKING:
    from optim.model.problem import Problem
    from replay.run.judge import MethodRun, Run

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
CLEARANCE_SLACK = 1e-4
"""By which the clearance of what is "improved" may fall short of the required one [m]; methods keep 1e-6."""


def gains(before: float, after: float) -> bool:
    """Whether J `after` is lower than J `before` by more than rounding."""
    return after < before * (1.0 - LEAST_GAIN)


def lacks_clearance(problem: "Problem", measured: Metrics) -> bool:
    """Whether a path with these metrics comes nearer to obstacles than a result may."""
    return measured.min_clearance < problem.required_clearance - CLEARANCE_SLACK


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
        "recorded_metrics": dataclasses.asdict(run.recorded_metrics),
        "recorded_audit": run.recorded_audit.to_dict(),
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
    """Read a results file from anywhere. What its paths and numbers are worth is the business of `replay.run.confirm`.

    Raises ReplayError (E_RESULTS), one line, for what is no file, too large, no strict JSON (see `strict_json`), of
    another schema, or lacks a field.
    """
    try:
        document = read_json(path, LARGEST_FILE)
    except JsonError as error:
        expected = "" if os.fspath(path).endswith(".json") else "; expected a results file, STEM.results.json"
        raise ReplayError(RESULTS_ERROR, f"{os.fspath(path)}: {error}{expected}") from None
    require_outline(document, os.fspath(path))
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


def require_outline(document: Any, source: str) -> None:
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


def _method(method: "MethodRun") -> dict[str, Any]:
    fields = ("name", "status", "stop", "reason", "iterations", "wall_s")
    return {name: getattr(method, name) for name in fields} | {
        "path": path_to_document(method.path),
        "metrics": dataclasses.asdict(method.metrics),
        "audit": method.audit.to_dict(),
        "rejected": None if method.rejected is None else method.rejected.to_dict(),
        "history": [vars(record) for record in method.history],
    }


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
