"""The truck with one trailer as a `Model`: knots in, augmented Lagrangian out."""

from dataclasses import replace
from typing import NamedTuple

import numpy as np

from optim.geometry.polygons import PackedScene
from optim.knots.transcription import Knots, within_rate
from optim.methods.ddp.backward import Expansion, Policy, new_expansion
from optim.methods.ddp.constraints import Lagrangian, Rows, residuals
from optim.methods.ddp.features import list_features
from optim.methods.ddp.truck import CONTROLS, CURVED, LEVER, STATES, Stages, expand, roll_out
from optim.model.problem import Problem
from optim.numerics.arrays import Array, IntArray

LONGEST_STEP = 1.0
"""Step lengths stay below this [m]: the Runge-Kutta step is exact to 1e-6 m there."""
SHORTEST_SEGMENT = 0.05
"""Segments do not get shorter than this [m]; what is about to vanish is merged before."""
HITCH_ROOM = 2e-4
"""The hitch angle stays that far from its limit at knots [rad], since between knots it may be larger."""
MOST_POLYGONS = 6
"""Polygons near one body at one knot that are looked at, the nearest ones."""
_STALE = 0.1  # share of the reach; where knots have moved farther, the list of features is made anew
_ROOM = 2048  # features to begin with; where there are more, the list is made anew


class Residuals(NamedTuple):
    """Of goal [m, rad], hitch angle [rad] and clearance [m], the largest each."""

    complementary: tuple[float, float, float]
    """What decides convergence: for the inequalities |max(c, -lambda / rho)|."""
    violation: tuple[float, float, float]
    """What decides feasibility: max(c, 0)."""


def stages_of(problem: Problem, knots: Knots) -> Stages:
    """One stage for each interval, and one before them that chooses the first steering angle and length."""
    gear = np.concatenate([[0.0], knots.gear.astype(float)])
    share, shortest, longest = np.zeros_like(gear), np.zeros_like(gear), np.zeros_like(gear)
    for run in knots.runs:
        count = run.stop - run.start
        share[run.start + 1 : run.stop + 1] = 1.0 / count
        shortest[run.start], longest[run.start] = SHORTEST_SEGMENT, LONGEST_STEP * count
    jump = np.where(gear == 0.0, problem.weights.jump, 0.0)
    jump[0] = 0.0
    vehicle, weights = problem.vehicle, problem.weights
    return Stages(
        gear=gear,
        share=share,
        jump=jump,
        toll=np.zeros_like(gear),
        shortest=shortest,
        longest=longest,
        weights=np.array([weights.length, weights.steer, weights.rate]),
        limits=np.array([vehicle.max_steer, vehicle.max_steer_rate]),
        kinematics=np.array(vehicle.kinematics),
    )


def trajectory_of(knots: Knots, limits: tuple[float, float]) -> tuple[Array, Array]:
    """States (N + 1, 6) and controls (N, 2) of the knots; steps become equal in each segment.

    The steering is brought within `limits`, on itself [rad] and on its rate [rad/m].
    """
    states = np.zeros((len(knots.phi) + 1, STATES))
    states[1:, :4] = knots.states
    states[0, :4] = knots.states[0]
    lengths = np.asarray(knots.lengths)
    for run, length in zip(knots.runs, lengths, strict=True):
        states[run.start + 1 : run.stop + 2, 5] = length
    steer = np.clip(knots.phi, -limits[0], limits[0])
    # equal to the rate's limit but for rounding: the bounds of the first expansion must hold
    states[1:, 4] = within_rate(replace(knots, phi=steer), limits[1] * (1.0 - 1e-9))
    states[0, 4:] = states[1, 4:]
    controls = states[1:, 4:].copy()
    controls[np.concatenate([[0], knots.gear]) != 0, 1] = 0.0
    return states, controls


def knots_from(states: Array, knots: Knots) -> Knots:
    """The inverse of `trajectory_of`, gears as in `knots`."""
    h = np.zeros(len(knots.gear))
    for run in knots.runs:
        h[run] = states[run.start + 1, 5] / (run.stop - run.start)
    return Knots(states[1:, :4].copy(), states[1:, 4].copy(), h, knots.gear)


class TruckModel:
    """Stages, constraints and their multipliers; `solver.Model`.

    required: clearance at each knot by truck and trailer [m], shape (K, 2); reach: of the list of features [m];
    curvature: whether there is room for second derivatives.
    """

    def __init__(self, problem: Problem, knots: Knots, required: Array, reach: float, curvature: bool) -> None:
        self.problem = problem
        self.stages = stages_of(problem, knots)
        self.reach = reach
        count = len(self.stages.gear)
        curved = CURVED if curvature else 0
        self.expansion = new_expansion(count, STATES, CONTROLS, curved, moving_bounds=True)
        ends = max(abs(problem.initial.start[3]), abs(problem.initial.goal[3]))
        self.lagrangian = Lagrangian(
            goal=np.array(problem.initial.goal),
            goal_multiplier=np.zeros(4),
            hitch_multiplier=np.zeros((count + 1, 2)),
            required=np.concatenate([required[:1], required]),
            scalars=np.array([1.0, 1.0, 1.0, max(problem.vehicle.max_hitch - HITCH_ROOM, ends)]),
        )
        none = np.zeros(0, np.int64)
        self._listed: Array | None = None
        self.rows = Rows(np.zeros(count + 2, np.int64), none, none, none, np.zeros(0))

    @property
    def _scene(self) -> PackedScene:
        return self.problem.scene.packed

    def refresh(self, states: Array) -> None:
        """List the features near each knot anew, multipliers kept, if a knot has moved by `_STALE` of the reach."""
        if self._listed is not None:
            moved = np.abs(states[:, :4] - self._listed).max(axis=0) * (1.0, 1.0, LEVER, LEVER)
            if moved.max() < _STALE * self.reach:
                return
        self._listed = states[:, :4].copy()
        vehicle, room = self.problem.vehicle, max(_ROOM, len(self.rows.body))
        first = np.zeros(len(states) + 1, np.int64)
        while True:
            body, polygon, feature = (np.empty(room, np.int64) for _ in range(3))
            multiplier = np.empty(room)
            place = (self._scene, vehicle.footprints, vehicle.hitch_offset, states, self.reach, MOST_POLYGONS)
            count = list_features(*place, self.rows, first, body, polygon, feature, multiplier)
            if count <= room:
                break
            room = 2 * count
        self.rows = Rows(first, body[:count], polygon[:count], feature[:count], multiplier[:count])

    def take_over(self, other: "TruckModel", knot: IntArray, share: Array) -> None:
        """Start with the multipliers of another model: knot k's are share[k] times those of its knot[k]."""
        counts = (other.rows.first[1:] - other.rows.first[:-1])[knot]
        first = np.concatenate([[0], np.cumsum(counts)])
        pick = np.repeat(other.rows.first[:-1][knot] - first[:-1], counts) + np.arange(first[-1])
        columns = (other.rows.body[pick], other.rows.polygon[pick], other.rows.feature[pick])
        self.rows = Rows(first, *columns, other.rows.multiplier[pick] * np.repeat(share, counts))
        self.lagrangian.goal_multiplier[:] = other.lagrangian.goal_multiplier
        self.lagrangian.hitch_multiplier[:] = other.lagrangian.hitch_multiplier[knot] * share[:, None]

    def expand(self, states: Array, controls: Array, curvature: bool) -> tuple[float, Expansion]:
        """As `solver.Model` asks for it; features are listed anew where that is needed."""
        self.refresh(states)
        place = (self.stages, self._scene, self.problem.vehicle.footprints, self.rows, self.lagrangian)
        return expand(*place, states, controls, curvature, self.expansion), self.expansion

    def roll_out(self, states: Array, controls: Array, policy: Policy, step: float, out: tuple[Array, Array]) -> float:
        """As `solver.Model` asks for it; infinite where a knot moves out of the reach of its list of features."""
        place = (self.stages, self._scene, self.problem.vehicle.footprints, self.rows, self.lagrangian)
        return roll_out(*place, self.expansion, states, controls, policy, step, self.reach, *out)

    def residuals(self, states: Array, update: bool) -> Residuals:
        """Largest residuals and violations; with `update`, the multipliers move."""
        vehicle = self.problem.vehicle
        place = (self._scene, vehicle.footprints, vehicle.hitch_offset, self.rows, self.lagrangian)
        goal, hitch, clear, over, short = residuals(*place, states, update)
        return Residuals((goal, hitch, clear), (goal, over, short))
