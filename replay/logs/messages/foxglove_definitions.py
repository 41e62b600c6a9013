"""Message definitions of Foxglove: the fields that are read, and their values where a message omits them."""

from typing import Any, Final, NamedTuple

from replay.logs.messages.types import PayloadError


class Field(NamedTuple):
    """One field of a message."""

    name: str
    kind: str
    """`double`, `fixed32`, `bool`, `enum`, `string`, `bytes`, `time`, or the name of a message."""
    repeated: bool


def _fields(text: str) -> tuple[Field, ...]:
    words = [word.partition(":") for word in text.split()]
    return tuple(Field(name, kind.removesuffix("[]"), kind.endswith("[]")) for name, _, kind in words)


_XYZ = "x:double y:double z:double"
MESSAGES: Final = {
    f"foxglove.{name}": _fields(text)
    for name, text in {
        "Vector2": "x:double y:double",
        "Vector3": _XYZ,
        "Point3": _XYZ,
        "Quaternion": _XYZ + " w:double",
        "Pose": "position:foxglove.Vector3 orientation:foxglove.Quaternion",
        "PackedElementField": "name:string offset:fixed32 type:enum",
        "Grid": "timestamp:time frame_id:string pose:foxglove.Pose column_count:fixed32 cell_size:foxglove.Vector2 "
        "row_stride:fixed32 cell_stride:fixed32 fields:foxglove.PackedElementField[] data:bytes",
        "PosesInFrame": "timestamp:time frame_id:string poses:foxglove.Pose[]",
        "PoseInFrame": "timestamp:time frame_id:string pose:foxglove.Pose",
        "FrameTransform": "timestamp:time parent_frame_id:string child_frame_id:string translation:foxglove.Vector3 "
        "rotation:foxglove.Quaternion",
        "FrameTransforms": "transforms:foxglove.FrameTransform[]",
        "JointState": "name:string position:double",
        "JointStates": "timestamp:time joints:foxglove.JointState[]",
        "SceneEntityDeletion": "timestamp:time type:enum id:string",
        "ArrowPrimitive": "",
        "TextPrimitive": "",
        "ModelPrimitive": "",
        "CubePrimitive": "pose:foxglove.Pose size:foxglove.Vector3",
        "SpherePrimitive": "pose:foxglove.Pose size:foxglove.Vector3",
        "CylinderPrimitive": "pose:foxglove.Pose size:foxglove.Vector3 bottom_scale:double top_scale:double",
        "LinePrimitive": "type:enum pose:foxglove.Pose thickness:double scale_invariant:bool "
        "points:foxglove.Point3[] indices:fixed32[]",
        "TriangleListPrimitive": "pose:foxglove.Pose points:foxglove.Point3[] indices:fixed32[]",
        "SceneEntity": "timestamp:time frame_id:string id:string arrows:foxglove.ArrowPrimitive[] "
        "cubes:foxglove.CubePrimitive[] spheres:foxglove.SpherePrimitive[] cylinders:foxglove.CylinderPrimitive[] "
        "lines:foxglove.LinePrimitive[] triangles:foxglove.TriangleListPrimitive[] texts:foxglove.TextPrimitive[] "
        "models:foxglove.ModelPrimitive[]",
        "SceneUpdate": "deletions:foxglove.SceneEntityDeletion[] entities:foxglove.SceneEntity[]",
    }.items()
}
"""Fields that are read; a message may have others."""

VECTORS: Final = frozenset(
    name for name, fields in MESSAGES.items() if fields and all(field.kind == "double" for field in fields)
)
"""Messages of doubles alone: they are decoded to lists of numbers."""
MAX_PARTS: Final = 1_000_000
"""Most messages within one message: each may take two bytes there and hundreds here."""
_ZEROS: Final[dict[str, Any]] = {
    "double": 0.0, "fixed32": 0, "bool": False, "enum": 0, "string": "", "bytes": b"", "time": 0,
}  # fmt: skip


def absent(field: Field) -> Any:
    """The value of a field that a message omits; None for a message."""
    return [] if field.repeated else _ZEROS.get(field.kind)


def nanoseconds(seconds: int, nanos: int, where: str) -> int:
    """One number of nanoseconds, which must fit into 64 bits. Raises PayloadError."""
    if not 0 <= nanos < 1_000_000_000 or abs(seconds) > 9_000_000_000:
        raise PayloadError(f"{where} is {seconds} s and {nanos} ns, which is not a time")
    return seconds * 1_000_000_000 + nanos
