"""The merit that a step must lower: the augmented Lagrangian of the true problem, in scaled units.

    m(z) = J(z) + lambda . g(z) + w/2 |g(z)|^2 + sum over knots and bodies  mu v(z) + w/2 v(z)^2

with the defects g of the dynamics and the missing clearance v >= 0 (and w/2 e^2 of limits exceeded by e); the
sub-problem minimises its convex model with virtual control and slack in the places of g and v.
"""

from dataclasses import dataclass

import numpy as np

from optim.knots.between import missing_at_knots
from optim.knots.transcription import Knots, defects, objective_of
from optim.methods.scp.linearisation import Linearisation, Scales
from optim.methods.scp.restoration import hitch_excess, rate_excess
from optim.methods.scp.subproblem import KnotLimits, Penalty, SubproblemSolution
from optim.model.problem import Problem
from optim.numerics.arrays import Array, Float64


@dataclass(frozen=True, eq=False)
class Point:
    """Knots with the values of everything that the merit is made of, in scaled units."""

    knots: Knots
    objective: float
    defects: Float64[Array, "K-1 4"]
    """Shape (K - 1, 4)."""
    missing: Float64[Array, "K 2"]
    """Clearance that truck and trailer lack. Shape (K, 2)."""
    excess: Float64[Array, " 2*K-1"]
    """Excess of hitch angles and steering rates, which only corrections can cause. Shape (2 K - 1,)."""

    @property
    def violation(self) -> float:
        """Largest defect, missing clearance or excess."""
        return max(float(np.abs(self.defects).max()), float(self.missing.max()), float(self.excess.max()))

    def merit(self, penalty: Penalty) -> float:
        """m of the module's docstring."""
        smooth = (penalty.dynamics * self.defects).sum() + (penalty.clearance * self.missing).sum()
        square = (self.defects**2).sum() + (self.missing**2).sum() + (self.excess**2).sum()
        return self.objective + float(smooth) + 0.5 * penalty.weight * float(square)


def evaluate(problem: Problem, knots: Knots, scales: Scales, limits: KnotLimits) -> Point:
    """The point at these knots."""
    gaps, _ = defects(problem.vehicle, knots)
    missing = missing_at_knots(problem, knots, limits.required)
    value = objective_of(knots, problem.weights) / scales.cost
    excess = np.concatenate([hitch_excess(problem.vehicle, knots), rate_excess(problem.vehicle, knots)]) / scales.angle
    return Point(knots, value, gaps / scales.state, missing / scales.length, excess)


def modelled_merit(near: Linearisation, step: SubproblemSolution, penalty: Penalty) -> float:
    """The convex model's value at the step: what the sub-problem minimised, and the objective it began with."""
    root = 1.0 / np.sqrt(penalty.weight)
    linear = near.g_phi @ step.phi + near.g_h @ step.h
    square = sum(float((part**2).sum()) for part in (step.r, step.nu, step.zeta))
    smooth = root * float((penalty.dynamics * step.nu).sum() + (penalty.clearance * step.zeta).sum())
    return near.objective + float(linear) + 0.5 * square + smooth
