"""From points to drivable paths: the fit, the rounds, and what the method says of both."""

import dataclasses

import numpy as np
import pytest
from scenes import random_problem

from optim.methods.cpo.drivable import _StretchFit, drivable_stretch, fit_points, steering
from optim.methods.cpo.method import Cpo
from optim.methods.cpo.points import RecordedAxle, spread
from optim.methods.cpo.spline import basis, positions
from optim.methods.cpo.trial import limit_checks
from optim.model.flat_map import flat_from_state
from optim.model.kinematics import rk4_step_jacobian
from optim.model.objective import objective
from optim.model.path import Path
from optim.model.problem import path_clearance
from optim.model.result import Stop
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle, body_corners
from optim.steering.flat import load

NOTHING = np.empty((0, 2))


def test_steering_agrees_with_the_local_planners_formulas():
    vehicle = Vehicle()
    for kappa, sigma, curl in np.random.default_rng(0).normal(0.0, 0.1, (20, 3)):
        tangent, rate = steering(vehicle, kappa, sigma, curl)
        l, l_t, _ = vehicle.kinematics
        assert abs(tangent) == pytest.approx(load(kappa, sigma, curl, (l, l_t, 1e9, 1.0, 1e9, 0.0)), rel=1e-9)
        assert abs(rate) == pytest.approx(load(kappa, sigma, curl, (l, l_t, 1e9, 1e9, 1.0, 0.0)), rel=1e-9)


@pytest.mark.parametrize("limit", [np.inf, 0.01])
def test_the_fits_jacobian_is_the_derivative_of_its_misfit(limit):
    rng = np.random.default_rng(1)
    bases = basis(10)
    c, length = rng.normal(0.0, 0.08, 13), 6.0
    start, end = np.array([1.0, 2.0, 0.3, c[0], 0.0]), np.array([5.0, 3.0, 0.5, c[-1], 0.0])
    vehicle = Vehicle(max_hitch=0.4, max_steer=0.3, max_steer_rate=0.1)
    fit = _StretchFit(vehicle, bases, rng.normal(0.0, 1.0, (len(bases.ends), 2)), start, end)
    rows, closing = fit.jacobian(c, length, limit)
    for k in range(len(c) + 1):
        step = np.zeros(len(c) + 1)
        step[k] = 1e-6
        ahead, behind = (fit.misfit(c + sign * step[:-1], length + sign * step[-1], limit) for sign in (1.0, -1.0))
        np.testing.assert_allclose(closing[:, k], (ahead[1] - behind[1]) / 2e-6, atol=1e-6)
        if k < len(c):  # the misfit's scale by the length is left out, as it changes no balance
            expected = (ahead[0] - behind[0]) / 2e-6
            np.testing.assert_allclose(rows[:, k], expected, atol=1e-6 * max(1.0, np.abs(expected).max()))


@pytest.mark.parametrize("seed", range(4))
def test_a_fitted_stretch_follows_the_kinematics_keeps_the_limits_and_meets_both_ends(seed):
    problem = random_problem(seed)
    vehicle = problem.vehicle
    for segment in problem.recorded.segments:
        axle = RecordedAxle.of(vehicle, segment)
        row = spread(axle, axle.flat[:, :2], axle.share, 0.5, NOTHING)
        stretch = drivable_stretch(vehicle, segment.direction, row.on_path, axle.flat[0], axle.flat[-1], 0.05)
        assert stretch is not None
        assert stretch.gap < 1e-9
        assert stretch.deviation < 0.1
        fitted = stretch.segment
        assert np.diff(fitted.s).max() <= 0.05
        ds, gear = np.diff(fitted.s), np.full(fitted.num_samples - 1, segment.direction)
        reached, _ = rk4_step_jacobian(vehicle, fitted.states[:-1], fitted.phi[:-1], fitted.phi[1:], ds, gear)
        assert np.abs(reached - fitted.states[1:]).max() < 1e-7
        np.testing.assert_allclose(fitted.states[[0, -1]], segment.states[[0, -1]], atol=1e-9)
        assert all(check.is_kept for check in limit_checks(problem, fitted)[:3])


def test_points_that_ask_for_more_than_the_steering_gives_are_approached_not_followed():
    vehicle = Vehicle()
    x = np.linspace(-20.0, 20.0, 81)
    points = np.stack([x, 1.5 * np.tanh(x / 1.5)], axis=1)
    start, end = (np.array([*point, 0.0, 0.0, 0.0]) for point in points[[0, -1]])
    c, length, deviation = fit_points(vehicle, points, start, end)
    bases = basis(len(c) - 3)
    turn = length * (bases.turn_nodes @ c)
    assert deviation > 0.1
    np.testing.assert_allclose(positions(start, turn, length)[-1], end[:2], atol=1e-9)
    tangent, rate = steering(vehicle, bases.ends @ c, bases.slope @ c / length, bases.curl @ c / length**2)
    assert np.arctan(np.abs(tangent)).max() <= vehicle.max_steer
    assert np.abs(rate).max() <= vehicle.max_steer_rate


def test_where_no_curve_keeps_the_limits_there_is_no_stretch():
    angle = np.linspace(0.0, np.pi, 60)
    points = np.stack([10.0 * np.sin(angle), 10.0 - 10.0 * np.cos(angle)], axis=1)
    start, end = np.zeros(5), np.array([0.0, 20.0, np.pi, 0.0, 0.0])
    stretch = drivable_stretch(Vehicle(max_steer=0.1), 1, points, start, end, 0.05)
    assert stretch is None or stretch.gap > 1e-3


@pytest.mark.parametrize("seed", [11, 12, 13])
def test_gear_changes_keep_pose_hitch_angle_and_curvature_from_both_sides(seed):
    problem = random_problem(seed)
    result = Cpo().solve(problem)
    assert "improved" in result.reason
    recorded, improved = problem.recorded.segments, result.path.segments
    assert len(recorded) == len(improved)
    for before, after in zip(recorded, improved, strict=True):
        np.testing.assert_array_equal(before.states[[0, -1]], after.states[[0, -1]])
        ends = [flat_from_state(problem.vehicle, one.states[[0, -1]], one.phi[[0, -1]]) for one in (before, after)]
        np.testing.assert_allclose(ends[0][:, 3], ends[1][:, 3], atol=1e-9)


def test_a_result_says_how_far_the_path_is_from_the_points_and_shows_them():
    problem = random_problem(11)
    result = Cpo().solve(problem)
    assert "m of the points" in result.reason
    picture = result.picture
    assert picture is not None
    assert picture.points.shape == (len(picture.anchored), 2)
    assert picture.anchored.any()
    assert not picture.anchored.all()
    trailer = flat_from_state(problem.vehicle, result.path.samples.states, result.path.samples.phi)[:, :2]
    apart = np.linalg.norm(picture.points[:, None] - trailer[None], axis=2).min(axis=1)
    assert apart.max() < 0.2
    assert picture.cost_map.min() == 0.0
    assert picture.cost_map.max() == 1000.0
    low = np.array(picture.origin)
    high = low + picture.resolution * (np.array(picture.cost_map.shape[::-1]) - 1)
    assert (trailer > low).all()
    assert (trailer < high).all()


def test_points_that_collide_are_anchored_round_by_round_until_the_path_is_clear():
    problem = dataclasses.replace(random_problem(21, num_blocks=40), margin=5.0)  # as near as recorded, no nearer
    iterates: list = []
    result = Cpo(d_max=1e-3, weight_obstacle=0.0).solve(problem, iterates.append)
    turned_down = [iterate for iterate in iterates if not iterate.accepted and iterate.violation > 0.0]
    assert turned_down
    assert max(one.residuals["clearance"] for one in turned_down) > 1.0
    assert path_clearance(problem.vehicle, problem.scene, result.path) >= problem.required_clearance - 1e-9


def test_a_segment_that_stays_as_recorded_is_named_with_the_check_and_by_how_much_it_fails():
    problem = dataclasses.replace(random_problem(21, num_blocks=40), margin=5.0)
    result = Cpo(weight_obstacle=0.0, rounds=1).solve(problem)
    assert result.stop is Stop.STALLED
    assert "stays as recorded: clearance" in result.reason
    assert "after round 1" in result.reason
    kept = [new is old for new, old in zip(result.path.segments, problem.recorded.segments, strict=True)]
    assert any(kept)


def test_a_stretch_that_collides_as_recorded_is_led_round_the_obstacle():
    problem = random_problem(2, num_blocks=0, lengths=(25.0,))
    (segment,) = problem.recorded.segments
    corners = body_corners(problem.vehicle, segment.states)[segment.num_samples // 2, 1]
    across, along = corners[2] - corners[1], corners[1] - corners[0]
    across, along = across / np.linalg.norm(across), along / np.linalg.norm(along)
    inner = (corners[2] + corners[3]) / 2.0 - 0.08 * across
    block = [inner - 0.5 * along, inner + 0.5 * along, inner + 0.5 * along + across, inner - 0.5 * along + across]
    problem = dataclasses.replace(problem, scene=make_scene([block]))
    assert problem.recorded_clearance < 0.0
    method = Cpo()
    trial = method.improve_segment(problem, method.terms(problem, method.spacing), segment, lambda _: None)
    assert trial.is_sound
    assert trial.stretch is not None
    assert path_clearance(problem.vehicle, problem.scene, Path((trial.stretch.segment,))) >= 0.1


@pytest.mark.parametrize("options", [{"obstacles": "points"}, {"minimiser": "lbfgs"}, {"spacing": 1.0}])
def test_the_variants_end_in_sound_paths_too(options):
    problem = random_problem(31)
    result = Cpo(**options).solve(problem)
    assert objective(result.path, problem.weights) < objective(problem.recorded, problem.weights)
    assert path_clearance(problem.vehicle, problem.scene, result.path) >= problem.required_clearance - 1e-9
    for segment in result.path.segments:
        assert all(check.residual <= 1.001 for check in limit_checks(problem, segment))


def test_the_method_begins_where_an_earlier_one_ended():
    problem = random_problem(11)
    first = Cpo(weight_change=5000.0).solve(problem).path
    again = dataclasses.replace(problem, start=first)
    iterates: list = []
    result = Cpo().solve(again, iterates.append)
    assert iterates[0].path is first
    assert objective(result.path, problem.weights) <= objective(first, problem.weights)


@pytest.mark.parametrize(
    ("option", "value"),
    [("obstacles", "cells"), ("minimiser", "cg"), ("rounds", 0), ("d_max", 0.0), ("weight_smoothness", 0.0),
     ("weight_change", -1.0), ("sample_spacing", 0.2), ("tolerance", 1.0), ("spacing", np.nan)],
)  # fmt: skip
def test_options_that_make_no_sense_are_refused_by_name(option, value):
    with pytest.raises(ValueError, match=f"cpo: {option} is .*, expected"):
        Cpo(**{option: value})
