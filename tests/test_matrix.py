"""The same scene and path from every family, encoding, compression and encoding of definitions.

And from whole logs of other software.
"""

import io
import json
import pathlib
from collections.abc import Callable, Iterator
from typing import Any

import foxglove
import foxglove_maker as fox
import logs_maker as make
import numpy as np
import pytest
from foxglove import channels
from foxglove import messages as sdk
from idl_maker import idl
from mcap.writer import CompressionType
from mcap_protobuf.writer import Writer as ProtobufWriter
from mcap_ros2.writer import Writer as Ros2Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from optim.model.vehicle import Vehicle
from replay.logs import read_cases
from replay.run.case import Case

Read = Callable[..., list[Case]]
TRUCK, AXLE = make.drive()
BOX, AT = (4.0, 2.0, 1.0), (45.0, 32.0, 0.25)
ORIGIN = (-1.0, -2.0, 0.0)
COMPRESSIONS = [CompressionType.NONE, CompressionType.LZ4, CompressionType.ZSTD]


def corners() -> np.ndarray:
    """The box from above."""
    half = np.array([[-2.0, -1.0], [2.0, -1.0], [2.0, 1.0], [-2.0, 1.0]])
    c, s = np.cos(AT[2]), np.sin(AT[2])
    return half @ np.array([[c, s], [-s, c]]) + AT[:2]


def ros_messages(scene: str, path: str) -> Iterator[tuple[str, Any]]:
    maps = {
        "grid": lambda: make.grid(make.yard(), 0.2, ORIGIN),
        "shapes": lambda: make.markers(make.marker(1, BOX, AT, z=0.5)),
        "polygon": lambda: make.polygon(corners()),
    }
    yield "/map", maps[scene]()
    write = {"path": make.path, "pose_array": make.pose_array}[path]
    yield "/truck", write(TRUCK)
    yield "/trailer", write(AXLE)


def foxglove_messages(scene: str) -> Iterator[tuple[str, Any]]:
    if scene == "grid":
        yield "/map", fox.grid(make.yard(), 0.2, ORIGIN)
    else:
        yield "/map", fox.scene(fox.entity("box", cubes=[fox.cube(AT, BOX)]))
    yield "/truck", fox.poses(TRUCK)
    yield "/trailer", fox.poses(AXLE)


PLAIN: dict[str, Case] = {}


def same(case: Case, scene: str, read: Read) -> None:
    """The case is that of a plain ROS 2 log of the same scene."""
    if scene not in PLAIN:
        maker = make.LogMaker().vehicle()
        for topic, message in ros_messages(scene, "path"):
            maker.add(topic, message, 1)
        (PLAIN[scene],) = read(maker)
    plain = PLAIN[scene].problem
    problem = case.problem
    assert problem.vehicle == plain.vehicle
    assert (case.frame, case.read.hitch, case.read.poses) == ("map", "trailer path", len(TRUCK))
    np.testing.assert_allclose(problem.recorded.samples.states, plain.recorded.samples.states, rtol=0.0, atol=1e-6)
    np.testing.assert_allclose(problem.recorded.samples.phi, plain.recorded.samples.phi, rtol=0.0, atol=1e-6)
    assert len(problem.scene.polygons) == len(plain.scene.polygons)
    for one, other in zip(problem.scene.polygons, plain.scene.polygons, strict=True):
        start = int(np.argmin(np.hypot(*(one - other[0]).T)))
        np.testing.assert_allclose(np.roll(one, -start, axis=0), other, rtol=0.0, atol=1e-6)


@pytest.mark.parametrize("compression", COMPRESSIONS, ids=lambda each: each.name.lower())
@pytest.mark.parametrize("definitions", ["ros2msg", "ros2idl"])
@pytest.mark.parametrize("scene", ["grid", "shapes"])
@pytest.mark.parametrize("path", ["path", "pose_array"])
def test_ros_logs_of_every_kind_are_read_alike(
    read: Read, path: str, scene: str, definitions: str, compression: CompressionType
) -> None:
    maker = make.LogMaker(compression=compression).vehicle()
    for topic, message in ros_messages(scene, path):
        kind = message.__msgtype__
        text = idl(kind) if definitions == "ros2idl" else make.typestore().generate_msgdef(kind, ros_version=2)[0]
        data = make.serialised(message)
        maker.add_raw(topic, kind, data, 1, definition=text.encode(), schema_encoding=definitions)
    (case,) = read(maker)
    same(case, scene, read)
    assert not case.read.notes


@pytest.mark.parametrize("chunked", [True, False])
@pytest.mark.parametrize("compression", COMPRESSIONS, ids=lambda each: each.name.lower())
@pytest.mark.parametrize("encoding", ["protobuf", "json"])
@pytest.mark.parametrize("scene", ["grid", "shapes"])
def test_foxglove_logs_of_every_kind_are_read_alike(
    read: Read, scene: str, encoding: str, compression: CompressionType, chunked: bool
) -> None:
    maker = make.LogMaker(compression=compression, chunked=chunked).vehicle()
    for topic, message in foxglove_messages(scene):
        fox.added(maker, topic, message, 1, encoding)
    (case,) = read(maker)
    same(case, scene, read)
    assert not case.read.notes


def test_families_mix_in_one_log(read: Read) -> None:
    maker = fox.added(make.LogMaker().vehicle(), "/map", fox.grid(make.yard(), 0.2, ORIGIN), 1, "json")
    maker.add("/truck", make.path(TRUCK), 1)
    (case,) = read(fox.added(maker, "/trailer", fox.poses(AXLE), 1))
    same(case, "grid", read)


def test_a_polygon_is_the_box_from_above(read: Read) -> None:
    maker = make.LogMaker().vehicle()
    for topic, message in ros_messages("polygon", "path"):
        maker.add(topic, message, 1)
    (case,) = read(maker)
    (polygon,) = case.problem.scene.polygons
    np.testing.assert_allclose(polygon, corners(), atol=1e-5)  # float32 on the wire


# ---- whole logs by other software


def vehicle_values() -> dict[str, str]:
    return {key: json.dumps(value) for key, value in vars(Vehicle()).items() if isinstance(value, float)}


def test_a_log_by_the_ros2_writer_of_mcap_is_read(read: Read) -> None:
    out = io.BytesIO()
    writer = Ros2Writer(out)
    for topic, message in ros_messages("shapes", "path"):
        for each in getattr(message, "markers", []):  # that writer wants lists
            each.texture.data, each.mesh_file.data = [], []
        kind = message.__msgtype__
        text, _ = make.typestore().generate_msgdef(kind, ros_version=2)
        writer.write_message(topic, writer.register_msgdef(kind, text), message, log_time=1, publish_time=1)
    writer._writer.add_metadata("vehicle", vehicle_values())
    writer.finish()
    (case,) = read(out.getvalue())
    same(case, "shapes", read)


@pytest.mark.parametrize("scene", ["grid", "shapes"])
def test_a_log_by_the_protobuf_writer_of_mcap_is_read(read: Read, scene: str) -> None:
    out = io.BytesIO()
    with ProtobufWriter(out) as writer:
        for topic, message in foxglove_messages(scene):
            writer.write_message(topic, message, log_time=1, publish_time=1)
        writer._writer.add_metadata("vehicle", vehicle_values())
    (case,) = read(out.getvalue())
    same(case, scene, read)


def sdk_pose(x: float, y: float, yaw: float, z: float = 0.0) -> Any:
    turn = sdk.Quaternion(x=0.0, y=0.0, z=np.sin(yaw / 2.0), w=np.cos(yaw / 2.0))
    return sdk.Pose(position=sdk.Vector3(x=x, y=y, z=z), orientation=turn)


def sdk_map(scene: str, time: Any) -> Any:
    if scene != "grid":
        cube = sdk.CubePrimitive(pose=sdk_pose(*AT, z=0.5), size=sdk.Vector3(x=BOX[0], y=BOX[1], z=BOX[2]))
        entity = sdk.SceneEntity(id="box", frame_id="map", timestamp=time, cubes=[cube])
        return sdk.SceneUpdate(entities=[entity])
    cells = make.yard()
    return sdk.Grid(
        timestamp=time,
        frame_id="map",
        pose=sdk_pose(*ORIGIN),
        column_count=cells.shape[1],
        cell_size=sdk.Vector2(x=0.2, y=0.2),
        row_stride=cells.shape[1],
        cell_stride=1,
        fields=[sdk.PackedElementField(name="occupancy", offset=0, type=sdk.PackedElementFieldNumericType.Int8)],
        data=cells.tobytes(),
    )


@pytest.mark.parametrize("scene", ["grid", "shapes"])
def test_a_log_by_foxgloves_own_software_is_read(read: Read, tmp_path: pathlib.Path, scene: str) -> None:
    context, time = foxglove.Context(), sdk.Timestamp(1, 0)
    paths = [
        (topic, sdk.PosesInFrame(timestamp=time, frame_id="map", poses=[sdk_pose(*row) for row in rows.tolist()]))
        for topic, rows in (("/truck", TRUCK), ("/trailer", AXLE))
    ]
    with foxglove.open_mcap(tmp_path / "sdk.mcap", context=context) as writer:
        writer.write_metadata("vehicle", vehicle_values())
        for topic, message in (("/map", sdk_map(scene, time)), *paths):
            channel = getattr(channels, f"{type(message).__name__}Channel")(topic, context=context)
            channel.log(message, log_time=1)
    (case,) = read_cases(tmp_path / "sdk.mcap")
    same(case, scene, read)


def test_json_through_foxgloves_own_software_is_read(read: Read, tmp_path: pathlib.Path) -> None:
    context = foxglove.Context()
    with foxglove.open_mcap(tmp_path / "sdk.mcap", context=context) as writer:
        writer.write_metadata("vehicle", vehicle_values())
        for topic, message in foxglove_messages("grid"):
            name = message.DESCRIPTOR.full_name
            schema = foxglove.Schema(name=name, encoding="jsonschema", data=b'{"type": "object"}')
            channel = foxglove.Channel(topic, schema=schema, message_encoding="json", context=context)
            channel.log(json.dumps(fox.tree(message)).encode(), log_time=1)
    (case,) = read_cases(tmp_path / "sdk.mcap")
    same(case, "grid", read)


def test_a_file_by_rosbags_is_read(read: Read, tmp_path: pathlib.Path) -> None:
    folder = tmp_path / "bag"
    with RosbagsWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, message in ros_messages("grid", "path"):
            connection = writer.add_connection(topic, message.__msgtype__, typestore=make.typestore())
            writer.write(connection, 1, make.serialised(message))
    (file,) = folder.glob("*.mcap")
    (case,) = read_cases(file)
    same(case, "grid", read)
