"""Bézier curves of order seven: ends, derivatives, limits."""

import math

import numpy as np
import pytest
from test_turns import DEFAULT, VEHICLES, largest_load, random_ends

from optim.numerics.arrays import frozen
from optim.steering.bezier import bends_at, coefficients, derivatives, plan_bezier, sample_bezier
from optim.steering.flat import curve_limits

START = frozen((0.06, 0.003))
GOAL = frozen((25.0, 9.0, 0.7, -0.04, 0.002))


def curve(start=START, goal=GOAL, a0=20.0, a1=26.0) -> np.ndarray:
    c = np.empty((8, 2))
    coefficients(start, goal, a0, a1, c)
    return c


def near_ends(vehicle, rng):
    """Ends ahead of each other: where a Bézier curve is the natural connection."""
    start, goal = random_ends(vehicle, rng, 0.003)
    distance, bearing = rng.uniform(8, 45), rng.uniform(-0.6, 0.6)
    x, y = distance * math.cos(bearing), distance * math.sin(bearing)
    return start, frozen((x, y, 2 * bearing + rng.uniform(-0.4, 0.4), goal[3], goal[4]))


def test_the_curve_matches_position_heading_curvature_and_sharpness_at_both_ends():
    c = curve()
    for t, expected in ((0.0, (0.0, 0.0, 0.0, *START)), (1.0, GOAL)):
        x, y, x1, y1, kappa, sigma, _ = bends_at(c, t)
        assert (x, y, math.atan2(y1, x1), kappa, sigma) == pytest.approx(tuple(expected), abs=1e-10)


def test_tangent_lengths_are_the_speeds_at_the_ends():
    c = curve(a0=20.0, a1=26.0)
    assert [math.hypot(*bends_at(c, t)[2:4]) for t in (0.0, 1.0)] == pytest.approx([20.0, 26.0])


@pytest.mark.parametrize("t", [0.1, 0.45, 0.9])
@pytest.mark.parametrize("order", [1, 2, 3, 4])
def test_derivatives_agree_with_finite_differences(t, order):
    c, h = curve(), 1e-4
    for i in (0, 1):
        slope = (derivatives(c, i, t + h)[order - 1] - derivatives(c, i, t - h)[order - 1]) / (2 * h)
        assert derivatives(c, i, t)[order] == pytest.approx(slope, rel=1e-5, abs=1e-3)


@pytest.mark.parametrize("t", [0.1, 0.45, 0.9])
def test_curvature_sharpness_and_its_slope_agree_with_finite_differences(t):
    c, h = curve(), 1e-5
    before, at, after = (bends_at(c, t + d) for d in (-h, 0.0, h))
    ds = math.hypot(after[0] - before[0], after[1] - before[1])
    turned = math.atan2(after[3], after[2]) - math.atan2(before[3], before[2])
    assert at[4] == pytest.approx(turned / ds, abs=1e-7)
    assert at[5] == pytest.approx((after[4] - before[4]) / ds, abs=1e-7)
    assert at[6] == pytest.approx((after[5] - before[5]) / ds, abs=1e-7)


@pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES.keys())
def test_found_curves_end_at_the_goal_and_keep_every_limit(vehicle):
    rng = np.random.default_rng(1)
    lim, found = curve_limits(vehicle), 0
    for _ in range(300):
        start, goal = near_ends(vehicle, rng)
        length, a0, a1 = plan_bezier(start, goal, lim, math.inf)
        if length == math.inf:
            continue
        found += 1
        truck, flat = sample_bezier(start, goal, a0, a1, 0.05, lim)
        whole = 2 * math.pi * round((flat[-1, 2] - goal[2]) / (2 * math.pi))
        assert np.abs(flat[-1] - [*goal[:2], goal[2] + whole, *goal[3:]]).max() < 1e-9
        assert np.abs(flat[0] - [0.0, 0.0, 0.0, *start]).max() < 1e-9
        assert largest_load(vehicle, flat, truck) < 1.0 + 1e-4
        chords = np.hypot(*np.diff(flat[:, :2], axis=0).T)
        assert chords.sum() == pytest.approx(length, rel=1e-5)
    assert found > 60


def test_samples_are_equally_spaced_along_the_truck_and_turn_with_its_curvature():
    lim = curve_limits(DEFAULT)
    truck, flat = sample_bezier(START, GOAL, 20.0, 26.0, 0.01, lim)
    stretch = np.sqrt(1.0 + (DEFAULT.hitch_to_axle * flat[:, 3]) ** 2)
    ds = truck / (len(flat) - 1)
    assert ds <= 0.01
    chords = np.hypot(*np.diff(flat[:, :2], axis=0).T)
    assert chords * (stretch[1:] + stretch[:-1]) / 2 == pytest.approx(np.full(len(chords), ds), rel=1e-5)
    assert np.diff(flat[:, 2]) / chords == pytest.approx((flat[1:, 3] + flat[:-1, 3]) / 2, abs=1e-5)


def test_a_straight_goal_is_reached_straight_and_forwards():
    ends, lim = (frozen((0.0, 0.0)), frozen((20.0, 0.0, 0.0, 0.0, 0.0))), curve_limits(DEFAULT)
    length, a0, a1 = plan_bezier(*ends, lim, math.inf)
    assert length == pytest.approx(20.0, rel=1e-6)
    _, flat = sample_bezier(*ends, a0, a1, 0.05, lim)
    assert (np.diff(flat[:, 0]) > 0.0).all()


def test_no_curve_turns_back_on_itself():
    length, *_ = plan_bezier(frozen((0.0, 0.0)), frozen((-20.0, 0.0, 0.0, 0.0, 0.0)), curve_limits(DEFAULT), math.inf)
    assert length == math.inf


def test_nothing_longer_than_asked_for_is_returned():
    rng = np.random.default_rng(2)
    for _ in range(100):
        start, goal = near_ends(DEFAULT, rng)
        bound = 1.05 * math.hypot(goal[0], goal[1])
        length, *_ = plan_bezier(start, goal, curve_limits(DEFAULT), bound)
        assert length <= bound or length == math.inf
