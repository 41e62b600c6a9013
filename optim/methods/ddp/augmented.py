"""The outer iteration: multipliers and penalties round the inner one, for one set of gear segments."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from optim.knots.transcription import Knots, objective_of
from optim.methods.ddp.model import Residuals, TruckModel, knots_from, trajectory_of
from optim.methods.ddp.solver import End, Settings, minimise
from optim.model.problem import Problem
from optim.numerics.arrays import Array

_UNKNOWN = Residuals((np.inf, np.inf, np.inf), (np.inf, np.inf, np.inf))
_MOST_PENALTY = (1e7, 1e6, 1e6)  # of goal, hitch angle and clearance: growth ends here; a plan may begin higher
_PATIENCE = 3  # updates within which the worst residual must halve
FALLEN, GROWTH = 0.25, 4.0
"""Where an update leaves more than this share of a residual, its penalty grows by this factor."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How far to go with one set of segments."""

    spacing: float
    """Distance between knots [m]."""
    penalties: tuple[float, float, float]
    """Of goal, hitch angle and clearance at the start [1/m^2, 1/rad^2]."""
    rounds: int
    """Updates of the multipliers, at most."""
    iterations: int
    """Inner iterations in each."""
    gradient: float
    """Largest projected gradient that counts as converged."""
    tolerances: tuple[float, float, float]
    """Largest residuals of goal [m, rad], hitch angle [rad] and clearance [m] that count as converged."""
    regularisation: float = 1.0
    """Of the first inner iteration."""
    curvature: bool = True
    """Whether second derivatives are used at all."""
    second_from: int = 1
    """The first round that uses second derivatives; before, Gauss-Newton, which is steadier far away."""
    reach: float = 1.0
    """Obstacles nearer than this [m] are seen, and no knot moves farther in one step."""


@dataclass(eq=False, kw_only=True)
class Descent:
    """Where a descent stands; `descend` moves it on."""

    problem: Problem
    layout: Knots
    """The knots begun with; gears and shares stay."""
    model: TruckModel
    states: Array
    """Shape (N + 1, 6), as `optim.methods.ddp.truck` has them."""
    controls: Array
    """Shape (N, 2)."""
    gradient: float = np.inf
    """Largest projected gradient."""
    gap: float = np.inf
    """Largest gap between two stages [m or rad]."""
    residuals: Residuals = _UNKNOWN
    end: End = End.ITERATION_LIMIT

    @property
    def knots(self) -> Knots:
        """Where it stands, as knots."""
        return knots_from(self.states, self.layout)

    @property
    def value(self) -> float:
        """J of the knots."""
        return objective_of(self.knots, self.problem.weights)


OnStep = Callable[[Descent, float], None]
"""Called after each accepted step with its length, 1 for a full one."""


def start_descent(problem: Problem, knots: Knots, required: Array, plan: Plan) -> Descent:
    """A descent that has not begun, from knots that keep required (K, 2) [m] clear; multipliers are 0."""
    model = TruckModel(problem, knots, required, plan.reach, plan.curvature)
    model.lagrangian.scalars[:3] = plan.penalties
    states, controls = trajectory_of(knots, (problem.vehicle.max_steer, problem.vehicle.max_steer_rate))
    return Descent(problem=problem, layout=knots, model=model, states=states, controls=controls)


def descend(descent: Descent, plan: Plan, on_step: OnStep) -> None:
    """Update states, controls, multipliers in turn, until all tests are met.

    Gives up where the worst residual, in units of its tolerance, has not halved in `_PATIENCE` updates.
    """
    model, before = descent.model, descent.residuals.complementary
    scalars, worst = model.lagrangian.scalars, []

    def stepped(states: Array, controls: Array, step: float, gradient: float) -> None:
        descent.states, descent.controls = states, controls
        descent.gradient = gradient
        descent.gap = (1.0 - step) * float(np.abs(model.expansion.gap).max(initial=0.0))  # what the step leaves of them
        on_step(descent, step)

    for number in range(plan.rounds):
        settings = Settings(
            iterations=plan.iterations,
            # without a step after each update the multipliers of the goal would only follow the rest of the gradient
            least_iterations=1,
            gradient=plan.gradient if number + 1 == plan.rounds else max(plan.gradient, 10.0 ** (-1 - number)),
            curvature=plan.curvature and number >= plan.second_from,
            first_regularisation=plan.regularisation if number == 0 else 0.0,
        )
        found = minimise(model, descent.states, descent.controls, settings, stepped)
        descent.states, descent.controls, descent.end = found.states, found.controls, found.end
        descent.gradient, descent.gap = found.gradient, found.gap
        descent.residuals = model.residuals(descent.states, update=True)
        now = descent.residuals.complementary
        met = all(value <= limit for value, limit in zip(now, plan.tolerances, strict=True))
        if met and found.gradient <= plan.gradient:
            return
        worst.append(max(value / limit for value, limit in zip(now, plan.tolerances, strict=True)))
        if len(worst) > _PATIENCE and worst[-1] > max(1.0, 0.5 * worst[-1 - _PATIENCE]):
            return
        for i in range(3):
            if now[i] > max(FALLEN * before[i], plan.tolerances[i]):
                scalars[i] = min(scalars[i] * GROWTH, max(_MOST_PENALTY[i], scalars[i]))
        before = now
