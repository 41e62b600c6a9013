"""Clearance at the knots and between them: what is missing, and what to ask for at two knots for their interval."""

import numpy as np

from optim.knots.transcription import Knots
from optim.model.clearance import clearance, separations, swept_clearance
from optim.model.path import Path
from optim.model.problem import Problem
from optim.numerics.arrays import Array, frozen

CLEARANCE_TOLERANCE = 1e-6
"""Clearance that a path may lack and still be given back [m]."""
_SAFETY = 1e-4  # [m]: clearance asked for beyond what is missing, so that the next measurement finds nothing missing
_BAND = 0.015  # of the wheelbase: intervals that near to lacking clearance are raised before they lack it


def required_at_knots(problem: Problem, knots: Knots, room: float = 0.0) -> Array:
    """Clearance to ask for at each knot by truck and trailer to begin with, `room` more than required [m]. (K, 2)."""
    return frozen(np.full((len(knots.phi), 2), problem.required_clearance + room))


def missing_at_knots(problem: Problem, knots: Knots, required: Array) -> Array:
    """Clearance that truck and trailer lack of required (K, 2) at each knot [m]; 0: nothing. Shape (K, 2).

    Nothing counts as missing at the ends, about which nothing can be done.
    """
    rows = separations(problem.scene, problem.vehicle, knots.states, float(required.max()), most=1)
    missing = np.zeros((len(knots.phi), 2))
    np.maximum.at(missing, (rows.knot, rows.body), required[rows.knot, rows.body] - rows.distance)
    missing[[0, -1]] = 0.0
    return missing


def missing_between(problem: Problem, knots: Knots, path: Path) -> Array:
    """Swept clearance that each interval lacks on the path of the knots, for truck and trailer [m]; <= 0: none.

    -inf where no obstacle is near. Shape (K - 1, 2).
    """
    missing = np.full((len(knots.h), 2), -np.inf)
    for run, segment in zip(knots.runs, path.segments, strict=True):
        swept = swept_clearance(problem.scene, problem.vehicle, segment.s, segment.states, segment.phi)
        ends = np.cumsum(knots.h[run])
        middle = 0.5 * (segment.s[1:] + segment.s[:-1])
        interval = run.start + np.minimum(np.searchsorted(ends, middle), len(ends) - 1)
        np.maximum.at(missing, interval, problem.required_clearance - swept)
    return missing


def raised(problem: Problem, knots: Knots, required: Array, missing: Array, room: float = 0.0) -> Array:
    """The clearance to ask for at the knots, so that it is kept between them [m]. Shape (K, 2).

    What an interval loses between its knots, their smaller clearance less its swept clearance, hardly changes with
    a small change of the path; so exactly that much more is required at both, where it matters.

    Args:
        required: what was asked for so far. Shape (K, 2).
        missing: as `missing_between` gives it.
        room: clearance required everywhere beyond the problem's requirement [m]; the tolerance of the optimiser.
    """
    at_knots = clearance(problem.scene, problem.vehicle, knots.states)
    lost = np.minimum(at_knots[:-1], at_knots[1:]) - (problem.required_clearance - missing)
    least = problem.required_clearance + room
    was_raised = np.maximum(required[:-1], required[1:]) > least + 0.5 * _SAFETY
    matters = was_raised | (missing > -_BAND * problem.vehicle.wheelbase)
    ask = np.where(matters & np.isfinite(lost), least + np.maximum(lost, 0.0) + _SAFETY, 0.0)
    out = np.full_like(required, least)
    out[:-1] = np.maximum(out[:-1], ask)
    out[1:] = np.maximum(out[1:], ask)
    return frozen(out)
