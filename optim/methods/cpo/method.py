"""Coordinate points optimisation (CPO) that ends in drivable paths.

Source: Esteban Cabezos 2020, section 4.2, equation (17), after Dolgov et al. 2010: the points of the trailer's axle
are moved to lower four terms (`optim.methods.cpo.terms`), each one-direction segment by itself, the gear changes
fixed. Two samples at each end of each segment are anchored, and points that collide are anchored where they were
recorded and the others moved again, in rounds.

Differences from the source, each because its own version leaves a gap: obstacles act on discs that contain truck and
trailer (`optim.methods.cpo.discs`), not on a point without orientation (`obstacles="points"` is the source's); value
and gradient come from one interpolated distance field; turns are signed; the minimiser knows the scale of the terms
(`optim.methods.cpo.bfgs`); and the points become a path by a fit of continuous sharpness that keeps the limits
(`optim.methods.cpo.drivable`). A segment whose stretch fails a check after the last round, or does not lower J, stays
as it was recorded, and the reason says which and why.

A round moves the points from the recorded path (or what is anchored of it) to the least F. In between they are laid
out evenly again: a detour that disappears leaves them crowded. Then the stretch beside them is checked
(`optim.methods.cpo.trial`). Points where it fails are anchored where they were recorded, more of them around with
every round, and the next round moves the others.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

import numpy as np

from optim.geometry.field import DistanceField
from optim.methods.cpo.assembly import Assembly
from optim.methods.cpo.bfgs import BfgsSolution, minimise_bfgs
from optim.methods.cpo.discs import axle_point, covering_discs
from optim.methods.cpo.drivable import drivable_stretch
from optim.methods.cpo.points import AxlePoints, RecordedAxle, spread
from optim.methods.cpo.terms import Terms
from optim.methods.cpo.trial import TOLERATED, SegmentTrial, limit_checks
from optim.model.clearance import distance_field
from optim.model.flat_map import not_flat
from optim.model.path import Segment, segment_from_states
from optim.model.problem import Problem
from optim.model.result import OnIterate, Picture, Result, Stop, ignore
from optim.numerics.arrays import Array, frozen
from optim.numerics.checks import require

_DEAREST = 1000.0  # of a cell, equation (18)
_LBFGS_MEMORY = 20  # pairs of steps and gradients
_SPREAD = 1e-3  # relative change of length from which on laying the points out again is worth another descent
_KEEP_AWAY, _FARTHER = 3.0, 0.05  # factor of w_o and addition to d_max [m] per round, where nothing can be anchored
_CLOSED = 1e-7  # a fit that misses its end by more [m or rad] has not converged


@dataclass(frozen=True, kw_only=True)
class Cpo:
    """Move the points of the trailer's axle, then fit a drivable path beside them.

    The weights of smoothness and change are J's own: by the flat map, for small curvatures and J's default weights,

        J = int 1 + (l_t^2 / 2 + l^2 / 2) kappa^2 + (l^2 l_t^2 / 2 + 5 l^2) sigma^2 + 5 l^2 l_t^2 (dsigma/ds_f)^2 ds_f,

    and the first two brackets are 38 m and 480 m^3 for the default truck. Over the sample logs J falls to 93.1 % with
    them (geometric mean, all twelve improved); to 93.2 % with half and 93.1 % with double the weight of change; over
    40 random problems with four vehicles to 98.1 %, 98.1 % and 98.2 %.
    """

    obstacles: Literal["discs", "points"] = "discs"
    """discs: discs that contain truck and trailer, in their orientation; points: the trailer's axle in a map of
    square cells (the source's, equation 18)."""
    weight_obstacle: float = 300.0
    """Weight of the squared lack of distance, over arc length and the bodies' outline, w_o [1/m^4].

    Enough to hold the points off: on the sample logs nothing had to be anchored, and a third gives the same J."""
    weight_curvature: float = 1000.0
    """Weight of the squared curvature of either axle beyond 98 % of its limit, over arc length, w_k [m].

    Ten times as much gives the same J."""
    weight_smoothness: float = 40.0
    """Weight of the squared second difference of the points, by arc length, w_s [m]."""
    weight_change: float = 500.0
    """Weight of the squared change of curvature, by arc length, w_g [m^3]."""
    d_max: float = 0.1
    """Discs cost where their distance to an obstacle is below the required clearance plus this [m]."""
    excess: float = 0.1
    """Discs protrude from the bodies by at most this [m]."""
    resolution: float = 0.25
    """Cells of the distance field for discs [m]."""
    map_d_max: float = 1.8
    """The point costs where its distance to an obstacle is below this [m]: half a width and half a metre."""
    map_resolution: float = 0.5
    """Cells of the map for the point [m] (the source's)."""
    spacing: float = 0.5
    """Distance between points [m]."""
    minimiser: Literal["bfgs", "lbfgs"] = "bfgs"
    """bfgs: every pair of steps and gradients since the metric was last evaluated is kept; lbfgs: the last twenty."""
    max_iterations: int = 100
    """Steps of the minimiser, at most, in each sweep of a round [-]."""
    tolerance: float = 1e-4
    """A sweep ends when the decrease still promised is at most tolerance * cost [-]."""
    max_step: float = 0.5
    """No point moves further in one step [m]: a longer one may jump over an obstacle."""
    sweeps: int = 2
    """Maximum number of rounds, each of which lays the points out evenly again and moves them on [-]."""
    rounds: int = 12
    """Rounds of anchoring for each segment, at most [-]; then it stays as recorded."""
    sample_spacing: float = 0.05
    """Distance between samples of the path [m]."""

    def __post_init__(self) -> None:
        positive = ("d_max", "excess", "resolution", "map_d_max", "map_resolution", "spacing", "max_step")
        require(
            self,
            "cpo",
            obstacles=("discs or points", self.obstacles in ("discs", "points")),
            minimiser=("bfgs or lbfgs", self.minimiser in ("bfgs", "lbfgs")),
            sample_spacing=("more than 0 and at most 0.1 m", 0.0 < self.sample_spacing <= 0.1),
            tolerance=("more than 0 and less than 1", 0.0 < self.tolerance < 1.0),
            weight_smoothness=("a number above 0", 0.0 < self.weight_smoothness < math.inf),
            **{name: ("1 or more", getattr(self, name) >= 1) for name in ("max_iterations", "sweeps", "rounds")},
            **{name: ("a length above 0 m", 0.0 < getattr(self, name) < math.inf) for name in positive},
            **{
                name: ("a number of 0 or more", 0.0 <= getattr(self, name) < math.inf)
                for name in ("weight_obstacle", "weight_curvature", "weight_change")
            },
        )

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        """Improve the path segment by segment; ends, gear changes and `problem.required_clearance` are kept."""
        if sentence := not_flat(problem.vehicle):
            return Result(path=problem.initial, stop=Stop.FAILED, reason=sentence, iterations=0)
        terms, assembly = self.terms(problem, self.spacing), Assembly(problem, on_iterate)
        shown: list[AxlePoints] = []
        for index, segment in enumerate(problem.initial.segments):
            trial = self.improve_segment(problem, terms, segment, partial(assembly.reject, index))
            is_taken = assembly.judge(index, trial)
            shown.append(trial.points if is_taken else self._recorded_points(problem, segment))
        return assembly.result(_picture(terms, shown))

    def terms(self, problem: Problem, spacing: float) -> Terms:
        """The cost of points that are `spacing` [m] apart."""
        vehicle, is_point = problem.vehicle, self.obstacles == "points"
        return Terms(
            vehicle=vehicle,
            discs=axle_point(vehicle) if is_point else covering_discs(vehicle, self.excess),
            field=_field(problem, self.map_resolution if is_point else self.resolution),
            d_max=self.map_d_max if is_point else problem.required_clearance + self.d_max,
            obstacle=self.weight_obstacle,
            curvature=self.weight_curvature,
            smoothness=self.weight_smoothness,
            change=self.weight_change,
            spacing=spacing,
        )

    def improve_segment(
        self, problem: Problem, terms: Terms, segment: Segment, on_rejected: Callable[[SegmentTrial], None]
    ) -> SegmentTrial:
        """The first sound trial of the rounds, or the last one; `on_rejected` gets those before it."""
        axle = RecordedAxle.of(problem.vehicle, segment)
        can_anchor = all(check.residual <= TOLERATED for check in limit_checks(problem, segment))
        anchors, iterations, number = np.empty((0, 2)), 0, 0
        while True:
            number += 1
            trial = self._round(problem, terms, segment, axle, anchors)._replace(round=number)
            iterations += trial.iterations
            is_last = trial.stretch is None or trial.points.anchored.all() or number == self.rounds
            if trial.is_sound or is_last:
                return trial._replace(iterations=iterations)
            on_rejected(trial)
            if can_anchor:
                anchors = np.concatenate([anchors, _failing(axle, trial, number * self.spacing / axle.length)])
            else:  # the recorded stretch is not sound itself; keep farther away instead
                terms = replace(terms, obstacle=_KEEP_AWAY * terms.obstacle, d_max=terms.d_max + _FARTHER)

    def _round(
        self, problem: Problem, terms: Terms, segment: Segment, axle: RecordedAxle, anchors: Array
    ) -> SegmentTrial:
        """Move the points, fit a drivable stretch beside them, check it."""
        iterations = 0
        points = spread(axle, axle.flat[:, :2], axle.share, self.spacing, anchors)
        for _ in range(self.sweeps):
            length = points.length
            moved = self._moved(terms, points)
            iterations += moved.iterations
            points = spread(axle, moved.points[1:-1], points.share[1:-1], self.spacing, anchors)
            if abs(points.length - length) <= _SPREAD * length:
                break
        step = float(np.hypot(*(points.xy - axle.at(points.share)).T)[1:-1].max())
        ends = (axle.flat[0], axle.flat[-1])
        stretch = drivable_stretch(problem.vehicle, axle.direction, points.on_path, *ends, self.sample_spacing)
        if stretch is None or stretch.gap > _CLOSED:
            return SegmentTrial(points, None, (), 0, iterations, step)
        # the flat map and back loses the last digit; cusps share a pose exactly
        states = stretch.segment.states.copy()
        states[0], states[-1] = segment.states[0], segment.states[-1]
        exact = segment_from_states(segment.direction, stretch.segment.s, states, stretch.segment.phi)
        found = limit_checks(problem, exact)
        return SegmentTrial(points, replace(stretch, segment=exact), found, 0, iterations, step)

    def _moved(self, terms: Terms, points: AxlePoints) -> BfgsSolution:
        """The points at the least F."""
        return minimise_bfgs(
            replace(terms, spacing=points.spacing).evaluate,
            points.xy,
            ~points.anchored,
            memory=self.max_iterations if self.minimiser == "bfgs" else _LBFGS_MEMORY,
            max_iterations=self.max_iterations,
            tolerance=self.tolerance,
            max_step=self.max_step,
        )

    def _recorded_points(self, problem: Problem, segment: Segment) -> AxlePoints:
        """The points of a segment that stays: all of them anchored."""
        axle = RecordedAxle.of(problem.vehicle, segment)
        everywhere = np.array([[0.0, 1.0]])
        return spread(axle, axle.flat[:, :2], axle.share, self.spacing, everywhere)


def _failing(axle: RecordedAxle, trial: SegmentTrial, widening: float) -> Array:
    """Intervals of shares in which the trial fails, widened at both ends. Shape (k, 2)."""
    assert trial.stretch is not None
    fails = np.any([check.fails for check in trial.checks], axis=0)
    segment = trial.stretch.segment
    cos = np.cos(segment.alpha)
    along = np.concatenate([[0.0], np.cumsum(np.diff(segment.s) * (cos[1:] + cos[:-1]) / 2.0)])
    if axle.direction < 0:
        fails, along = fails[::-1], along[-1] - along[::-1]
    points = trial.points.on_path
    distance = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    share = np.interp(along / along[-1], distance / distance[-1], trial.points.share[1:-1])
    edges = np.diff(np.concatenate([[0], fails.astype(int), [0]]))
    first, last = np.flatnonzero(edges == 1), np.flatnonzero(edges == -1) - 1
    return np.stack([share[first] - widening, share[last] + widening], axis=1)


def _field(problem: Problem, resolution: float) -> DistanceField:
    """Distances wherever a body may come: as far round the path as it is long."""
    vehicle, states = problem.vehicle, problem.initial.samples.states
    reach = vehicle.truck_front + vehicle.hitch_to_axle + vehicle.trailer_rear
    low, high = states[:, :2].min(axis=0) - reach, states[:, :2].max(axis=0) + reach
    return distance_field(problem.scene, resolution, (low[0], low[1], high[0], high[1]))


def _picture(terms: Terms, shown: list[AxlePoints]) -> Picture:
    """The points where they ended, and the map of costs: of a cell as in equation (18)."""
    field = terms.field
    return Picture(
        points=frozen(np.concatenate([points.on_path for points in shown])),
        anchored=np.concatenate([points.anchored[1:-1] for points in shown]),
        cost_map=frozen(_DEAREST * np.clip(1.0 - field.values / terms.d_max, 0.0, 1.0)),
        origin=field.origin,
        resolution=field.resolution,
    )
