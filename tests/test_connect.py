"""Connections: exact states at both ends, kinematics between samples, reverse, invariance."""

import math

import numpy as np
import pytest

from optim.model.flat_map import flat_from_state, state_from_flat
from optim.model.kinematics import derivative
from optim.model.path import Segment
from optim.model.vehicle import Vehicle
from optim.steering.connect import END_TOLERANCE, Connection, connections
from optim.steering.flat import Flat

VEHICLE = Vehicle()


def random_flat(rng: np.random.Generator, sharpness: float = 0.0, reach: float = 30.0) -> Flat:
    top = 0.6 * VEHICLE.max_kappa
    x, y = rng.uniform(-reach, reach, 2)
    return Flat(x, y, rng.uniform(-math.pi, math.pi), rng.uniform(-top, top), sharpness * rng.uniform(-1, 1))


def random_connections(seed: int, count: int, sharpness: float = 0.0) -> list[Connection]:
    rng = np.random.default_rng(seed)
    found = []
    for k in range(count):
        start, end = random_flat(rng, sharpness), random_flat(rng, sharpness)
        found += connections(VEHICLE, start, end, 1 if k % 2 else -1)
    # both kinds: a Bézier curve is rarely possible between random states
    for k in range(count):
        start = random_flat(rng, sharpness)
        distance, bearing = rng.uniform(15, 40), rng.uniform(-0.3, 0.3)
        x = start.x + distance * math.cos(start.theta + bearing)
        y = start.y + distance * math.sin(start.theta + bearing)
        end = Flat(x, y, start.theta + 2 * bearing, start.kappa / 2, start.sigma / 2)
        found += connections(VEHICLE, start, end, 1) if k % 2 else connections(VEHICLE, end, start, -1)
    assert {connection.kind for connection in found} == {"turns", "bezier"}
    return found


def defects(segment) -> np.ndarray:
    """What each interval misses its stored end by when integrated from its start, phi linear. Shape (n - 1, 4)."""
    q, steps = segment.states[:-1].copy(), 5
    h = np.diff(segment.s) / steps

    def slope(q, share):
        phi = segment.phi[:-1] + share * np.diff(segment.phi)
        return derivative(VEHICLE, q, phi, segment.direction)

    for i in range(steps):
        a = slope(q, i / steps)
        b = slope(q + a * h[:, None] / 2, (i + 0.5) / steps)
        c = slope(q + b * h[:, None] / 2, (i + 0.5) / steps)
        d = slope(q + c * h[:, None], (i + 1) / steps)
        q = q + (a + 2 * b + 2 * c + d) * h[:, None] / 6
    return q - segment.states[1:]


@pytest.mark.parametrize("sharpness", [0.0, 0.004])
def test_re_integrated_intervals_end_where_the_next_one_begins(sharpness):
    for connection in random_connections(1, 40, sharpness):
        segment = connection.segment(0.05)
        missed = np.abs(defects(segment))
        position, angle = np.hypot(missed[:, 0], missed[:, 1]), missed[:, 2:].max(axis=1)
        assert position.max() <= 1e-4
        assert angle.max() <= 1e-4
        share = 60.0 / max(segment.length, 60.0)
        assert position.sum() * share <= 3e-3
        assert angle.sum() * share <= 3e-3


@pytest.mark.parametrize("sharpness", [0.0, 0.004])
def test_the_first_and_last_states_are_those_asked_for(sharpness):
    for connection in random_connections(2, 40, sharpness):
        states, phi = state_from_flat(VEHICLE, np.array([connection.start, connection.end]))
        segment = connection.segment(0.5)
        assert np.abs(segment.states[0] - states[0]).max() < 1e-13
        assert np.abs(segment.states[-1] - states[-1])[[0, 1, 3]].max() < 1e-13
        turns = (segment.theta[-1] - states[-1, 2]) / (2 * math.pi)
        assert turns == pytest.approx(round(turns), abs=1e-12)
        assert segment.phi[[0, -1]] == pytest.approx(phi, abs=1e-13)
        flat = connection.flat(0.5)
        assert tuple(flat[0]) == connection.start
        assert tuple(flat[-1, [0, 1, 3, 4]]) == tuple(np.array(connection.end)[[0, 1, 3, 4]])


def test_samples_keep_the_limits():
    for connection in random_connections(3, 60, 0.004):
        segment = connection.segment(0.05)
        rate = np.abs(np.diff(segment.phi) / np.diff(segment.s))
        assert np.abs(segment.phi).max() <= VEHICLE.max_steer * (1 + 1e-4)
        assert np.abs(segment.alpha).max() <= VEHICLE.max_hitch * (1 + 1e-4)
        assert rate.max() <= VEHICLE.max_steer_rate * (1 + 1e-4)


def test_samples_are_equally_spaced_and_no_further_apart_than_asked_for():
    for connection in random_connections(4, 5):
        for spacing in (0.05, 0.3, 2.0):
            segment = connection.segment(spacing)
            assert segment.s[0] == 0.0
            assert np.diff(segment.s) == pytest.approx(np.full(segment.num_samples - 1, segment.s[1]))
            assert segment.s[1] <= spacing + 1e-9
            assert segment.length == pytest.approx(connection.truck_length, abs=1e-9)
            assert segment.direction == connection.direction


def test_the_trailer_length_is_that_of_the_samples():
    for connection in random_connections(5, 10):
        assert connection.segment(0.05).trailer_length == pytest.approx(connection.trailer_length, rel=1e-5)


def test_coarse_samples_lie_on_the_same_curve_as_dense_ones():
    for connection in random_connections(6, 10):
        coarse = connection.segment(1.0)
        dense = connection.segment(coarse.s[1] / 16)
        assert dense.num_samples == 16 * (coarse.num_samples - 1) + 1
        assert dense.states[::16] == pytest.approx(coarse.states, abs=1e-9)


def test_headings_start_as_asked_for_and_never_jump():
    rng = np.random.default_rng(7)
    for direction in (1, -1):
        start, end = random_flat(rng)._replace(theta=9.0), random_flat(rng)._replace(theta=-9.0)
        for connection in connections(VEHICLE, start, end, direction):
            segment = connection.segment()
            assert segment.theta[0] + segment.alpha[0] == pytest.approx(9.0, abs=1e-12)
            assert np.abs(np.diff(segment.theta)).max() < 0.05


def test_reverse_is_the_time_reversal_of_forward():
    rng = np.random.default_rng(8)
    for _ in range(20):
        start, end = random_flat(rng, 0.003), random_flat(rng, 0.003)
        forward, reverse = connections(VEHICLE, start, end, 1), connections(VEHICLE, end, start, -1)
        assert [c.trailer_length for c in forward] == [c.trailer_length for c in reverse]
        for a, b in zip(forward, reverse, strict=True):
            there, back = a.segment(0.2), b.segment(0.2)
            assert back.s == pytest.approx(there.length - there.s[::-1], abs=1e-9)
            assert back.phi == pytest.approx(there.phi[::-1], abs=1e-12)
            turns = 2 * math.pi * round((there.theta[-1] - back.theta[0]) / (2 * math.pi))
            assert back.states + [0.0, 0.0, turns, 0.0] == pytest.approx(there.states[::-1], abs=1e-9)


def moved(flat: Flat, dx: float, dy: float, turn: float) -> Flat:
    c, s = math.cos(turn), math.sin(turn)
    return flat._replace(x=c * flat.x - s * flat.y + dx, y=s * flat.x + c * flat.y + dy, theta=flat.theta + turn)


def test_connections_move_with_their_ends():
    rng = np.random.default_rng(9)
    for _ in range(20):
        start, end = random_flat(rng), random_flat(rng)
        motion = 200.0, -300.0, 2.0
        there = connections(VEHICLE, start, end, 1)
        here = connections(VEHICLE, moved(start, *motion), moved(end, *motion), 1)
        assert [c.kind for c in there] == [c.kind for c in here]
        lengths = [c.trailer_length for c in there]
        assert [c.trailer_length for c in here] == pytest.approx(lengths, abs=1e-8)
        for a, b in zip(there, here, strict=True):
            expected = [moved(Flat._make(row), *motion) for row in a.flat(0.5).tolist()]
            assert b.flat(0.5) == pytest.approx(np.array(expected), abs=1e-7)


def test_connections_are_mirrored_with_their_ends():
    rng = np.random.default_rng(10)
    for _ in range(40):
        pair = random_flat(rng, 0.003), random_flat(rng, 0.003)
        mirrored = [Flat(f.x, -f.y, -f.theta, -f.kappa, -f.sigma) for f in pair]
        there, here = connections(VEHICLE, *pair, 1), connections(VEHICLE, mirrored[0], mirrored[1], 1)
        assert len(there) == len(here)
        lengths = [c.trailer_length for c in there]
        assert [c.trailer_length for c in here] == pytest.approx(lengths, rel=2e-3)


def test_connections_come_shortest_first_and_none_is_longer_than_asked_for():
    rng = np.random.default_rng(11)
    for _ in range(40):
        start, end = random_flat(rng), random_flat(rng)
        lengths = [c.trailer_length for c in connections(VEHICLE, start, end, 1)]
        assert lengths == sorted(lengths)
        bound = 1.5 * math.hypot(end.x - start.x, end.y - start.y)
        assert all(c.trailer_length <= bound for c in connections(VEHICLE, start, end, 1, max_length=bound))


def test_nearly_all_random_pairs_are_connected_in_both_gears():
    rng = np.random.default_rng(12)
    pairs = [(random_flat(rng), random_flat(rng)) for _ in range(300)]
    for direction in (1, -1):
        connected = sum(bool(connections(VEHICLE, *pair, direction)) for pair in pairs)
        assert connected >= 0.97 * len(pairs)


def connected(start: np.ndarray, start_phi: float, end: np.ndarray, end_phi: float, direction: int) -> Segment:
    """The shortest connection of two states with their steering."""
    states, phi = np.array([start, end], float), np.array([start_phi, end_phi])
    first, last = (Flat(*row) for row in flat_from_state(VEHICLE, states, phi).tolist())
    return connections(VEHICLE, first, last, direction)[0].segment(0.05)


@pytest.mark.parametrize("goal", [(25, 40, 0, 0), (30, -5, 0, 0), (-5, -10, 0, 0)])
@pytest.mark.parametrize("direction", [1, -1])
def test_the_pairs_of_the_thesis_are_connected_in_both_gears(goal, direction):
    """Figure 2.4 of the thesis, with a largest hitch angle of 1 rad."""
    segment = connected(np.zeros(4), 0.0, np.array(goal), 0.0, direction)
    assert segment.states[0] == pytest.approx(np.zeros(4), abs=1e-12)
    assert segment.states[-1, [0, 1, 3]] == pytest.approx([goal[0], goal[1], 0.0], abs=1e-12)
    assert math.remainder(segment.theta[-1], 2 * math.pi) == pytest.approx(0.0, abs=1e-12)


@pytest.mark.parametrize(("goal", "most"), [((25, 40, 0, 0), 70.0), ((30, -5, 0, 0), 32.0)])
def test_the_pairs_of_the_thesis_that_lie_ahead_need_no_detour_forwards(goal, most):
    segment = connected(np.zeros(4), 0.0, np.array(goal), 0.0, 1)
    assert math.hypot(goal[0], goal[1]) < segment.length < most


def test_the_steering_given_at_the_ends_is_kept():
    start, end = np.array([0.0, 0.0, 0.1, -0.2]), np.array([28.0, 6.0, 0.4, -0.1])
    segment = connected(start, 0.15, end, -0.05, 1)
    assert segment.phi[[0, -1]] == pytest.approx([0.15, -0.05], abs=1e-12)
    assert segment.states[[0, -1]] == pytest.approx(np.array([start, end]), abs=1e-12)
    flat = flat_from_state(VEHICLE, segment.states, segment.phi)
    assert np.abs(np.diff(flat[:, 4])).max() < 0.01


def test_states_that_break_the_limits_themselves_are_not_connected():
    beyond = Flat(0.0, 0.0, 0.0, 1.1 * VEHICLE.max_kappa, 0.0)
    assert connections(VEHICLE, beyond, Flat(40.0, 0.0, 0.0, 0.0, 0.0), 1) == []


def test_a_state_at_its_limit_is_connected():
    state = np.array([0.0, 0.0, 0.0, 0.0])
    flat = Flat(*flat_from_state(VEHICLE, state, np.array(VEHICLE.max_steer)).tolist())
    assert connections(VEHICLE, flat, Flat(40.0, 20.0, 1.0, 0.0, 0.0), 1)


def test_from_a_state_to_itself_there_are_only_full_turns():
    here = Flat(1.0, 2.0, 0.5, 0.0, 0.0)
    found = connections(VEHICLE, here, here, 1)
    assert found
    assert found[0].trailer_length > 2.0 * math.pi / VEHICLE.max_kappa


def test_far_coordinates_keep_their_precision():
    start, end = Flat(4e6, 5e6, 0.5, 0.0, 0.0), Flat(4e6 + 30.0, 5e6 + 20.0, 1.0, 0.02, 0.0)
    found = connections(VEHICLE, start, end, 1)
    assert found
    assert np.abs(found[0].flat()[-1] - end).max() < END_TOLERANCE


def test_a_hitch_that_is_not_over_the_axle_is_refused():
    with pytest.raises(ValueError, match="hitch_offset"):
        connections(Vehicle(hitch_offset=0.3), Flat(0, 0, 0, 0, 0), Flat(30, 0, 0, 0, 0), 1)
