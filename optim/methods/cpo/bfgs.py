"""BFGS in the metric of the sum of squares: quasi-Newton steps whose first guess of the curvature is Gauss-Newton's.

Plain BFGS starts from a multiple of the identity and learns the second derivatives pair by pair. A smoothness term
has eigenvalues that spread like the fourth power of the number of points, so it takes hundreds of pairs, each at
the price of a product of dense matrices. Here the inverse of the banded metric takes the identity's place, which is
the same as plain BFGS after the change of variables z = L^T x with metric = L L^T; the updates are kept as
products (Nocedal's two loops): all of them for BFGS, the last few for L-BFGS.
"""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np
from scipy.linalg import cho_solve_banded, cholesky_banded

from optim.methods.cpo.terms import BAND
from optim.numerics.arrays import Array, BoolArray, Float64

_DECREASE = 1e-4  # Armijo's condition: the least share of the decrease that the slope promises
_REFRESH = 20  # steps after which the metric is first evaluated again
_ROUNDING = 1e-14  # a promised decrease below this is none, where F itself is 0
_SMALLEST_SHARE = 1e-8  # of a step; shorter ones change nothing
_CURVATURE = 1e-10  # pairs with less curvature than this, relative to their size, are left out


class BfgsSolution(NamedTuple):
    """Result of the minimiser."""

    points: Float64[Array, "M 2"]  # [m]
    value: float  # F
    iterations: int
    evaluations: int  # of F
    converged: bool


def minimise_bfgs(
    evaluate: Callable[[Array, bool], tuple[float, Array, Array | None]],
    points: Array,
    free: BoolArray,
    *,
    memory: int,
    max_iterations: int,
    tolerance: float,
    max_step: float,
) -> BfgsSolution:
    """Lower F from `points` (M, 2), moving those with `free` (M,) only.

    Converged when the decrease that the metric promises is at most tolerance * F. No point moves by more than
    max_step [m] at once: a full step may jump over a thin obstacle. The metric is evaluated again, and the pairs
    are forgotten, after `_REFRESH` steps, then twice as many, and so on: far from rest a new metric is worth more than
    what was learned, near it less.

    evaluate: gives the value of F at points, its gradient (M, 2), and on request the metric, (BAND, 2 M).
    """
    mask = np.repeat(free, 2)
    points = points.copy()
    value, slope, metric = evaluate(points, True)
    slope = np.where(mask, slope.ravel(), 0.0)
    factor, pairs, evaluations = _factor(metric, mask), [], 1
    age, refresh = 0, _REFRESH
    for iteration in range(max_iterations):
        step = -_apply(factor, pairs, slope)
        promised = -float(slope @ step)
        if promised <= tolerance * value or promised <= _ROUNDING:
            return BfgsSolution(points, value, iteration, evaluations, True)
        step *= min(1.0, max_step / np.hypot(*step.reshape(-1, 2).T).max())
        promised, share = -float(slope @ step), 1.0
        while True:
            trial = points + share * step.reshape(-1, 2)
            trial_value, trial_slope, _ = evaluate(trial, False)
            evaluations += 1
            if trial_value <= value - _DECREASE * share * promised:
                break
            if np.isfinite(trial_value):  # the parabola through both values and the slope
                share *= np.clip(0.5 * promised * share / (trial_value - value + promised * share), 0.1, 0.5)
            else:
                share *= 0.1
            if share < _SMALLEST_SHARE:
                return BfgsSolution(points, value, iteration, evaluations, False)
        trial_slope = np.where(mask, trial_slope.ravel(), 0.0)
        moved, turned = share * step, trial_slope - slope
        points, value, slope = trial, trial_value, trial_slope
        age += 1
        if age == refresh:
            age, refresh = 0, 2 * refresh
            factor, pairs = _factor(evaluate(points, True)[2], mask), []
        elif moved @ turned > _CURVATURE * np.linalg.norm(moved) * np.linalg.norm(turned):
            pairs = [*pairs, (moved, turned)][-memory:]
    return BfgsSolution(points, value, max_iterations, evaluations, False)


def _factor(metric: Array | None, mask: BoolArray) -> Array:
    """Cholesky factor of the metric on the free coordinates, 1 on the others."""
    assert metric is not None
    metric = metric.copy()
    for k in range(BAND):
        kept = mask[: len(mask) - k] & mask[k:]
        metric[k, : len(kept)] *= kept
    scale = metric[0].max()
    metric[0] = np.where(mask, metric[0] + 1e-9 * scale, 1.0)
    return cholesky_banded(metric, lower=True)


def _apply(factor: Array, pairs: list[tuple[Array, Array]], slope: Array) -> Array:
    """The inverse Hessian's approximation times the slope."""
    shares = []
    for moved, turned in reversed(pairs):
        shares.append(float(moved @ slope) / float(moved @ turned))
        slope = slope - shares[-1] * turned
    result = cho_solve_banded((factor, True), slope)
    for (moved, turned), share in zip(pairs, reversed(shares), strict=True):
        result = result + (share - float(turned @ result) / float(moved @ turned)) * moved
    return result
