"""The outer iteration: multipliers and penalties round the inner one, for one set of gear segments."""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from optim.arrays import Array
from optim.ddp.model import Residuals, TruckModel, knots_from, trajectory_of
from optim.ddp.solver import End, Settings, minimise
from optim.methods.transcription import Knots, objective_of
from optim.problem import Problem

_UNKNOWN = Residuals((np.inf, np.inf, np.inf), (np.inf, np.inf, np.inf))
_MOST_PENALTY = (1e7, 1e6, 1e6)


@dataclass(frozen=True, kw_only=True)
class Plan:
    """How far to go with one set of segments."""

    spacing: float
    """Distance between knots [m]."""
    penalties: tuple[float, float, float]
    """Of goal, hitch angle and clearance at the start."""
    rounds: int
    """Updates of the multipliers, at most."""
    iterations: int
    """Inner iterations in each."""
    gradient: float
    """Largest projected gradient that counts as converged."""
    tolerances: tuple[float, float, float]
    """Largest residuals of goal [m, rad], hitch angle [rad] and clearance [m] that count as converged."""
    growth: float = 4.0
    """Penalties grow by this factor where a residual has not fallen to a quarter."""
    regularisation: float = 1.0
    """Of the first inner iteration."""
    curvature: bool = True
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
    controls: Array
    gradient: float = np.inf
    gap: float = np.inf
    residuals: Residuals = _UNKNOWN
    end: End = End.ITERATION_LIMIT

    @property
    def knots(self) -> Knots:
        return knots_from(self.states, self.layout)

    @property
    def value(self) -> float:
        """J of the knots."""
        return objective_of(self.knots, self.problem.weights)


OnStep = Callable[[Descent, float], None]


def start_descent(problem: Problem, knots: Knots, required: Array, plan: Plan) -> Descent:
    model = TruckModel(problem, knots, required, plan.reach, plan.curvature)
    model.lagrangian.scalars[:3] = plan.penalties
    states, controls = trajectory_of(knots, (problem.vehicle.max_steer, problem.vehicle.max_steer_rate))
    return Descent(problem=problem, layout=knots, model=model, states=states, controls=controls)


_PATIENCE = 3


def descend(descent: Descent, plan: Plan, on_step: OnStep) -> bool:
    """Update states, controls, multipliers in turn; whether all tests are met.

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
            return True
        worst.append(max(value / limit for value, limit in zip(now, plan.tolerances, strict=True)))
        if len(worst) > _PATIENCE and worst[-1] > max(1.0, 0.5 * worst[-1 - _PATIENCE]):
            return False
        for i in range(3):
            if now[i] > max(0.25 * before[i], plan.tolerances[i]):
                scalars[i] = min(scalars[i] * plan.growth, max(_MOST_PENALTY[i], scalars[i]))
        before = now
    return False
