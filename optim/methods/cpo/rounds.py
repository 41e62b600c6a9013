"""One segment: move its points, fit a drivable stretch, check it, anchor what fails, and again.

A round moves the points from the recorded path (or what is anchored of it) to the least F. In between they are laid
out evenly again: a detour that has gone leaves them crowded. Then the stretch beside them is checked as the audit
will check it: limits at the samples, clearance between them. Points where it fails are anchored where they were
recorded, more of them around with every round, and the next round moves the others.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple

import numpy as np

from optim.methods.cpo.descent import Descent, descend
from optim.methods.cpo.drivable import Stretch, drivable_stretch
from optim.methods.cpo.points import Row, Track, spread
from optim.methods.cpo.terms import Terms
from optim.model.clearance import swept_clearance
from optim.model.path import Segment, segment_from_states
from optim.model.problem import Problem
from optim.numerics.arrays import Array, BoolArray

_SLACK = 1e-9  # of limits, relative: rounding
TOLERATED = 1.001  # residual of a recorded stretch that counts as kept: the audit relaxes limits by as much
_SPREAD = 1e-3  # change of length, relative, from which on laying the points out anew is worth another descent
_KEEP_AWAY, _FARTHER = (
    3.0,
    0.05,
)  # factor of w_o and addition to d_max [m] from round to round, where nothing can anchor
_CLOSED = 1e-7  # a fit that misses its end by more [m or rad] has not converged


@dataclass(frozen=True, eq=False, kw_only=True)
class Settings:
    """What the rounds need besides the segment; the options of `optim.methods.cpo.method.Cpo`."""

    problem: Problem
    terms: Terms
    spacing: float
    """Between points [m]."""
    rounds: int
    sweeps: int
    memory: int
    """Pairs of steps and gradients that the minimiser keeps."""
    max_iterations: int
    tolerance: float
    max_step: float
    """[m]."""
    sample_spacing: float
    """Between samples of the stretch [m]."""


class Check(NamedTuple):
    """One thing that a stretch must keep, and where it does not."""

    name: str
    value: float  # the worst
    limit: float
    unit: str
    residual: float  # 1 or less where it is kept
    fails: BoolArray  # (n,) samples at or beside which it fails

    @property
    def is_kept(self) -> bool:
        """Whether it fails nowhere."""
        return not self.fails.any()

    def __str__(self) -> str:
        return f"{self.name} {self.value:.4g} {self.unit}, limit {self.limit:.4g}"


class Trial(NamedTuple):
    """What a round made of the segment."""

    row: Row
    stretch: Stretch | None  # None where no curve beside the points was found
    checks: tuple[Check, ...]
    round: int  # from 1
    iterations: int  # of the minimiser
    step: float  # largest distance of a point from where it was recorded [m]

    @property
    def is_sound(self) -> bool:
        """Whether there is a stretch that keeps everything."""
        return self.stretch is not None and all(check.is_kept for check in self.checks)


def checks(problem: Problem, segment: Segment) -> tuple[Check, ...]:
    """Limits and clearance of a segment, as the audit will look at them."""
    vehicle = problem.vehicle
    rate = np.abs(np.diff(segment.phi) / np.diff(segment.s))
    clearance = swept_clearance(problem.scene, vehicle, segment.s, segment.states, segment.phi).min(axis=1)
    required = problem.required_clearance
    limits = (
        ("steering angle", np.abs(segment.phi), vehicle.max_steer, "rad"),
        ("hitch angle", np.abs(segment.alpha), vehicle.max_hitch, "rad"),
        ("steering rate", rate, vehicle.max_steer_rate, "rad/m"),
    )
    found = [
        Check(
            name, values.max(), limit, unit, values.max() / limit, _at_samples(values > limit * (1.0 + _SLACK), segment)
        )
        for name, values, limit, unit in limits
    ]
    low = float(clearance.min())
    short = _at_samples(clearance < required, segment)
    # a deficit of a millimetre counts as one, as a limit exceeded does
    found.append(Check("clearance", low, required, "m", max(0.0, 1.0 + (required - low) / 1e-3), short))
    return tuple(found)


def _at_samples(fails: BoolArray, segment: Segment) -> BoolArray:
    """Intervals' failures at both of their samples; samples' own as they are."""
    if len(fails) == segment.num_samples:
        return fails
    return np.concatenate([fails, [False]]) | np.concatenate([[False], fails])


def improve(settings: Settings, segment: Segment, tell: Callable[[Trial], None]) -> Trial:
    """The first sound trial, or the last one; `tell` gets those before it."""
    track = Track.of(settings.problem.vehicle, segment)
    can_anchor = all(check.residual <= TOLERATED for check in checks(settings.problem, segment))
    anchors = np.empty((0, 2))
    iterations = 0
    turn = 0
    while True:
        turn += 1
        trial = _round(settings, segment, track, anchors)._replace(round=turn)
        iterations += trial.iterations
        if trial.is_sound or trial.stretch is None or trial.row.anchored.all() or turn == settings.rounds:
            break
        tell(trial)
        if not can_anchor:  # the recorded stretch is no place to go back to; keep away further instead
            terms = settings.terms
            terms = replace(terms, obstacle=_KEEP_AWAY * terms.obstacle, d_max=terms.d_max + _FARTHER)
            settings = replace(settings, terms=terms)
            continue
        widening = turn * settings.spacing / track.length
        anchors = np.concatenate([anchors, _failing(track, trial, widening)])
    return trial._replace(iterations=iterations)


def _round(settings: Settings, segment: Segment, track: Track, anchors: Array) -> Trial:
    iterations = 0
    row = spread(track, track.flat[:, :2], track.share, settings.spacing, anchors)
    for _ in range(settings.sweeps):
        length = row.length
        descent = move(settings, row)
        iterations += descent.iterations
        row = spread(track, descent.points[1:-1], row.share[1:-1], settings.spacing, anchors)
        if abs(row.length - length) <= _SPREAD * length:
            break
    step = float(np.hypot(*(row.points - track.at(row.share)).T)[1:-1].max())
    vehicle, ends = settings.problem.vehicle, (track.flat[0], track.flat[-1])
    stretch = drivable_stretch(vehicle, track.direction, row.on_path, *ends, settings.sample_spacing)
    if stretch is None or stretch.gap > _CLOSED:
        return Trial(row, None, (), 0, iterations, step)
    # the flat map and back loses the last digit; cusps share a pose exactly
    states = stretch.segment.states.copy()
    states[0], states[-1] = segment.states[0], segment.states[-1]
    exact = segment_from_states(segment.direction, stretch.segment.s, states, stretch.segment.phi)
    found = checks(settings.problem, exact)
    return Trial(row, replace(stretch, segment=exact), found, 0, iterations, step)


def move(settings: Settings, row: Row) -> Descent:
    """The points at the least F."""
    return descend(
        replace(settings.terms, spacing=row.spacing).evaluate,
        row.points,
        ~row.anchored,
        memory=settings.memory,
        max_iterations=settings.max_iterations,
        tolerance=settings.tolerance,
        max_step=settings.max_step,
    )


def _failing(track: Track, trial: Trial, widening: float) -> Array:
    """Where the trial fails, as intervals of shares, widened at both ends. Shape (k, 2)."""
    assert trial.stretch is not None
    fails = np.any([check.fails for check in trial.checks], axis=0)
    segment = trial.stretch.segment
    cos = np.cos(segment.alpha)
    along = np.concatenate([[0.0], np.cumsum(np.diff(segment.s) * (cos[1:] + cos[:-1]) / 2.0)])
    if track.direction < 0:
        fails, along = fails[::-1], along[-1] - along[::-1]
    points = trial.row.on_path
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    share = np.interp(along / along[-1], distance / distance[-1], trial.row.share[1:-1])
    edges = np.diff(np.concatenate([[0], fails.astype(int), [0]]))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return np.stack([share[first] - widening, share[last] + widening], axis=1)
