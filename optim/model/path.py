"""A path: where the combination is, and how it steers, by arc length. No time in it.

A path is a sequence of segments, each driven in one direction. Between two samples of a segment the steering
angle is linear in arc length and the states follow from the kinematics; that makes a path exact, not a polyline.
Neighbouring segments share position, heading and hitch angle at the cusp; the steering may differ there, since
the vehicle stands still.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from itertools import pairwise
from typing import Any, NamedTuple

import numpy as np

from optim.model.kinematics import LARGEST_STEP, roll_out, roll_out_kernel
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64, Int64, IntArray, data_frame, frozen, frozen_int
from optim.numerics.kernel import kernel

LENGTH_TOLERANCE = 1e-9
"""Pieces shorter than this [m] are dropped: below it, differences of coordinates carry no direction."""
STEER_TOLERANCE = 1e-6
"""Steering angles that differ by no more are the same [rad]: the flat map and back keeps ten digits."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Segment:
    """One stretch in one direction. All arrays have shape (n,), n >= 2, and are read-only.

    Raises ValueError when lengths differ, a value is not finite, or s does not start at 0 and increase.
    """

    direction: int
    """+1 forward, -1 reverse."""
    s: Float64[Array, " n"]
    """Arc length of the truck's rear axle from the segment's start [m], strictly increasing from 0."""
    x: Float64[Array, " n"]
    """Rear axle [m]."""
    y: Float64[Array, " n"]
    """Rear axle [m]."""
    theta: Float64[Array, " n"]
    """Truck heading [rad], unwrapped."""
    alpha: Float64[Array, " n"]
    """Hitch angle, trailer heading minus truck heading [rad]."""
    phi: Float64[Array, " n"]
    """Steering angle [rad]."""

    def __post_init__(self) -> None:
        if self.direction not in (1, -1):
            raise ValueError(f"segment: direction is {self.direction!r}, expected 1 or -1")
        for name in ("s", "x", "y", "theta", "alpha", "phi"):
            values = frozen(getattr(self, name))
            if values.shape != (len(self.s),) or len(values) < 2:
                raise ValueError(f"segment: {name} has shape {values.shape}, expected ({max(len(self.s), 2)},)")
            if not np.isfinite(values).all():
                raise ValueError(f"segment: {name}[{int(np.argmin(np.isfinite(values)))}] is not finite")
            object.__setattr__(self, name, values)
        if self.s[0] != 0.0 or (np.diff(self.s) <= 0.0).any():
            raise ValueError("segment: s must start at 0 and increase strictly")

    def __repr__(self) -> str:
        return f"Segment({self.direction * self.length:+.2f} m, {self.num_samples} samples)"

    @cached_property
    def states(self) -> Array:
        """Columns x, y, theta, alpha. Shape (n, 4)."""
        return frozen(np.stack([self.x, self.y, self.theta, self.alpha], axis=1))

    @property
    def num_samples(self) -> int:
        """Number of samples, n."""
        return len(self.s)

    @property
    def length(self) -> float:
        """Distance driven by the truck's rear axle [m]."""
        return float(self.s[-1])

    @property
    def trailer_length(self) -> float:
        """Distance travelled by the trailer's axle with a hitch over the rear axle, the integral of cos(alpha) [m]."""
        cos = np.cos(self.alpha)
        return float(np.sum(np.diff(self.s) * (cos[1:] + cos[:-1])) / 2.0)


class Samples(NamedTuple):
    """All samples of a path in a row; a cusp appears twice, once for each segment. N samples."""

    s: Float64[Array, " N"]
    """Arc length from the start of the path [m]. Shape (N,)."""
    states: Float64[Array, "N 4"]
    """Columns x, y, theta, alpha. Shape (N, 4)."""
    phi: Float64[Array, " N"]
    """Steering angle [rad]. Shape (N,)."""
    direction: Int64[IntArray, " N"]
    """+1 forward, -1 reverse. Shape (N,)."""
    segment: Int64[IntArray, " N"]
    """Index of the segment. Shape (N,)."""


@dataclass(frozen=True, eq=False)
class Path:
    """Segments in the order in which they are driven. Raises ValueError for none."""

    segments: tuple[Segment, ...]

    def __post_init__(self) -> None:
        if not self.segments:
            raise ValueError("path: no segments")

    def __repr__(self) -> str:
        gears = " ".join(f"{segment.direction * segment.length:+.2f} m" for segment in self.segments)
        return f"Path({gears}; {sum(segment.num_samples for segment in self.segments)} samples)"

    def to_dataframe(self) -> Any:
        """All samples as rows, SI units; `s` counts from the start of the path.

        A DataFrame of pandas, else of polars. Raises ImportError where neither is installed.
        """
        samples = self.samples
        columns = dict(zip(("x", "y", "theta", "alpha"), samples.states.T, strict=True))
        whole = {"segment": samples.segment, "direction": samples.direction, "s": samples.s}
        return data_frame(whole | columns | {"phi": samples.phi})

    @cached_property
    def samples(self) -> Samples:
        """The samples of all segments in a row."""
        lengths = [segment.length for segment in self.segments]
        starts = np.concatenate([[0.0], np.cumsum(lengths)[:-1]])
        counts = [segment.num_samples for segment in self.segments]
        return Samples(
            s=frozen(np.concatenate([a + segment.s for a, segment in zip(starts, self.segments, strict=True)])),
            states=frozen(np.concatenate([segment.states for segment in self.segments])),
            phi=frozen(np.concatenate([segment.phi for segment in self.segments])),
            direction=frozen_int(np.repeat([segment.direction for segment in self.segments], counts)),
            segment=frozen_int(np.repeat(np.arange(len(counts)), counts)),
        )

    @property
    def length(self) -> float:
        """Distance driven by the truck's rear axle [m]."""
        return sum(segment.length for segment in self.segments)

    @property
    def trailer_length(self) -> float:
        """Distance travelled by the trailer's axle [m]."""
        return sum(segment.trailer_length for segment in self.segments)

    @property
    def num_cusps(self) -> int:
        """Number of gear changes."""
        directions = [segment.direction for segment in self.segments]
        return sum(a != b for a, b in pairwise(directions))

    @property
    def start(self) -> Array:
        """First state. Shape (4,)."""
        return self.segments[0].states[0]

    @property
    def goal(self) -> Array:
        """Last state. Shape (4,)."""
        return self.segments[-1].states[-1]

    @property
    def segment(self) -> IntArray:
        """Index of the segment of each sample. Shape (N,)."""
        return self.samples.segment

    @property
    def s(self) -> Array:
        """Arc length of each sample from the start of the path [m]; at a gear change twice the same. Shape (N,)."""
        return self.samples.s

    @property
    def x(self) -> Array:
        """Rear axle at each sample [m]. Shape (N,)."""
        return self.samples.states[:, 0]

    @property
    def y(self) -> Array:
        """Rear axle at each sample [m]. Shape (N,)."""
        return self.samples.states[:, 1]

    @property
    def theta(self) -> Array:
        """Truck heading at each sample [rad]. Shape (N,)."""
        return self.samples.states[:, 2]

    @property
    def alpha(self) -> Array:
        """Hitch angle at each sample [rad]. Shape (N,)."""
        return self.samples.states[:, 3]

    @property
    def phi(self) -> Array:
        """Steering angle at each sample [rad]. Shape (N,)."""
        return self.samples.phi


def segment_from_states(direction: int, s: Array, states: Array, phi: Array) -> Segment:
    """A segment from states of shape (n, 4); s may start anywhere and is shifted to start at 0."""
    s = np.asarray(s, float)
    x, y, theta, alpha = np.asarray(states, float).T
    return Segment(direction=direction, s=s - s[0], x=x, y=y, theta=theta, alpha=alpha, phi=phi)


def roll_out_segment(vehicle: Vehicle, state0: Array, direction: int, s: Array, phi: Array) -> Segment:
    """The segment that the kinematics make of the steering angles phi at the arc lengths s, from state0."""
    return segment_from_states(direction, s, roll_out(vehicle, state0, s, phi, direction), phi)


def sample_segment(vehicle: Vehicle, segment: Segment, s: Array) -> tuple[Array, Array]:
    """States (n, 4) and steering (n,) at arc lengths s (n,) of a segment: stored where stored, else integrated."""
    s = np.clip(np.asarray(s, float), 0.0, segment.length)
    left = np.clip(np.searchsorted(segment.s, s, side="right") - 1, 0, segment.num_samples - 2)
    phi = np.interp(s, segment.s, segment.phi)
    place = (segment.states, segment.s, segment.phi, float(segment.direction), vehicle.kinematics)
    return _sample(*place, frozen(s), frozen_int(left), frozen(phi)), phi


@kernel
def _sample(states, along, steering, d, kinematics, s, left, phi):
    """States at s, each integrated from the sample left of it."""
    out = np.empty((s.size, 4))
    span, steer = np.empty(2), np.empty(2)
    for k in range(s.size):
        i = left[k]
        if abs(s[k] - along[i + 1]) <= LENGTH_TOLERANCE:
            out[k] = states[i + 1]
        elif s[k] - along[i] > LENGTH_TOLERANCE:
            span[0], span[1], steer[0], steer[1] = along[i], s[k], steering[i], phi[k]
            out[k] = roll_out_kernel(states[i], span, steer, d, kinematics, LARGEST_STEP)[1]
        else:
            out[k] = states[i]
    return out


def resample(vehicle: Vehicle, path: Path, spacing: float) -> Path:
    """The same path with samples at most `spacing` [m] apart: samples are added by integration, and none moves.

    Stored samples stay, since phi is linear only between them.
    """
    segments = []
    for segment in path.segments:
        counts = np.maximum(1, np.ceil(np.diff(segment.s) / spacing - LENGTH_TOLERANCE).astype(int))
        if counts.max() == 1:
            segments.append(segment)
            continue
        pieces = [
            np.linspace(a, b, n, endpoint=False) for a, b, n in zip(segment.s, segment.s[1:], counts, strict=False)
        ]
        s = np.concatenate([*pieces, segment.s[-1:]])
        states, phi = sample_segment(vehicle, segment, s)
        segments.append(segment_from_states(segment.direction, s, states, phi))
    return Path(tuple(segments))


def merge(segments: Sequence[Segment]) -> Path:
    """Join neighbours of equal direction into one segment where the steering is continuous.

    Where it jumps by more than `STEER_TOLERANCE`, the vehicle stands still to steer, and they stay apart.
    """
    runs: list[list[Segment]] = []
    for segment in segments:
        before = runs[-1][-1] if runs else None
        goes_on = before is not None and before.direction == segment.direction
        if before is not None and goes_on and abs(segment.phi[0] - before.phi[-1]) <= STEER_TOLERANCE:
            runs[-1].append(segment)
        else:
            runs.append([segment])
    return Path(tuple(run[0] if len(run) == 1 else _joined(run) for run in runs))


def _joined(run: list[Segment]) -> Segment:
    columns, start = [], 0.0
    for segment in run:
        keep = slice(0, -1) if segment is not run[-1] else slice(None)
        columns.append((start + segment.s[keep], segment.states[keep], segment.phi[keep]))
        start += segment.length
    s, states, phi = (np.concatenate(column) for column in zip(*columns, strict=True))
    return segment_from_states(run[0].direction, s, states, phi)


def reverse(path: Path) -> Path:
    """The same curve driven from its end to its start, gears swapped (time reversal)."""
    return Path(
        tuple(
            segment_from_states(-seg.direction, seg.length - seg.s[::-1], seg.states[::-1], seg.phi[::-1])
            for seg in reversed(path.segments)
        )
    )
