"""The trust region, and the patience with a search that makes no progress."""

from dataclasses import dataclass

import numpy as np

LEAST_RADIUS, _LARGEST_RADIUS = 1e-4, 10.0  # relative to the first
ACCEPT_ABOVE, _SHRINK_BELOW, _GROW_ABOVE = 1e-3, 0.25, 0.7  # ratio of actual to predicted decrease (Oguri 2023)
_AT_BOUND = 0.9  # share of the radius from which on a step counts as held by the trust region
LARGEST_WEIGHT = 1e8
"""Largest weight of the squared violation; there the violation is all that counts."""
_PATIENCE = 12  # sub-problems at the largest weight that do not halve the violation: nothing near is feasible


@dataclass
class TrustRegion:
    """Radius of the steps and share of the model's curvature; both follow the ratio of actual to predicted decrease."""

    radius: float = 1.0
    """Relative to the first [-]."""
    curvature: float = 1.0
    """Share of the curvature of the Lagrangian that the model keeps [-]."""

    @property
    def is_exhausted(self) -> bool:
        """Whether steps have become too short to go on."""
        return self.radius < LEAST_RADIUS

    def shrink(self) -> None:
        """After a sub-problem that the solver did not solve."""
        self.radius *= 0.25

    def update(self, ratio: float, reach: float) -> None:
        """After a step that needed a radius of `reach`, and whose decrease was `ratio` times the predicted one."""
        self.curvature = _next_curvature(self.curvature, ratio, at_bound=reach > _AT_BOUND * self.radius)
        self.radius = _next_radius(self.radius, reach, ratio)


def _next_radius(radius: float, reach: float, ratio: float) -> float:
    """Smaller where the model was wrong, than the step too; larger where it was right and the step at its bound."""
    if ratio < _SHRINK_BELOW:
        return 0.5 * min(radius, reach)
    return min(3.0 * radius, _LARGEST_RADIUS) if ratio > _GROW_ABOVE and reach > _AT_BOUND * radius else radius


def _next_curvature(curvature: float, ratio: float, at_bound: bool) -> float:
    """The share of the model's curvature to keep: making it convex adds some, and the ratio shows how much.

    Where the step minimises the model along itself, true over model curvature is 2 - ratio. Halves the number of
    sub-problems where convergence is slow (41 to 21 on a dock, 16 to 11 on an angled bay).
    """
    if ratio < _SHRINK_BELOW:
        return min(1.0, 4.0 * curvature)
    if ratio > 1.2 and not at_bound:
        return max(0.05, curvature * max(0.4, 2.0 - ratio))
    return min(1.0, 1.5 * curvature) if ratio < 0.8 else curvature


class Patience:
    """Ends a hopeless search: at the largest weight the violation is all that counts, and it does not fall."""

    def __init__(self) -> None:
        self.least, self.waited = np.inf, 0

    def is_over(self, violation: float, weight: float) -> bool:
        """Count one more sub-problem; whether enough have not halved the violation."""
        if weight < LARGEST_WEIGHT or violation < 0.5 * self.least:
            self.least, self.waited = violation, 0
        else:
            self.waited += 1
        return self.waited >= _PATIENCE
