"""The points of one segment: where they are, which of them may move, and where they were on the recorded path.

Rows are in the order of the trailer's heading, so that a reverse segment is read from its end. The first and the
last row are not points of the path: together with the two anchored samples at each end they make the curvature of
the end that of the recorded path, so that both sides of a cusp meet in it.
"""

from dataclasses import dataclass

import numpy as np

from optim.model.flat_map import flat_from_state
from optim.model.path import Segment
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Bool, BoolArray, Float64

ENDS = 2
"""Samples anchored at each end of a segment (the source's number)."""


@dataclass(frozen=True, eq=False)
class RecordedAxle:
    """The trailer's axle on one recorded segment, in the order of its heading."""

    direction: int
    """+1 forward, -1 reverse."""
    flat: Float64[Array, "n 5"]
    """x, y [m], heading [rad], kappa [1/m], sigma [1/m^2] of the samples. Shape (n, 5)."""
    share: Float64[Array, " n"]
    """Distance of the axle up to each sample as a share of the whole. Shape (n,), from 0 to 1."""
    length: float
    """Distance of the axle [m]."""

    @staticmethod
    def of(vehicle: Vehicle, segment: Segment) -> "RecordedAxle":
        """The axle on a segment; a reverse one is read from its end."""
        flat = flat_from_state(vehicle, segment.states, segment.phi)[:: segment.direction]
        along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(flat[:, :2], axis=0).T))])
        return RecordedAxle(segment.direction, flat, along / along[-1], float(along[-1]))

    def at(self, share: Array) -> Array:
        """Points of the recorded axle. Shape (n, 2)."""
        return np.stack([np.interp(share, self.share, self.flat[:, k]) for k in range(2)], axis=1)


@dataclass(frozen=True, eq=False)
class AxlePoints:
    """The points of one segment in motion."""

    xy: Float64[Array, "M 2"]
    """M points, the first and the last beyond the ends [m]. Shape (M, 2)."""
    share: Float64[Array, " M"]
    """Start of each point along the recorded axle. Shape (M,)."""
    anchored: Bool[BoolArray, " M"]
    """Points that do not move. Shape (M,)."""
    spacing: float
    """[m]."""

    @property
    def length(self) -> float:
        """Length of the polyline [m]."""
        return float(np.hypot(*np.diff(self.on_path, axis=0).T).sum())

    @property
    def on_path(self) -> Array:
        """The points without the two beyond the ends. Shape (M - 2, 2)."""
        return self.xy[1:-1]


def spread(axle: RecordedAxle, curve: Array, share: Array, spacing: float, anchors: Array) -> AxlePoints:
    """Points at equal distances along a polyline (n, 2) with shares (n,), ends and anchored stretches put in place.

    anchors: (k, 2) first and last share of each stretch that stays as recorded.
    """
    from scipy.interpolate import CubicSpline  # takes a quarter of a second to load

    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(curve, axis=0).T))])
    count = max(2 * ENDS + 2, round(along[-1] / spacing) + 1)
    h = along[-1] / (count - 1)
    at = np.linspace(0.0, along[-1], count)
    points = CubicSpline(along, curve)(at)
    shares = np.interp(at, along, share)
    stays = np.zeros(count, dtype=bool)
    for low, high in anchors:
        stays |= (shares >= low) & (shares <= high)
    points[stays] = axle.at(shares[stays])
    start, end = axle.flat[0], axle.flat[-1]
    points = np.concatenate(
        [_arc(start, h * np.arange(-1, ENDS)), points[ENDS:-ENDS], _arc(end, h * np.arange(1 - ENDS, 2))]
    )
    fixed = np.ones(ENDS + 1, dtype=bool)
    stays = np.concatenate([fixed, stays[ENDS:-ENDS], fixed])
    return AxlePoints(points, np.concatenate([[0.0], shares, [1.0]]), stays, h)


def _arc(flat: Array, s: Array) -> Array:
    """Points on the circle of curvature, at the distances s [m] from it. Shape (n, 2)."""
    heading = flat[2] + 0.5 * flat[3] * s
    chord = s * np.sinc(flat[3] * s / (2.0 * np.pi))
    return flat[:2] + np.stack([chord * np.cos(heading), chord * np.sin(heading)], axis=1)
