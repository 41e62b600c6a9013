"""Result of a round for one segment, and the checks that decide whether it is accepted.

The checks are those of the audit: limits at the samples, clearance between them.
"""

from typing import NamedTuple

import numpy as np

from optim.methods.cpo.drivable import Stretch
from optim.methods.cpo.points import AxlePoints
from optim.model.clearance import swept_clearance
from optim.model.path import Segment
from optim.model.problem import Problem
from optim.numerics.arrays import Bool, BoolArray

TOLERATED = 1.001
"""Residual of a recorded stretch up to which it counts as kept: the audit relaxes limits by as much."""
_SLACK = 1e-9  # of limits, relative: rounding


class LimitCheck(NamedTuple):
    """One thing that a stretch must keep, and where it does not."""

    name: str
    value: float  # the worst
    limit: float
    unit: str
    residual: float  # 1 or less where it is kept
    fails: Bool[BoolArray, " n"]  # samples at or beside which it fails

    @property
    def is_kept(self) -> bool:
        """Whether all checks pass."""
        return not self.fails.any()

    def __str__(self) -> str:
        return f"{self.name} {self.value:.4g} {self.unit}, limit {self.limit:.4g}"


class SegmentTrial(NamedTuple):
    """Result of a round for the segment."""

    points: AxlePoints
    stretch: Stretch | None  # None where no curve beside the points was found
    checks: tuple[LimitCheck, ...]
    round: int  # from 1
    iterations: int  # of the minimiser
    step: float  # largest distance of a point from where it was recorded [m]

    @property
    def is_sound(self) -> bool:
        """Whether there is a stretch that keeps everything."""
        return self.stretch is not None and all(check.is_kept for check in self.checks)


def limit_checks(problem: Problem, segment: Segment) -> tuple[LimitCheck, ...]:
    """Limits and clearance of a segment, as the audit will look at them."""
    vehicle = problem.vehicle
    rate = np.abs(np.diff(segment.phi) / np.diff(segment.s))
    clearance = swept_clearance(problem.scene, vehicle, segment.s, segment.states, segment.phi).min(axis=1)
    required = problem.required_clearance
    limits = (
        ("steering angle", np.abs(segment.phi), vehicle.max_steer, "rad"),
        ("hitch angle", np.abs(segment.alpha), vehicle.max_hitch, "rad"),
        ("steering rate", rate, vehicle.max_steer_rate, "rad/m"),
    )
    found = [
        LimitCheck(
            name, values.max(), limit, unit, values.max() / limit, _at_samples(values > limit * (1.0 + _SLACK), segment)
        )
        for name, values, limit, unit in limits
    ]
    low = float(clearance.min())
    short = _at_samples(clearance < required, segment)
    # a deficit of a millimetre counts as one, as a limit exceeded does
    found.append(LimitCheck("clearance", low, required, "m", max(0.0, 1.0 + (required - low) / 1e-3), short))
    return tuple(found)


def _at_samples(fails: BoolArray, segment: Segment) -> BoolArray:
    """Intervals' failures at both of their samples; samples' own as they are."""
    if len(fails) == segment.num_samples:
        return fails
    return np.concatenate([fails, [False]]) | np.concatenate([[False], fails])
