"""One transcription for the optimisers that work at knots: a path as knots and step lengths, and back.

Between the knots k and k + 1 the vehicle drives h_k metres in gear d_k while phi goes linearly from phi_k to
phi_{k+1}; one Runge-Kutta step of order four connects the states:

    q_{k+1} = F(q_k, phi_k, phi_{k+1}, h_k, d_k),    q = (x, y, theta, alpha).

A gear change is an interval of its own with d_k = 0 and h_k = 0: the state stays, phi is free to jump. All
intervals have the same form that way, and J is a sum over intervals:

    J = sum_k  w_length h + w_steer h (phi_k^2 + phi_k phi_{k+1} + phi_{k+1}^2) / 3 + w_rate (dphi)^2 / h
        + sum over gear changes  w_cusp + w_jump (dphi)^2.

Step lengths are unknowns of the optimisation: gear changes move, and a needless one goes when its segment shrinks
to nothing. A vanished segment must be merged away, not kept: at h -> 0 it would buy a free jump of the steering.
"""

from dataclasses import dataclass
from itertools import groupby, pairwise

import numpy as np

from optim.knots.step import empty_jet, step_jet
from optim.model.kinematics import rk4
from optim.model.objective import Weights
from optim.model.path import Path, Segment, sample_segment, segment_from_states
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64, Int64, IntArray, frozen, frozen_int
from optim.numerics.kernel import kernel

FEWEST = 4
"""Intervals of a segment, at least: a short one may still bend."""
STEP_RANGE = (0.01, 2.0)
"""Least and largest step length, by the distance between knots: short enough to shrink a segment to nothing, not 0."""
VANISHED = 0.5
"""Length, by the distance between knots, below which a segment has shrunk to nothing."""
LARGEST_DEFECT = 1e-6
"""Defect of one interval up to which knots count as drivable [m or rad]; the audit allows 1e-4, and 10 mm in sum."""
LARGEST_SPACING = 0.1
"""Samples of a path that is given back are at most this far apart [m]."""


@dataclass(frozen=True, eq=False)
class Knots:
    """K knots and the K - 1 intervals between them; all arrays read-only."""

    states: Float64[Array, "K 4"]
    """Columns x, y, theta, alpha. Shape (K, 4)."""
    phi: Float64[Array, " K"]
    """Steering angle [rad]. Shape (K,)."""
    h: Float64[Array, " K-1"]
    """Step lengths [m], 0 in a gear change. Shape (K - 1,)."""
    gear: Int64[IntArray, " K-1"]
    """+1, -1, or 0 in a gear change. Shape (K - 1,)."""

    def __post_init__(self) -> None:
        for name in ("states", "phi", "h"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        object.__setattr__(self, "gear", frozen_int(self.gear))

    @property
    def num_cusps(self) -> int:
        """Number of gear changes."""
        return int(np.count_nonzero(self.gear == 0))

    @property
    def runs(self) -> list[slice]:
        """The intervals of each segment, in order; its knots are one more."""
        cusps = np.flatnonzero(self.gear == 0)
        starts, stops = np.concatenate([[0], cusps + 1]), np.concatenate([cusps, [len(self.gear)]])
        return [slice(int(a), int(b)) for a, b in zip(starts, stops, strict=True)]

    @property
    def lengths(self) -> Array:
        """Length of each segment [m]. Shape (S,)."""
        return frozen([self.h[run].sum() for run in self.runs])


def objective_of(knots: Knots, weights: Weights) -> float:
    """J of the knots; the same as `optim.model.objective.objective` of their path."""
    value, _ = objective_gradient(knots, weights)
    return value


def objective_gradient(knots: Knots, weights: Weights) -> tuple[float, tuple[Array, Array]]:
    """J, and its derivatives by phi, shape (K,), and by h, shape (K - 1,); by h = 0 in a gear change."""
    drives = knots.gear != 0
    h, left, right = np.where(drives, knots.h, 1.0), knots.phi[:-1], knots.phi[1:]
    change = right - left
    square = (left * left + left * right + right * right) / 3.0
    rate = change / h
    pieces = weights.length * h + weights.steer * h * square + weights.rate * change * rate
    jumps = weights.cusp + weights.jump * change**2
    value = float(np.where(drives, pieces, jumps).sum())
    slope = np.where(drives, 2.0 * weights.rate * rate, 2.0 * weights.jump * change)
    bend = np.where(drives, weights.steer * h / 3.0, 0.0)
    by_phi = np.zeros(len(knots.phi))
    by_phi[:-1] += bend * (2.0 * left + right) - slope
    by_phi[1:] += bend * (left + 2.0 * right) + slope
    by_h = np.where(drives, weights.length + weights.steer * square - weights.rate * rate**2, 0.0)
    return value, (by_phi, by_h)


def defects(vehicle: Vehicle, knots: Knots) -> tuple[Array, Array]:
    """How far each interval's end is from the next knot, and the step's derivatives.

    Returns F(q_k, ...) - q_{k+1}, shape (K - 1, 4), and the derivatives of F by
    (x, y, theta, alpha, phi_k, phi_{k+1}, h), shape (K - 1, 4, 7); in a gear change F is the identity.
    """
    gaps, jacobian, _ = _steps(vehicle, knots, None)
    return gaps, jacobian


def dynamics_curvature(vehicle: Vehicle, knots: Knots, multipliers: Array) -> Array:
    """Second derivatives of multipliers . F by (theta, alpha, phi_k, phi_{k+1}, h), exact.

    multipliers: shape (K - 1, 4). Shape (K - 1, 5, 5), 0 in a gear change.
    """
    return _steps(vehicle, knots, multipliers)[2]


def _steps(vehicle: Vehicle, knots: Knots, multipliers: Array | None) -> tuple[Array, Array, Array]:
    weights = frozen(np.zeros((0, 4)) if multipliers is None else multipliers)
    gears = frozen_int(knots.gear)
    return steps_kernel(knots.states, knots.phi, knots.h, gears, vehicle.kinematics, weights)


@kernel
def steps_kernel(states, phi, h, gear, kinematics, weights):
    """Defects, derivatives, and curvature weighted by (K - 1, 4) weights; with (0, 4) weights no curvature."""
    count, second = h.size, weights.shape[0] > 0
    gaps, jacobian = np.empty((count, 4)), np.zeros((count, 4, 7))
    curvature = np.zeros((count if second else 0, 5, 5))
    jet = empty_jet()
    value, gradient, hessian = jet.value, jet.gradient, jet.hessian
    for k in range(count):
        for o in range(4):
            gaps[k, o] = states[k, o] - states[k + 1, o]
            jacobian[k, o, o] = 1.0
        if gear[k] == 0:
            continue
        z = (states[k, 2], states[k, 3], phi[k], phi[k + 1], h[k])
        step_jet(z, gear[k], kinematics, second, jet)
        for o in range(4):
            gaps[k, o] += value[o]
            for i in range(5):
                jacobian[k, o, 2 + i] = gradient[o, i]
            if second:
                for i in range(5):
                    for j in range(5):
                        curvature[k, i, j] += weights[k, o] * hessian[o, i, j]
    return gaps, jacobian, curvature


def knots_of(vehicle: Vehicle, path: Path, spacing: float) -> Knots:
    """Equal intervals in each segment, at most `spacing` [m] long and at least `FEWEST`.

    Neighbouring segments of equal gear become one: where the steering jumps between them, the knot takes the mean.
    """
    parts: list[tuple[Array, Array, Array, IntArray]] = []
    for gear, group in groupby(path.segments, key=lambda segment: segment.direction):
        states, phi, h = _knots_of_group(vehicle, list(group), spacing)
        # a gear change follows, but for the last segment
        parts.append((states, phi, np.append(h, 0.0), np.append(np.full(len(h), gear), 0)))
    states, phi, h, gears = (np.concatenate(column) for column in zip(*parts, strict=True))
    return Knots(states, phi, h[:-1], gears[:-1])


def _knots_of_group(vehicle: Vehicle, group: list[Segment], spacing: float) -> tuple[Array, Array, Array]:
    """Knots, their steering, and the step lengths of segments driven in one gear."""
    total = sum(segment.length for segment in group)
    count = max(FEWEST, int(np.ceil(total / spacing - 1e-9)))
    at = np.linspace(0.0, total, count + 1)
    states, phi = np.empty((count + 1, 4)), np.empty(count + 1)
    start = 0.0
    for segment in group:
        rest = at >= start  # where this segment ends, the next one overwrites
        states[rest], phi[rest] = sample_segment(vehicle, segment, at[rest] - start)
        start += segment.length
    place = 0.0
    for before, after in pairwise(group):
        place += before.length
        phi[np.argmin(np.abs(at - place))] = 0.5 * (before.phi[-1] + after.phi[0])
    return states, phi, np.full(count, total / count)


def path_of(vehicle: Vehicle, knots: Knots, like: Path) -> Path:
    """The path through the knots, sampled at most `LARGEST_SPACING` apart by integration from knot to knot.

    First and last state are those of `like`, which the knots meet up to their defects.
    """
    pieces = np.maximum(1, np.ceil(knots.h / LARGEST_SPACING - 1e-9)).astype(np.int64)
    states, phi, s = _fill(knots.states, knots.phi, knots.h, knots.gear, vehicle.kinematics, frozen_int(pieces))
    first = np.concatenate([[0], np.cumsum(pieces)])  # sample at each knot
    segments: list[Segment] = []
    runs = knots.runs
    for position, run in enumerate(runs):
        block = slice(first[run.start], first[run.stop] + 1)
        own = states[block].copy()
        own[0] = segments[-1].states[-1] if segments else like.start
        if position == len(runs) - 1:
            own[-1] = like.goal
        segments.append(segment_from_states(int(knots.gear[run.start]), s[block] - s[block.start], own, phi[block]))
    return Path(tuple(segments))


@kernel
def _fill(states, phi, h, gear, kinematics, pieces):
    """States, steering and arc length at the knots and, so many pieces to an interval, between them."""
    l, l_t, offset = kinematics
    total = pieces.sum() + 1
    out, steer, s = np.empty((total, 4)), np.empty(total), np.zeros(total)
    at = 0
    for k in range(h.size):
        out[at], steer[at] = states[k], phi[k]
        x, y, theta, alpha = states[k, 0], states[k, 1], states[k, 2], states[k, 3]
        start, n = s[at], pieces[k]
        for i in range(1, n + 1):
            a = phi[k] + (phi[k + 1] - phi[k]) * ((i - 1) / n)
            b = phi[k] + (phi[k + 1] - phi[k]) * (i / n)
            x, y, theta, alpha = rk4(x, y, theta, alpha, a, b, h[k] / n, gear[k], l, l_t, offset)
            out[at + i, 0], out[at + i, 1], out[at + i, 2], out[at + i, 3] = x, y, theta, alpha
            steer[at + i], s[at + i] = b, start + h[k] * (i / n)
        at += n
    out[at], steer[at] = states[h.size], phi[h.size]
    return out, steer, s


def without_segment(knots: Knots, index: int) -> Knots:
    """The knots without one segment: an inner one's neighbours, of equal gear, become one segment.

    The steering at the seam is the mean. The states on both sides stay, so that a gap remains between them.
    Raises ValueError for the only segment.
    """
    runs = knots.runs
    if len(runs) == 1:
        raise ValueError("knots: the only segment cannot go")
    end, after = runs[index].start, runs[index].stop + 1  # of the knots before the segment; first knot behind it
    states, phi, h, gear = knots.states, knots.phi, knots.h, knots.gear
    if index == 0:
        return Knots(states[after:], phi[after:], h[after:], gear[after:])
    if index == len(runs) - 1:
        return Knots(states[:end], phi[:end], h[: end - 1], gear[: end - 1])
    # the two knots at the seam become one
    seam_state, seam_phi = (0.5 * (values[end - 1] + values[after]) for values in (states, phi))
    return Knots(
        np.concatenate([states[: end - 1], seam_state[None], states[after + 1 :]]),
        np.concatenate([phi[: end - 1], [seam_phi], phi[after + 1 :]]),
        np.concatenate([h[: end - 1], h[after:]]),
        np.concatenate([gear[: end - 1], gear[after:]]),
    )


def merge_vanished(knots: Knots, shortest: float) -> Knots:
    """The knots without the segments shorter than `shortest` [m], shortest first; the last one stays."""
    while knots.num_cusps:
        lengths = knots.lengths
        index = int(np.argmin(lengths))
        if lengths[index] >= shortest:
            break
        knots = without_segment(knots, index)
    return knots


def remesh(vehicle: Vehicle, knots: Knots, spacing: float, like: Path) -> Knots:
    """Equal intervals again, at most `spacing` [m] long, on the same path."""
    return knots_of(vehicle, path_of(vehicle, knots, like), spacing)


def within_rate(knots: Knots, limit: float) -> Array:
    """The steering with no change faster than the limit [rad/m]: the mean of limiting it from either end."""
    return _within_rate(knots.phi, knots.h, knots.gear, float(limit))


@kernel
def _within_rate(phi, h, gear, limit):
    forth, back = phi.copy(), phi.copy()
    for k in range(h.size):
        if gear[k] != 0:
            most = limit * h[k]
            forth[k + 1] = min(max(phi[k + 1], forth[k] - most), forth[k] + most)
    for k in range(h.size - 1, -1, -1):
        if gear[k] != 0:
            most = limit * h[k]
            back[k] = min(max(phi[k], back[k + 1] - most), back[k + 1] + most)
    return 0.5 * (forth + back)  # both keep the limits, which are convex


def is_worn(knots: Knots, spacing: float) -> bool:
    """Whether a segment has grown so much that it needs more knots."""
    return max(float(knots.h[run].mean()) for run in knots.runs) > 1.5 * spacing


def gears_alternate(knots: Knots) -> bool:
    """Whether each gear change changes the gear."""
    gears = [int(knots.gear[run.start]) for run in knots.runs]
    return all(a == -b for a, b in pairwise(gears))
