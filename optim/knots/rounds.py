"""Rounds around an optimiser at knots: merge vanished segments, remesh, raise the clearance between knots.

An optimiser keeps clearance at the knots only, and moves the step lengths. Around it, until nothing is left to do:

1. segments that have shrunk to nothing are merged away, and the rest is solved again;
2. where a segment has grown a lot, its knots are laid out again;
3. the swept clearance of the dense path is measured on every interval, and the clearance required at the interval's
   two knots raised by what is missing;
4. once the path is clear, leaving out segments is tried (`optim.knots.removal`).

The result is the best path seen that keeps everything, judged by J of the dense path. The initial path counts only
if it keeps everything itself: a recorded path may not.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from optim.knots.between import CLEARANCE_TOLERANCE, missing_between, raised, required_at_knots
from optim.knots.removal import leave_out_segments, reseated, seed_without
from optim.knots.transcription import (
    LARGEST_DEFECT,
    VANISHED,
    Knots,
    defects,
    gears_alternate,
    is_worn,
    knots_of,
    merge_vanished,
    path_of,
    remesh,
    within_rate,
)
from optim.model.iterates import IterateStream
from optim.model.objective import objective
from optim.model.path import Path
from optim.model.problem import Problem, path_clearance
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from optim.model.vehicle import Vehicle
from optim.model.vehicle_limits import within_limits
from optim.numerics.arrays import Array

MAX_ROUNDS = 8
"""Solutions after the first, for clearance and new layouts."""
_LIMIT_SLACK = 1e-4  # relative, of limits on steering, its rate and the hitch angle; the audit allows 1e-3


@dataclass(frozen=True, eq=False, kw_only=True)
class KnotSolution:
    """Result of an optimiser at knots."""

    knots: Knots
    stop: Stop
    reason: str
    """One sentence."""
    iterations: int


class Announce(Protocol):
    """Announce an iterate at knots: `make(iteration=..., path=...)` gives it."""

    def __call__(self, knots: Knots, make: Callable[..., Iterate]) -> None:
        """Announce these knots; `make` is called only if somebody listens."""
        ...


class KnotOptimizer(Protocol):
    """Minimise J from these knots, keeping at knot k the clearances required[k] of truck and trailer [m]."""

    def __call__(self, knots: Knots, required: Array, announce: Announce) -> KnotSolution:
        """Better knots than these, and why it stopped there; `required` has shape (K, 2) [m]."""
        ...


def improve(
    problem: Problem, optimize: KnotOptimizer, *, spacing: float, removals: int, on_iterate: OnIterate = ignore
) -> Result:
    """Run an optimiser at knots in rounds; the best path found that keeps everything, or the initial one.

    Args:
        problem: the problem, which the optimiser knows as well.
        optimize: the optimiser.
        spacing: distance between knots [m].
        removals: segments whose removal is tried [-].
        on_iterate: called with every iterate of all solutions, numbered through.
    """
    rounds = _Rounds(problem, optimize, spacing, IterateStream.begin(problem, on_iterate))
    first, solution = rounds.descend(knots_of(problem.vehicle, problem.initial, spacing))
    path, reason = problem.initial, "; no path found keeps everything"
    if first is not None:
        found = leave_out_segments(first, problem.vehicle, rounds.without, removals, only_failures_count=False)
        solution, reason = found[-1].solution, ""
        if found[-1].objective < _value(problem, problem.initial) or not _is_sound(problem, problem.initial):
            path = found[-1].path
    rounds.iterates.emit_path(problem, path)
    reason = f"{solution.reason}; {rounds.iterations} iterations in {rounds.solutions} solutions{reason}"
    return Result(path=path, stop=solution.stop, reason=reason, iterations=rounds.iterations)


@dataclass(frozen=True, eq=False)
class _SoundPath:
    """A path, its J, and the solution that it is of."""

    path: Path
    objective: float
    solution: KnotSolution

    @property
    def knots(self) -> Knots:
        return self.solution.knots


class _Rounds:
    """One optimiser on one problem, with the iterations and solutions of all its rounds."""

    def __init__(self, problem: Problem, optimize: KnotOptimizer, spacing: float, iterates: IterateStream) -> None:
        self.problem, self.optimize, self.spacing, self.iterates = problem, optimize, spacing, iterates
        self.iterations = self.solutions = 0

    def descend(self, knots: Knots) -> tuple[_SoundPath | None, KnotSolution]:
        """Rounds from these knots on: the best path that keeps everything, and the last solution."""
        best, required, left = None, required_at_knots(self.problem, knots), MAX_ROUNDS
        while True:
            solution = self._solve(knots, required)
            candidate, following = self._judge(solution, required)
            if candidate is not None and (best is None or candidate.objective < best.objective):
                best = candidate
            if following is None or left == 0:
                return best, solution
            (knots, required), left = following, left - 1

    def _judge(self, solution: KnotSolution, required: Array) -> tuple[_SoundPath | None, tuple[Knots, Array] | None]:
        """The path of a solution if it keeps everything; knots and clearance to solve for again, unless it is done."""
        problem, knots = self.problem, solution.knots
        merged = merge_vanished(knots, VANISHED * self.spacing)
        if len(merged.phi) < len(knots.phi):
            fresh = self._within_rate(reseated(problem, merged, self.spacing))
            return None, (fresh, required_at_knots(problem, fresh))
        path = path_of(problem.vehicle, knots, problem.initial)
        missing = missing_between(problem, knots, path)
        sound = (
            _SoundPath(path, _value(problem, path), solution) if _keeps_everything(problem, knots, missing) else None
        )
        if not _may_go_on(problem, solution):
            return sound, None
        if is_worn(knots, self.spacing):
            fresh = remesh(problem.vehicle, knots, self.spacing, problem.initial)
            return sound, (fresh, required_at_knots(problem, fresh))
        if missing.max() <= 0.0:
            return sound, None
        return sound, (knots, raised(problem, knots, required, missing))

    def without(self, best: _SoundPath, index: int) -> _SoundPath | None:
        """The best path of rounds that begin without a segment."""
        seed = seed_without(self.problem, best.knots, index, self.spacing)
        better, _ = self.descend(self._within_rate(seed))
        return better

    def _solve(self, knots: Knots, required: Array) -> KnotSolution:
        solution = self.optimize(knots, required, self._announce)
        self.solutions += 1
        self.iterations += solution.iterations
        return solution

    def _announce(self, knots: Knots, make: Callable[..., Iterate]) -> None:
        vehicle, initial = self.problem.vehicle, self.problem.initial
        self.iterates.emit(lambda number: make(iteration=number, path=path_of(vehicle, knots, initial)))

    def _within_rate(self, knots: Knots) -> Knots:
        return replace(knots, phi=within_rate(knots, self.problem.vehicle.max_steer_rate))


def _may_go_on(problem: Problem, solution: KnotSolution) -> bool:
    """Whether its knots are worth another solution: they are solved, or at least drivable."""
    if solution.stop is Stop.ITERATION_LIMIT:
        gaps, _ = defects(problem.vehicle, solution.knots)
        return float(np.abs(gaps).max()) <= LARGEST_DEFECT
    return solution.stop in (Stop.CONVERGED, Stop.STALLED)


def _keeps_everything(problem: Problem, knots: Knots, missing: Array) -> bool:
    """Whether a path keeps the dynamics, the limits and the clearance."""
    gaps, _ = defects(problem.vehicle, knots)
    return (
        float(np.abs(gaps).max()) <= LARGEST_DEFECT
        and float(missing.max()) <= CLEARANCE_TOLERANCE
        and _within_limits(problem.vehicle, knots)
        and gears_alternate(knots)
    )


def _is_sound(problem: Problem, path: Path) -> bool:
    """Whether a path that follows the kinematics keeps the limits and the clearance too."""
    if not within_limits(problem.vehicle, path, _LIMIT_SLACK):
        return False
    return path_clearance(problem.vehicle, problem.scene, path) >= problem.required_clearance - CLEARANCE_TOLERANCE


def _within_limits(vehicle: Vehicle, knots: Knots) -> bool:
    drives = knots.gear != 0
    rate = np.abs(np.diff(knots.phi)[drives]) / knots.h[drives]
    return bool(
        np.abs(knots.phi).max() <= vehicle.max_steer * (1.0 + _LIMIT_SLACK)
        and np.abs(knots.states[:, 3]).max() <= vehicle.max_hitch * (1.0 + _LIMIT_SLACK)
        and rate.max() <= vehicle.max_steer_rate * (1.0 + _LIMIT_SLACK)
    )


def _value(problem: Problem, path: Path) -> float:
    return objective(path, problem.weights)
