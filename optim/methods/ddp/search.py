"""Around the descents: coarse knots first, segments that the path can do without, clearance between the knots."""

from dataclasses import dataclass, replace

import numpy as np

from optim.knots.between import missing_between, raised, required_at_knots
from optim.knots.removal import leave_out_segments, seed_without
from optim.knots.transcription import LARGEST_DEFECT, Knots, path_of, remesh
from optim.methods.ddp.algorithm import Descent, OnStep, PenaltySchedule, descend, start_descent
from optim.model.objective import objective
from optim.model.path import Path
from optim.model.problem import Problem
from optim.numerics.arrays import Array, IntArray

PRESSED_OUT = 0.3
"""Length to which a segment must shrink under the toll before it is left out [m]."""
TOLL = 5.0
"""What a metre of a segment costs more while it is pressed out of the path [1/m]."""
ROOM = 2e-5
"""Clearance asked for beyond the requirement, above the tolerance of the last descent [m]."""
_PATIENCE = 3
"""Descents that may end infeasible before `polish` gives up."""
_MET = 5.0
"""Multiple of its tolerance up to which a constraint counts as met where a descent has not converged."""


@dataclass(frozen=True, eq=False, kw_only=True)
class FeasiblePath:
    """A path that keeps everything."""

    path: Path
    objective: float
    """Its J [-]."""


def settle(problem: Problem, knots: Knots, schedule: PenaltySchedule, on_step: OnStep) -> Descent:
    """A descent from these knots to its end."""
    descent = start_descent(problem, knots, required_at_knots(problem, knots, ROOM), schedule)
    descend(descent, schedule, on_step)
    return descent


def is_feasible(descent: Descent, schedule: PenaltySchedule) -> bool:
    """Whether constraints are met, stationary or not; up to `_MET` times their tolerances will do."""
    residuals, tolerances = descent.residuals.violation, schedule.tolerances
    met = (value <= _MET * limit for value, limit in zip(residuals, tolerances, strict=True))
    return descent.gap <= LARGEST_DEFECT and all(met)


def shed_segments(first: Descent, schedule: PenaltySchedule, most: int, on_step: OnStep) -> list[Descent]:
    """Leave out segments while J falls, with at most `most` failed trials; `first` and every better one."""
    return leave_out_segments(
        first,
        first.problem.vehicle,
        lambda best, index: _without(best, index, schedule, on_step),
        most,
        only_failures_count=True,
    )


def _without(best: Descent, index: int, schedule: PenaltySchedule, on_step: OnStep) -> Descent | None:
    """A descent without the segment: it is shrunk by a toll on its length, then taken out; None where that fails."""
    knots, problem = best.knots, best.problem
    if knots.lengths[index] > PRESSED_OUT:
        pressed = start_descent(problem, knots, required_at_knots(problem, knots, ROOM), schedule)
        run = knots.runs[index]
        pressed.model.stages.toll[run.start + 1 : run.stop + 1] = TOLL
        same = np.arange(len(knots.phi) + 1)
        pressed.model.take_over(best.model, same, np.ones(len(same)))
        descend(pressed, replace(schedule, rounds=2), on_step)
        if pressed.knots.lengths[index] > PRESSED_OUT:
            return None
        knots = pressed.knots
    found = settle(problem, seed_without(problem, knots, index, schedule.spacing), schedule, on_step)
    return found if is_feasible(found, schedule) else None


def refined(descent: Descent, schedule: PenaltySchedule) -> Descent:
    """The same descent at other knots, multipliers carried over."""
    problem, old = descent.problem, descent.knots
    knots = remesh(problem.vehicle, old, schedule.spacing, problem.initial)
    new = start_descent(problem, knots, required_at_knots(problem, knots, ROOM), schedule)
    new.model.take_over(descent.model, *_counterparts(old, knots))
    return new


def _counterparts(old: Knots, new: Knots) -> tuple[IntArray, Array]:
    """For each state of the stages at new knots: the old one beside it, and how much shorter its steps are."""
    index, share = np.zeros(len(new.phi) + 1, np.int64), np.ones(len(new.phi) + 1)
    for before, after in zip(old.runs, new.runs, strict=True):
        count, more = before.stop - before.start, after.stop - after.start
        places = np.rint(np.linspace(0.0, count, more + 1)).astype(np.int64)
        index[after.start + 1 : after.stop + 2] = before.start + 1 + places
        share[after.start + 1 : after.stop + 2] = count / more
    return index, share


def polish(descent: Descent, schedule: PenaltySchedule, rounds: int, on_step: OnStep) -> FeasiblePath | None:
    """Descend, measure clearance and hitch angle between the knots, ask for what is missing, again; the clear path."""
    problem, failures = descent.problem, 0
    for _ in range(rounds):
        descend(descent, schedule, on_step)
        if not is_feasible(descent, schedule):
            failures += 1
            if failures == _PATIENCE:
                break
            continue
        path = path_of(problem.vehicle, descent.knots, problem.initial)
        missing = missing_between(problem, descent.knots, path)
        hitch = _hitch_excess(problem, path)
        if missing.max() <= 0.0 and hitch <= 0.0:
            return FeasiblePath(path=path, objective=objective(path, problem.weights))
        if missing.max() > 0.0:
            descent.model.required[:] = raised(problem, descent.knots, descent.model.required, missing, ROOM)
        if hitch > 0.0:
            descent.model.lower_max_hitch(hitch + ROOM)
    return None


def _hitch_excess(problem: Problem, path: Path) -> float:
    """Excess of the hitch angle between knots over its limit, or that at the ends [rad]; <= 0: none."""
    limit = max(problem.vehicle.max_hitch, abs(path.start[3]), abs(path.goal[3]))
    return max(float(np.abs(segment.alpha).max()) for segment in path.segments) - limit
