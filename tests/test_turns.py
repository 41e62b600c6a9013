"""Continuous-sharpness turns: ramps at the limits, exact ends, all directions."""

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optim.model.flat_map import flat_from_state, state_from_flat
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import frozen
from optim.steering.flat import Flat, curve_limits, effort, load, ramp_load, shortest_ramp
from optim.steering.pieces import pieces_of, sample_turns
from optim.steering.sharpest import ROWS, peak_curvature, ramp_end, sharpest_turns, turn_end
from optim.steering.turns import plan_turns

VEHICLES = {
    "european semi": Vehicle(),
    "long trailer": Vehicle(wheelbase=3.6, hitch_to_axle=12.036, trailer_rear=14.6),
    "yard tractor": Vehicle(wheelbase=3.0, hitch_to_axle=5.0),
}
DEFAULT = VEHICLES["european semi"]


def random_ends(vehicle: Vehicle, rng: np.random.Generator, sharpness: float = 0.0):
    """(k0, s0) and (x, y, theta, k1, s1) with curvature within 60 % of the limit."""
    top = 0.6 * vehicle.max_kappa
    s0, s1 = sharpness * rng.uniform(-1, 1, 2)
    start = frozen((rng.uniform(-top, top), s0))
    goal = frozen((*rng.uniform(-40, 40, 2), rng.uniform(-math.pi, math.pi), rng.uniform(-top, top), s1))
    return start, goal


def largest_load(vehicle: Vehicle, flat: np.ndarray, length: float) -> float:
    """Largest of |alpha|, |phi| and |dphi/ds| by its limit, from the samples' own states and steering."""
    states, phi = state_from_flat(vehicle, flat)
    rate = np.abs(np.diff(phi)) / (length / (len(flat) - 1))
    relative = [
        np.abs(phi).max() / vehicle.max_steer,
        np.abs(states[:, 3]).max() / vehicle.max_hitch,
        rate.max() / vehicle.max_steer_rate,
    ]
    return max(relative)


@pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES.keys())
@pytest.mark.parametrize("sharpness", [0.0, 0.004])
def test_turns_end_exactly_at_the_goal(vehicle, sharpness):
    rng = np.random.default_rng(1)
    connected = 0
    for _ in range(700):
        start, goal = random_ends(vehicle, rng, sharpness)
        rows = plan_turns(start, goal, curve_limits(vehicle), math.inf)
        connected += len(rows) > 0
        for row in rows:
            _, flat = sample_turns(row, start, goal, 5.0, curve_limits(vehicle))
            error = flat[-1] - [
                *goal[:2],
                goal[2] + 2 * math.pi * round((flat[-1, 2] - goal[2]) / 2 / math.pi),
                *goal[3:],
            ]
            assert np.abs(error).max() < 1e-9
            assert np.abs(flat[0] - [0, 0, 0, *start]).max() < 1e-12
    assert connected > 0.95 * 700


@pytest.mark.parametrize("vehicle", VEHICLES.values(), ids=VEHICLES.keys())
@pytest.mark.parametrize("sharpness", [0.0, 0.004])
def test_turns_keep_every_limit_between_all_samples(vehicle, sharpness):
    rng = np.random.default_rng(2)
    for _ in range(60):
        start, goal = random_ends(vehicle, rng, sharpness)
        for row in plan_turns(start, goal, curve_limits(vehicle), math.inf):
            length, flat = sample_turns(row, start, goal, 0.05, curve_limits(vehicle))
            assert largest_load(vehicle, flat, length) < 1.0 + 1e-4


def test_turns_are_about_as_sharp_as_the_limits_allow():
    rng = np.random.default_rng(3)
    loads = []
    for _ in range(60):
        start, goal = random_ends(DEFAULT, rng)
        for row in plan_turns(start, goal, curve_limits(DEFAULT), math.inf)[:1]:
            length, flat = sample_turns(row, start, goal, 0.05, curve_limits(DEFAULT))
            loads.append(largest_load(DEFAULT, flat, length))
    assert np.median(loads) > 0.97


def test_curvature_and_sharpness_are_continuous_across_all_joints():
    rng = np.random.default_rng(4)
    for _ in range(200):
        start, goal = random_ends(DEFAULT, rng, sharpness=0.004)
        for row in plan_turns(start, goal, curve_limits(DEFAULT), math.inf):
            pieces = pieces_of(row, start, goal)
            length, c0, c1, c2, c3 = pieces.T
            kappa = c0 + length * (c1 + length * (c2 + length * c3))
            sigma = c1 + length * (2 * c2 + 3 * length * c3)
            assert np.abs(kappa[:-1] - c0[1:]).max() < 1e-12
            assert np.abs(sigma[:-1] - c1[1:]).max() < 1e-12
            assert (length >= 0.0).all()
            assert length.sum() == pytest.approx(row[0], abs=1e-9)


def test_samples_are_the_integral_of_their_own_curvature():
    rng = np.random.default_rng(5)
    start, goal = random_ends(DEFAULT, rng)
    row = plan_turns(start, goal, curve_limits(DEFAULT), math.inf)[0]
    length, flat = sample_turns(row, start, goal, 0.01, curve_limits(DEFAULT))
    u = np.sqrt(1.0 + (DEFAULT.hitch_to_axle * flat[:, 3]) ** 2)
    ds = length / (len(flat) - 1)

    def integral(values):  # by the truck's arc length: the trailer's is shorter by u
        values = values / u
        return np.concatenate([[0.0], np.cumsum(0.5 * ds * (values[1:] + values[:-1]))])

    assert np.abs(integral(flat[:, 3]) - flat[:, 2]).max() < 1e-5
    assert np.abs(integral(np.cos(flat[:, 2])) - flat[:, 0]).max() < 1e-4
    assert np.abs(integral(np.sin(flat[:, 2])) - flat[:, 1]).max() < 1e-4
    assert integral(np.ones(len(flat)))[-1] == pytest.approx(row[0], abs=1e-4)


@pytest.mark.parametrize(
    ("goal", "signs"),
    [((40, 20, 2.0), (1, 1)), ((40, -20, -2.0), (-1, -1)), ((40, 15, 0.0), (1, -1)), ((40, -15, 0.0), (-1, 1))],
)
def test_the_shortest_turns_take_the_directions_that_the_goal_asks_for(goal, signs):
    goal = frozen((*goal, 0.0, 0.0))
    start = frozen((0.0, 0.0))
    first, last = plan_turns(start, goal, curve_limits(DEFAULT), math.inf)[0, 8:]
    assert (np.sign(first), np.sign(-last)) == signs


def test_all_four_pairs_of_turn_directions_are_found_where_there_is_room():
    start, goal = frozen((0.0, 0.0)), frozen((80.0, 0.0, 0.0, 0.0, 0.0))
    found = set()
    for x in (60.0, 80.0):
        for y in (-30.0, 0.0, 30.0):
            goal = frozen((x, y, 0.0, 0.0, 0.0))
            rows = plan_turns(start, goal, curve_limits(DEFAULT), math.inf)
            found |= {(np.sign(row[8]), np.sign(-row[9])) for row in rows}
    assert {(1, 1), (-1, -1), (1, -1), (-1, 1)} <= found


def test_a_straight_goal_is_reached_straight():
    rows = plan_turns(frozen((0.0, 0.0)), frozen((20.0, 0.0, 0.0, 0.0, 0.0)), curve_limits(DEFAULT), math.inf)
    assert rows[0, 0] == pytest.approx(20.0)


def test_nothing_longer_than_asked_for_is_returned():
    rng = np.random.default_rng(6)
    for _ in range(200):
        start, goal = random_ends(DEFAULT, rng)
        lengths = plan_turns(start, goal, curve_limits(DEFAULT), math.inf)[:, 0]
        bound = 1.2 * math.hypot(goal[0], goal[1])
        bounded = plan_turns(start, goal, curve_limits(DEFAULT), bound)[:, 0]
        assert (bounded <= bound).all()
        assert lengths.size == 0 or lengths.min() > 0.999 * bound or bounded.size > 0


@given(
    k0=st.floats(-0.1, 0.1),
    s0=st.floats(-0.005, 0.005),
    kp=st.floats(-0.19, 0.19),
    lengths=st.tuples(st.floats(1, 15), st.floats(0, 10), st.floats(1, 15)),
)
@settings(max_examples=100, deadline=None)
def test_peak_curvature_inverts_the_deflection(k0, s0, kp, lengths):
    l1, hold, l2 = lengths
    s = np.linspace(0.0, l1, 20001)
    u = s / l1
    ramp = k0 * (1 - 3 * u**2 + 2 * u**3) + s0 * l1 * (u - 2 * u**2 + u**3) + kp * (3 * u**2 - 2 * u**3)
    deflection = np.sum((ramp[1:] + ramp[:-1]) / 2) * (s[1] - s[0]) + hold * kp + l2 * kp / 2
    assert peak_curvature(deflection, k0, s0, l1, hold, l2) == pytest.approx(kp, abs=1e-7)


@given(k0=st.floats(-0.19, 0.19), kp=st.floats(-0.19, 0.19), length=st.floats(0.5, 25), heading=st.floats(-3, 3))
@settings(max_examples=100, deadline=None)
def test_the_end_of_a_ramp_is_integrated_to_rounding(k0, kp, length, heading):
    s = np.linspace(0.0, length, 4001)
    u = s / length
    angle = heading + length * (k0 * u + (kp - k0) * (u**3 - u**4 / 2))
    weights = np.full(4001, 2.0)
    weights[1::2] = 4.0
    weights[[0, -1]] = 1.0
    exact = (weights * np.cos(angle)).sum() * s[1] / 3, (weights * np.sin(angle)).sum() * s[1] / 3
    assert ramp_end(heading, k0, 0.0, kp, length, 1.0) == pytest.approx(exact, abs=1e-10)
    assert ramp_end(heading, k0, 0.0, kp, length, 0.0) == pytest.approx(exact, abs=0.05)


def test_a_turn_that_only_holds_is_an_arc():
    x, y = turn_end(1.0, 0.1, 0.0, 1e-9, 10.0, 1e-9, 1.0)
    assert (x, y) == pytest.approx((10 * math.sin(1.0), 10 * (1 - math.cos(1.0))), abs=1e-6)


@given(kappa=st.floats(-0.19, 0.19), sigma=st.floats(-0.02, 0.02), curl=st.floats(-0.01, 0.01))
@settings(max_examples=200, deadline=None)
def test_the_load_has_the_steering_and_the_rate_of_the_flat_map(kappa, sigma, curl):
    h = 1e-5
    ds = np.array([-h, 0.0, h])
    flat = np.stack([ds * 0, ds * 0, ds * 0, kappa + sigma * ds + curl * ds**2 / 2, sigma + curl * ds], axis=1)
    _, phi = state_from_flat(DEFAULT, flat)
    rate = (phi[2] - phi[0]) / (2 * h) / math.hypot(1.0, DEFAULT.hitch_to_axle * kappa)
    expected = max(
        abs(kappa) / DEFAULT.max_kappa,
        abs(math.tan(phi[1])) / math.tan(DEFAULT.max_steer),
        abs(rate) / DEFAULT.max_steer_rate,
    )
    assert load(kappa, sigma, curl, curve_limits(DEFAULT)) == pytest.approx(expected, rel=1e-5, abs=1e-7)


def test_the_load_of_a_curve_described_backwards_is_that_with_the_trailer_ahead():
    l, l_t, *rest = curve_limits(DEFAULT)
    forwards = load(0.1, 0.004, 0.002, (l, l_t, *rest))
    assert load(-0.1, 0.004, -0.002, (l, -l_t, *rest)) == pytest.approx(forwards, rel=1e-12)


@pytest.mark.parametrize("sign", [1.0, -1.0])
@pytest.mark.parametrize(("k0", "s0", "k1"), [(0.0, 0.0, 0.15), (0.15, 0.0, 0.0), (0.1, 0.0, -0.1), (0.05, 0.004, 0.1)])
def test_the_shortest_ramp_is_within_the_limits_and_a_shorter_one_is_not(sign, k0, s0, k1):
    lim = curve_limits(DEFAULT)
    length = shortest_ramp(sign * k0, sign * s0, sign * k1, 1.001, lim)
    assert ramp_load(sign * k0, sign * s0, sign * k1, length, 200.0, math.inf, lim) < 1.0 + 1e-3
    assert ramp_load(sign * k0, sign * s0, sign * k1, 0.99 * length, 200.0, math.inf, lim) > 1.0


def test_a_curvature_beyond_the_limit_has_no_ramp():
    assert shortest_ramp(0.0, 0.0, 1.01 * DEFAULT.max_kappa, 1.1, curve_limits(DEFAULT)) == math.inf


def test_a_load_that_is_no_number_is_not_within_the_limits():
    assert not ramp_load(0.0, 0.0, math.nan, 5.0, 12.0, math.inf, curve_limits(DEFAULT)) < math.inf


def test_the_effort_of_few_samples_is_close_to_that_of_many_and_not_above_it():
    rng = np.random.default_rng(7)
    lim = curve_limits(DEFAULT)
    for _ in range(20):
        start, goal = random_ends(DEFAULT, rng)
        for row in plan_turns(start, goal, lim, math.inf)[:1]:
            length, flat = sample_turns(row, start, goal, 0.05, lim)
            _, phi = state_from_flat(DEFAULT, flat)
            ds = length / (len(flat) - 1)
            steer = np.sum((phi[1:] ** 2 + phi[1:] * phi[:-1] + phi[:-1] ** 2) / 3) * ds
            rate = np.sum(np.diff(phi) ** 2) / ds
            assert effort(flat, length, lim) == pytest.approx((steer, rate), rel=1e-9)
            coarse_steer, coarse_rate = effort(sample_turns(row, start, goal, 1.0, lim)[1], length, lim)
            assert coarse_steer == pytest.approx(steer, rel=0.05)
            # linear between samples: the least that any curve through them has
            assert 0.7 * rate < coarse_rate <= rate


def test_the_flat_state_is_that_of_the_vehicle():
    state, phi = np.array([1.0, 2.0, 0.3, -0.4]), 0.2
    flat = Flat(*flat_from_state(DEFAULT, state, np.array(phi)).tolist())
    assert flat.x == pytest.approx(1.0 - 8.0 * math.cos(-0.1))
    assert flat.theta == pytest.approx(-0.1)


def test_a_hitch_that_is_not_over_the_axle_is_refused():
    with pytest.raises(ValueError, match="hitch_offset"):
        curve_limits(Vehicle(hitch_offset=0.5))


def test_a_curvature_that_no_ramp_can_take_on_that_side_has_no_turns_there() -> None:
    """The curvature at the goal is 1 % below the limit, and its sharpness leads beyond it: no ramp is short enough.

    The tables once began at minus infinity then, and were read far outside.
    """
    start = frozen((0.00018040314495609835, 0.0))
    goal = frozen(
        (13.424578873623112, -4.140585429093845, -1.1459728282601378, -0.1926573926027884, 0.007296496291732908)
    )
    lim = (3.6, 8.0, 0.1946759655818628, 0.6131052132881357, 0.5, 0.19428661365069905)
    table = np.empty((4 * ROWS, 4))
    sided = (lim[0], -lim[1], *lim[2:])
    sharpest_turns(-goal[3], goal[4], 0, sided, 14.793067762069319, table)
    assert (table[: 2 * ROWS, 0] > -10.0).all()
    for row in plan_turns(start, goal, lim, 14.793067762069319):
        assert 0.0 < row[0] <= 14.793067762069319
