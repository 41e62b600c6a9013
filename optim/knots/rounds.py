"""What every optimiser at knots needs around it: merging, laying out anew, clearance between the knots.

An optimiser keeps clearance at the knots only, and moves the step lengths. Around it, until nothing is left to do:

1. segments that have shrunk to nothing are merged away, and the rest is solved again;
2. where a segment has grown a lot, its knots are laid out anew;
3. the swept clearance of the dense path is measured on every interval, and the clearance required at the interval's
   two knots raised by what is missing;
4. when the path is clear, leaving out one segment, and with it two gear changes, is tried: a local optimum with
   a needless gear change is no stranger to the optimiser, and the objective says whether it was needless.

What is given back is the best path seen that keeps everything, judged by J of the dense path. The path begun with
counts in that only if it keeps everything itself: a recorded path may not.
"""

import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from typing import Protocol

import numpy as np

from optim.knots.between import missing_between, raised
from optim.knots.transcription import (
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
    without_segment,
)
from optim.model.limits import within_limits
from optim.model.objective import objective
from optim.model.path import Path
from optim.model.problem import Problem, path_clearance
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, frozen

LARGEST_DEFECT = 1e-6
"""Of one interval of a path that is given back [m or rad]; the audit allows 1e-4, and 10 mm in the sum."""
CLEARANCE_TOLERANCE = 1e-6
"""By which a path that is given back may fall short of the required clearance [m]."""
_LIMIT_SLACK = 1e-4  # relative, of limits on steering, its rate and the hitch angle; the audit allows 1e-3
_GAIN = 1e-6  # relative; less is no improvement


@dataclass(frozen=True, eq=False, kw_only=True)
class Outcome:
    """What an optimiser at knots gives back."""

    knots: Knots
    stop: Stop
    reason: str
    """One sentence."""
    iterations: int


@dataclass(frozen=True, eq=False, kw_only=True)
class Report:
    """An iterate at knots, as an optimiser tells it; everything but the knots as in `optim.model.result.Iterate`."""

    knots: Knots
    objective: float
    violation: float
    step: float = 0.0
    residuals: Mapping[str, float] = field(default_factory=dict)
    accepted: bool = True
    trust_region: float = math.nan
    solver_s: float = math.nan


Tell = Callable[[Report], None]


class AtKnots(Protocol):
    """Minimise J from these knots, keeping at knot k the clearances required[k] of truck and trailer [m]."""

    def __call__(self, knots: Knots, required: Array, tell: Tell) -> Outcome: ...


@dataclass(frozen=True, kw_only=True)
class RoundOptions:
    """How far the rounds go."""

    spacing: float
    """Distance between knots [m]."""
    max_rounds: int = 8
    """Solutions after the first, for clearance and new layouts."""
    max_removals: int = 3
    """Segments whose removal is tried."""


@dataclass(frozen=True, eq=False)
class _Best:
    """A path, its J, and the outcome that it is of."""

    path: Path
    objective: float
    outcome: Outcome

    @property
    def knots(self) -> Knots:
        return self.outcome.knots


class _Teller:
    """Numbers the iterates of all solutions through, and turns knots into paths."""

    def __init__(self, problem: Problem, on_iterate: OnIterate) -> None:
        self.problem, self.on_iterate, self.count, self.solutions = problem, on_iterate, 0, 0
        self.on_iterate(Iterate(iteration=0, path=problem.initial, objective=_value(problem, problem.initial)))

    def __call__(self, report: Report) -> None:
        self.count += 1
        path = path_of(self.problem.vehicle, report.knots, self.problem.initial)
        fields = {name: value for name, value in vars(report).items() if name != "knots"}
        self.on_iterate(Iterate(iteration=self.count, path=path, **fields))

    def last(self, path: Path) -> None:
        self.count += 1
        self.on_iterate(Iterate(iteration=self.count, path=path, objective=_value(self.problem, path)))


def improve(problem: Problem, solve: AtKnots, options: RoundOptions, on_iterate: OnIterate = ignore) -> Result:
    """Run an optimiser at knots in rounds; the best path found that keeps everything, or the one begun with."""
    tell = _Teller(problem, on_iterate)
    start = knots_of(problem.vehicle, problem.initial, options.spacing)
    best, outcome, iterations = _descend(problem, solve, options, start, tell)
    removals = 0
    while best is not None and removals < options.max_removals:
        better, tried, more = _remove_one(problem, solve, options, best, tell, options.max_removals - removals)
        removals, iterations = removals + tried, iterations + more
        if better is None:
            break
        best = better
    path = problem.initial if best is None else best.path
    if best is not None and best.objective >= _value(problem, problem.initial) and _is_sound(problem, problem.initial):
        path = problem.initial
    tell.last(path)
    outcome = outcome if best is None else best.outcome
    reason = f"{outcome.reason}; {iterations} iterations in {tell.solutions} solutions"
    if best is None:
        reason += "; no path found keeps everything"
    return Result(path=path, stop=outcome.stop, reason=reason, iterations=iterations)


def _descend(
    problem: Problem, solve: AtKnots, options: RoundOptions, knots: Knots, tell: _Teller
) -> tuple[_Best | None, Outcome, int]:
    """Rounds from these knots on: the best path, the outcome of the last solution, sub-iterations of all."""
    best: _Best | None = None
    required = _required(problem, knots)
    iterations = 0
    outcome = Outcome(knots=knots, stop=Stop.ITERATION_LIMIT, reason="no round was allowed", iterations=0)
    for _ in range(options.max_rounds + 1):
        outcome = solve(knots, required, tell)
        tell.solutions += 1
        iterations += outcome.iterations
        merged = merge_vanished(outcome.knots, VANISHED * options.spacing)
        if len(merged.phi) < len(outcome.knots.phi):
            knots = _seed(problem, merged, options.spacing)
            required = _required(problem, knots)
            continue
        path = path_of(problem.vehicle, outcome.knots, problem.initial)
        missing = missing_between(problem, outcome.knots, path)
        candidate = _Best(path, _value(problem, path), outcome)
        if _keeps_everything(problem, candidate, missing) and (best is None or candidate.objective < best.objective):
            best = candidate
        if not _may_go_on(problem, outcome):
            break
        if is_worn(outcome.knots, options.spacing):
            knots = remesh(problem.vehicle, outcome.knots, options.spacing, problem.initial)
            required = _required(problem, knots)
            continue
        if missing.max() <= 0.0:
            break
        knots, required = outcome.knots, raised(problem, outcome.knots, required, missing)
    return best, outcome, iterations


def _may_go_on(problem: Problem, outcome: Outcome) -> bool:
    """Whether its knots are worth another solution: they are solved, or at least drivable."""
    if outcome.stop is Stop.ITERATION_LIMIT:
        gaps, _ = defects(problem.vehicle, outcome.knots)
        return float(np.abs(gaps).max()) <= LARGEST_DEFECT
    return outcome.stop in (Stop.CONVERGED, Stop.STALLED)


def _remove_one(
    problem: Problem, solve: AtKnots, options: RoundOptions, best: _Best, tell: _Teller, most: int
) -> tuple[_Best | None, int, int]:
    """The first better path without one of the segments, how many were tried, and their iterations."""
    lengths = best.knots.lengths
    if len(lengths) < 2:
        return None, 0, 0
    reach = problem.vehicle.truck_front + problem.vehicle.trailer_rear
    iterations = 0
    candidates = [int(index) for index in np.argsort(lengths, kind="stable") if lengths[index] <= reach][:most]
    for tried, index in enumerate(candidates, start=1):
        seed = _seed(problem, without_segment(best.knots, index), options.spacing)
        better, _, more = _descend(problem, solve, options, seed, tell)
        iterations += more
        if better is not None and better.objective < best.objective * (1.0 - _GAIN):
            return better, tried, iterations
    return None, len(candidates), iterations


def _seed(problem: Problem, knots: Knots, spacing: float) -> Knots:
    """Knots to begin with after a segment has gone: ends in place, equal steps, steering within its rate limit.

    The states keep the gap that the segment has left; closing it is the optimiser's business.
    """
    states = knots.states.copy()
    states[0], states[-1] = problem.initial.start, problem.initial.goal
    knots = remesh(problem.vehicle, replace(knots, states=states), spacing, problem.initial)
    return replace(knots, phi=within_rate(knots, problem.vehicle.max_steer_rate))


def _required(problem: Problem, knots: Knots) -> Array:
    """Clearance to keep at each knot by truck and trailer [m], to begin with. Shape (K, 2)."""
    return frozen(np.full((len(knots.phi), 2), problem.required_clearance))


def _keeps_everything(problem: Problem, candidate: _Best, missing: Array) -> bool:
    """Whether a path keeps the dynamics, the limits and the clearance."""
    knots = candidate.knots
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
