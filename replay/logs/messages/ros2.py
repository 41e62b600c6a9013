"""The ROS 2 message types that are understood, and their decoders: CDR to plain arrays.

A further type is one message definition (`ros2_definitions.py`), and here one decoder and one entry in
`MESSAGE_TYPES`. Decoders check lengths only; values are checked by `planar.py` and by the callers. `layout` is the
number of the standard definition that the log's equals.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, Final

import numpy as np
from numpy.typing import NDArray

from optim.numerics.arrays import Array, frozen, frozen_int
from replay.logs.messages import ros2_definitions as definitions
from replay.logs.messages.cdr import HEADER_SIZE, CdrError, CdrReader
from replay.logs.messages.definition import matching_definition
from replay.logs.messages.types import (
    Decode,
    Grid,
    Header,
    Joints,
    Marker,
    MessageType,
    PoseSeries,
    Ring,
    Role,
    Transform,
)


def _stamp(reader: CdrReader, field: str) -> int:
    seconds, nanoseconds = reader.i32(f"{field}.sec"), reader.u32(f"{field}.nanosec")
    if nanoseconds >= 1_000_000_000:
        raise CdrError(f"{field}.nanosec is {nanoseconds}, expected less than 1e9")
    return seconds * 1_000_000_000 + nanoseconds


def _header(reader: CdrReader, field: str = "header") -> Header:
    return Header(_stamp(reader, f"{field}.stamp"), reader.text(f"{field}.frame_id"))


def decode_grid(data: bytes, layout: int) -> Grid:
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


def decode_path(data: bytes, layout: int) -> PoseSeries:
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
    return PoseSeries(header=header, stamps=frozen_int(stamps), poses=frozen(poses), frames=frozenset(frames))


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


def decode_marker(data: bytes, layout: int) -> tuple[Marker, ...]:
    """Decode a single marker, as a sequence of one. Raises CdrError."""
    reader = CdrReader(data)
    marker = _marker(reader, "", layout)
    reader.finish()
    return (marker,)


def decode_markers(data: bytes, layout: int) -> tuple[Marker, ...]:
    """Decode an array of markers. Raises CdrError."""
    reader = CdrReader(data)
    count = reader.count(150, "markers")  # fixed-size fields alone take more
    markers = tuple(_marker(reader, f"markers[{i}].", layout) for i in range(count))
    reader.finish()
    return markers


def _all_at(header: Header, count: int) -> NDArray[np.int64]:
    """The header's stamp for each of `count` poses."""
    return frozen_int(np.full(count, header.stamp, np.int64))


def decode_pose_array(data: bytes, layout: int) -> PoseSeries:
    """Decode an array of poses, all of one time and frame. Raises CdrError."""
    reader = CdrReader(data)
    header = _header(reader)
    count = reader.count(56, "poses")
    poses = reader.numbers("<f8", 7 * count, "poses").reshape(-1, 7)
    reader.finish()
    return PoseSeries(header=header, stamps=_all_at(header, count), poses=poses, frames=frozenset())


def _one(header: Header, pose: Array, speed: Array | None = None) -> PoseSeries:
    return PoseSeries(header=header, stamps=_all_at(header, 1), poses=pose[None], frames=frozenset(), speed=speed)


def decode_pose_stamped(data: bytes, layout: int) -> PoseSeries:
    """Decode a single pose. Raises CdrError."""
    reader = CdrReader(data)
    header, pose = _header(reader), reader.numbers("<f8", 7, "pose")
    reader.finish()
    return _one(header, pose)


def decode_pose_covariance(data: bytes, layout: int) -> PoseSeries:
    """Decode a single pose with its covariance, which is not used. Raises CdrError."""
    reader = CdrReader(data)
    header, values = _header(reader), reader.numbers("<f8", 43, "pose")
    reader.finish()
    return _one(header, values[:7])


def decode_odometry(data: bytes, layout: int) -> PoseSeries:
    """Decode a single pose with the speed ahead. Raises CdrError."""
    reader = CdrReader(data)
    header = _header(reader)
    reader.text("child_frame_id")
    pose, twist = reader.numbers("<f8", 43, "pose"), reader.numbers("<f8", 42, "twist")
    reader.finish()
    return _one(header, pose[:7], twist[:1])


_POINT = np.dtype([("sec", "<i4"), ("nanosec", "<u4"), ("pose", "<f8", (7,)), ("values", "<f4", (6,))])
"""A trajectory's point from an offset that is a multiple of eight, as all but the first are."""
_SPEED, _FRONT_WHEEL = 0, 4  # of `values`, beside lateral speed, acceleration, heading rate, rear wheel angle


def decode_trajectory(data: bytes, layout: int) -> PoseSeries:
    """Decode Autoware's trajectory: poses with speeds and steering angles. Raises CdrError."""
    reader = CdrReader(data)
    header = _header(reader)
    count = reader.count(_POINT.itemsize, "points")
    points = np.zeros(count, _POINT)
    if count:
        points[0] = (
            reader.i32("points[0].time_from_start.sec"),
            reader.u32("points[0].time_from_start.nanosec"),
            reader.numbers("<f8", 7, "points[0].pose"),
            reader.numbers("<f4", 6, "points[0]"),
        )
        points[1:] = reader.rows(_POINT, count - 1, "points")
    reader.finish()
    late = np.flatnonzero(points["nanosec"] >= 1_000_000_000)
    if len(late):
        value = points["nanosec"][late[0]]
        raise CdrError(f"points[{late[0]}].time_from_start.nanosec is {value}, expected less than 1e9")
    since = points["sec"].astype(np.int64) * 1_000_000_000 + points["nanosec"]
    values = frozen(points["values"])
    return PoseSeries(
        header=header,
        stamps=_all_at(header, count) if not since.any() else frozen_int(header.stamp + since),
        poses=frozen(points["pose"]),
        frames=frozenset(),
        speed=values[:, _SPEED],
        steer=values[:, _FRONT_WHEEL],
    )


def _ring(reader: CdrReader, header: Header | None, field: str) -> tuple[Ring, ...]:
    points = reader.numbers("<f4", 3 * reader.count(12, field), field).reshape(-1, 3)
    reader.finish()
    return (Ring(header=header, points=frozen(points)),)


def decode_polygon(data: bytes, layout: int) -> tuple[Ring, ...]:
    """Decode a polygon without a header, as a sequence of one. Raises CdrError."""
    return _ring(CdrReader(data), None, "points")


def decode_polygon_stamped(data: bytes, layout: int) -> tuple[Ring, ...]:
    """Decode a polygon, as a sequence of one. Raises CdrError."""
    reader = CdrReader(data)
    return _ring(reader, _header(reader), "polygon.points")


def decode_joints(data: bytes, layout: int) -> tuple[Joints, ...]:
    """Decode the state of joints, as a sequence of one. Raises CdrError."""
    reader = CdrReader(data)
    header = _header(reader)
    names = tuple(reader.text(f"name[{i}]") for i in range(reader.count(4, "name")))
    positions = reader.numbers("<f8", reader.count(8, "position"), "position")
    for field in ("velocity", "effort"):
        reader.numbers("<f8", reader.count(8, field), field)
    reader.finish()
    return (Joints(stamp=header.stamp, names=names, positions=positions),)


def decode_transforms(data: bytes, layout: int) -> tuple[Transform, ...]:
    """Decode transforms between frames. Raises CdrError."""
    reader = CdrReader(data)
    found = []
    for i in range(reader.count(72, "transforms")):  # stamp 8, two empty names 8, transform 56
        header, child = _header(reader, f"transforms[{i}].header"), reader.text(f"transforms[{i}].child_frame_id")
        found.append(Transform(header=header, child=child, pose=reader.numbers("<f8", 7, f"transforms[{i}]")))
    reader.finish()
    return tuple(found)


@dataclass(frozen=True, kw_only=True)
class Ros2Type(MessageType):
    """A ROS 2 message type, in CDR."""

    encodings = ("cdr", "ros2msg"), ("cdr", "ros2idl")
    standards: tuple[str, ...]
    """The message definitions that `decode` knows."""
    decode: Callable[[bytes, int], Any]
    """Decodes a message whose definition is the one of that number. Raises PayloadError."""

    def decoder(self, encodings: tuple[str, str], definition: bytes) -> Decode:
        """The decoder for the messages of a channel. Raises DefinitionError."""
        standard = matching_definition(self.name, definition, self.standards, encodings[1])
        return lambda data: self.decode(data, standard)


def _by_name(*types: tuple[str, Role, Callable[[bytes, int], Any], tuple[str, ...]]) -> dict[str, Ros2Type]:
    return {
        name: Ros2Type(name=name, role=role, decode=decode, standards=standards)
        for name, role, decode, standards in types
    }


_MARKERS = (definitions.MARKER, definitions.MARKER_OLD)
MESSAGE_TYPES: Final[Mapping[str, Ros2Type]] = _by_name(
    ("nav_msgs/msg/OccupancyGrid", "grid", decode_grid, (definitions.GRID,)),
    (
        "visualization_msgs/msg/MarkerArray",
        "markers",
        decode_markers,
        tuple(map(definitions.array_of, _MARKERS)),
    ),
    ("visualization_msgs/msg/Marker", "markers", decode_marker, _MARKERS),
    ("geometry_msgs/msg/PolygonStamped", "polygon", decode_polygon_stamped, (definitions.POLYGON_STAMPED,)),
    ("geometry_msgs/msg/Polygon", "polygon", decode_polygon, (definitions.POLYGON,)),
    ("nav_msgs/msg/Path", "path", decode_path, (definitions.PATH,)),
    ("geometry_msgs/msg/PoseArray", "path", decode_pose_array, (definitions.POSE_ARRAY,)),
    ("autoware_planning_msgs/msg/Trajectory", "path", decode_trajectory, (definitions.TRAJECTORY,)),
    ("nav_msgs/msg/Odometry", "stream", decode_odometry, (definitions.ODOMETRY,)),
    ("geometry_msgs/msg/PoseStamped", "stream", decode_pose_stamped, (definitions.POSE_STAMPED,)),
    (
        "geometry_msgs/msg/PoseWithCovarianceStamped",
        "stream",
        decode_pose_covariance,
        (definitions.POSE_COVARIANCE,),
    ),
    ("sensor_msgs/msg/JointState", "joints", decode_joints, (definitions.JOINTS,)),
    ("tf2_msgs/msg/TFMessage", "transforms", decode_transforms, (definitions.TRANSFORMS,)),
)
"""Message types by schema name."""
