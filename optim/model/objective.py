"""J, the objective that every method is compared by; the only place that knows the weights.

    J = w_length L + w_steer int phi^2 ds + w_rate int (dphi/ds)^2 ds
        + w_cusp (number of cusps) + w_jump sum over cusps of (jump of phi)^2

phi is linear between samples, so both integrals are exact sums. Where two segments of one gear meet, since the vehicle
stands still to steer, the jump counts, but not as a gear change.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from optim.model.path import Path
from optim.numerics.arrays import Array


@dataclass(frozen=True, kw_only=True)
class Weights:
    """Weights of the objective."""

    length: float = 1.0
    """Weight on the distance driven by the truck [1/m]."""
    steer: float = 0.5
    """Weight on the integral of phi^2 over arc length [1/(rad^2 m)]."""
    rate: float = 5.0
    """Weight on the integral of (dphi/ds)^2 over arc length [m/rad^2]."""
    cusp: float = 5.0
    """Weight on each gear change [-]."""
    jump: float = 1.0
    """Weight on the squared change of steering at standstill, as at each gear change [1/rad^2]."""

    def __post_init__(self) -> None:
        for name, value in vars(self).items():
            if not (np.isfinite(value) and value >= 0.0):
                raise ValueError(f"weights: {name} is {value!r}, expected a number that is not negative")


def terms(path: Path, weights: Weights) -> dict[str, float]:
    """The five weighted terms of J, by the names of `Weights`."""
    steer = rate = 0.0
    for segment in path.segments:
        ds, left, right = np.diff(segment.s), segment.phi[:-1], segment.phi[1:]
        steer += float(np.sum(ds * (left * left + left * right + right * right)) / 3.0)
        rate += float(np.sum((right - left) ** 2 / ds))
    return {
        "length": weights.length * path.length,
        "steer": weights.steer * steer,
        "rate": weights.rate * rate,
        "cusp": weights.cusp * path.num_cusps,
        "jump": weights.jump * float(np.sum(cusp_jumps(path) ** 2)),
    }


def objective(path: Path, weights: Weights) -> float:
    """J of a path [-]."""
    return sum(terms(path, weights).values())


def cusp_jumps(path: Path) -> Array:
    """Change of steering between neighbouring segments [rad]. Shape (number of segments - 1,)."""
    return np.array([after.phi[0] - before.phi[-1] for before, after in pairwise(path.segments)], dtype=float)
