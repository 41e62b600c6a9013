"""The Foxglove messages that are understood, from protobuf and JSON, as the same arrays as those of ROS 2."""

from collections.abc import Callable, Iterator, Mapping
from dataclasses import dataclass
from functools import partial
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from optim.numerics.arrays import Array, frozen, frozen_int
from replay.logs.messages import types as m
from replay.logs.messages.json_messages import decode_json
from replay.logs.messages.protobuf import Decoder
from replay.logs.messages.types import (
    Decode,
    Grid,
    Header,
    Joints,
    Marker,
    MessageType,
    PayloadError,
    PoseSeries,
    Role,
    Transform,
)

MessageTree = dict[str, Any]
_NOT_TURNED = (0.0, 0.0, 0.0, 1.0)
_ZERO = (0.0, 0.0, 0.0)
OCCUPANCY: Final = ("occupancy", "occupied", "cost", "value")
"""The field of a grid that is read, where it has several."""
_TYPES: Final = {1: "<u1", 2: "<i1", 3: "<u2", 4: "<i2", 5: "<u4", 6: "<i4", 7: "<f4", 8: "<f8"}


def _pose(tree: MessageTree | None, unset: tuple[float, ...]) -> Array:
    """Position and quaternion, shape (7,); `unset` is the quaternion of a pose without one."""
    tree = tree or {"position": None, "orientation": None}
    return frozen([*(tree["position"] or _ZERO), *(tree["orientation"] or unset)])


def _points(rows: list[list[float]]) -> Array:
    return frozen(np.array(rows, np.float64).reshape(-1, 3))


# ---- one function for each message


def poses(tree: MessageTree) -> PoseSeries:
    """`foxglove.PosesInFrame`."""
    rows = [[*(pose["position"] or _ZERO), *(pose["orientation"] or (0.0,) * 4)] for pose in tree["poses"]]
    stamps = frozen_int(np.full(len(rows), tree["timestamp"], np.int64))
    header = Header(tree["timestamp"], tree["frame_id"])
    array = frozen(np.array(rows, np.float64).reshape(-1, 7))
    return PoseSeries(header=header, stamps=stamps, poses=array, frames=frozenset())


def pose(tree: MessageTree) -> PoseSeries:
    """`foxglove.PoseInFrame`: a series of one."""
    blank = {"position": None, "orientation": None}
    return poses({**tree, "poses": [tree["pose"] or blank]})


def transform(tree: MessageTree) -> tuple[Transform, ...]:
    """`foxglove.FrameTransform`."""
    header = Header(tree["timestamp"], tree["parent_frame_id"])
    pose = {"position": tree["translation"], "orientation": tree["rotation"]}
    return (Transform(header=header, child=tree["child_frame_id"], pose=_pose(pose, _NOT_TURNED)),)


def transforms(tree: MessageTree) -> tuple[Transform, ...]:
    """`foxglove.FrameTransforms`."""
    return tuple(each for part in tree["transforms"] for each in transform(part))


def joints(tree: MessageTree) -> tuple[Joints, ...]:
    """`foxglove.JointStates`."""
    names = tuple(joint["name"] for joint in tree["joints"])
    positions = frozen(np.array([joint["position"] for joint in tree["joints"]], np.float64))
    return (Joints(stamp=tree["timestamp"], names=names, positions=positions),)


def joint(tree: MessageTree) -> tuple[Joints, ...]:
    """`foxglove.JointState`, whose time is the log's."""
    return joints({"timestamp": 0, "joints": [tree]})


def grid(tree: MessageTree) -> Grid:
    """`foxglove.Grid`. Raises PayloadError unless it is a grid of square cells with an occupancy."""
    x, y = tree["cell_size"] or (0.0, 0.0)
    if not abs(x - y) <= 1e-6 * abs(x):
        raise PayloadError(f"its cells have {x:g} by {y:g} m, expected squares")
    values = _cells(tree)
    return Grid(
        header=Header(tree["timestamp"], tree["frame_id"]),
        resolution=x,
        width=values.shape[1],
        height=values.shape[0],
        origin=_pose(tree["pose"], _NOT_TURNED),
        data=_occupancy(values).ravel(),
    )


def _cells(tree: MessageTree) -> NDArray:
    """The values of the one field of a grid that says how occupied cells are. Shape (height, width)."""
    field = _occupancy_field(tree["fields"])
    dtype = _TYPES.get(field["type"])
    if dtype is None:
        raise PayloadError(f"field {field['name'][:40]!r} of its cells has the type {field['type']}, expected 1 to 8")
    data, columns = tree["data"], tree["column_count"]
    row, cell = tree["row_stride"], tree["cell_stride"]
    size = np.dtype(dtype).itemsize
    if field["offset"] + size > cell or columns * cell > row or row == 0 or len(data) % row:
        text = f"{len(data)} bytes in rows of {row}, {columns} cells of {cell} each with a value of {size} at byte"
        raise PayloadError(f"its sizes contradict each other: {text} {field['offset']}")
    height = len(data) // row
    if columns * height == 0:
        return np.zeros((height, columns), dtype)
    return np.ndarray((height, columns), dtype, data, field["offset"], (row, cell))


def _occupancy_field(fields: list[MessageTree]) -> MessageTree:
    if len(fields) == 1:
        return fields[0]
    named = [field for field in fields if field["name"].lower() in OCCUPANCY]
    if len(named) == 1:
        return named[0]
    listed = ", ".join(repr(field["name"][:40]) for field in fields[:6]) or "none"
    raise PayloadError(f"its cells have the fields {listed}; expected one, or one of {', '.join(OCCUPANCY)}")


def _occupancy(values: NDArray) -> NDArray[np.int8]:
    """-1 unknown, 0 to 100: whole numbers as they are, 255 of a byte as unknown; fractions are probabilities."""
    if values.dtype.kind == "f":
        known = np.isfinite(values) & (values >= 0.0)
        if not (np.isnan(values) | (values == -1.0) | (known & (values <= 1.0))).all():
            raise PayloadError(
                "its cells hold numbers that are not probabilities: expected 0 to 1, or -1 or NaN: unknown"
            )
        found = np.where(known, np.rint(np.where(known, values, 0.0) * 100.0), -1.0).astype(np.int8)
    else:
        unknown = values == 255 if values.dtype == np.uint8 else values == np.array(-1)
        if not (unknown | ((values >= 0) & (values <= 100))).all():
            worst = int(values[~unknown].max()) if (values[~unknown] > 100).any() else int(values.min())
            raise PayloadError(f"its cells hold the value {worst}, expected 0 to 100, or -1 (255 in a byte): unknown")
        found = np.where(unknown, -1, values).astype(np.int8)
    found.flags.writeable = False
    return found


# ---- scenes


def scene(tree: MessageTree) -> tuple[Marker, ...]:
    """`foxglove.SceneUpdate` as markers: an entity is a namespace, its primitives are numbered."""
    found: list[Marker] = []
    for deletion in tree["deletions"]:
        name = "" if deletion["type"] == 1 else _namespace(deletion["id"])
        found.append(_forget(name, deletion["timestamp"]))
    for entity in tree["entities"]:
        header, name = Header(entity["timestamp"], entity["frame_id"]), _namespace(entity["id"])
        found.append(_forget(name, 0))
        for number, (kind, pose, scale, points) in enumerate(_primitives(entity)):
            found.append(
                Marker(
                    header=header,
                    ns=name,
                    id=number,
                    type=kind,
                    action=m.ADD,
                    pose=_pose(pose, _NOT_TURNED),
                    scale=frozen(scale),
                    points=_points(points),
                )
            )
    return tuple(found)


def _namespace(entity: str) -> str:
    return f"entity {entity}"  # never empty: an empty one means all


def _forget(ns: str, stamp: int) -> Marker:
    """A deletion of a namespace, or of all if it is empty, up to a stamp [ns]; 0: of whatever age."""
    nothing = frozen(_ZERO)
    return Marker(
        header=Header(stamp, ""),
        ns=ns,
        id=0,
        type=0,
        action=m.FORGET,
        pose=_pose(None, _NOT_TURNED),
        scale=nothing,
        points=_points([]),
    )


def _primitives(entity: MessageTree) -> Iterator[tuple[int, MessageTree | None, Any, list[list[float]]]]:
    """Marker type, pose, scale and points of each primitive."""
    for cube in entity["cubes"]:
        yield m.CUBE, cube["pose"], cube["size"] or _ZERO, []
    for sphere in entity["spheres"]:
        yield m.SPHERE, sphere["pose"], sphere["size"] or _ZERO, []
    for cylinder in entity["cylinders"]:
        x, y, z = cylinder["size"] or _ZERO
        wide = max(cylinder["bottom_scale"], cylinder["top_scale"])
        yield m.CYLINDER, cylinder["pose"], (x * wide, y * wide, z), []
    for line in entity["lines"]:
        points = _indexed(line)
        closed = line["type"] == 1 and points
        width = 0.0 if line["scale_invariant"] else line["thickness"]
        kind = m.LINE_LIST if line["type"] == 2 else m.LINE_STRIP
        yield kind, line["pose"], (width, 0.0, 0.0), [*points, points[0]] if closed else points
    for triangles in entity["triangles"]:
        yield m.TRIANGLE_LIST, triangles["pose"], (1.0, 1.0, 1.0), _indexed(triangles)
    for kind, name in ((m.ARROW, "arrows"), (m.TEXT, "texts"), (m.MESH, "models")):
        yield from ((kind, None, _ZERO, []) for _ in entity[name])


def _indexed(primitive: MessageTree) -> list[list[float]]:
    points, indices = primitive["points"], primitive["indices"]
    if not indices:
        return points
    if max(indices) >= len(points):
        raise PayloadError(f"a shape names point {max(indices)} of {len(points)}")
    return [points[i] for i in indices]


# ---- the table


@dataclass(frozen=True, kw_only=True)
class FoxgloveType(MessageType):
    """A Foxglove message type, in protobuf or JSON."""

    encodings = ("protobuf", "protobuf"), ("json", "jsonschema"), ("json", "")
    convert: Callable[[MessageTree], Any]
    """Makes of a message's fields what its role asks for. Raises PayloadError."""

    def decoder(self, encodings: tuple[str, str], definition: bytes) -> Decode:
        """The decoder for the messages of a channel. Raises DefinitionError. JSON names its fields: it needs none."""
        if encodings[0] == "json":
            fields = partial(decode_json, self.name)
        else:
            fields = Decoder(self.name, definition)
        return lambda data: self.convert(fields(data))


def _by_name(*types: tuple[str, Role, Callable[[MessageTree], Any]]) -> dict[str, FoxgloveType]:
    return {name: FoxgloveType(name=name, role=role, convert=convert) for name, role, convert in types}


MESSAGE_TYPES: Final[Mapping[str, FoxgloveType]] = _by_name(
    ("foxglove.Grid", "grid", grid),
    ("foxglove.SceneUpdate", "markers", scene),
    ("foxglove.PosesInFrame", "path", poses),
    ("foxglove.PoseInFrame", "stream", pose),
    ("foxglove.FrameTransform", "transforms", transform),
    ("foxglove.FrameTransforms", "transforms", transforms),
    ("foxglove.JointState", "joints", joint),
    ("foxglove.JointStates", "joints", joints),
)
"""Message types by schema name; the fields of each are in `foxglove_definitions.py`."""
