"""Logs for tests, written by other software than the reader: the `mcap` writer and `rosbags`' CDR."""

import io
import json
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from mcap.writer import CompressionType, Writer
from rosbags.typesys import Stores, get_types_from_msg, get_typestore

from optim.model.kinematics import roll_out
from optim.model.vehicle import Vehicle, body_poses
from replay.base.errors import LogError
from replay.logs import ReadOptions, read_cases
from replay.run.case import Case

SECOND = 1_000_000_000
GRID, PATH = "nav_msgs/msg/OccupancyGrid", "nav_msgs/msg/Path"
MARKERS = "visualization_msgs/msg/MarkerArray"
AUTOWARE = {
    "Trajectory": "std_msgs/Header header\nautoware_planning_msgs/TrajectoryPoint[] points\n",
    "TrajectoryPoint": "builtin_interfaces/Duration time_from_start\ngeometry_msgs/Pose pose\n"
    + "".join(
        f"float32 {name}\n"
        for name in (
            "longitudinal_velocity_mps",
            "lateral_velocity_mps",
            "acceleration_mps2",
            "heading_rate_rps",
            "front_wheel_angle_rad",
            "rear_wheel_angle_rad",
        )
    ),
}
"""Definitions that ROS 2 itself does not hold."""


@cache
def typestore(store: Stores = Stores.ROS2_HUMBLE) -> Any:
    """The message types of a ROS 2 distribution."""
    types = get_typestore(store)
    for name, text in AUTOWARE.items():
        types.register(get_types_from_msg(text, f"autoware_planning_msgs/msg/{name}"))
    return types


def ros(kind: str, **fields: Any) -> Any:
    """A message of type `kind`, such as ``geometry_msgs/msg/Point``."""
    return typestore().types[kind](**fields)


def stamp(time: int) -> Any:
    return ros("builtin_interfaces/msg/Time", sec=time // SECOND, nanosec=time % SECOND)


def header(frame: str = "map", time: int = 0) -> Any:
    return ros("std_msgs/msg/Header", stamp=stamp(time), frame_id=frame)


def pose(x: float, y: float, yaw: float, z: float = 0.0, quaternion: Sequence[float] | None = None) -> Any:
    q = quaternion if quaternion is not None else (0.0, 0.0, np.sin(yaw / 2.0), np.cos(yaw / 2.0))
    return ros(
        "geometry_msgs/msg/Pose",
        position=ros("geometry_msgs/msg/Point", x=float(x), y=float(y), z=z),
        orientation=ros("geometry_msgs/msg/Quaternion", x=q[0], y=q[1], z=q[2], w=q[3]),
    )


def path(
    poses: Iterable[Sequence[float]], frame: str = "map", stamps: Sequence[int] | None = None, time: int = 0
) -> Any:
    """A path of (x, y, yaw); all stamps equal unless given."""
    rows = [pose(x, y, yaw) for x, y, yaw in poses]
    times = [time] * len(rows) if stamps is None else stamps
    stamped = [
        ros("geometry_msgs/msg/PoseStamped", header=header(frame, t), pose=row)
        for t, row in zip(times, rows, strict=True)
    ]
    return ros(PATH, header=header(frame, time), poses=stamped)


def grid(
    cells: np.ndarray, resolution: float = 0.2, origin: tuple[float, float, float] = (0.0, 0.0, 0.0), frame: str = "map"
) -> Any:
    """An occupancy grid of cells (H, W), row 0 at the bottom."""
    info = ros(
        "nav_msgs/msg/MapMetaData",
        map_load_time=stamp(0),
        resolution=resolution,
        width=cells.shape[1],
        height=cells.shape[0],
        origin=pose(*origin),
    )
    return ros(GRID, header=header(frame), info=info, data=np.ascontiguousarray(cells, np.int8).ravel())


def marker(
    kind: int,
    scale: Sequence[float],
    at: Sequence[float] = (0.0, 0.0, 0.0),
    *,
    z: float = 0.0,
    points: Iterable[Sequence[float]] = (),
    ns: str = "",
    id: int = 0,
    action: int = 0,
    frame: str = "map",
    quaternion: Sequence[float] | None = None,
) -> Any:
    """A marker at (x, y, yaw) and height z."""
    none = ros("std_msgs/msg/ColorRGBA", r=0.0, g=0.0, b=0.0, a=1.0)
    no_data = np.zeros(0, np.uint8)
    return ros(
        "visualization_msgs/msg/Marker",
        header=header(frame),
        ns=ns,
        id=id,
        type=kind,
        action=action,
        pose=pose(*at, z=z, quaternion=quaternion),
        scale=ros("geometry_msgs/msg/Vector3", x=scale[0], y=scale[1], z=scale[2]),
        color=none,
        lifetime=ros("builtin_interfaces/msg/Duration", sec=0, nanosec=0),
        frame_locked=False,
        points=[ros("geometry_msgs/msg/Point", x=float(x), y=float(y), z=float(h)) for x, y, h in points],
        colors=[],
        texture_resource="",
        texture=ros("sensor_msgs/msg/CompressedImage", header=header(""), format="", data=no_data),
        uv_coordinates=[],
        text="",
        mesh_resource="",
        mesh_file=ros("visualization_msgs/msg/MeshFile", filename="", data=no_data),
        mesh_use_embedded_materials=False,
    )


def markers(*each: Any) -> Any:
    return ros(MARKERS, markers=list(each))


def pose_array(poses: Iterable[Sequence[float]], frame: str = "map", time: int = 0) -> Any:
    return ros(
        "geometry_msgs/msg/PoseArray", header=header(frame, time), poses=[pose(x, y, yaw) for x, y, yaw in poses]
    )


def trajectory(
    poses: np.ndarray, speed: Iterable[float], steer: Iterable[float], frame: str = "map", step: int = 0
) -> Any:
    """Autoware's trajectory of (x, y, yaw) with speeds [m/s] and wheel angles [rad], `step` [ns] apart."""
    points = [
        ros(
            "autoware_planning_msgs/msg/TrajectoryPoint",
            time_from_start=ros("builtin_interfaces/msg/Duration", sec=i * step // SECOND, nanosec=i * step % SECOND),
            pose=pose(row[0], row[1], row[2]),
            longitudinal_velocity_mps=float(v),
            lateral_velocity_mps=0.0,
            acceleration_mps2=0.0,
            heading_rate_rps=0.0,
            front_wheel_angle_rad=float(phi),
            rear_wheel_angle_rad=0.0,
        )
        for i, (row, v, phi) in enumerate(zip(poses, speed, steer, strict=True))
    ]
    return ros("autoware_planning_msgs/msg/Trajectory", header=header(frame), points=points)


def polygon(corners: Iterable[Sequence[float]], frame: str | None = "map", time: int = 0) -> Any:
    """A polygon of corners (x, y); without a header where `frame` is None."""
    points = [ros("geometry_msgs/msg/Point32", x=float(x), y=float(y), z=0.0) for x, y in corners]
    plain = ros("geometry_msgs/msg/Polygon", points=points)
    return (
        plain if frame is None else ros("geometry_msgs/msg/PolygonStamped", header=header(frame, time), polygon=plain)
    )


def joints(positions: Mapping[str, float], time: int = 0) -> Any:
    none = np.zeros(0)
    return ros(
        "sensor_msgs/msg/JointState",
        header=header("", time),
        name=list(positions),
        position=np.array(list(positions.values())),
        velocity=none,
        effort=none,
    )


def transform(parent: str, child: str, at: Sequence[float], time: int = 0, z: float = 0.0) -> Any:
    """The pose (x, y, yaw) of frame `child` in frame `parent`."""
    there = pose(at[0], at[1], at[2])
    return ros(
        "geometry_msgs/msg/TransformStamped",
        header=header(parent, time),
        child_frame_id=child,
        transform=ros(
            "geometry_msgs/msg/Transform",
            translation=ros("geometry_msgs/msg/Vector3", x=float(at[0]), y=float(at[1]), z=z),
            rotation=there.orientation,
        ),
    )


def transforms(*each: Any) -> Any:
    return ros("tf2_msgs/msg/TFMessage", transforms=list(each))


def serialised(message: Any) -> bytes:
    return bytes(typestore().serialize_cdr(message, message.__msgtype__))


@dataclass(kw_only=True)
class LogMaker:
    """Collects messages and metadata and writes them as one MCAP file."""

    compression: CompressionType = CompressionType.ZSTD
    chunked: bool = True
    data_crcs: bool = True
    chunk_size: int = 1 << 20
    messages: list[tuple[str, str, str, str, bytes, bytes, int]] = field(default_factory=list)
    metadata: list[tuple[str, Mapping[str, str]]] = field(default_factory=list)

    def add(self, topic: str, message: Any, time: int = 0) -> "LogMaker":
        """A ROS 2 message at a log time [s]."""
        kind = message.__msgtype__
        text, _ = typestore().generate_msgdef(kind, ros_version=2)
        return self.add_raw(topic, kind, serialised(message), time, definition=text.encode())

    def add_raw(
        self,
        topic: str,
        schema: str,
        data: bytes,
        time: int = 0,
        *,
        definition: bytes = b"",
        encoding: str = "cdr",
        schema_encoding: str = "ros2msg",
    ) -> "LogMaker":
        """Any bytes on any topic."""
        self.messages.append((topic, schema, encoding, schema_encoding, definition, data, time * SECOND))
        return self

    def vehicle(self, vehicle: Vehicle | None = None, **changes: str) -> "LogMaker":
        """The metadata record `vehicle`, with some values replaced by the given texts."""
        values = {
            key: json.dumps(value) for key, value in vars(vehicle or Vehicle()).items() if isinstance(value, float)
        }
        self.metadata.append(("vehicle", values | changes))
        return self

    def nodes(self, text: str) -> "LogMaker":
        """The metadata record `path_nodes`."""
        self.metadata.append(("path_nodes", {"indices": text}))
        return self

    def bytes(self) -> bytes:
        """The whole file."""
        out = io.BytesIO()
        writer = Writer(
            out,
            compression=self.compression,
            use_chunking=self.chunked,
            enable_data_crcs=self.data_crcs,
            chunk_size=self.chunk_size,
        )
        writer.start(profile="ros2", library="tests")
        schemas: dict[tuple[str, bytes, str], int] = {}
        channels: dict[tuple[str, int, str], int] = {}
        for number, (topic, name, encoding, schema_encoding, definition, data, time) in enumerate(self.messages):
            schema = schemas.setdefault((name, definition, schema_encoding), 0)
            if not schema:
                schema = writer.register_schema(name, schema_encoding, definition)
                schemas[name, definition, schema_encoding] = schema
            channel = channels.get((topic, schema, encoding))
            if channel is None:
                channel = channels[topic, schema, encoding] = writer.register_channel(topic, encoding, schema)
            writer.add_message(channel, log_time=time, publish_time=time, data=data, sequence=number)
        for name, values in self.metadata:
            writer.add_metadata(name, dict(values))
        writer.finish()
        return out.getvalue()

    def write(self, file: Path) -> Path:
        """Write the file and give its path."""
        file.write_bytes(self.bytes())
        return file


def yard(width: float = 60.0, height: float = 40.0, resolution: float = 0.2) -> np.ndarray:
    """Cells of a yard with walls one cell thick all round, its corner at the origin."""
    cells = np.zeros((round(height / resolution), round(width / resolution)), np.int8)
    cells[[0, -1]] = 100
    cells[:, [0, -1]] = 100
    return cells


def drive(vehicle: Vehicle | None = None, reverse: float = 6.0, step: float = 0.25) -> tuple[np.ndarray, np.ndarray]:
    """Poses (x, y, theta) of truck and of the trailer's axle: forward in a gentle S, then back. Shapes (n, 3)."""
    vehicle = vehicle or Vehicle()
    s = np.arange(0.0, 20.0 + 1e-9, step)
    there = roll_out(vehicle, np.array([20.0, 18.0, 0.1, 0.0]), s, 0.2 * np.sin(np.pi * s / 10.0), 1)
    s = np.arange(0.0, reverse + 1e-9, step)
    back = roll_out(vehicle, there[-1], s, 0.1 * np.sin(np.pi * s / 6.0), -1)
    states = np.concatenate([there, back[1:]])
    hitch = body_poses(vehicle, states)[:, 1]
    axle = hitch[:, :2] - vehicle.hitch_to_axle * np.stack([np.cos(hitch[:, 2]), np.sin(hitch[:, 2])], axis=1)
    return states[:, :3], np.column_stack([axle, hitch[:, 2]])


def sound_log(trailer: bool = True, **options: Any) -> LogMaker:
    """A vehicle, a map and one path: what most tests begin with."""
    truck, axle = drive()
    maker = LogMaker(**options).vehicle().add("/map", grid(yard()), 1).add("/truck", path(truck), 2)
    return maker.add("/trailer", path(axle), 2) if trailer else maker


def shifted(poses: np.ndarray, dx: float, dy: float = 0.0) -> np.ndarray:
    """Poses moved as a whole."""
    return poses + np.array([dx, dy, 0.0])


def log_of(truck: Any, axle: Any = None, cells: np.ndarray | None = None, **options: Any) -> LogMaker:
    """A log of a vehicle, a map and one or two paths, given as poses or as messages."""
    maker = LogMaker().vehicle().add("/map", grid(yard() if cells is None else cells, **options), 1)
    maker.add("/truck", truck if hasattr(truck, "header") else path(truck), 2)
    if axle is not None:
        maker.add("/trailer", axle if hasattr(axle, "header") else path(axle), 2)
    return maker


def read_log(file: Path, log: LogMaker | bytes, **options: Any) -> list[Case]:
    """The cases of a log, written to `file` first; `options` are fields of ReadOptions."""
    file.write_bytes(log if isinstance(log, bytes) else log.bytes())
    return read_cases(file, ReadOptions(**options))


def refusal_of(file: Path, log: LogMaker | bytes, **options: Any) -> LogError:
    """The error with which a log is refused: one printable line that names the file."""
    with pytest.raises(LogError) as caught:
        read_log(file, log, **options)
    assert str(caught.value).isprintable()
    assert f"{file.name}: " in str(caught.value)
    assert caught.value.exit_status == 2
    return caught.value
