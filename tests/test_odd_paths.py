"""Paths at the edge of what can be used: which of several is whose, millimetres, standstill, no way to drive."""

import re
from collections.abc import Callable

import logs_maker as make
import numpy as np
import pytest

from optim.model.clearance import swept_clearance, witnesses
from optim.model.vehicle import body_corners
from replay.base.errors import LogError
from replay.run.case import Case

Read = Callable[..., list[Case]]
Refusal = Callable[..., LogError]
TRUCK, AXLE = make.drive()


def noisy(poses: np.ndarray, position: float, heading: float, seed: int = 0) -> np.ndarray:
    sigma = [position, position, heading]
    return poses + np.random.default_rng(seed).normal(0.0, 1.0, poses.shape) * sigma


def straight(length: float, step: float) -> np.ndarray:
    s = np.arange(0.0, length + 1e-9, step)
    return np.column_stack([20.0 + s, np.full(len(s), 18.0), np.zeros(len(s))])


# ---- which path is whose


def beside(*others: tuple[str, object]) -> make.LogMaker:
    log = make.log_of(TRUCK)
    for topic, message in others:
        log.add(topic, message, 2)
    return log


def test_paths_of_which_none_follows_another_are_refused_with_the_distance(refusal: Refusal) -> None:
    error = refusal(beside(("/other", make.path(make.shifted(TRUCK, 0.0, 2.0)))))
    assert error.code == "E_AMBIGUOUS"
    assert "no two of them belong together as truck and trailer (the nearest axle is" in str(error)
    assert "--path-topic and --trailer-topic" in str(error)


def test_paths_that_cannot_be_compared_are_refused_with_the_reason(refusal: Refusal) -> None:
    error = refusal(beside(("/other", make.path(AXLE, frame="odom"))))
    assert error.code == "E_AMBIGUOUS"
    assert "no static transform between them is in the log" in str(error)


def test_of_several_paths_one_that_is_broken_in_itself_is_what_is_told(refusal: Refusal) -> None:
    broken = make.shifted(TRUCK, 0.0, 2.0)
    broken[30:, 1] += 9.0
    error = refusal(beside(("/other", make.path(broken))))
    assert error.code == "E_PATH_DISCONTINUOUS"
    assert "path topic '/other'" in str(error)


def test_a_path_of_several_frames_is_refused_with_them(refusal: Refusal) -> None:
    message = make.path(TRUCK)
    message.poses[7].header.frame_id = "odom"
    error = refusal(make.log_of(message))
    assert error.code == "E_FRAME"
    assert "it is in frame 'odom'" in str(error)
    assert "expected one frame for both" in str(error)


def test_more_transforms_than_can_be_meant_are_refused(refusal: Refusal) -> None:
    log = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
    log.add("/tf_static", make.transforms(*(make.transform("map", f"f{i}", (0.0, 0.0, 0.0)) for i in range(10_001))), 1)
    error = refusal(log.add("/truck", make.path(TRUCK, "odom"), 2))
    assert error.code == "E_FRAME"
    assert "more than 10000 pairs of frames" in str(error)


def test_a_trailer_that_stands_across_the_truck_is_refused_with_the_pose(refusal: Refusal) -> None:
    axle = AXLE.copy()
    heading = TRUCK[40:, 2] + np.radians(100.0)
    axle[40:] = np.column_stack([TRUCK[40:, 0] - 8 * np.cos(heading), TRUCK[40:, 1] - 8 * np.sin(heading), heading])
    error = refusal(make.log_of(TRUCK, axle))
    assert error.code == "E_HITCH"
    assert re.search(r"pose \d+: the hitch angle is \d+ degrees, expected below 90", str(error))


def test_paths_without_stamps_that_are_too_long_to_pair_are_refused(refusal: Refusal) -> None:
    truck, axle = (np.repeat(poses, 60, axis=0) for poses in (TRUCK, AXLE))
    error = refusal(make.log_of(truck, axle[:-1]), path_topic="/truck", trailer_topic="/trailer")
    assert error.code == "E_PATH_PAIR"
    assert "poses without stamps are too many to pair" in str(error)


# ---- poses that hardly move


def test_a_path_of_steps_of_millimetres_is_read(read: Read) -> None:
    (case,) = read(make.log_of(straight(3.0, 0.006)))
    np.testing.assert_allclose(case.problem.recorded.goal[:2], [23.0, 18.0], atol=1e-9)
    assert case.problem.recorded.length == pytest.approx(3.0, abs=1e-6)


@pytest.mark.parametrize("back", [0.006, 0.019])
@pytest.mark.parametrize("times", [1, 3, 20])
def test_rocking_at_standstill_is_no_motion(read: Read, back: float, times: int) -> None:
    poses = straight(6.0, 0.25)
    rocking = np.repeat(poses[9:10], 2 * times, axis=0)
    rocking[::2, 0] -= back
    (case,) = read(make.log_of(np.concatenate([poses[:10], rocking, poses[10:]])))
    assert case.problem.recorded.length == pytest.approx(6.0, abs=1e-6)
    assert case.read.max_deviation_m <= back


def test_a_path_that_rocks_back_by_a_step_ends_at_its_last_pose(read: Read) -> None:
    poses = straight(3.0, 0.25)
    rocked = np.concatenate([poses, poses[-1:] + [0.005 + 4e-7, 0.0, 0.0], poses[-1:] + [5e-7, 0.0, 0.0]])
    (case,) = read(make.log_of(rocked))
    np.testing.assert_allclose(case.problem.recorded.goal[:2], rocked[-1, :2], atol=1e-9)
    assert case.problem.recorded.num_cusps == 0


def test_noise_around_one_place_is_no_path(refusal: Refusal) -> None:
    standing = noisy(np.repeat(TRUCK[:1], 60, axis=0), 0.01, 0.01)
    error = refusal(make.log_of(standing))
    assert error.code == "E_PATH_ZERO_LENGTH"
    assert "within their noise" in str(error)


def test_noisy_poses_that_are_far_apart_are_not_averaged(read: Read) -> None:
    truck = noisy(make.drive(step=1.5, reverse=0.0)[0], 0.03, 0.005)
    (case,) = read(make.log_of(truck))
    assert case.read.poses == len(truck)
    assert not any("averaged" in note for note in case.read.notes)
    assert any("its poses have noise of" in note for note in case.read.notes)


def test_a_short_stretch_between_two_changes_of_gear_has_a_heading(read: Read) -> None:
    corners = np.array([[20.0, 18.0], [22.0, 18.0], [21.0, 18.0], [23.0, 18.0], [24.0, 18.0]])
    (case,) = read(make.log_of(np.column_stack([corners, np.full(5, 1.0)])), margin=0.0)
    assert [part.direction for part in case.problem.recorded.segments] == [1, -1, 1]
    assert np.abs(case.problem.recorded.samples.states[:, 2]).max() < 1e-6


# ---- what is stated beside the poses


def test_a_stated_gear_counts_in_noisy_poses_too(read: Read) -> None:
    poses = noisy(straight(12.0, 0.1), 0.01, 0.002)
    poses[60:64, 0] -= 0.35  # four poses that seem to go back
    (plain,) = read(make.log_of(poses))
    (stated,) = read(make.log_of(make.trajectory(poses, np.ones(len(poses)), np.zeros(len(poses)))))
    assert plain.problem.recorded.num_cusps > 0
    assert stated.problem.recorded.num_cusps == 0
    assert any("taken for noise in the poses" in note for note in stated.read.notes)


# ---- motion that no truck can make


def test_poses_that_no_truck_can_follow_are_refused_with_the_place(refusal: Refusal) -> None:
    poses = straight(20.0, 0.5)
    poses[20, 1] += 0.45  # aside and back, just within what is called a jump
    error = refusal(make.log_of(poses))
    assert error.code == "E_KINEMATICS"
    assert re.search(r"pose \d+\)", str(error))


@pytest.mark.parametrize("row", [20, 53])
def test_a_heading_that_no_motion_explains_is_refused_with_the_place(refusal: Refusal, row: int) -> None:
    poses = TRUCK.copy()
    poses[row, 2] += 2.0
    error = refusal(make.log_of(poses))
    assert error.code == "E_KINEMATICS"
    assert re.search(
        r"the best one jumps by .* between its samples, and is up to .* m from them \(at .* m, pose \d+", str(error)
    )


def test_a_trailer_that_overlaps_whatever_its_hitch_angle_is_refused(refusal: Refusal) -> None:
    truck = make.drive(reverse=25.0)[0]
    x, y, _ = truck[-1]
    post = make.polygon([(x - 0.1, y - 0.1), (x + 0.1, y - 0.1), (x + 0.1, y + 0.1), (x - 0.1, y + 0.1)])
    log = make.LogMaker().vehicle().add("/lots", post, 1).add("/truck", make.path(noisy(truck, 0.02, 0.005)), 2)
    assert refusal(log).code == "E_GOAL_COLLISION"


def test_an_initial_hitch_angle_that_folds_the_trailer_is_told(read: Read) -> None:
    poses = straight(9.0, 0.25)[::-1]
    (case,) = read(make.log_of(poses), initial_hitch=0.9)
    assert any("reaches 90 degrees; is the initial hitch angle right?" in note for note in case.read.notes)


def test_an_obstacle_that_is_touched_between_samples_alone_is_told(read: Read) -> None:
    far = make.polygon([(50.0, 30.0), (52.0, 30.0), (52.0, 32.0)])
    (case,) = read(make.LogMaker().vehicle().add("/lots", far, 1).add("/truck", make.path(TRUCK), 2))
    samples, vehicle = case.problem.recorded.samples, case.problem.vehicle
    row = int(np.argmax(np.abs(samples.phi)))
    corner = body_corners(vehicle, samples.states[row : row + 1])[0, 0, 2 if samples.phi[row] < 0 else 1]
    theta = samples.states[row, 2]
    side = 1.0 if samples.phi[row] < 0 else -1.0  # the front goes wide on the outside of the turn
    ahead, out = np.array([np.cos(theta), np.sin(theta)]), side * np.array([-np.sin(theta), np.cos(theta)])
    tip = corner + 2e-5 * (ahead + out)
    post = [tip, tip + 0.2 * ahead + 0.1 * out, tip + 0.1 * ahead + 0.2 * out]
    (case,) = read(make.LogMaker().vehicle().add("/lots", make.polygon(post), 1).add("/truck", make.path(TRUCK), 2))
    segment = case.problem.recorded.segments[0]
    scene = case.problem.scene
    assert witnesses(scene, vehicle, case.problem.recorded.samples.states).distance.min() >= 0.0
    assert swept_clearance(scene, vehicle, segment.s, segment.states, segment.phi).min() < 0.0
    assert any("between its samples the recorded path's truck may touch an obstacle" in n for n in case.read.notes)
