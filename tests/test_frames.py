"""Frames that differ, and hitch angles from other sources than paths: joints and transforms."""

import tracemalloc
from collections.abc import Callable
from pathlib import Path

import logs_maker as make
import numpy as np
import pytest

from replay.base.errors import LogError
from replay.logs.container.folder import open_log
from replay.logs.meaning.frames import Frames
from replay.logs.meaning.topics import is_wanted, topics_of
from replay.run.case import Case

Read = Callable[..., list[Case]]
Refusal = Callable[..., LogError]
TRUCK, AXLE = make.drive()
HITCH = AXLE[:, 2] - TRUCK[:, 2]
TIMES = ((np.arange(len(TRUCK)) + 1) * 2e8).astype(int)
BOX = (2.0, 2.0, 2.0)


def seen_from(poses: np.ndarray, frame: tuple[float, float, float]) -> np.ndarray:
    """Poses in a frame that lies at (x, y, yaw)."""
    x, y, yaw = frame
    c, s = np.cos(yaw), np.sin(yaw)
    place = (poses[:, :2] - [x, y]) @ np.array([[c, -s], [s, c]])
    return np.column_stack([place, poses[:, 2] - yaw])


def stamped(poses: np.ndarray = TRUCK, times: np.ndarray = TIMES) -> object:
    return make.path(poses, stamps=times.tolist())


def same(case: Case) -> None:
    (plain,) = CASES
    np.testing.assert_allclose(case.problem.recorded.samples.states, plain.problem.recorded.samples.states, atol=1e-6)


CASES: list[Case] = []


@pytest.fixture(autouse=True)
def _plain(read: Read) -> None:
    if not CASES:
        CASES.extend(read(make.sound_log()))


# ---- frames


@pytest.mark.parametrize("backwards", [False, True])
def test_paths_in_another_frame_are_put_into_the_maps(read: Read, backwards: bool) -> None:
    odom = (12.0, -3.0, 0.7)
    base = (5.0, 1.0, -0.4)
    maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
    link = make.transform("/map", "odom", odom)
    if backwards:
        link = make.transform("odom", "map", seen_from(np.zeros((1, 3)), odom)[0])
    maker.add("/tf_static", make.transforms(link, make.transform("odom", "base", base)), 1)
    truck = seen_from(seen_from(TRUCK, odom), base)
    maker.add("/truck", make.path(truck, "base"), 2).add("/trailer", make.path(seen_from(AXLE, odom), "odom"), 2)
    (case,) = read(maker)
    same(case)
    assert (case.frame, case.read.hitch) == ("map", "trailer path")
    assert any("a transform of the log puts it into 'map'" in note for note in case.read.notes)


def test_a_static_transform_whose_quaternion_is_repeated_with_the_other_sign_stands_still(read: Read) -> None:
    odom = (12.0, -3.0, np.pi)
    maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
    for yaw in (np.pi, -np.pi):
        maker.add("/tf", make.transforms(make.transform("map", "odom", (*odom[:2], yaw))), 1)
    maker.add("/truck", make.path(seen_from(TRUCK, odom), "odom"), 2)
    (case,) = read(maker.add("/trailer", make.path(seen_from(AXLE, odom), "odom"), 2))
    same(case)


def test_a_long_chain_of_frames_takes_little_memory(tmp_path: Path) -> None:
    links = [make.transform(f"f{i}", f"f{i + 1}", (1.0, 0.0, 0.0)) for i in range(3000)]
    file = make.LogMaker().add("/tf", make.transforms(*links), 1).write(tmp_path / "chain.mcap")
    frames = Frames(topics_of(open_log(file, is_wanted)))
    tracemalloc.start()
    try:
        moved = frames.moved(np.array([[0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]]), "f3000", "f0")
        assert tracemalloc.get_traced_memory()[1] < 16 << 20
    finally:
        tracemalloc.stop()
    np.testing.assert_allclose(moved[0, :3], [3000.0, 0.0, 0.0])


def test_frames_that_nothing_static_relates_are_refused_by_both_names(refusal: Refusal) -> None:
    def log(*links: tuple[int, object]) -> make.LogMaker:
        maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
        for time, link in links:
            maker.add("/tf", make.transforms(link), time)
        return maker.add("/truck", make.path(TRUCK, "odom"), 2)

    for links, why in (
        ((), "no static transform"),
        (((1, make.transform("map", "world", (0.0, 0.0, 0.0))),), "no static transform"),
        ([(t, make.transform("map", "odom", (float(t), 0.0, 0.0))) for t in (1, 2)], "they move"),
    ):
        error = refusal(log(*links))
        assert error.code == "E_FRAME"
        for part in ("'odom'", "'map'", why):
            assert part in str(error)
    for at, code in (((np.nan, 0.0, 0.0), "E_NONFINITE"), ((0.0, 0.0, 0.0), "E_QUATERNION")):
        link = make.transform("map", "odom", at)
        if code == "E_QUATERNION":
            link.transform.rotation.w = 3.0
        error = refusal(log((1, link)))
        assert error.code == code
    tilted = make.transform("map", "odom", (0.0, 0.0, 0.0))
    tilted.transform.rotation.x, tilted.transform.rotation.w = np.sin(0.1), np.cos(0.1)
    assert "tilted" in str(refusal(log((1, tilted))))


def test_markers_of_several_frames_are_put_into_that_of_most(read: Read) -> None:
    one, two = make.marker(1, BOX, (40.0, 30.0, 0.0), id=1), make.marker(1, BOX, (44.0, 30.0, 0.0), id=2)
    far = make.marker(1, BOX, (4.0, 0.0, 0.0), id=3, frame="gate", quaternion=(0.0, 0.0, 0.0, 0.0))
    maker = make.LogMaker().vehicle().add("/obstacles", make.markers(one, two, far), 1)
    maker.add("/tf_static", make.transforms(make.transform("map", "gate", (50.0, 5.0, np.pi / 2.0))), 1)
    (case,) = read(maker.add("/truck", make.path(TRUCK), 2))
    centres = sorted(part.mean(axis=0).round(6).tolist() for part in case.problem.scene.polygons)
    assert centres == [[40.0, 30.0], [44.0, 30.0], [50.0, 9.0]]


def test_a_turned_map_origin_turns_its_cells(read: Read) -> None:
    origin = (40.0, 2.0, np.pi / 2.0)
    cells = np.zeros((60, 100), np.int8)
    cells[10:20, 30:50] = 100  # 2 m to 4 m along the grid's y, 6 m to 10 m along its x
    (case,) = read(make.log_of(TRUCK, AXLE, cells, origin=origin), unknown="free")
    corners = np.concatenate(case.problem.scene.polygons)
    np.testing.assert_allclose(corners.min(axis=0), [36.0, 8.0], atol=1e-6)
    np.testing.assert_allclose(corners.max(axis=0), [38.0, 12.0], atol=1e-6)


# ---- hitch angles


def joint_log(values: np.ndarray, times: np.ndarray = TIMES, name: str = "hitch_joint") -> make.LogMaker:
    maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
    for time, value in zip(times.tolist(), values.tolist(), strict=True):
        maker.add("/joints", make.joints({"trailer_wheel_left": 7.0, name: value, "steer": 0.1}, time), 1)
    return maker


def test_the_hitch_angle_comes_from_a_joint_by_its_name_and_stamps(read: Read) -> None:
    (case,) = read(joint_log(HITCH + 2.0 * np.pi).add("/truck", stamped(), 2))
    same(case)
    assert case.read.hitch == "joint"
    assert not case.read.notes
    (case,) = read(joint_log(HITCH, name="j7").add("/truck", stamped(), 2), hitch_joint="j7")
    assert case.read.hitch == "joint"
    (case,) = read(joint_log(HITCH, name="j7").add("/truck", stamped(), 2))
    assert case.read.hitch == "reconstructed"


def test_joints_without_stamps_are_paired_by_index_where_the_counts_agree(read: Read) -> None:
    (case,) = read(joint_log(HITCH).add("/truck", make.path(TRUCK), 2))
    same(case)
    assert case.read.hitch == "joint"


def test_of_a_planned_path_a_joint_gives_the_first_hitch_angle(read: Read) -> None:
    maker = joint_log(np.array([0.05, 0.2, 0.3]), np.array([1, 2, 30]) * make.SECOND)
    (case,) = read(maker.add("/truck", make.path(TRUCK, time=3 * make.SECOND), 2))
    assert case.read.hitch == "reconstructed"
    assert case.problem.recorded.start[3] == pytest.approx(0.2)
    assert any("0.200 rad, is that of joint 'hitch_joint'" in note for note in case.read.notes)


def test_sources_that_disagree_are_told_with_the_amount(read: Read) -> None:
    maker = joint_log(HITCH + 0.04 * np.linspace(0.0, 1.0, len(HITCH)))
    (case,) = read(maker.add("/truck", stamped(), 2).add("/trailer", stamped(AXLE), 2))
    assert case.read.hitch == "trailer path"
    last = f"up to 0.040 rad (pose {len(TRUCK) - 1})"
    assert any(
        f"from joint 'hitch_joint' differ from those of the trailer's path by {last}" in n for n in case.read.notes
    )
    (case,) = read(joint_log(HITCH).add("/truck", stamped(), 2).add("/trailer", stamped(AXLE), 2))
    assert not case.read.notes


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda: joint_log(HITCH[:40], TIMES[:40]), "41 of 105 truck poses; pose 41 has none"),
        (lambda: joint_log(HITCH + 1.7), "expected below 90"),
        (lambda: joint_log(HITCH * np.nan), "not finite"),
        (lambda: joint_log(HITCH).add("/j2", make.joints({"hitch": 0.0}), 1), "choose with --hitch-joint"),
        (lambda: joint_log(HITCH).add_raw("/j2", "sensor_msgs/msg/JointState", b"", 1), "is not the standard one"),
    ],
)
def test_joints_that_cannot_be_used_cost_a_note_and_no_more(
    read: Read, change: Callable[[], make.LogMaker], says: str
) -> None:
    (case,) = read(change().add("/truck", stamped(), 2))
    assert case.read.hitch == "reconstructed"
    assert any(says in note for note in case.read.notes), case.read.notes


def test_a_joint_or_frame_that_an_option_names_must_be_there(refusal: Refusal) -> None:
    log = joint_log(HITCH).add("/truck", stamped(), 2)
    error = refusal(log, hitch_joint="pin")
    assert (error.code, "hitch_joint, steer" in str(error)) == ("E_NO_TOPIC", True)
    error = refusal(log, trailer_frame="cart")
    assert (error.code, "'cart'" in str(error)) == ("E_NO_TOPIC", True)


def transform_log(*links: tuple[int, object]) -> make.LogMaker:
    maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
    for _, link in links:
        maker.add("/tf", make.transforms(link), 1)
    return maker.add("/truck", stamped(), 2)


def test_the_hitch_angle_comes_from_a_transform_between_truck_and_trailer(read: Read) -> None:
    each = zip(TIMES.tolist(), HITCH.tolist(), strict=True)
    links = [(t, make.transform("base_link", "trailer", (0.0, 0.0, a), t)) for t, a in each]
    wheel = (0, make.transform("trailer", "trailer_wheel", (-8.0, 0.0, 0.0)))
    (case,) = read(transform_log(*links, wheel))
    same(case)
    assert case.read.hitch == "transform"


def test_a_transform_of_the_trailer_in_a_frame_that_stands_still_gives_its_heading_too(read: Read) -> None:
    odom = (12.0, -3.0, 0.7)
    truck, axle = seen_from(TRUCK, odom), seen_from(AXLE, odom)
    maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
    maker.add("/tf_static", make.transforms(make.transform("map", "odom", odom)), 1)
    for time, row in zip(TIMES.tolist(), axle, strict=True):
        maker.add("/tf", make.transforms(make.transform("odom", "trailer", row.tolist(), time)), 1)
    (case,) = read(maker.add("/truck", make.path(truck, "odom", stamps=TIMES.tolist()), 2))
    same(case)
    assert case.read.hitch == "transform"


def test_a_transform_of_the_trailer_in_the_maps_frame_gives_its_heading(read: Read) -> None:
    links = [
        (t, make.transform("map", "cart", (x, y, yaw), t)) for t, (x, y, yaw) in zip(TIMES.tolist(), AXLE, strict=True)
    ]
    (case,) = read(transform_log(*links), trailer_frame="cart")
    same(case)
    assert case.read.hitch == "transform"


def test_several_frames_that_may_be_the_trailers_are_told(read: Read) -> None:
    links = [(0, make.transform("base", name, (0.0, 0.0, 0.1))) for name in ("trailer_a", "trailer_b")]
    (case,) = read(transform_log(*links))
    assert any("trailer_a, trailer_b; choose with --trailer-frame" in note for note in case.read.notes)


# ---- requests


def test_one_request_of_a_log_can_be_chosen(read: Read, refusal: Refusal) -> None:
    maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
    for shift in (0.0, 1.0, 1.0, 2.0):
        maker.add("/truck", make.path(make.shifted(TRUCK, 0.0, shift)), 2)
    (case,) = read(maker, case=2)
    assert case.name == "yard/2"
    np.testing.assert_allclose(case.problem.recorded.start[:2], TRUCK[0, :2] + [0.0, 2.0])
    error = refusal(maker, case=3)
    assert "--case 3: it holds 3 requests" in str(error)
