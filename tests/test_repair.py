"""Noisy recorded paths are led within the limits and clear of obstacles where their noise allows it."""

import logs_maker as make
import numpy as np
import pytest

from optim.model.kinematics import roll_out
from optim.model.problem import path_clearance
from optim.model.scene import Scene, make_scene
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array
from replay.logs.meaning.planar import Refusal
from replay.logs.meaning.plausibility import check_fit
from replay.logs.meaning.recorded_poses import RecordedPoses, recorded_poses
from replay.logs.meaning.repair import repaired

VEHICLE = Vehicle()
FAR = make_scene([np.array([[500.0, 0.0], [501.0, 0.0], [501.0, 1.0]])])


def _forward_and_back(reverse: float = 30.0) -> Array:
    """States every 0.5 m: 20 m forward in an S, then back, steered so that the trailer ends about straight."""
    s = np.arange(0.0, 20.0 + 1e-9, 0.5)
    there = roll_out(VEHICLE, np.zeros(4), s, 0.25 * np.sin(np.pi * s / 10.0), 1)
    states = [there[-1]]
    for _ in range(round(reverse / 0.5)):  # feedback holds the hitch angle, as drivers do
        _, _, theta, alpha = states[-1]
        steer = np.clip(-1.5 * (alpha + 0.5 * (theta + alpha)), -0.4, 0.4)
        states.append(roll_out(VEHICLE, states[-1], np.array([0.0, 0.5]), np.full(2, steer), -1)[-1])
    return np.concatenate([there, np.array(states[1:])])


def _read(states: Array, position: float, heading: float, seed: int) -> RecordedPoses:
    noise = np.random.default_rng(seed).normal(0.0, 1.0, (len(states), 3)) * [position, position, heading]
    return recorded_poses(states[:, :3] + noise, 1)


def _box(x: float, y: float, length: float = 1.0, width: float = 1.0) -> Array:
    return np.array([[x, y], [x + length, y], [x + length, y + width], [x, y + width]])


def test_an_exact_path_within_the_limits_is_left_as_it_is() -> None:
    states = _forward_and_back(5.0)
    fit, notes = repaired(VEHICLE, FAR, _read(states, 0.0, 0.0, 0), None, 0.0)
    assert notes == []
    assert fit.position_error.max() < 2e-3


@pytest.mark.parametrize("seed", range(4))
def test_noise_that_breaks_a_limit_is_led_back_within_it(seed: int) -> None:
    s = np.arange(0.0, 15.0 + 1e-9, 0.5)
    states = roll_out(VEHICLE, np.zeros(4), s, 0.52 * np.sin(np.pi * s / 15.0) ** 2, 1)
    fit, notes = repaired(VEHICLE, FAR, _read(states, 0.03, 0.01, seed), None, 0.0)
    samples = fit.path.samples
    assert np.abs(samples.phi).max() <= VEHICLE.max_steer * 1.001
    assert fit.position_error.max() < 0.15
    assert all("within the noise of its poses" in note for note in notes)


def test_limits_that_the_poses_plainly_break_are_left_to_the_checks() -> None:
    narrow = Vehicle(max_steer=0.1)
    fit, notes = repaired(narrow, FAR, _read(_forward_and_back(5.0), 0.0, 0.0, 0), None, 0.0)
    assert notes == []
    assert np.abs(fit.path.samples.phi).max() > 0.2


def test_a_path_is_moved_aside_by_the_noise_but_not_by_more() -> None:
    x = np.arange(0.0, 40.0, 0.5)
    straight = np.column_stack([x, 0.0 * x, 0.0 * x, 0.0 * x])
    recorded = _read(straight, 0.02, 0.003, 1)
    clear, _ = repaired(VEHICLE, FAR, recorded, None, 0.0)
    at = clear.path.samples.states[np.argmin(np.abs(clear.path.samples.s - 20.0))]
    for depth, is_moved in ((0.015, True), (0.2, False)):
        scene = make_scene([_box(float(at[0]), float(at[1]) + VEHICLE.truck_width / 2.0 - depth)])
        assert path_clearance(VEHICLE, scene, clear.path) < 0.0
        fit, notes = repaired(VEHICLE, scene, recorded, None, 0.0)
        assert (path_clearance(VEHICLE, scene, fit.path) >= 0.0) == is_moved
        assert any("clear of obstacles" in note for note in notes) == is_moved
        assert fit.position_error.max() < clear.position_error.max() + 0.08


def _lane(states: Array) -> Scene:
    """Walls 0.5 m beside the trailer's end at the last pose."""
    x, y, heading = states[-1, 0], states[-1, 1], states[-1, 2] + states[-1, 3]
    turn = np.array([[np.cos(heading), -np.sin(heading)], [np.sin(heading), np.cos(heading)]])
    side = VEHICLE.trailer_width / 2.0 + 0.5
    return make_scene([np.array([x, y]) + _box(-12.0, low, 6.0, 0.5) @ turn.T for low in (side, -side - 0.5)])


def test_a_hitch_angle_that_the_poses_leave_open_is_one_at_which_the_trailer_is_free() -> None:
    states = _forward_and_back(40.0)
    told = 0
    for seed in range(3):
        fit, notes = repaired(VEHICLE, _lane(states), _read(states, 0.03, 0.01, seed), None, 0.0)
        assert fit.goal_hitch_sigma > 0.1
        assert path_clearance(VEHICLE, _lane(states), fit.path) >= 0.0
        assert abs(fit.path.goal[3] - states[-1, 3]) < 0.12
        told += any("it is taken to end at" in note for note in notes)
    assert told > 0


def test_a_trailer_that_no_hitch_angle_frees_is_left_where_the_poses_have_it() -> None:
    states = _forward_and_back(40.0)
    recorded = _read(states, 0.03, 0.01, 0)
    scene = make_scene([_box(states[-1, 0] - 0.1, states[-1, 1] - 0.1, 0.2, 0.2)])  # at the hitch itself
    alone, _ = repaired(VEHICLE, FAR, recorded, None, 0.0)
    fit, notes = repaired(VEHICLE, scene, recorded, None, 0.0)
    assert path_clearance(VEHICLE, scene, fit.path) < -0.5
    assert not any("it is taken to end at" in note for note in notes)
    assert fit.path.goal[3] == pytest.approx(alone.path.goal[3], abs=0.02)


def test_the_expected_error_of_the_last_hitch_angle_is_that_of_many_noisy_logs() -> None:
    states = _forward_and_back(20.0)
    fits = [repaired(VEHICLE, FAR, _read(states, 0.03, 0.01, seed), None, 0.0)[0] for seed in range(8)]
    errors = [fit.path.goal[3] - states[-1, 3] for fit in fits]
    expected = np.mean([fit.goal_hitch_sigma for fit in fits])
    assert 0.4 * expected < np.std(errors) < 2.0 * expected


def test_poses_through_which_no_fit_can_be_made_are_refused() -> None:
    poses = make.drive()[0][:30]
    poses[28, 2] += 1.8597760627112647  # lengths beside it shrink until they vanish against the way
    vehicle = Vehicle(wheelbase=6.68296200347444, hitch_to_axle=0.0780723004756614, truck_front=7.0)
    recorded = recorded_poses(poses, 1)
    with pytest.raises(Refusal, match="no drivable path was found near its poses"):
        check_fit(recorded, repaired(vehicle, FAR, recorded, None, -0.5827331002757071)[0])


def test_a_logged_trailer_pins_the_hitch_angle() -> None:
    states = _forward_and_back(40.0)
    recorded = _read(states, 0.03, 0.01, 0)
    alpha = np.interp(recorded.kept, np.arange(len(states)), states[:, 3])
    fit, notes = repaired(VEHICLE, _lane(states), recorded, alpha, 0.0)
    assert fit.goal_hitch_sigma < 0.02
    assert abs(fit.path.goal[3] - states[-1, 3]) < 0.02
    assert notes == []


def test_sound_logs_are_read_without_a_word_of_repair(tmp_path) -> None:
    (case,) = make.read_log(tmp_path / "sound.mcap", make.sound_log())
    assert case.read.notes == ()
