"""Foxglove messages for tests, made with Foxglove's own protobuf classes, and their JSON form."""

import base64
import importlib
import json
from collections.abc import Iterable, Sequence
from typing import Any

import numpy as np
from google.protobuf.descriptor_pb2 import FileDescriptorSet

SECOND = 1_000_000_000


def message(kind: str, **fields: Any) -> Any:
    """A message of Foxglove's, such as ``message("Grid", frame_id="map")``."""
    return getattr(importlib.import_module(f"foxglove_schemas_protobuf.{kind}_pb2"), kind)(**fields)


def time(stamp: int) -> Any:
    timestamp = importlib.import_module("google.protobuf.timestamp_pb2").Timestamp
    return timestamp(seconds=stamp // SECOND, nanos=stamp % SECOND)


def pose(x: float, y: float, yaw: float, z: float = 0.0) -> Any:
    position = message("Vector3", x=x, y=y, z=z)
    return message("Pose", position=position, orientation=message("Quaternion", z=np.sin(yaw / 2), w=np.cos(yaw / 2)))


def poses(rows: Iterable[Sequence[float]], frame: str = "map", stamp: int = 0) -> Any:
    each = [pose(row[0], row[1], row[2]) for row in rows]
    return message("PosesInFrame", timestamp=time(stamp), frame_id=frame, poses=each)


def grid(
    cells: np.ndarray,
    resolution: float = 0.2,
    origin: Sequence[float] = (0.0, 0.0, 0.0),
    frame: str = "map",
    kind: int = 2,
) -> Any:
    """A grid of cells (H, W), as bytes of one field: `kind` 1 is uint8, 2 int8, 7 float32, 8 float64."""
    values = np.ascontiguousarray(cells, {1: "<u1", 2: "<i1", 7: "<f4", 8: "<f8"}[kind])
    return message(
        "Grid",
        timestamp=time(0),
        frame_id=frame,
        pose=pose(origin[0], origin[1], origin[2]),
        column_count=values.shape[1],
        cell_size=message("Vector2", x=resolution, y=resolution),
        row_stride=values.strides[0],
        cell_stride=values.itemsize,
        fields=[message("PackedElementField", name="occupancy", offset=0, type=kind)],
        data=values.tobytes(),
    )


def entity(name: str, frame: str = "map", stamp: int = 0, **primitives: Any) -> Any:
    return message("SceneEntity", timestamp=time(stamp), frame_id=frame, id=name, **primitives)


def scene(*entities: Any, deletions: Sequence[Any] = ()) -> Any:
    return message("SceneUpdate", entities=entities, deletions=deletions)


def cube(at: Sequence[float], size: Sequence[float], z: float = 0.5) -> Any:
    return message("CubePrimitive", pose=pose(at[0], at[1], at[2], z), size=vector(size))


def vector(values: Sequence[float]) -> Any:
    return message("Vector3", x=values[0], y=values[1], z=values[2])


def points(rows: Iterable[Sequence[float]]) -> list[Any]:
    return [message("Point3", x=x, y=y, z=z) for x, y, z in rows]


def transform(parent: str, child: str, at: Sequence[float], stamp: int = 0) -> Any:
    there = pose(at[0], at[1], at[2])
    return message(
        "FrameTransform",
        timestamp=time(stamp),
        parent_frame_id=parent,
        child_frame_id=child,
        translation=there.position,
        rotation=there.orientation,
    )


def joints(stamp: int = 0, **positions: float) -> Any:
    each = [message("JointState", name=name, position=value) for name, value in positions.items()]
    return message("JointStates", timestamp=time(stamp), joints=each)


def definition(each: Any) -> bytes:
    """The FileDescriptorSet of a message and of all that it imports."""
    found: dict[str, Any] = {}
    todo = [each.DESCRIPTOR.file]
    while todo:
        file = todo.pop()
        if file.name not in found:
            found[file.name] = file
            todo += file.dependencies
    result = FileDescriptorSet()
    for file in found.values():
        file.CopyToProto(result.file.add())
    return result.SerializeToString()


def tree(each: Any) -> Any:
    """A message as Foxglove's JSON has it: names as they are, times as sec and nsec, bytes in base64."""
    if each.DESCRIPTOR.full_name.startswith("google.protobuf."):
        return {"sec": each.seconds, "nsec": each.nanos}
    found: dict[str, Any] = {}
    for field in each.DESCRIPTOR.fields:
        value = getattr(each, field.name)
        if field.is_repeated:
            found[field.name] = [tree(item) if field.message_type else item for item in value]
        elif field.message_type:
            if each.HasField(field.name):
                found[field.name] = tree(value)
        else:
            found[field.name] = base64.b64encode(value).decode() if isinstance(value, bytes) else value
    return found


def added(maker: Any, topic: str, each: Any, when: int = 0, encoding: str = "protobuf") -> Any:
    """A log maker with one message more, in an encoding."""
    name = each.DESCRIPTOR.full_name
    if encoding == "protobuf":
        data, text, schema = each.SerializeToString(), definition(each), "protobuf"
    else:
        data, text, schema = json.dumps(tree(each)).encode(), b'{"type": "object"}', "jsonschema"
    return maker.add_raw(topic, name, data, when, definition=text, encoding=encoding, schema_encoding=schema)
