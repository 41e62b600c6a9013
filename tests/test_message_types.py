"""Every ROS 2 message type that may hold a map or a path, from the bytes to a case."""

from collections.abc import Callable
from pathlib import Path
from typing import Any

import logs_maker as make
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from idl_maker import idl
from shapely import Polygon, union_all
from stream_maker import odometry, stamped, with_covariance

from optim.model.vehicle import Vehicle
from replay.base.errors import LogError
from replay.logs.container.folder import open_log
from replay.logs.meaning.topics import is_wanted, topics_of
from replay.logs.meaning.understood import uses
from replay.logs.messages.cdr import CdrError
from replay.logs.messages.ros2 import MESSAGE_TYPES
from replay.logs.messages.types import Joints, PoseSeries, Ring, Transform
from replay.run.case import Case

Read = Callable[..., list[Case]]
Refusal = Callable[..., LogError]
TRUCK, AXLE = make.drive()
frames = st.text(max_size=12)
numbers = st.floats(allow_nan=False, width=64)
rows = st.lists(st.tuples(*[st.floats(-1e6, 1e6)] * 3), max_size=9)


def decode(message: Any) -> Any:
    return MESSAGE_TYPES[message.__msgtype__].decode(make.serialised(message), 0)


def moving(poses: np.ndarray) -> np.ndarray:
    """Speeds along the headings, in m/s: those with which each pose is left."""
    step = np.diff(poses[:, :2], axis=0)
    along = np.cos(poses[:-1, 2]) * step[:, 0] + np.sin(poses[:-1, 2]) * step[:, 1]
    return np.append(np.sign(along), 0.0)


# ---- decoders


@given(poses=rows, frame=frames)
@settings(max_examples=40)
def test_an_array_of_poses_comes_back_exactly(poses: list[tuple[float, float, float]], frame: str) -> None:
    series: PoseSeries = decode(make.pose_array(poses, frame, time=12))
    assert series.header == (12, frame)
    assert series.stamps.tolist() == [12] * len(poses)
    assert series.poses[:, :2].tolist() == [[x, y] for x, y, _ in poses]
    assert series.speed is None


@given(poses=rows, frame=frames)
@settings(max_examples=40)
def test_a_trajectory_comes_back_exactly_with_speeds_and_wheel_angles(
    poses: list[tuple[float, float, float]], frame: str
) -> None:
    values = np.arange(len(poses), dtype=float)
    series: PoseSeries = decode(
        make.trajectory(np.array(poses).reshape(-1, 3), values, -values, frame, step=1_500_000_000)
    )
    assert series.header.frame == frame
    assert series.stamps.tolist() == [1_500_000_000 * i for i in range(len(poses))]
    assert series.poses[:, :2].tolist() == [[x, y] for x, y, _ in poses]
    assert series.speed is not None
    assert series.steer is not None
    assert (series.speed.tolist(), series.steer.tolist()) == (values.tolist(), (-values).tolist())


@given(corners=st.lists(st.tuples(*[st.floats(-1e3, 1e3, width=32)] * 2), max_size=9), frame=frames)
@settings(max_examples=40)
def test_polygons_come_back_exactly(corners: list[tuple[float, float]], frame: str) -> None:
    for head in (frame, None):
        (ring,) = decode(make.polygon(corners, head, time=5))
        assert isinstance(ring, Ring)
        assert ring.points[:, :2].tolist() == [list(corner) for corner in corners]
        assert ring.header == (None if head is None else (5, frame))


@given(names=st.lists(frames, max_size=5, unique=True), value=numbers)
@settings(max_examples=40)
def test_joints_and_transforms_come_back_exactly(names: list[str], value: float) -> None:
    (joints,) = decode(make.joints(dict.fromkeys(names, value), time=7))
    assert isinstance(joints, Joints)
    assert (joints.stamp, joints.names, joints.positions.tolist()) == (7, tuple(names), [value] * len(names))
    found = decode(make.transforms(*[make.transform(name, "b", (value, 2.0, 0.0), 9, z=3.0) for name in names]))
    assert all(isinstance(each, Transform) for each in found)
    assert [(each.header, each.child) for each in found] == [((9, name), "b") for name in names]
    assert all(each.pose.tolist() == [value, 2.0, 3.0, 0.0, 0.0, 0.0, 1.0] for each in found)


@pytest.mark.parametrize(
    "message",
    [
        make.pose_array(TRUCK[:3]),
        make.trajectory(TRUCK[:3], [1.0] * 3, [0.0] * 3),
        make.polygon(TRUCK[:3, :2]),
        make.polygon(TRUCK[:3, :2], None),
        make.joints({"a": 1.0, "b": 2.0}),
        make.transforms(make.transform("a", "b", (1.0, 2.0, 3.0))),
    ],
    ids=lambda message: message.__msgtype__,
)
def test_a_payload_of_the_wrong_length_is_an_error_wherever_it_ends(message: Any) -> None:
    data = make.serialised(message)
    family = MESSAGE_TYPES[message.__msgtype__]
    for end in range(len(data) - 4):
        with pytest.raises(CdrError):
            family.decode(data[:end], 0)
    with pytest.raises(CdrError, match="left over"):
        family.decode(data + bytes(8), 0)


def test_a_trajectory_with_times_that_are_none_is_refused() -> None:
    data = bytearray(make.serialised(make.trajectory(TRUCK[:3], [1.0] * 3, [0.0] * 3, step=5)))
    at = data.index((5).to_bytes(4, "little"))
    data[at : at + 4] = b"\xff" * 4
    with pytest.raises(CdrError, match="nanosec is 4294967295"):
        MESSAGE_TYPES["autoware_planning_msgs/msg/Trajectory"].decode(bytes(data), 0)


# ---- paths


@pytest.mark.parametrize("definitions", ["ros2msg", "ros2idl"])
@pytest.mark.parametrize("make_path", [make.path, make.pose_array])
def test_paths_of_every_type_become_the_same_case(read: Read, make_path: Callable[..., Any], definitions: str) -> None:
    maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
    for topic, poses in (("/truck", TRUCK), ("/trailer", AXLE)):
        message = make_path(poses)
        kind = message.__msgtype__
        text = idl(kind) if definitions == "ros2idl" else make.typestore().generate_msgdef(kind, ros_version=2)[0]
        data = make.serialised(message)
        maker.add_raw(topic, kind, data, 2, definition=text.encode(), schema_encoding=definitions)
    (case,) = read(maker)
    (plain,) = read(make.sound_log())
    np.testing.assert_allclose(case.problem.recorded.samples.states, plain.problem.recorded.samples.states, atol=1e-9)
    assert case.read.hitch == "trailer path"


def test_a_trajectory_is_a_path_whose_stated_values_agree(read: Read) -> None:
    (plain,) = read(make.sound_log(trailer=False))
    samples = plain.problem.recorded.samples
    s = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(TRUCK[:, :2], axis=0).T))])
    steer = np.interp(s, samples.s, samples.phi)
    (case,) = read(make.log_of(make.trajectory(TRUCK, moving(TRUCK), steer)))
    assert not case.read.notes
    assert case.problem.recorded.num_cusps == 1
    (other,) = read(make.log_of(make.trajectory(TRUCK, moving(TRUCK), steer + 0.3)))
    assert any("steering angles that it states differ by up to 0.3" in note for note in other.read.notes)


def test_the_stated_gear_decides_where_motion_may_be_noise_and_is_told_where_it_cannot_be(read: Read) -> None:
    poses, speed = TRUCK.copy(), moving(TRUCK)
    along = np.stack([np.cos(poses[40:42, 2]), np.sin(poses[40:42, 2])], axis=1)
    poses[40:42, :2] += np.array([[0.15], [-0.15]]) * along  # two poses that have changed places
    (case,) = read(make.log_of(make.trajectory(poses, speed, 0.0 * speed)))
    assert case.problem.recorded.num_cusps == 1
    assert any("taken for noise" in note for note in case.read.notes)
    (case,) = read(make.log_of(make.trajectory(TRUCK, np.abs(speed), 0.0 * speed)))
    assert case.problem.recorded.num_cusps == 1
    assert any("the motion counts" in note for note in case.read.notes)


def test_without_headings_the_first_stated_gear_says_how_the_path_starts(read: Read) -> None:
    poses = TRUCK.copy()
    poses[:, 2] = 0.5
    (case,) = read(make.log_of(make.trajectory(poses, -moving(TRUCK), 0.0 * poses[:, 0])), unknown="free")
    assert [part.direction for part in case.problem.recorded.segments] == [-1, 1]


@pytest.mark.parametrize(("reference", "offset"), [("rear-axle", 1.3), ("centre", 0.0), ("front-axle", -0.5)])
def test_poses_of_another_point_of_the_truck_are_moved_to_its_rear_axle(
    read: Read, refusal: Refusal, reference: str, offset: float
) -> None:
    vehicle = Vehicle()
    ahead = offset + {"rear-axle": 0.0, "centre": 2.0, "front-axle": vehicle.wheelbase}[reference]
    moved = TRUCK.copy()
    moved[:, :2] += ahead * np.stack([np.cos(TRUCK[:, 2]), np.sin(TRUCK[:, 2])], axis=1)
    options = {"reference": reference, "reference_offset": offset}
    (case,) = read(make.log_of(moved, AXLE), **options)
    np.testing.assert_allclose(case.problem.recorded.start[:3], TRUCK[0], atol=1e-9)
    np.testing.assert_allclose(case.problem.recorded.goal[:3], TRUCK[-1], atol=1e-9)
    assert case.read.hitch == "trailer path"
    moved[:, 2] = 0.0
    assert refusal(make.log_of(moved), **options).code == "E_PATH_HEADING"


@pytest.mark.parametrize("offset", [3.6, -1.0])
@pytest.mark.parametrize("heading", [0.0, 0.5])
def test_a_straight_drive_is_moved_to_the_rear_axle_though_its_headings_are_equal(
    read: Read, heading: float, offset: float
) -> None:
    along = np.array([np.cos(heading), np.sin(heading)])
    xy = np.array([20.0, 15.0]) + np.arange(0.0, 15.0, 0.25)[:, None] * along
    poses = np.column_stack([xy + offset * along, np.full(len(xy), heading)])
    (case,) = read(make.log_of(poses), reference_offset=offset)
    np.testing.assert_allclose(case.problem.recorded.start[:3], [*xy[0], heading], atol=1e-9)


# ---- poses one by one


def streamed(one: Callable[..., Any], step: int = 200_000_000) -> make.LogMaker:
    maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
    for number, (row, speed) in enumerate(zip(TRUCK, moving(TRUCK), strict=True)):
        maker.add("/driven", one(row, number * step, speed), 2 + number)
    return maker


@pytest.mark.parametrize("one", [odometry, stamped, with_covariance], ids=lambda one: one.__name__)
def test_poses_that_come_one_by_one_make_a_path(read: Read, one: Callable[..., Any]) -> None:
    (case,) = read(streamed(one))
    (plain,) = read(make.sound_log(trailer=False))
    np.testing.assert_allclose(case.problem.recorded.samples.states, plain.problem.recorded.samples.states, atol=1e-9)
    assert case.read.poses == len(TRUCK)


def test_info_counts_poses_that_come_one_by_one(tmp_path: Path) -> None:
    log = open_log(streamed(odometry).write(tmp_path / "driven.mcap"), is_wanted)
    assert {use.text for use in uses(log, topics_of(log))} == {
        "map: grid, 60000 cells",
        f"poses one by one, {len(TRUCK)} poses",
    }


def test_beside_a_path_single_poses_are_used_only_where_an_option_names_them(read: Read, refusal: Refusal) -> None:
    maker = streamed(stamped).add("/plan", make.path(make.shifted(TRUCK, 0.0, 1.0)), 2)
    (case,) = read(maker)
    np.testing.assert_allclose(case.problem.recorded.start[:2], TRUCK[0, :2] + [0.0, 1.0])
    (case,) = read(maker, path_topic="/driven")
    np.testing.assert_allclose(case.problem.recorded.start[:2], TRUCK[0, :2])
    maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1).add("/goal", stamped(TRUCK[0], 0, 0.0), 2)
    assert refusal(maker).code == "E_NO_PATH"  # one pose is a goal, not a drive


def test_single_poses_without_stamps_have_the_times_of_the_log(read: Read) -> None:
    maker = streamed(stamped, step=0)
    for number, row in enumerate(AXLE):
        maker.add("/trailer", stamped(row, 0, 0.0), 2 + number)
    (case,) = read(maker)
    assert case.read.hitch == "trailer path"
    error_free = [note for note in case.read.notes if "differ" in note]
    assert not error_free


# ---- maps


def test_polygons_of_one_moment_are_one_map_and_later_ones_replace_it(read: Read) -> None:
    square = np.array([[5.0, 5.0], [8.0, 5.0], [8.0, 8.0], [5.0, 8.0]])
    arrow = np.array([[50.0, 30.0], [56.0, 33.0], [50.0, 36.0], [52.0, 33.0]])  # not convex
    maker = make.LogMaker().vehicle()
    maker.add("/lots", make.polygon(square, time=1), 1).add("/lots", make.polygon(arrow[::-1], time=1), 1)
    maker.add("/lots", make.polygon([], time=1), 1).add("/truck", make.path(TRUCK), 2)
    maker.add("/lots", make.polygon(square + 20.0, time=3), 3).add("/truck", make.path(TRUCK + [0.0, 1.0, 0.0]), 4)
    first, second = read(maker)
    covered = union_all([Polygon(part) for part in first.problem.scene.polygons])
    assert covered.symmetric_difference(union_all([Polygon(square), Polygon(arrow)])).area < 1e-9
    assert any("polygons that are not obstacles: 1" in note for note in first.read.notes)
    assert [len(case.problem.scene.polygons) for case in (first, second)] == [3, 1]
    assert first.frame == "map"


def test_a_polygon_without_a_header_is_in_the_frame_of_the_path(read: Read) -> None:
    square = make.polygon([(5.0, 5.0), (8.0, 5.0), (8.0, 8.0), (5.0, 8.0)], None)
    (case,) = read(make.LogMaker().vehicle().add("/lot", square, 1).add("/truck", make.path(TRUCK, "yard"), 2))
    assert case.frame == "yard"
    assert len(case.problem.scene.polygons) == 1


@pytest.mark.parametrize(
    ("corners", "code"),
    [
        ([(0.0, 0.0), (5.0, 5.0), (5.0, 0.0), (0.0, 5.0)], "E_MAP"),  # crosses itself
        ([(0.0, 0.0), (np.nan, 5.0), (5.0, 0.0)], "E_NONFINITE"),
        ([(0.0, 0.0), (5.0, 0.0)], "E_MAP"),
        ([(np.cos(a), np.sin(a)) for a in np.linspace(0.0, 6.0, 10_001)], "E_TOO_MANY_SHAPES"),
    ],
)
def test_polygons_that_are_none_are_refused(refusal: Refusal, corners: list[tuple[float, float]], code: str) -> None:
    maker = make.LogMaker().vehicle().add("/lot", make.polygon(corners), 1).add("/truck", make.path(TRUCK), 2)
    assert refusal(maker).code == code


def test_polygons_of_one_moment_in_several_frames_are_refused(refusal: Refusal) -> None:
    square = [(5.0, 5.0), (8.0, 5.0), (8.0, 8.0), (5.0, 8.0)]
    maker = make.LogMaker().vehicle().add("/lot", make.polygon(square), 1).add("/lot", make.polygon(square, "odom"), 1)
    assert refusal(maker.add("/truck", make.path(TRUCK), 2)).code == "E_FRAME"
