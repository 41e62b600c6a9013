"""Leave out segments, each with its gear changes, while J falls.

An optimiser can stop at a local optimum with a redundant gear change: no small step removes a segment of several
metres. Whether it was redundant is for J to say, of a path that was optimised without it.
"""

from collections.abc import Callable
from dataclasses import replace
from typing import Protocol, TypeVar

import numpy as np

from optim.knots.transcription import Knots, remesh, without_segment
from optim.model.problem import Problem
from optim.model.vehicle import Vehicle

LEAST_GAIN = 1e-6
"""Relative decrease of J below which a candidate does not count as better."""


class Candidate(Protocol):
    """A solution at knots."""

    @property
    def knots(self) -> Knots:
        """The knots."""
        ...

    @property
    def objective(self) -> float:
        """J of the path at these knots."""
        ...


_C = TypeVar("_C", bound=Candidate)


def leave_out_segments(
    first: _C, vehicle: Vehicle, attempt: Callable[[_C, int], _C | None], most: int, *, only_failures_count: bool
) -> list[_C]:
    """Try to leave out one segment after the other, shortest first, from the last candidate that was better.

    Args:
        first: the candidate to begin with.
        attempt: gives a candidate without the segment of this number, or None.
        most: number of attempts after which to end [-].
        only_failures_count: whether `most` limits the attempts that did not lower J only, or all.

    Returns `first` and each candidate that was better than the one before.
    """
    found, spent = [first], 0
    while True:
        for index in removable_segments(vehicle, found[-1].knots):
            if spent == most:
                return found
            candidate = attempt(found[-1], index)
            if candidate is None or not candidate.objective < found[-1].objective * (1.0 - LEAST_GAIN):
                spent += 1
                continue
            spent += not only_failures_count
            found.append(candidate)
            break
        else:
            return found


def removable_segments(vehicle: Vehicle, knots: Knots) -> list[int]:
    """Segments no longer than the vehicle from bumper to bumper, shortest first; none where there is one only."""
    lengths = knots.lengths
    if len(lengths) < 2:
        return []
    longest = vehicle.truck_front + vehicle.trailer_rear
    return [int(index) for index in np.argsort(lengths, kind="stable") if lengths[index] <= longest]


def seed_without(problem: Problem, knots: Knots, index: int, spacing: float) -> Knots:
    """Knots to begin with after a segment has been left out."""
    return reseated(problem, without_segment(knots, index), spacing)


def reseated(problem: Problem, knots: Knots, spacing: float) -> Knots:
    """Knots to begin with after a segment was removed: ends in place, equal steps of at most `spacing` [m].

    The states keep the gap that the segment has left; closing it is up to the optimiser.
    """
    states = knots.states.copy()
    states[0], states[-1] = problem.initial.start, problem.initial.goal
    return remesh(problem.vehicle, replace(knots, states=states), spacing, problem.initial)
