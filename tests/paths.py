"""Drivable paths for the tests: random ones, limits kept, reverse segments held by feedback; and straight ones."""

import math

import numpy as np

from optim.model.kinematics import rk4_step
from optim.model.path import Path, Segment, roll_out_segment
from optim.model.vehicle import Vehicle


def random_segment(
    vehicle: Vehicle,
    state: np.ndarray,
    direction: int,
    length: float,
    seed: int,
    spacing: float = 0.05,
    turning: float = 0.0,
) -> Segment:
    """A segment whose hitch angle follows a smooth random target around -direction * turning [rad].

    With turning > 0 the combination keeps turning left, in either gear: a three-point turn.
    """
    rng = np.random.default_rng(seed)
    count = max(2, math.ceil(length / spacing)) + 1
    s = np.linspace(0.0, length, count)
    ds = s[1]
    wave = rng.uniform(-0.3, 0.3, 3) * vehicle.max_hitch
    phase = rng.uniform(0, 6, 3)
    target = np.sin(np.outer(s / 12.0, [1, 2, 3]) + phase) @ wave - direction * turning
    phi = np.zeros(count)
    limit, rate = 0.9 * vehicle.max_steer, 0.9 * vehicle.max_steer_rate * ds
    q = np.asarray(state, float)
    for k in range(1, count):
        # dalpha/ds = -d (sin(alpha) / l_t + tan(phi) / l) = -(alpha - target) / 4 m
        wish = math.sin(q[3]) / vehicle.hitch_to_axle - direction * (q[3] - target[k]) / 4.0
        wish = np.clip(math.atan(-vehicle.wheelbase * wish), -limit, limit)
        phi[k] = np.clip(wish, phi[k - 1] - rate, phi[k - 1] + rate) if k > 1 else wish
        if k == 1:
            phi[0] = phi[1]
        q = rk4_step(vehicle, q, phi[k - 1], phi[k], ds, direction)
    return roll_out_segment(vehicle, np.asarray(state, float), direction, s, phi)


def random_path(
    vehicle: Vehicle,
    lengths: tuple[float, ...],
    first_direction: int = 1,
    seed: int = 0,
    spacing: float = 0.05,
    turning: float = 0.0,
) -> Path:
    """A path with a cusp between the given lengths [m], from near the origin."""
    rng = np.random.default_rng(seed)
    state = np.array([*rng.uniform(-5, 5, 2), rng.uniform(-3, 3), rng.uniform(-0.2, 0.2)])
    segments: list[Segment] = []
    for k, length in enumerate(lengths):
        direction = first_direction * (-1) ** k
        segments.append(random_segment(vehicle, state, direction, length, seed + 97 * k, spacing, turning))
        state = segments[-1].states[-1]
    return Path(tuple(segments))


def straight(*lengths: float, weave: float = 0.0) -> Path:
    """Along the x axis from the origin, by lengths [m] that are negative in reverse; with a weave it leaves the axis.

    Samples are at most 0.1 m apart; `weave` is the largest steering angle [rad].
    """
    segments: list[Segment] = []
    state = np.zeros(4)
    for length in lengths:
        s = np.linspace(0.0, abs(length), math.ceil(abs(length) / 0.1) + 1)
        phi = weave * np.sin(2 * np.pi * s / abs(length))
        segments.append(roll_out_segment(Vehicle(), state, 1 if length > 0 else -1, s, phi))
        state = segments[-1].states[-1]
    return Path(tuple(segments))


def logged(path: Path, step: int) -> tuple[np.ndarray, np.ndarray]:
    """Every step-th state of each segment and its ends, cusps once; and the gear of each interval."""
    rows, gears = [path.start[None]], []
    for segment in path.segments:
        keep = np.unique(np.r_[np.arange(0, segment.num_samples, step), segment.num_samples - 1])[1:]
        rows.append(segment.states[keep])
        gears += [segment.direction] * len(keep)
    return np.concatenate(rows), np.array(gears)
