"""Exact steering between two full states: the cheaper of continuous-sharpness turns and a Bézier curve.

Reverse by time reversal: a path driven backwards from A to B is a path driven forwards from B to A, with the same
curve of the trailer's axle oriented along its heading, so curvature and sharpness keep their values.
"""

import math
from dataclasses import dataclass
from functools import cached_property
from typing import Literal, NamedTuple

import numpy as np

from optim.model.flat_map import state_from_flat
from optim.model.path import Segment, segment_from_states
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64, frozen
from optim.steering.bezier import plan_bezier, sample_bezier
from optim.steering.flat import Flat, curve_limits, effort
from optim.steering.pieces import sample_turns
from optim.steering.turns import plan_turns

END_TOLERANCE = 1e-8
"""Largest distance of the computed last state from the requested one, which replaces it [m, rad]."""


class Sampled(NamedTuple):
    """A connection at equal distances of the truck; the states between follow from phi linear in s. N samples."""

    s: Float64[Array, " N"]
    """Arc length of the truck's rear axle from the connection's start [m]. Shape (N,)."""
    states: Float64[Array, "N 4"]
    """Columns x, y, theta, alpha. Shape (N, 4)."""
    phi: Float64[Array, " N"]
    """Steering angle [rad]. Shape (N,)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Connection:
    """One drivable way from `start` to `end`."""

    kind: Literal["turns", "bezier"]
    direction: int
    """+1 forward, -1 reverse."""
    start: Flat
    end: Flat
    trailer_length: float
    """Distance of the trailer's axle [m]."""
    vehicle: Vehicle
    curve: Float64[Array, " _"]
    """Parameters of the curve in the order of travel forwards: a row of `plan_turns`, or the tangent lengths a0, a1."""

    @property
    def truck_length(self) -> float:
        """Distance of the truck's rear axle [m]."""
        return self._coarse[0]

    @property
    def effort(self) -> tuple[float, float]:
        """(integral of phi^2 [rad^2 m], integral of (dphi/ds)^2 [rad^2/m]) over the truck's distance, from few samples.

        phi is taken as linear between samples 1 m apart: of all curves through them that has the least second integral.
        """
        length, flat = self._coarse
        return effort(flat, length, curve_limits(self.vehicle))

    @cached_property
    def _coarse(self) -> tuple[float, Array]:
        return self._flat(1.0)

    def _flat(self, spacing: float) -> tuple[float, Array]:
        """(truck's distance, flat states (n, 5)) in the order of travel forwards, in the frame of its first state."""
        first, last = (self.start, self.end) if self.direction > 0 else (self.end, self.start)
        ends, lim = local_ends(first, last), curve_limits(self.vehicle)
        if self.kind == "turns":
            return sample_turns(self.curve, *ends, float(spacing), lim)
        return sample_bezier(*ends, float(self.curve[0]), float(self.curve[1]), float(spacing), lim)

    def flat(self, spacing: float = 0.05) -> Array:
        """States (x, y, theta, kappa, sigma) of the trailer's axle in the order of travel. Shape (N, 5).

        At equal distances, at most `spacing` [m], of the *truck's* rear axle. The heading starts at start.theta and
        is continuous: at the end it may differ from end.theta by a multiple of 2 pi.
        """
        first, last = (self.start, self.end) if self.direction > 0 else (self.end, self.start)
        _, local = self._flat(spacing)
        cos, sin = math.cos(first.theta), math.sin(first.theta)
        flat = local.copy()
        flat[:, 0] = first.x + cos * local[:, 0] - sin * local[:, 1]
        flat[:, 1] = first.y + sin * local[:, 0] + cos * local[:, 1]
        flat[:, 2] += first.theta
        turns = 2.0 * math.pi * round((flat[-1, 2] - last.theta) / (2.0 * math.pi))
        exact = np.array([first, last], dtype=float)
        exact[1, 2] += turns
        error = np.abs(flat[[0, -1]] - exact).max()
        if error > END_TOLERANCE * max(1.0, 1e-6 * np.abs(exact).max()):
            raise ArithmeticError(f"steering: {self.kind} from {first} to {last} ends {error:.1e} off")
        if self.direction < 0:
            flat, exact = flat[::-1], exact[::-1]
            flat[:, 2] -= turns
            exact[:, 2] -= turns
        flat[[0, -1]] = exact
        flat[0, 2] = self.start.theta
        return flat

    def sample(self, spacing: float = 0.05) -> Sampled:
        """States and steering at equal distances of the truck, at most `spacing` [m] apart.

        The first state is that of `start`, the last one that of `end` but for a multiple of 2 pi in heading: exactly
        in flat coordinates, so to rounding here.
        """
        flat = self.flat(spacing)
        states, phi = state_from_flat(self.vehicle, flat)
        return Sampled(np.linspace(0.0, self.truck_length, len(flat)), states, phi)

    def segment(self, spacing: float = 0.05) -> Segment:
        """The samples of `sample` as a segment."""
        return segment_from_states(self.direction, *self.sample(spacing))


def local_ends(first: Flat, last: Flat) -> tuple[Array, Array]:
    """(k0, s0) and (x, y, theta, k1, s1) in the frame of the first state, theta in [-pi, pi]."""
    dx, dy = last.x - first.x, last.y - first.y
    cos, sin = math.cos(first.theta), math.sin(first.theta)
    turned = math.remainder(last.theta - first.theta, 2.0 * math.pi)
    goal = (cos * dx + sin * dy, cos * dy - sin * dx, turned, last.kappa, last.sigma)
    return frozen((first.kappa, first.sigma)), frozen(goal)


def connections(
    vehicle: Vehicle, start: Flat, end: Flat, direction: int, max_length: float = math.inf
) -> list[Connection]:
    """Drivable connections from start to end in one direction, by distance of the trailer's axle, shortest first.

    All keep |kappa|, |phi| and |dphi/ds| within the vehicle's limits, and none is longer than max_length [m]; there
    may be none. Several pairs of turns and at most one Bézier curve are returned: where the shortest collides,
    another may not. Raises ValueError for a hitch that is not over the rear axle.
    """
    lim = curve_limits(vehicle)
    first, last = (start, end) if direction > 0 else (end, start)
    ends = local_ends(first, last)
    if math.hypot(ends[1][0], ends[1][1]) > max_length:
        return []
    found = [
        Connection(
            kind="turns",
            direction=direction,
            start=start,
            end=end,
            trailer_length=float(row[0]),
            vehicle=vehicle,
            curve=frozen(row),
        )
        for row in plan_turns(*ends, lim, float(max_length))
    ]
    length, a0, a1 = plan_bezier(*ends, lim, float(max_length))
    if length < math.inf and length <= max_length:
        found.append(
            Connection(
                kind="bezier",
                direction=direction,
                start=start,
                end=end,
                trailer_length=length,
                vehicle=vehicle,
                curve=frozen((a0, a1)),
            )
        )
    return sorted(found, key=lambda connection: connection.trailer_length)
