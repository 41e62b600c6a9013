"""The truck with one trailer as a `Model` of DDP: knots in, augmented Lagrangian out."""

from dataclasses import replace

import numpy as np

from optim.knots.transcription import Knots, within_rate
from optim.methods.ddp.backward import Expansion, Policy, Trajectory, new_expansion
from optim.methods.ddp.constraints import (
    Bodies,
    ClearanceRows,
    Constraints,
    Lagrangian,
    PerConstraint,
    Residuals,
    residuals,
)
from optim.methods.ddp.features import list_features
from optim.methods.ddp.truck import CONTROLS, CURVED, LEVER, STATES, Stages, StageWeights, expand, roll_out
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
_STALE = 0.1  # share of the reach; where knots have moved farther, features are listed again
_ROOM = 2048  # features to begin with; where there are more, they are listed again


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
    l, l_t, offset = map(float, vehicle.kinematics)
    return Stages(
        gear=gear,
        share=share,
        jump=jump,
        toll=np.zeros_like(gear),
        shortest=shortest,
        longest=longest,
        weights=StageWeights(float(weights.length), float(weights.steer), float(weights.rate)),
        max_steer=float(vehicle.max_steer),
        max_steer_rate=float(vehicle.max_steer_rate),
        kinematics=(l, l_t, offset),
    )


def trajectory_of(knots: Knots, max_steer: float, max_steer_rate: float) -> Trajectory:
    """States (N + 1, 6) and controls (N, 2) of the knots; steps become equal in each segment.

    The steering is brought within its limits, on itself [rad] and on its rate [rad/m].
    """
    states = np.zeros((len(knots.phi) + 1, STATES))
    states[1:, :4] = knots.states
    states[0, :4] = knots.states[0]
    lengths = np.asarray(knots.lengths)
    for run, length in zip(knots.runs, lengths, strict=True):
        states[run.start + 1 : run.stop + 2, 5] = length
    steer = np.clip(knots.phi, -max_steer, max_steer)
    # equal to the rate's limit but for rounding: the bounds of the first expansion must hold
    states[1:, 4] = within_rate(replace(knots, phi=steer), max_steer_rate * (1.0 - 1e-9))
    states[0, 4:] = states[1, 4:]
    controls = states[1:, 4:].copy()
    controls[np.concatenate([[0], knots.gear]) != 0, 1] = 0.0
    return Trajectory(states, controls)


def knots_from(states: Array, knots: Knots) -> Knots:
    """The inverse of `trajectory_of`, gears as in `knots`."""
    h = np.zeros(len(knots.gear))
    for run in knots.runs:
        h[run] = states[run.start + 1, 5] / (run.stop - run.start)
    return Knots(states[1:, :4].copy(), states[1:, 4].copy(), h, knots.gear)


class TruckModel:
    """Stages, constraints and their multipliers; a `Model` of `optim.methods.ddp.algorithm`.

    Args:
        problem: the problem.
        knots: those to begin with; gears and shares of the steps stay.
        required: clearance at each knot by truck and trailer [m]. Shape (K, 2).
        reach: features nearer than this are listed [m].
        curvature: whether there is room for second derivatives.
        penalty: first penalties.
    """

    def __init__(
        self,
        problem: Problem,
        knots: Knots,
        required: Array,
        *,
        reach: float,
        curvature: bool,
        penalty: PerConstraint,
    ) -> None:
        self.problem = problem
        self.stages = stages_of(problem, knots)
        self.reach = reach
        count = len(self.stages.gear)
        curved = CURVED if curvature else 0
        self.expansion = new_expansion(count, STATES, CONTROLS, curved, moving_bounds=True)
        ends = max(abs(problem.initial.start[3]), abs(problem.initial.goal[3]))
        self.lagrangian = Lagrangian(
            penalty=PerConstraint(*map(float, penalty)),
            goal=np.array(problem.initial.goal),
            goal_multiplier=np.zeros(4),
            max_hitch=float(max(problem.vehicle.max_hitch - HITCH_ROOM, ends)),
            hitch_multiplier=np.zeros((count + 1, 2)),
            required=np.concatenate([required[:1], required]),
        )
        none = np.zeros(0, np.int64)
        self.rows = ClearanceRows(np.zeros(count + 2, np.int64), none, none, none, np.zeros(0))
        self._listed: Array | None = None

    @property
    def constraints(self) -> Constraints:
        """What the kernels read of the constraints."""
        vehicle, scene = self.problem.vehicle, self.problem.scene.packed
        return Constraints(scene, Bodies(vehicle.footprints, float(vehicle.hitch_offset)), self.rows, self.lagrangian)

    @property
    def required(self) -> Array:
        """Clearance that is asked for at each knot [m]. Writable. Shape (K, 2)."""
        return self.lagrangian.required[1:]  # the stage before the first knot asks for nothing

    def lower_max_hitch(self, by: float) -> None:
        """Ask for a smaller hitch angle at the knots [rad]."""
        self.lagrangian = self.lagrangian._replace(max_hitch=self.lagrangian.max_hitch - by)

    def set_penalty(self, penalty: PerConstraint) -> None:
        """Replace the penalties; the multipliers stay."""
        self.lagrangian = self.lagrangian._replace(penalty=penalty)

    def list_rows(self, states: Array) -> None:
        """List the features near each knot, multipliers kept, if a knot has moved by `_STALE` of the reach."""
        if self._listed is not None:
            moved = np.abs(states[:, :4] - self._listed).max(axis=0) * (1.0, 1.0, LEVER, LEVER)
            if moved.max() < _STALE * self.reach:
                return
        self._listed = states[:, :4].copy()
        room = max(_ROOM, len(self.rows.body))
        while True:
            first, body, polygon, feature = (np.zeros(n, np.int64) for n in (len(states) + 1, room, room, room))
            new = ClearanceRows(first, body, polygon, feature, np.empty(room))
            count = list_features(self.constraints, states, self.reach, MOST_POLYGONS, new)
            if count <= room:
                break
            room = 2 * count
        self.rows = ClearanceRows(first, body[:count], polygon[:count], feature[:count], new.multiplier[:count])

    def take_over(self, other: "TruckModel", knot: IntArray, share: Array) -> None:
        """Start with the multipliers of another model: knot k's are share[k] times those of its knot[k]."""
        counts = (other.rows.first[1:] - other.rows.first[:-1])[knot]
        first = np.concatenate([[0], np.cumsum(counts)])
        pick = np.repeat(other.rows.first[:-1][knot] - first[:-1], counts) + np.arange(first[-1])
        columns = (other.rows.body[pick], other.rows.polygon[pick], other.rows.feature[pick])
        self.rows = ClearanceRows(first, *columns, other.rows.multiplier[pick] * np.repeat(share, counts))
        self.lagrangian.goal_multiplier[:] = other.lagrangian.goal_multiplier
        self.lagrangian.hitch_multiplier[:] = other.lagrangian.hitch_multiplier[knot] * share[:, None]

    def expand(self, now: Trajectory, curvature: bool) -> tuple[float, Expansion]:
        """Implement `Model.expand`; features are listed again where needed."""
        self.list_rows(now.states)
        return expand(self.stages, self.constraints, now, curvature, self.expansion), self.expansion

    def roll_out(self, now: Trajectory, policy: Policy, step: float, into: Trajectory) -> float:
        """Implement `Model.roll_out`; infinite where a knot leaves the reach of its list of features."""
        return roll_out(self.stages, self.constraints, self.expansion, now, policy, step, self.reach, into)

    def residuals(self, states: Array) -> Residuals:
        """Largest residuals and violations."""
        return residuals(self.constraints, states, False)

    def update_multipliers(self, states: Array) -> Residuals:
        """Move the multipliers by what the constraints lack; the residuals before."""
        return residuals(self.constraints, states, True)
