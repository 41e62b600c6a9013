"""What noisy poses say about the motion: noise, gears, groups; and that paths read from them are the true ones."""

import logs_maker as make
import numpy as np
import pytest
from paths import random_path
from scipy.spatial import KDTree

from optim.model.vehicle import Vehicle
from replay.logs.meaning.noisy_motion import groups, noise_of, rough_chain, signed_travel, turning_points
from replay.logs.meaning.recorded_poses import recorded_poses

TRUCK, FINE = make.drive(step=0.1)[0], make.drive(step=0.005)[0]


def _noisy(poses: np.ndarray, position: float, heading: float, seed: int = 0) -> np.ndarray:
    sigma = [position, position, heading]
    return poses + np.random.default_rng(seed).normal(0.0, 1.0, poses.shape) * sigma


def _at_standstill(count: int) -> np.ndarray:
    """The drive with `count` poses at each end and at the change of gear, 200 poses from the start."""
    return np.repeat(TRUCK, np.where(np.isin(np.arange(len(TRUCK)), [0, 200, len(TRUCK) - 1]), count, 1), axis=0)


@pytest.mark.parametrize(("position", "heading"), [(0.01, 0.005), (0.02, 0.002), (0.05, 0.02)])
@pytest.mark.parametrize("step", [0.1, 0.5])
def test_the_noise_of_poses_is_estimated_from_them(position: float, heading: float, step: float) -> None:
    poses = make.drive(step=step, reverse=20.0)[0]
    found = [noise_of(_noisy(poses, position, heading, seed)) for seed in range(20)]
    assert np.mean([each.position for each in found]) == pytest.approx(position, rel=0.1)
    assert np.mean([each.heading for each in found]) == pytest.approx(heading, rel=0.1)
    assert min(each.position for each in found) > 0.6 * position
    assert max(each.position for each in found) < 1.6 * position


@pytest.mark.parametrize("step", [0.1, 0.25, 0.5, 1.0])
def test_poses_without_noise_have_none(step: float) -> None:
    path = random_path(Vehicle(), (30.0, 25.0), seed=4)
    samples = path.samples
    s = np.arange(0.0, samples.s[-1], step)
    found = noise_of(np.stack([np.interp(s, samples.s, samples.states[:, k]) for k in range(3)], axis=1))
    assert found.position < 2e-3
    assert found.heading < 2e-3


def test_noise_of_a_pose_does_not_add_up_in_the_travel() -> None:
    exact = signed_travel(TRUCK)
    assert exact[-1] == pytest.approx(20.0 - 6.0, abs=1e-3)
    off = signed_travel(_noisy(TRUCK, 0.02, 0.005)) - exact
    assert np.abs(off).max() < 5.0 * 0.02


@pytest.mark.parametrize("seed", range(20))
def test_jitter_at_standstill_is_no_change_of_gear_and_a_true_one_is_found(seed: int) -> None:
    poses = _noisy(_at_standstill(30), 0.02, 0.005, seed)
    turns, gear = turning_points(signed_travel(poses), 0.14)
    assert gear == 1
    assert len(turns) == 1
    assert 225 <= turns[0] <= 262  # the poses at standstill are 229 to 258


def test_a_change_of_gear_right_after_the_start_is_found() -> None:
    travel = np.concatenate([np.linspace(0.0, -0.3, 4), np.linspace(-0.2, 5.0, 40)])
    turns, gear = turning_points(travel, 0.12)
    assert (turns.tolist(), gear) == ([3], -1)


def test_travel_that_hardly_is_any_has_one_gear() -> None:
    assert turning_points(np.array([0.0, 0.01, -0.02, -0.03]), 0.12)[1] == -1
    assert len(turning_points(np.array([0.0, 0.01, -0.02, 0.01]), 0.12)[0]) == 0


def test_groups_rise_along_the_path_and_stops_have_their_own() -> None:
    travel = np.concatenate([np.zeros(5), np.arange(0.1, 3.0, 0.1), np.full(6, 3.0), np.arange(2.9, 1.0, -0.1)])
    label, gears = groups(travel, np.array([34]), 1, 0.4, 0.01)
    assert len(gears) == label.max()
    assert set(label[:5].tolist()) == {0}
    assert len(set(label[34:40].tolist())) == 1
    used = label[label >= 0]
    assert (np.diff(used) >= 0).all()
    assert set(np.diff(used).tolist()) == {0, 1}
    means = np.array([travel[label == k].mean() for k in range(label.max() + 1)])
    np.testing.assert_array_equal(np.sign(np.diff(means)), gears)
    assert np.abs(np.diff(means)).min() > 0.15
    assert np.abs(np.diff(means)).max() < 0.7


def test_poses_farther_apart_than_a_group_stand_for_themselves() -> None:
    label, _ = groups(np.arange(0.0, 5.0, 0.5), np.zeros(0, int), 1, 0.3, 0.01)
    assert label.tolist() == list(range(10))


def test_a_rough_chain_leaves_out_the_jitter() -> None:
    poses = _noisy(_at_standstill(40), 0.02, 0.005)
    chain = rough_chain(poses[:, :2], 0.02)
    assert chain[0] == 0
    assert chain[-1] == len(poses) - 1
    assert np.hypot(*np.diff(poses[chain[:-1], :2], axis=0).T).min() >= 12.0 * 0.02


@pytest.mark.parametrize("has_headings", [True, False])
@pytest.mark.parametrize("seed", range(3))
def test_noisy_poses_become_fewer_ones_with_less_noise_and_the_true_gears(has_headings: bool, seed: int) -> None:
    truth = _at_standstill(15)
    noisy = _noisy(truth, 0.02, 0.005, seed)
    noisy[:, 2] *= has_headings
    found = recorded_poses(noisy, 1)
    assert np.flatnonzero(np.diff(found.direction)).shape == (1,)
    assert found.direction[0] == 1
    np.testing.assert_array_equal(found.poses[[0, -1], :2], noisy[[0, -1], :2])
    off, nearest = KDTree(FINE[:, :2]).query(found.poses[1:-1, :2])
    assert np.sqrt(np.mean(off**2)) < 0.015
    turn = found.poses[1:-1, 2] - FINE[nearest, 2]
    assert np.sqrt(np.mean(turn**2)) < (0.005 if has_headings else 0.06)
    assert any("noise of" in note for note in found.notes)


def test_what_belongs_to_the_poses_is_averaged_as_they_are() -> None:
    found = recorded_poses(_noisy(TRUCK, 0.02, 0.005), 1)
    same = found.averaged(_noisy(TRUCK, 0.02, 0.005))
    np.testing.assert_allclose(same[:, :2], found.poses[:, :2], atol=1e-12)
