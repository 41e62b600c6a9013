"""A built site as the bytes of a ROS 2 log: an MCAP file with map, path, vehicle, and what the planner knew.

Nothing in it depends on the clock, the machine or the order of work: stamps are made up, numbers are rounded, and
the file names no library version. Only another release of zstd may compress the same content differently; the
content's own digest tells.
"""

import dataclasses
import hashlib
import io
import itertools
import json
import math
from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np
from mcap.reader import make_reader
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_typestore
from rosbags.typesys.store import Typestore

from optim.numerics.arrays import Array
from optim.planning.protocol import Pose, place
from tools.corpus.build import Built
from tools.corpus.grid import Cells
from tools.corpus.site import Block, Box, Obstacle, Shapes, Site, Wall

FRAME = "map"
LIBRARY = "truck-trailer-replay make_corpus"
_FIRST_DAY = 1_716_000_000  # [s]: a morning in May 2024
_NANO = 1_000_000_000
_COLOURS = {
    "building": (0.45, 0.42, 0.40),
    "trailer": (0.85, 0.85, 0.88),
    "truck": (0.20, 0.35, 0.60),
    "container": (0.65, 0.30, 0.20),
    "fence": (0.35, 0.35, 0.35),
    "wall": (0.55, 0.52, 0.50),
    "kerb": (0.60, 0.60, 0.60),
    "car": (0.70, 0.15, 0.15),
}


_COMPRESSION = {"zstd": CompressionType.ZSTD, "lz4": CompressionType.LZ4, "none": CompressionType.NONE}


class _Log:
    """An MCAP writer that knows ROS 2 messages."""

    def __init__(self, site: Site) -> None:
        self.stream = io.BytesIO()
        self.store: Typestore = get_typestore(Stores.ROS2_HUMBLE)
        self.writer = Writer(
            self.stream,
            chunk_size=1 << 20,
            compression=_COMPRESSION[site.compression],
            use_chunking=site.is_chunked,
            enable_data_crcs=True,
        )
        self.writer.start(profile="ros2", library=LIBRARY)
        self.schemas: dict[str, int] = {}
        self.channels: dict[str, int] = {}
        self.counts: dict[str, int] = {}

    def make(self, kind: str, **fields: Any) -> Any:
        """A message of the type `kind`, such as `Path` of nav_msgs."""
        return self.store.types[kind](**fields)

    def add(self, topic: str, message: Any, time: int) -> None:
        """Write a message at a time [ns]; its channel and schema are made with the first."""
        kind = str(message.__msgtype__)
        if kind not in self.schemas:
            text = self.store.generate_msgdef(kind, ros_version=2)[0]
            self.schemas[kind] = self.writer.register_schema(kind, "ros2msg", text.encode())
        if topic not in self.channels:
            once = topic in ("/map", "/obstacles")
            metadata = {"offered_qos_profiles": _qos(transient_local=once)}
            self.channels[topic] = self.writer.register_channel(topic, "cdr", self.schemas[kind], metadata)
        sequence = self.counts.get(topic, 0)
        self.counts[topic] = sequence + 1
        data = bytes(self.store.serialize_cdr(message, kind))
        self.writer.add_message(self.channels[topic], time, data, time - 400_000, sequence)

    def header(self, time: int) -> Any:
        stamp = self.make("builtin_interfaces/msg/Time", sec=time // _NANO, nanosec=time % _NANO)
        return self.make("std_msgs/msg/Header", stamp=stamp, frame_id=FRAME)

    def point(self, x: float, y: float, z: float = 0.0) -> Any:
        return self.make("geometry_msgs/msg/Point", x=_tidy(x), y=_tidy(y), z=_tidy(z))

    def pose(self, x: float, y: float, yaw: float, z: float = 0.0) -> Any:
        """A pose in the plane; the quaternion is rounded, so that no library's sine decides a bit."""
        quaternion = {"z": round(math.sin(yaw / 2.0), 9) + 0.0, "w": round(math.cos(yaw / 2.0), 9) + 0.0}
        turn = self.make("geometry_msgs/msg/Quaternion", x=0.0, y=0.0, **quaternion)
        return self.make("geometry_msgs/msg/Pose", position=self.point(x, y, z), orientation=turn)


def to_bytes(built: Built, *, without: Sequence[str] = (), vehicle_changes: Mapping[str, str] | None = None) -> bytes:
    """The log; `without` some of map, plan, trailer, and with other values in the vehicle's record, for broken logs."""
    log, site = _Log(built.site), built.site
    start = (_FIRST_DAY + 3600 * site.noise) * _NANO
    log.writer.add_metadata("vehicle", vehicle_record(site) | dict(vehicle_changes or {}))
    if site.has_path_nodes:
        log.writer.add_metadata("path_nodes", {"indices": json.dumps(built.poses.nodes)})
    if "map" in without:
        pass
    elif built.cells is not None:
        log.add("/map", _grid(log, built.cells, start), start)
    else:
        for k, markers in enumerate(_marker_messages(log, site, start)):
            log.add("/obstacles", markers, start + k * _NANO)
    planned = start + 3 * _NANO + 217_000_000
    since = _drive_times(built)
    if "plan" not in without:
        log.add("/plan", _path(log, built.poses.truck, since, planned), planned)
    if site.has_trailer_path and "trailer" not in without:
        log.add("/plan/trailer", _path(log, built.poses.trailer, since, planned), planned + 1_000_000)
    log.writer.finish()
    return log.stream.getvalue()


def vehicle_record(site: Site) -> dict[str, str]:
    """The vehicle's fields as JSON values."""
    return {name: json.dumps(value) for name, value in dataclasses.asdict(site.vehicle).items()}


def content_digest(data: bytes) -> str:
    """sha256 of what a log says, whatever it is compressed with: schemas, channels, messages, metadata."""
    digest = hashlib.sha256()
    reader = make_reader(io.BytesIO(data), validate_crcs=True)
    for schema, channel, message in reader.iter_messages():
        assert schema is not None
        for part in (schema.name, schema.encoding, schema.data, channel.topic, channel.message_encoding):
            digest.update(part if isinstance(part, bytes) else part.encode())
        digest.update(f"{message.log_time} {message.publish_time} {message.sequence}".encode() + message.data)
    for record in reader.iter_metadata():
        digest.update(json.dumps([record.name, record.metadata], sort_keys=True).encode())
    return digest.hexdigest()


def _qos(transient_local: bool) -> str:
    return (
        "- history: 1\n  depth: 1\n  reliability: 1\n"
        f"  durability: {1 if transient_local else 2}\n"
        "  deadline:\n    sec: 9223372036\n    nsec: 854775807\n"
        "  lifespan:\n    sec: 9223372036\n    nsec: 854775807\n"
        "  liveliness: 1\n  liveliness_lease_duration:\n    sec: 9223372036\n    nsec: 854775807\n"
        "  avoid_ros_namespace_conventions: false"
    )


def _tidy(value: float) -> float:
    return round(float(value), 6) + 0.0


def _grid(log: _Log, cells: Cells, time: int) -> Any:
    rows, columns = cells.values.shape
    header = log.header(time)
    info = log.make(
        "nav_msgs/msg/MapMetaData",
        map_load_time=header.stamp,
        resolution=cells.resolution,
        width=columns,
        height=rows,
        origin=log.pose(*cells.origin),
    )
    data = np.ascontiguousarray(cells.values).ravel()
    return log.make("nav_msgs/msg/OccupancyGrid", header=header, info=info, data=data)


def _drive_times(built: Built) -> Array:
    """When the truck is at each pose, after the plan [s]: 1 m/s, if the log says so, else all at once. Shape (N,)."""
    poses = built.poses.truck
    if not built.site.has_stamps:
        return np.zeros(len(poses))
    steps = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    return np.concatenate([[0.0], np.cumsum(steps)]).round(3)


def _path(log: _Log, poses: Array, since: Array, time: int) -> Any:
    stamped = [
        log.make(
            "geometry_msgs/msg/PoseStamped",
            header=log.header(time + 1_000_000 * round(1000.0 * after)),
            pose=log.pose(*pose.tolist()),
        )
        for pose, after in zip(poses, since.tolist(), strict=True)
    ]
    return log.make("nav_msgs/msg/Path", header=log.header(time), poses=stamped)


def _marker_messages(log: _Log, site: Site, time: int) -> list[Any]:
    """The obstacles; and a second message where some of them are taken away again."""
    assert isinstance(site.map, Shapes)
    markers = [_marker(log, site, obstacle, k, time) for k, obstacle in enumerate(site.obstacles)]
    first = len(markers)
    removed = [_marker(log, site, box, first + k, time) for k, box in enumerate(site.map.removed)]
    messages = [log.make("visualization_msgs/msg/MarkerArray", markers=markers + removed)]
    if removed:
        gone = [_marker(log, site, box, first + k, time + _NANO, 2) for k, box in enumerate(site.map.removed)]
        messages.append(log.make("visualization_msgs/msg/MarkerArray", markers=gone))
    return messages


def _marker(log: _Log, site: Site, obstacle: Obstacle, number: int, time: int, action: int = 0) -> Any:
    if isinstance(obstacle, Box):
        shape = _cube(log, obstacle, site.pose)
    elif isinstance(obstacle, Wall):
        shape = _line_strip(log, obstacle, site.pose)
    else:
        shape = _triangles(log, obstacle, site.pose)
    red, green, blue = _COLOURS.get(obstacle.kind, (0.75, 0.60, 0.35))
    empty = log.make("sensor_msgs/msg/CompressedImage", header=log.header(0), format="", data=np.zeros(0, np.uint8))
    return log.make(
        "visualization_msgs/msg/Marker",
        header=log.header(time),
        ns=obstacle.kind,
        id=number,
        action=action,
        color=log.make("std_msgs/msg/ColorRGBA", r=red, g=green, b=blue, a=1.0),
        lifetime=log.make("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        colors=[],
        texture_resource="",
        texture=empty,
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=log.make("visualization_msgs/msg/MeshFile", filename="", data=np.zeros(0, np.uint8)),
        mesh_use_embedded_materials=False,
        **shape,
    )


def _cube(log: _Log, box: Box, pose: Pose) -> dict[str, Any]:
    x, y = place(np.array([[box.x, box.y]]), pose)[0].tolist()
    return {
        "type": 1,
        "pose": log.pose(x, y, round(box.yaw + pose[2], 7), box.bottom + box.height / 2.0),
        "scale": log.make("geometry_msgs/msg/Vector3", x=box.length, y=box.width, z=box.height),
        "points": [],
    }


def _line_strip(log: _Log, wall: Wall, pose: Pose) -> dict[str, Any]:
    return {
        "type": 4,
        "pose": log.pose(0.0, 0.0, 0.0),
        "scale": log.make("geometry_msgs/msg/Vector3", x=wall.width, y=0.0, z=0.0),
        "points": [log.point(x, y) for x, y in place(np.array(wall.points), pose)],
    }


def _triangles(log: _Log, block: Block, pose: Pose) -> dict[str, Any]:
    """A fan of triangles, in the frame of the site: the marker's pose places it."""
    corners = block.points
    fan = [corner for a, b in itertools.pairwise(corners[1:]) for corner in (corners[0], a, b)]
    return {
        "type": 11,
        "pose": log.pose(*pose),
        "scale": log.make("geometry_msgs/msg/Vector3", x=1.0, y=1.0, z=1.0),
        "points": [log.point(x, y, 0.1) for x, y in fan],
    }
