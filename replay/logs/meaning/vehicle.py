"""The metadata records of a log: `vehicle`, the dimensions of the truck, and `path_nodes`, the planner's nodes."""

import dataclasses
import json
from collections.abc import Sequence
from typing import Any, NoReturn

import numpy as np

from optim.model.vehicle import BEYOND_AXLES, Vehicle
from optim.numerics.arrays import IntArray
from replay.base.errors import LogError, printable
from replay.logs.container.log import Log, Metadata
from replay.logs.meaning.planar import Refusal

REQUIRED = ("wheelbase", "hitch_to_axle")
MAX_NODES_TEXT = 1 << 20
"""Longest list of node indices [characters]."""


def vehicle_in(log: Log) -> tuple[Vehicle, list[str]]:
    """`vehicle_of` the metadata of a log. Raises LogError (E_VEHICLE)."""
    try:
        return vehicle_of(log.metadata)
    except Refusal as error:
        raise LogError(error.code, log.path, str(error)) from None


def vehicle_of(metadata: Sequence[Metadata]) -> tuple[Vehicle, list[str]]:
    """The vehicle that the log names, else the default truck; and notes. Raises Refusal (E_VEHICLE)."""
    record = _only(metadata, "vehicle", "E_VEHICLE")
    if record is None:
        return Vehicle(), [
            "the log names no vehicle (metadata record 'vehicle'); the default truck is used (--vehicle names another)"
        ]
    fields = {field.name for field in dataclasses.fields(Vehicle)}
    values = {key: _number(key, text) for key, text in record.values.items() if key in fields}
    missing = [name for name in REQUIRED if name not in values]
    if missing:
        raise Refusal("E_VEHICLE", f"metadata record 'vehicle' lacks {' and '.join(missing)}")
    notes = []
    unknown = sorted(set(record.values) - fields)
    if unknown:
        shown = ", ".join(printable(key, 30) for key in unknown[:5]) + (", ..." if len(unknown) > 5 else "")
        notes.append(f"metadata record 'vehicle': unknown keys are ignored ({shown})")
    absent = sorted(fields - set(values) - {"hitch_offset"})
    if absent:
        notes.append(f"metadata record 'vehicle' lacks {', '.join(absent)}; the default truck's are used")
    notes += _lengthened(values)
    try:
        return Vehicle(**values), notes
    except ValueError as error:
        raise Refusal("E_VEHICLE", f"metadata record 'vehicle': {error}") from None


def _lengthened(values: dict[str, float]) -> list[str]:
    """Notes; in `values`, bodies whose lengths the log does not give reach their axles."""
    notes = []
    for extent, (axle, _) in BEYOND_AXLES.items():
        if extent not in values and getattr(Vehicle, extent) < values[axle]:
            values[extent] = values[axle]
            text = f"{extent} is taken to be {axle}, {values[axle]:g} m: the default truck's is less"
            notes.append(f"metadata record 'vehicle': {text}")
    return notes


def nodes_of(metadata: Sequence[Metadata], num_poses: int) -> IntArray | None:
    """Indices of the poses at which planner nodes lie, increasing; None without such a record. Raises Refusal."""
    record = _only(metadata, "path_nodes", "E_PATH_NODES")
    if record is None:
        return None
    text = record.values.get("indices", "")
    try:
        indices = json.loads(text) if len(text) <= MAX_NODES_TEXT else None
    except (ValueError, RecursionError):
        indices = None
    if not isinstance(indices, list) or not indices or not all(type(i) is int for i in indices):
        raise Refusal(
            "E_PATH_NODES",
            f"metadata record 'path_nodes': indices is {text[:40]!r}, expected a list of integers",
        )
    outside = [i for i in indices if not 0 <= i < num_poses]
    if outside:
        raise Refusal(
            "E_PATH_NODES",
            f"metadata record 'path_nodes': index {outside[0]} of a path with {num_poses} poses",
        )
    return np.unique(np.array(indices, np.int64))


def _only(metadata: Sequence[Metadata], name: str, code: str) -> Metadata | None:
    """The one record of that name. Two different ones, or a repeated key, leave open what is meant."""
    found = [record for record in metadata if record.name == name]
    if not found:
        return None
    if any(record.duplicates for record in found) or any(record.values != found[0].values for record in found):
        raise Refusal(code, f"the log has several metadata records {name!r}, or repeated keys in one, that differ")
    return found[0]


def _number(key: str, text: str) -> float:
    def refuse(found: object = text) -> NoReturn:
        raise Refusal("E_VEHICLE", f"metadata record 'vehicle': {key} is {str(found)[:40]!r}, expected a number")

    try:
        value: Any = json.loads(text, parse_constant=refuse) if len(text) <= 64 else None
    except (ValueError, RecursionError):
        refuse()
    if isinstance(value, bool) or not isinstance(value, int | float):
        refuse()
    return float(value)
