"""The ROS 2 messages that are understood: their standard definitions and their decoders.

Decoders check lengths only; what the values must be is `planar.py`'s and the callers' business. A further type is
one entry in `FAMILIES`.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optim.arrays import Array
from replay.logs.cdr import HEADER_SIZE, CdrError, CdrReader


class Header(NamedTuple):
    """`std_msgs/msg/Header`."""

    stamp: int
    """[ns]"""
    frame: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Grid:
    """`nav_msgs/msg/OccupancyGrid`, as sent."""

    header: Header
    resolution: float
    width: int
    height: int
    origin: Array
    """Position x, y, z [m] and quaternion x, y, z, w. Shape (7,)."""
    data: NDArray[np.int8]
    """Row by row from the origin. Shape (n,); n need not be width x height here."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseSeries:
    """`nav_msgs/msg/Path`, as sent. n poses."""

    header: Header
    stamps: NDArray[np.int64]
    """[ns], shape (n,)."""
    poses: Array
    """Position x, y, z [m] and quaternion x, y, z, w. Shape (n, 7)."""
    frames: frozenset[str]
    """Every frame that a pose names."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Marker:
    """`visualization_msgs/msg/Marker`, without colours, textures and meshes."""

    header: Header
    ns: str
    id: int
    type: int
    action: int
    pose: Array
    """Position x, y, z [m] and quaternion x, y, z, w. Shape (7,)."""
    scale: Array
    """[m], shape (3,)."""
    points: Array
    """[m], in the marker's own frame. Shape (n, 3)."""


def _stamp(reader: CdrReader, field: str) -> int:
    seconds, nanoseconds = reader.i32(f"{field}.sec"), reader.u32(f"{field}.nanosec")
    if nanoseconds >= 1_000_000_000:
        raise CdrError(f"{field}.nanosec is {nanoseconds}, expected less than 1e9")
    return seconds * 1_000_000_000 + nanoseconds


def _header(reader: CdrReader, field: str = "header") -> Header:
    return Header(_stamp(reader, f"{field}.stamp"), reader.text(f"{field}.frame_id"))


def decode_grid(data: bytes, layout: int = 0) -> Grid:
    """Decode an occupancy grid. Raises CdrError."""
    reader = CdrReader(data)
    header = _header(reader)
    _stamp(reader, "info.map_load_time")
    resolution = float(reader.numbers("<f4", 1, "info.resolution")[0])
    width, height = reader.u32("info.width"), reader.u32("info.height")
    origin = reader.numbers("<f8", 7, "info.origin")
    cells = reader.numbers("<i1", reader.count(1, "data"), "data")
    reader.finish()
    return Grid(header=header, resolution=resolution, width=width, height=height, origin=origin, data=cells)


def decode_path(data: bytes, layout: int = 0) -> PoseSeries:
    """Decode a path. Raises CdrError."""
    reader = CdrReader(data)
    header = _header(reader)
    count = reader.count(68, "poses")  # stamp 8, empty frame 4, pose 56
    stamps, poses = np.empty(count, np.int64), np.empty((count, 7))
    frames: set[str] = set()
    done = tries = 0
    while done < count:
        if tries < 4:  # a path whose frames change often is refused anyway: no need to be fast
            done += _read_alike(reader, stamps[done:], poses[done:], frames)
            tries += 1
        if done < count:  # the first pose may be aligned otherwise, or name another frame
            stamp, frame = _header(reader, f"poses[{done}].header")
            stamps[done], poses[done] = stamp, reader.numbers("<f8", 7, f"poses[{done}].pose")
            frames.add(frame)
            done += 1
    reader.finish()
    stamps.flags.writeable = poses.flags.writeable = False
    return PoseSeries(header=header, stamps=stamps, poses=poses, frames=frozenset(frames))


def _read_alike(reader: CdrReader, stamps: NDArray[np.int64], poses: Array, frames: set[str]) -> int:
    """Read poses from here on that have the same frame, all at once; how many they are.

    From an offset that is a multiple of eight, poses with frames of equal length lie at equal distances.
    """
    start, end = reader.pos, reader.end
    if (start - HEADER_SIZE) % 8 or end - start < 68:
        return 0
    size = int.from_bytes(reader.data[start + 8 : start + 12], "little")
    if size > 255:
        return 0
    lead = -(-(12 + size) // 8) * 8
    count = min((end - start) // (lead + 56), len(stamps))
    if count < 2:
        return 0
    rows = np.frombuffer(reader.data, np.uint8, count * (lead + 56), start).reshape(count, lead + 56)
    alike = (rows[:, 8 : 12 + size] == rows[0, 8 : 12 + size]).all(axis=1)
    count = count if alike.all() else int(np.argmin(alike))
    rows = rows[:count]
    seconds = np.ascontiguousarray(rows[:, :4]).view("<i4")[:, 0]
    nanoseconds = np.ascontiguousarray(rows[:, 4:8]).view("<u4")[:, 0]
    if (nanoseconds >= 1_000_000_000).any():
        return 0  # the loop finds and names the first one
    probe = CdrReader(reader.data)
    probe.pos = start + 8
    frames.add(probe.text("poses[].header.frame_id"))
    stamps[:count] = seconds.astype(np.int64) * 1_000_000_000 + nanoseconds
    poses[:count] = np.ascontiguousarray(rows[:, lead:]).view("<f8")
    reader.pos = start + count * (lead + 56)
    return count


def _marker(reader: CdrReader, field: str, layout: int) -> Marker:
    header = _header(reader, f"{field}header")
    ns, number = reader.text(f"{field}ns"), reader.i32(f"{field}id")
    kind, action = reader.i32(f"{field}type"), reader.i32(f"{field}action")
    pose, scale = reader.numbers("<f8", 7, f"{field}pose"), reader.numbers("<f8", 3, f"{field}scale")
    reader.numbers("<f4", 4, f"{field}color")
    reader.numbers("<i4", 2, f"{field}lifetime")
    reader.u8(f"{field}frame_locked")
    points = reader.numbers("<f8", 3 * reader.count(24, f"{field}points"), f"{field}points").reshape(-1, 3)
    reader.numbers("<f4", 4 * reader.count(16, f"{field}colors"), f"{field}colors")
    if layout == 0:
        _texture(reader, field)
    reader.text(f"{field}text")
    reader.text(f"{field}mesh_resource")
    if layout == 0:
        reader.text(f"{field}mesh_file.filename")
        reader.numbers("<u1", reader.count(1, f"{field}mesh_file"), f"{field}mesh_file")
    reader.u8(f"{field}mesh_use_embedded_materials")
    return Marker(
        header=header, ns=ns, id=number, type=kind, action=action, pose=pose, scale=scale, points=points
    )  # fmt: skip


def _texture(reader: CdrReader, field: str) -> None:
    reader.text(f"{field}texture_resource")
    _header(reader, f"{field}texture.header")
    reader.text(f"{field}texture.format")
    reader.numbers("<u1", reader.count(1, f"{field}texture.data"), f"{field}texture.data")
    reader.numbers("<f4", 2 * reader.count(8, f"{field}uv_coordinates"), f"{field}uv_coordinates")


def decode_marker(data: bytes, layout: int = 0) -> tuple[Marker, ...]:
    """Decode a single marker, as a sequence of one. Raises CdrError."""
    reader = CdrReader(data)
    marker = _marker(reader, "", layout)
    reader.finish()
    return (marker,)


def decode_markers(data: bytes, layout: int = 0) -> tuple[Marker, ...]:
    """Decode an array of markers. Raises CdrError."""
    reader = CdrReader(data)
    count = reader.count(150, "markers")  # fixed-size fields alone take more
    markers = tuple(_marker(reader, f"markers[{i}].", layout) for i in range(count))
    reader.finish()
    return markers


# ---- standard definitions (ROS 2 Humble and later; layout 1 of Marker: Foxy and Galactic)

_RULE = "=" * 80 + "\n"


def _definition(body: str, *parts: str) -> str:
    return _RULE.join((body, *parts))


_HEADER = "MSG: std_msgs/Header\nbuiltin_interfaces/Time stamp\nstring frame_id\n"
_TIME = "MSG: builtin_interfaces/Time\nint32 sec\nuint32 nanosec\n"
_POINT = "MSG: geometry_msgs/Point\nfloat64 x\nfloat64 y\nfloat64 z\n"
_POSE = _definition(
    "MSG: geometry_msgs/Pose\ngeometry_msgs/Point position\ngeometry_msgs/Quaternion orientation\n",
    _POINT,
    "MSG: geometry_msgs/Quaternion\nfloat64 x\nfloat64 y\nfloat64 z\nfloat64 w\n",
)
_GRID = _definition(
    "std_msgs/Header header\nnav_msgs/MapMetaData info\nint8[] data\n",
    "MSG: nav_msgs/MapMetaData\nbuiltin_interfaces/Time map_load_time\nfloat32 resolution\n"
    "uint32 width\nuint32 height\ngeometry_msgs/Pose origin\n",
    _HEADER, _TIME, _POSE,
)  # fmt: skip
_PATH = _definition(
    "std_msgs/Header header\ngeometry_msgs/PoseStamped[] poses\n",
    "MSG: geometry_msgs/PoseStamped\nstd_msgs/Header header\ngeometry_msgs/Pose pose\n",
    _HEADER, _TIME, _POSE,
)  # fmt: skip
_MARKER_START = (
    "std_msgs/Header header\nstring ns\nint32 id\nint32 type\nint32 action\ngeometry_msgs/Pose pose\n"
    "geometry_msgs/Vector3 scale\nstd_msgs/ColorRGBA color\nbuiltin_interfaces/Duration lifetime\n"
    "bool frame_locked\ngeometry_msgs/Point[] points\nstd_msgs/ColorRGBA[] colors\n"
)
_MARKER_PARTS = (
    _HEADER, _TIME, _POSE,
    "MSG: geometry_msgs/Vector3\nfloat64 x\nfloat64 y\nfloat64 z\n",
    "MSG: std_msgs/ColorRGBA\nfloat32 r\nfloat32 g\nfloat32 b\nfloat32 a\n",
    "MSG: builtin_interfaces/Duration\nint32 sec\nuint32 nanosec\n",
)  # fmt: skip
_TEXTURE_PARTS = (
    "MSG: sensor_msgs/CompressedImage\nstd_msgs/Header header\nstring format\nuint8[] data\n",
    "MSG: visualization_msgs/UVCoordinate\nfloat32 u\nfloat32 v\n",
    "MSG: visualization_msgs/MeshFile\nstring filename\nuint8[] data\n",
)
_MARKER = _definition(
    _MARKER_START + "string texture_resource\nsensor_msgs/CompressedImage texture\n"
    "visualization_msgs/UVCoordinate[] uv_coordinates\nstring text\nstring mesh_resource\n"
    "visualization_msgs/MeshFile mesh_file\nbool mesh_use_embedded_materials\n",
    *_MARKER_PARTS, *_TEXTURE_PARTS,
)  # fmt: skip
_MARKER_OLD = _definition(
    _MARKER_START + "string text\nstring mesh_resource\nbool mesh_use_embedded_materials\n", *_MARKER_PARTS
)


def _array_of(marker: str) -> str:
    return _definition("visualization_msgs/Marker[] markers\n", "MSG: visualization_msgs/Marker\n" + marker)


@dataclass(frozen=True, kw_only=True)
class Family:
    """A message type that is understood."""

    role: Literal["grid", "markers", "path"]
    """What it is read as."""
    encoding: str
    """Message encoding that the decoder reads."""
    schema_encoding: str
    """Encoding of the definition that `standards` are compared with."""
    standards: tuple[str, ...]
    """Definitions that the decoder knows; the decoder is told which one it is."""
    decode: Callable[[bytes, int], Any]


def _ros2(role: Literal["grid", "markers", "path"], decode: Callable[[bytes, int], Any], *standards: str) -> Family:
    return Family(role=role, encoding="cdr", schema_encoding="ros2msg", standards=standards, decode=decode)


FAMILIES: Final[Mapping[str, Family]] = {
    "nav_msgs/msg/OccupancyGrid": _ros2("grid", decode_grid, _GRID),
    "nav_msgs/msg/Path": _ros2("path", decode_path, _PATH),
    "visualization_msgs/msg/MarkerArray": _ros2("markers", decode_markers, _array_of(_MARKER), _array_of(_MARKER_OLD)),
    "visualization_msgs/msg/Marker": _ros2("markers", decode_marker, _MARKER, _MARKER_OLD),
}
"""Message types by schema name."""
