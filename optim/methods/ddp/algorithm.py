"""Differential dynamic programming on one page, with the kernels in the modules below.

    descend        until the constraints are met                                multipliers and penalties
      minimise     until the projected gradient is small
        expand         derivatives of dynamics and cost along the trajectory    `optim.methods.ddp.truck`
        backward pass  value function and feedback, from the last stage on      `optim.methods.ddp.backward`
        roll out       drive with the feedback, full step first                 `optim.methods.ddp.truck`
        line search    half the step while it does not keep its promise

Gaps between the stages are allowed at the start and shrink by 1 - step with every accepted step; the line search
looks at cost + weight * sum |gap|, the weight above the largest |V_x| beside a gap. Regularisation grows and shrinks
with acceleration (Tassa, Mansard and Todorov 2014).
"""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from optim.knots.transcription import Knots, objective_of
from optim.methods.ddp.backward import Expansion, Outlook, Policy, Trajectory, backward_pass, new_policy
from optim.methods.ddp.constraints import PerConstraint, Residuals
from optim.methods.ddp.model import TruckModel, knots_from, trajectory_of
from optim.model.problem import Problem
from optim.model.result import Stop
from optim.numerics.arrays import Array

FALLEN, GROWTH = 0.25, 4.0
"""Where an update leaves more than this share of a residual, its penalty grows by this factor."""
_MOST_PENALTY = PerConstraint(goal=1e7, hitch=1e6, clearance=1e6)  # growth ends here; a schedule may begin higher
_PATIENCE = 3  # updates within which the worst residual must halve
_NONE_YET = Residuals(PerConstraint(np.inf, np.inf, np.inf), PerConstraint(np.inf, np.inf, np.inf))
_LARGEST_GAP = 1e-9  # of a trajectory that counts as converged, in units of the states: rounding
_LEAST_REGULARISATION, _MOST_REGULARISATION = 1e-4, 1e10  # below the first it is 0, beyond the second all is lost
_LEAST_STEP = 0.2  # where none down to this is good enough, regularisation grows instead
_ACCEPTANCE = 1e-4  # a step must give at least this share of the decrease it promises (Armijo)
_ROUNDING = 1e-12  # promised decreases below this, relative to the cost, are rounding: the full step is taken


@dataclass(frozen=True, kw_only=True)
class PenaltySchedule:
    """How far to go with one set of segments."""

    spacing: float
    """Distance between knots [m]."""
    penalties: PerConstraint
    """Initial penalties [1/m^2, 1/rad^2]."""
    rounds: int
    """Maximum number of updates of the multipliers."""
    iterations: int
    """Maximum number of iterations in each."""
    gradient: float
    """Largest projected gradient that counts as converged."""
    tolerances: PerConstraint
    """Largest residuals that count as converged."""
    regularisation: float = 1.0
    """Regularisation of the first iteration."""
    curvature: bool = True
    """Whether second derivatives are used at all."""
    second_from: int = 1
    """The first round that uses second derivatives; before, Gauss-Newton, which is steadier far away."""
    reach: float = 1.0
    """Obstacles nearer than this [m] are seen, and no knot moves farther in one step."""

    def inner(self, number: int) -> "InnerOptions":
        """Options of round `number`, counted from 0."""
        return InnerOptions(
            iterations=self.iterations,
            # without a step after each update the multipliers of the goal would only follow the rest of the gradient
            least_iterations=1,
            gradient=self.gradient if number + 1 == self.rounds else max(self.gradient, 10.0 ** (-1 - number)),
            curvature=self.curvature and number >= self.second_from,
            first_regularisation=self.regularisation if number == 0 else 0.0,
        )

    def raised(self, penalty: PerConstraint, now: PerConstraint, before: PerConstraint) -> PerConstraint:
        """Penalties after an update that left residuals of `before` at `now`."""
        return PerConstraint(
            *(
                min(old * GROWTH, max(most, old)) if value > max(FALLEN * last, limit) else old
                for old, most, value, last, limit in zip(
                    penalty, _MOST_PENALTY, now, before, self.tolerances, strict=True
                )
            )
        )


@dataclass(eq=False, kw_only=True)
class Descent:
    """Where a descent stands; `descend` moves it on."""

    problem: Problem
    layout: Knots
    """The knots begun with; gears and shares stay."""
    model: TruckModel
    trajectory: Trajectory
    """As `optim.methods.ddp.truck` has states and controls."""
    gradient: float = np.inf
    """Largest projected gradient."""
    gap: float = np.inf
    """Largest gap between two stages [m or rad]."""
    residuals: Residuals = _NONE_YET
    stop: Stop = Stop.ITERATION_LIMIT

    @property
    def knots(self) -> Knots:
        """Where it stands, as knots."""
        return knots_from(self.trajectory.states, self.layout)

    @property
    def objective(self) -> float:
        """J of the knots."""
        return objective_of(self.knots, self.problem.weights)


OnStep = Callable[[Descent, float], None]
"""Called after each accepted step with its length, 1 for a full one."""


def start_descent(problem: Problem, knots: Knots, required: Array, schedule: PenaltySchedule) -> Descent:
    """A descent that has not begun, from knots that keep required (K, 2) [m] clear; multipliers are 0."""
    model = TruckModel(
        problem,
        knots,
        required,
        reach=schedule.reach,
        curvature=schedule.curvature,
        penalty=schedule.penalties,
    )
    trajectory = trajectory_of(knots, problem.vehicle.max_steer, problem.vehicle.max_steer_rate)
    return Descent(problem=problem, layout=knots, model=model, trajectory=trajectory)


def descend(descent: Descent, schedule: PenaltySchedule, on_step: OnStep) -> None:
    """Minimise and update the multipliers in turn, until all tests are met.

    Gives up where the worst residual, in units of its tolerance, has not halved in `_PATIENCE` updates.
    """
    model, before, worst = descent.model, descent.residuals.complementary, []

    def stepped(now: Trajectory, step: float, gradient: float) -> None:
        descent.trajectory, descent.gradient = now, gradient
        descent.gap = (1.0 - step) * float(np.abs(model.expansion.gap).max(initial=0.0))  # what the step leaves of them
        on_step(descent, step)

    for number in range(schedule.rounds):
        found = minimise(model, descent.trajectory, schedule.inner(number), stepped)
        descent.trajectory, descent.stop = found.trajectory, found.stop
        descent.gradient, descent.gap = found.gradient, found.gap
        descent.residuals = model.update_multipliers(found.trajectory.states)
        now = descent.residuals.complementary
        is_met = all(value <= limit for value, limit in zip(now, schedule.tolerances, strict=True))
        if is_met and found.gradient <= schedule.gradient:
            return
        worst.append(max(value / limit for value, limit in zip(now, schedule.tolerances, strict=True)))
        if len(worst) > _PATIENCE and worst[-1] > max(1.0, 0.5 * worst[-1 - _PATIENCE]):
            return
        model.set_penalty(schedule.raised(model.lagrangian.penalty, now, before))
        before = now


class Model(Protocol):
    """An optimal-control problem of N stages, n states, m controls."""

    def expand(self, now: Trajectory, curvature: bool) -> tuple[float, Expansion]:
        """Cost and derivatives at a trajectory; the model keeps the arrays."""
        ...

    def roll_out(self, now: Trajectory, policy: Policy, step: float, into: Trajectory) -> float:
        """Fill `into` by driving with u + step k + K dx, gaps closed by `step`; the cost, or inf.

        `now` is the trajectory of the last expansion.
        """
        ...


@dataclass(frozen=True, kw_only=True)
class InnerOptions:
    """When the inner iteration ends, and how it begins."""

    iterations: int = 100
    """Maximum number of iterations."""
    least_iterations: int = 0
    """Minimum number of iterations, converged or not."""
    gradient: float = 1e-6
    """Converged when no entry of |u - clip(u - Q_u)| is larger, and no gap beyond rounding."""
    curvature: bool = True
    """Second derivatives of the dynamics: full DDP; without them iLQR."""
    first_regularisation: float = 0.0
    """Multiples of the metrics that are added at the first backward pass."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Solution:
    """Where the inner iteration ended."""

    trajectory: Trajectory
    cost: float
    stop: Stop
    """CONVERGED, STALLED or ITERATION_LIMIT."""
    iterations: int
    gradient: float
    """Largest projected gradient."""
    gap: float
    """Largest gap."""


def minimise(
    model: Model,
    start: Trajectory,
    options: InnerOptions,
    on_step: Callable[[Trajectory, float, float], None] | None = None,
) -> Solution:
    """Iterate from a trajectory whose states and controls need not fit each other; it stays as it is.

    on_step: called after each accepted step with the trajectory, the step's length, and the projected gradient before.
    """
    now = Trajectory(np.array(start.states), np.array(start.controls))
    spare = Trajectory(np.empty_like(now.states), np.empty_like(now.controls))
    policy = new_policy(len(now.controls), now.states.shape[1], now.controls.shape[1])
    regularisation = _Regularisation(options.first_regularisation)
    cost, e = model.expand(now, options.curvature)
    iteration = 0
    while True:
        outlook = _backward(e, policy, regularisation, options.curvature)
        gap = float(np.abs(e.gap).max(initial=0.0))
        is_met = outlook.gradient <= options.gradient and gap <= _LARGEST_GAP
        if regularisation.is_exhausted:
            stop = Stop.STALLED
            break
        if is_met and iteration >= options.least_iterations:
            stop = Stop.CONVERGED
            break
        if iteration == options.iterations:
            stop = Stop.ITERATION_LIMIT
            break
        iteration += 1
        step = _line_search(model, now, cost, e, policy, outlook, spare)
        if step == 0.0:
            regularisation.increase()
            if regularisation.is_exhausted:
                stop = Stop.STALLED
                break
            continue
        now, spare = spare, now
        if step == 1.0:
            regularisation.decrease()
        if on_step is not None:
            on_step(now, step, outlook.gradient)
        cost, e = model.expand(now, options.curvature)
    return Solution(trajectory=now, cost=cost, stop=stop, iterations=iteration, gradient=outlook.gradient, gap=gap)


@dataclass
class _Regularisation:
    """Grows by 4, 8, 16, ... while steps fail; shrinks by 4 with each step that goes all the way."""

    value: float
    factor: float = 2.0

    def increase(self) -> None:
        self.factor = min(2.0 * self.factor, 64.0)
        self.value = max(_LEAST_REGULARISATION, self.value * self.factor)

    @property
    def is_exhausted(self) -> bool:
        return self.value > _MOST_REGULARISATION

    def decrease(self) -> None:
        self.factor = 2.0
        self.value *= 0.25
        if self.value < _LEAST_REGULARISATION:
            self.value = 0.0


def _backward(e: Expansion, policy: Policy, regularisation: _Regularisation, curvature: bool) -> Outlook:
    """A backward pass that goes through: without second derivatives where it must, then with more regularisation."""
    while True:
        outlook = backward_pass(e, regularisation.value, curvature, policy)
        if outlook.failed_stage < 0:
            return outlook
        if curvature:
            curvature = False
            continue
        regularisation.increase()
        if regularisation.is_exhausted:
            return outlook


def _line_search(
    model: Model, now: Trajectory, cost: float, e: Expansion, policy: Policy, outlook: Outlook, into: Trajectory
) -> float:
    """Backtrack from the full step; the step taken, with its trajectory in `into`, or 0 if none is good enough."""
    gaps = float(np.abs(e.gap).sum())
    weight = 2.0 * outlook.gap_slope
    noise = _ROUNDING * (1.0 + abs(cost))
    step = 1.0
    while step >= _LEAST_STEP:
        value = model.roll_out(now, policy, step, into)
        bend = outlook.change - outlook.linear
        expected = step * outlook.linear + step * step * bend - step * weight * gaps
        change = value - cost - step * weight * gaps
        if (expected < 0.0 and change <= _ACCEPTANCE * expected) or abs(expected) + abs(change) <= noise:
            return step
        step *= 0.5
    return 0.0
