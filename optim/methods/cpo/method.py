"""Coordinate points optimisation (CPO) that ends in drivable paths.

Source: Esteban Cabezos 2020, section 4.2, equation (17), after Dolgov et al. 2010: the points of the trailer's axle
are moved to lower four terms (`optim.methods.cpo.terms`), each one-direction segment by itself, the gear changes
fixed. Two samples at each end of each segment are anchored, and points that collide are anchored where they were
recorded and the others moved again, in rounds.

Differences from the source, each because its own version leaves a gap: obstacles act on discs that contain truck and
trailer (`optim.methods.cpo.discs`), not on a point without orientation (`obstacles="points"` is the source's); value
and gradient come from one interpolated distance field; turns are signed; the minimiser knows the scale of the terms
(`optim.methods.cpo.descent`); and the points become a path by a fit of continuous sharpness that keeps the limits
(`optim.methods.cpo.drivable`). A segment whose stretch fails a check after the last round, or does not lower J, stays
as it was recorded, and the reason says which and why.
"""

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from optim.geometry.field import DistanceField
from optim.methods.cpo.discs import axle_point, covering_discs
from optim.methods.cpo.points import Row, Track, spread
from optim.methods.cpo.rounds import TOLERATED, Settings, Trial, checks, improve
from optim.methods.cpo.terms import Terms
from optim.model.clearance import distance_field
from optim.model.flat_map import not_flat
from optim.model.objective import objective
from optim.model.path import Path, Segment
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Picture, Result, Stop, ignore
from optim.numerics.arrays import frozen
from optim.numerics.checks import require

_DEAREST = 1000.0  # of a cell, equation (18)
_LEAST_GAIN = 1e-6  # of J, relative: less is rounding


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
    """In each round the points are laid out evenly again and moved on, this often at most [-]."""
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
        settings = self.settings(problem)
        progress = _Progress(problem, on_iterate)
        rows: list[Row] = []
        for index, segment in enumerate(problem.initial.segments):
            trial = improve(settings, segment, lambda failed, index=index: progress.turn_down(index, failed))
            is_taken = progress.judge(index, trial)
            rows.append(trial.row if is_taken else _recorded_row(settings, segment))
        return progress.result(_picture(settings.terms, rows))

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

    def settings(self, problem: Problem) -> Settings:
        """What the rounds of each segment need."""
        return Settings(
            problem=problem,
            terms=self.terms(problem, self.spacing),
            spacing=self.spacing,
            rounds=self.rounds,
            sweeps=self.sweeps,
            memory=self.max_iterations if self.minimiser == "bfgs" else 20,
            max_iterations=self.max_iterations,
            tolerance=self.tolerance,
            max_step=self.max_step,
            sample_spacing=self.sample_spacing,
        )


class _Progress:
    """The path so far, what is told of it, and what is said of it in the end."""

    def __init__(self, problem: Problem, on_iterate: OnIterate) -> None:
        self.problem = problem
        self.on_iterate = on_iterate
        self.path = problem.initial
        self.value = objective(self.path, problem.weights)
        self.number, self.steps, self.deviation = 0, 0, 0.0
        self.kept: list[tuple[int, str, bool]] = []  # segment, why it stays as recorded, whether it failed a check
        self._told = self.path
        on_iterate(Iterate(iteration=0, path=self.path, objective=self.value))

    def turn_down(self, index: int, trial: Trial) -> None:
        """Tell of a trial that is not taken."""
        if trial.stretch is not None:
            path = self._with(index, trial.stretch.segment)
            self._tell(trial, path, objective(path, self.problem.weights), is_accepted=False)

    def judge(self, index: int, trial: Trial) -> bool:
        """Take the segment's last trial if it is sound and lowers J; else note why it stays as it was."""
        self.steps += trial.iterations
        if trial.stretch is None:
            self.kept.append((index, "no drivable curve was found beside its points", True))
        elif not trial.is_sound:
            failed = [str(check) for check in trial.checks if not check.is_kept]
            self.kept.append((index, f"{', '.join(failed)} after round {trial.round}", True))
        else:
            path = self._with(index, trial.stretch.segment)
            value = objective(path, self.problem.weights)
            if value < self.value * (1.0 - _LEAST_GAIN):
                self.path, self.value = path, value
                self.deviation = max(self.deviation, trial.stretch.deviation)
                self._tell(trial, path, value, is_accepted=True)
                return True
            more = value - self.value
            why = f"J would rise by {more:.2g}" if more > _LEAST_GAIN * self.value else "there is nothing to gain"
            self.kept.append((index, why, False))
            self.turn_down(index, trial)
        return False

    def result(self, picture: Picture) -> Result:
        """What came of it; the path that was given where a stretch that stays is itself unsound."""
        unsound = [
            f"{self._name(index)}: {check}"
            for index, _, _ in self.kept
            for check in checks(self.problem, self.path.segments[index])
            if check.residual > TOLERATED
        ]
        improved = len(self.path.segments) - len(self.kept)
        reason, stop = self._reason(improved), Stop.CONVERGED
        if unsound:
            self.path = self.problem.initial
            reason = f"What stays as recorded is not sound ({'; '.join(unsound)}); {reason}"
            stop = Stop.INFEASIBLE
        elif any(failed for _, _, failed in self.kept):
            stop = Stop.STALLED
        if self._told is not self.path:
            value = objective(self.path, self.problem.weights)
            self.on_iterate(Iterate(iteration=self.number + 1, path=self.path, objective=value))
        return Result(path=self.path, stop=stop, reason=reason, iterations=self.steps, picture=picture)

    def _reason(self, improved: int) -> str:
        parts = [f"{improved} of {len(self.path.segments)} segments improved"]
        if improved:
            parts.append(f"the path is within {self.deviation:.3f} m of the points")
        parts += [f"{self._name(index)} stays as recorded: {why}" for index, why, _ in self.kept]
        return "; ".join(parts)

    def _name(self, index: int) -> str:
        gear = "forward" if self.path.segments[index].direction > 0 else "reverse"
        return f"segment {index + 1} ({gear})"

    def _with(self, index: int, segment: Segment) -> Path:
        return Path((*self.path.segments[:index], segment, *self.path.segments[index + 1 :]))

    def _tell(self, trial: Trial, path: Path, value: float, is_accepted: bool) -> None:
        self.number += 1
        self._told = path
        self.on_iterate(
            Iterate(
                iteration=self.number,
                path=path,
                objective=value,
                violation=max(0.0, *(check.residual - 1.0 for check in trial.checks)),
                step=trial.step,
                residuals={check.name: check.residual for check in trial.checks},
                accepted=is_accepted,
            )
        )


def _field(problem: Problem, resolution: float) -> DistanceField:
    """Distances wherever a body may come: as far round the path as it is long."""
    vehicle, states = problem.vehicle, problem.initial.samples.states
    reach = vehicle.truck_front + vehicle.hitch_to_axle + vehicle.trailer_rear
    low, high = states[:, :2].min(axis=0) - reach, states[:, :2].max(axis=0) + reach
    return distance_field(problem.scene, resolution, (low[0], low[1], high[0], high[1]))


def _recorded_row(settings: Settings, segment: Segment) -> Row:
    """The points of a segment that stays: all of them anchored."""
    track = Track.of(settings.problem.vehicle, segment)
    everywhere = np.array([[0.0, 1.0]])
    return spread(track, track.flat[:, :2], track.share, settings.spacing, everywhere)


def _picture(terms: Terms, rows: list[Row]) -> Picture:
    """The points where they ended, and the map of costs: of a cell as in equation (18)."""
    field = terms.field
    return Picture(
        points=frozen(np.concatenate([row.on_path for row in rows])),
        anchored=np.concatenate([row.anchored[1:-1] for row in rows]),
        cost_map=frozen(_DEAREST * np.clip(1.0 - field.values / terms.d_max, 0.0, 1.0)),
        origin=field.origin,
        resolution=field.resolution,
    )
