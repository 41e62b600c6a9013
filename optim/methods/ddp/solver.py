"""The iteration: expand, backward pass, roll-out with line search, for any model that offers these.

Gaps between the stages are allowed at the start and shrink by 1 - step with every accepted step; the line search
looks at cost + weight * sum |gap|, the weight above the largest |V_x| beside a gap. Regularisation grows and shrinks
with acceleration (Tassa, Mansard and Todorov 2014).
"""

import enum
from collections.abc import Callable
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from optim.methods.ddp.backward import Expansion, Policy, backward_pass, new_policy
from optim.numerics.arrays import Array


class Model(Protocol):
    """An optimal-control problem of N stages, n states, m controls."""

    def expand(self, states: Array, controls: Array, curvature: bool) -> tuple[float, Expansion]:
        """Cost and derivatives at states (N + 1, n) and controls (N, m); the model keeps the arrays."""
        ...

    def roll_out(self, states: Array, controls: Array, policy: Policy, step: float, out: tuple[Array, Array]) -> float:
        """Fill `out` with the states and controls of u + step k + K dx, gaps closed by `step`; their cost or inf.

        The states and controls are those of the last expansion."""
        ...


_LARGEST_GAP = 1e-9  # of a trajectory that counts as converged, in units of the states: rounding
_LEAST_REGULARISATION, _MOST_REGULARISATION = 1e-4, 1e10  # below the first it is 0, beyond the second all is lost
_LEAST_STEP = 0.2  # where none down to this is good enough, regularisation grows instead
_ACCEPTANCE = 1e-4  # a step must give at least this share of the decrease it promises (Armijo)
_ROUNDING = 1e-12  # promised decreases below this, relative to the cost, are rounding: the full step is taken


@dataclass(frozen=True, kw_only=True)
class Settings:
    """When the iteration ends, and how it begins."""

    iterations: int = 100
    """So many at most."""
    least_iterations: int = 0
    """So many at least, converged or not."""
    gradient: float = 1e-6
    """Converged when no entry of |u - clip(u - Q_u)| is larger, and no gap beyond rounding."""
    curvature: bool = True
    """Second derivatives of the dynamics: full DDP; without them iLQR."""
    first_regularisation: float = 0.0
    """Multiples of the metrics that are added at the first backward pass."""


class End(enum.Enum):
    """Why the iteration ended."""

    CONVERGED = "converged"
    STALLED = "stalled"
    ITERATION_LIMIT = "iteration limit"


@dataclass(frozen=True, eq=False, kw_only=True)
class Solution:
    """Where the iteration ended."""

    states: Array
    """Shape (N + 1, n)."""
    controls: Array
    """Shape (N, m)."""
    cost: float
    end: End
    iterations: int
    gradient: float
    """Largest projected gradient."""
    gap: float
    """Largest gap."""
    policy: Policy
    """The last backward pass: feedback and value function."""


OnStep = Callable[[Array, Array, float, float], None]
"""Called after each accepted step: states, controls, the step's length, the projected gradient before it."""


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


def minimise(
    model: Model, states: Array, controls: Array, settings: Settings, on_step: OnStep | None = None
) -> Solution:
    """Iterate from states (N + 1, n) and controls (N, m), which need not fit each other and stay as they are."""
    states, controls = np.array(states), np.array(controls)
    spare = np.empty_like(states), np.empty_like(controls)
    policy = new_policy(len(controls), states.shape[1], controls.shape[1])
    report = np.zeros(4)
    regularisation = _Regularisation(settings.first_regularisation)
    cost, e = model.expand(states, controls, settings.curvature)
    end, iteration = End.ITERATION_LIMIT, 0
    while True:
        full = settings.curvature
        while backward_pass(e, regularisation.value, full, policy, report) >= 0:
            if full:
                full = False
                continue
            regularisation.increase()
            if regularisation.is_exhausted:
                end = End.STALLED
                break
        gaps = np.abs(e.gap)
        largest = float(gaps.max(initial=0.0))
        if end is End.STALLED:
            break
        met = report[2] <= settings.gradient and largest <= _LARGEST_GAP
        if met and iteration >= settings.least_iterations:
            end = End.CONVERGED
            break
        if iteration == settings.iterations:
            break
        iteration += 1
        step = _search(model, (states, controls, cost), e.gap, policy, report, spare)
        if step == 0.0:
            regularisation.increase()
            if regularisation.is_exhausted:
                end = End.STALLED
                break
            continue
        (states, controls), spare = spare, (states, controls)
        if step == 1.0:
            regularisation.decrease()
        if on_step is not None:
            on_step(states, controls, step, float(report[2]))
        cost, e = model.expand(states, controls, settings.curvature)
    return Solution(
        states=states,
        controls=controls,
        cost=cost,
        end=end,
        iterations=iteration,
        gradient=float(report[2]),
        gap=largest,
        policy=policy,
    )


def _search(
    model: Model,
    now: tuple[Array, Array, float],
    gap: Array,
    policy: Policy,
    report: Array,
    out: tuple[Array, Array],
) -> float:
    """Backtrack from the full step; the step taken, 0 if none is good enough."""
    states, controls, cost = now
    total, linear, _, slope = report
    gaps = float(np.abs(gap).sum())
    weight = 2.0 * slope
    noise = _ROUNDING * (1.0 + abs(cost))
    step = 1.0
    while step >= _LEAST_STEP:
        value = model.roll_out(states, controls, policy, step, out)
        expected = step * linear + step * step * (total - linear) - step * weight * gaps
        change = value - cost - step * weight * gaps
        if (expected < 0.0 and change <= _ACCEPTANCE * expected) or abs(expected) + abs(change) <= noise:
            return step
        step *= 0.5
    return 0.0
