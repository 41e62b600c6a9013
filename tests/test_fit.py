import numpy as np
import pytest
from paths import logged, random_path

from optim.fit.poses import FitOptions, fit_path
from optim.model.kinematics import roll_out
from optim.model.vehicle import Vehicle

VEHICLE = Vehicle()


def _largest_defect(path) -> float:
    worst = 0.0
    for segment in path.segments:
        for k in range(segment.num_samples - 1):
            span, phi = segment.s[k : k + 2], segment.phi[k : k + 2]
            end = roll_out(VEHICLE, segment.states[k], span, phi, segment.direction, max_step=0.01)[-1]
            worst = max(worst, np.abs(end - segment.states[k + 1]).max())
    return worst


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("has_trailer", [True, False])
def test_exact_poses_give_the_path_back(seed, has_trailer):
    truth = random_path(VEHICLE, (18, 12, 9), seed=seed)
    states, gears = logged(truth, 5)
    fit = fit_path(VEHICLE, states[:, :3], gears, states[:, 3] if has_trailer else None, states[0, 3])
    assert fit.converged
    assert fit.position_error.max() < 1e-3
    assert fit.heading_error.max() < 2e-3
    assert _largest_defect(fit.path) < 1e-6
    assert fit.path.num_cusps == 2
    np.testing.assert_allclose(fit.path.goal, truth.goal, atol=3e-3)
    assert np.diff(fit.path.samples.s).max() <= 0.1 + 1e-6


@pytest.mark.parametrize("seed", range(3))
def test_noisy_poses_give_a_drivable_path_near_them_whose_ends_are_the_logs(seed):
    truth = random_path(VEHICLE, (20, 15), seed=seed)
    states, gears = logged(truth, 10)
    rng = np.random.default_rng(seed)
    noisy = states[:, :3] + rng.normal(0, 1, (len(states), 3)) * [0.02, 0.02, 0.004]
    fit = fit_path(VEHICLE, noisy, gears, None, states[0, 3])
    assert fit.converged
    assert _largest_defect(fit.path) < 1e-6
    assert max(np.diff(segment.s).max() for segment in fit.path.segments) <= 0.1 + 1e-9
    np.testing.assert_allclose(fit.path.start[:3], noisy[0], atol=1e-9)
    np.testing.assert_allclose(fit.path.goal[:3], noisy[-1], atol=1e-9)
    assert np.sqrt(np.mean(fit.position_error**2)) < 0.05
    assert fit.position_error.max() > 0.005  # it smooths, it does not follow the noise


def test_the_hitch_angle_is_integrated_from_the_given_one_where_the_log_has_none():
    truth = random_path(VEHICLE, (10,), seed=8)
    states, gears = logged(truth, 4)
    fit = fit_path(VEHICLE, states[:, :3], gears, None, 0.25)
    assert fit.path.start[3] == pytest.approx(0.25, abs=1e-9)
    assert len(fit.hitch_error) == 0


def test_arc_lengths_of_the_poses_point_at_the_poses():
    truth = random_path(VEHICLE, (8, 6), seed=9)
    states, gears = logged(truth, 7)
    fit = fit_path(VEHICLE, states[:, :3], gears, states[:, 3])
    samples = fit.path.samples
    for s, pose in zip(fit.pose_s, states, strict=True):
        at = int(np.argmin(np.abs(samples.s - s)))
        assert samples.s[at] == pytest.approx(s, abs=1e-9)
        np.testing.assert_allclose(samples.states[at, :2], pose[:2], atol=2e-3)


def test_poses_that_no_truck_can_drive_show_as_deviation():
    x = np.arange(0.0, 10.0, 0.5)
    y = np.where(x > 5.0, 0.6, 0.0)  # a sideways jump
    poses = np.column_stack([x, y, np.zeros_like(x)])
    fit = fit_path(VEHICLE, poses, np.ones(len(x) - 1, int), options=FitOptions())
    assert fit.position_error.max() > 0.1


@pytest.mark.parametrize("seed", range(12))
def test_a_fit_that_leads_nowhere_is_not_much_longer_than_the_way_from_pose_to_pose(seed):
    rng = np.random.default_rng(seed)
    poses = np.column_stack([np.cumsum(rng.uniform(-1.0, 1.0, (8, 2)), axis=0), np.zeros(8)])
    fit = fit_path(VEHICLE, poses, rng.choice([-1, 1], 7), None, 1.2)
    assert fit.path.length <= 10.0 * np.hypot(*np.diff(poses[:, :2], axis=0).T).sum() * (1.0 + 1e-9)


def test_too_few_poses_are_refused():
    with pytest.raises(ValueError, match="1 poses"):
        fit_path(VEHICLE, np.zeros((1, 3)), np.zeros(0, int))
