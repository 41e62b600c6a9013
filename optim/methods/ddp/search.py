"""Round the descents: coarse knots first, segments that the path can do without, clearance between the knots."""

from dataclasses import dataclass, replace

import numpy as np

from optim.knots.between import missing_between, raised
from optim.knots.transcription import Knots, path_of, remesh, without_segment
from optim.methods.ddp.augmented import Descent, OnStep, Plan, descend, start_descent
from optim.model.objective import objective
from optim.model.path import Path
from optim.model.problem import Problem
from optim.numerics.arrays import Array, IntArray

LARGEST_GAP = 1e-6
"""Of a trajectory that counts as feasible [m or rad]; after one full step there is none but rounding."""
VANISHED = 0.3
"""Segments shorter than this [m] are merged away: they only buy a jump of the steering."""
TOLL = 5.0
"""What a metre of a segment costs more while it is pressed out of the path [1/m]."""
_ROOM = 2e-5  # [m]: clearance asked for beyond the requirement, above the tolerance of the last descent
_PATIENCE = 3
"""Descents that may end infeasible before `polish` gives up."""
_MET = 5.0
"""Multiple of its tolerance up to which a constraint counts as met where a descent has not converged."""
_GAIN = 1e-6  # relative; less is no improvement


@dataclass(frozen=True, eq=False, kw_only=True)
class Finding:
    """A path that keeps everything."""

    path: Path
    value: float
    """Its J [-]."""


def required_clearance(problem: Problem, knots: Knots) -> Array:
    """Clearance to ask for at each knot by truck and trailer [m], to begin with. Shape (K, 2)."""
    return np.full((len(knots.phi), 2), problem.required_clearance + _ROOM)


def settle(problem: Problem, knots: Knots, plan: Plan, on_step: OnStep) -> Descent:
    """A descent from these knots to its end."""
    descent = start_descent(problem, knots, required_clearance(problem, knots), plan)
    descend(descent, plan, on_step)
    return descent


def is_feasible(descent: Descent, plan: Plan) -> bool:
    """Whether constraints are met, stationary or not; up to `_MET` times their tolerances will do."""
    met = (value <= _MET * limit for value, limit in zip(descent.residuals.violation, plan.tolerances, strict=True))
    return descent.gap <= LARGEST_GAP and all(met)


def shed_segments(first: Descent, plan: Plan, most: int, on_step: OnStep) -> list[Descent]:
    """Leave out segments, shortest first, while J falls; at most so many trials that fail. All that were better."""
    found, failures = [first], 0
    vehicle = first.problem.vehicle
    longest = vehicle.truck_front + vehicle.trailer_rear
    while failures < most:
        lengths = np.asarray(found[-1].knots.lengths)
        candidates = [int(i) for i in np.argsort(lengths, kind="stable") if len(lengths) > 1 and lengths[i] <= longest]
        for index in candidates:
            trial = _without(found[-1], index, plan, on_step)
            if trial is not None and trial.value < found[-1].value * (1.0 - _GAIN):
                found.append(trial)
                break
            failures += 1
            if failures == most:
                break
        else:
            break
    return found


def _without(best: Descent, index: int, plan: Plan, on_step: OnStep) -> Descent | None:
    """A descent without the segment: it is shrunk by a toll on its length, then taken out; None where that fails."""
    knots, problem = best.knots, best.problem
    if knots.lengths[index] > VANISHED:
        pressed = start_descent(problem, knots, required_clearance(problem, knots), plan)
        run = knots.runs[index]
        pressed.model.stages.toll[run.start + 1 : run.stop + 1] = TOLL
        same = np.arange(len(knots.phi) + 1)
        pressed.model.take_over(best.model, same, np.ones(len(same)))
        descend(pressed, replace(plan, rounds=2), on_step)
        if pressed.knots.lengths[index] > VANISHED:
            return None
        knots = pressed.knots
    knots = without_segment(knots, index)
    states = knots.states.copy()
    states[0], states[-1] = problem.initial.start, problem.initial.goal
    knots = remesh(problem.vehicle, replace(knots, states=states), plan.spacing, problem.initial)
    found = settle(problem, knots, plan, on_step)
    return found if is_feasible(found, plan) else None


def refined(descent: Descent, plan: Plan) -> Descent:
    """The same descent at other knots, multipliers carried over."""
    problem, old = descent.problem, descent.knots
    knots = remesh(problem.vehicle, old, plan.spacing, problem.initial)
    new = start_descent(problem, knots, required_clearance(problem, knots), plan)
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


def polish(descent: Descent, plan: Plan, rounds: int, on_step: OnStep) -> Finding | None:
    """Descend, measure clearance and hitch angle between the knots, ask for what is missing, again; the clear path."""
    problem, failures = descent.problem, 0
    for _ in range(rounds):
        descend(descent, plan, on_step)
        if not is_feasible(descent, plan):
            failures += 1
            if failures == _PATIENCE:
                break
            continue
        path = path_of(problem.vehicle, descent.knots, problem.initial)
        missing = missing_between(problem, descent.knots, path)
        hitch = _hitch_excess(problem, path)
        if missing.max() <= 0.0 and hitch <= 0.0:
            return Finding(path=path, value=objective(path, problem.weights))
        if missing.max() > 0.0:
            required = descent.model.lagrangian.required[1:]  # the stage before the first knot asks for nothing
            required[:] = raised(problem, descent.knots, required, missing, _ROOM)
        if hitch > 0.0:
            descent.model.lagrangian.scalars[3] -= hitch + _ROOM
    return None


def _hitch_excess(problem: Problem, path: Path) -> float:
    """By how much the hitch angle exceeds its limit, or that at the ends, between the knots [rad]; <= 0: not."""
    limit = max(problem.vehicle.max_hitch, abs(path.start[3]), abs(path.goal[3]))
    return max(float(np.abs(segment.alpha).max()) for segment in path.segments) - limit
