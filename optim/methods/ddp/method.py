"""Differential dynamic programming over gear segments of free length, constraints by an augmented Lagrangian.

Source: Esteban Cabezos 2020, section 4.3. What the source does with weights (the goal, obstacles) is done with
multipliers here, so that the goal is reached and the limits are kept exactly; its own formulation stays available as
`variant="source"`. The algorithm is in `optim.methods.ddp.algorithm`; see `optim.methods.ddp.truck` for stages, states
and controls, `optim.methods.ddp.features` for the clearance, `optim.methods.ddp.search` for what is done about
redundant gear changes and clearance between the knots.
"""

from dataclasses import dataclass, replace
from functools import partial
from typing import Literal

from optim.knots.transcription import LARGEST_DEFECT, knots_of, path_of
from optim.methods.ddp.algorithm import Descent, OnStep, PenaltySchedule
from optim.methods.ddp.constraints import PerConstraint, Residuals
from optim.methods.ddp.search import FeasiblePath, is_feasible, polish, refined, settle, shed_segments
from optim.methods.ddp.source import solve_source
from optim.model.iterates import IterateStream
from optim.model.objective import objective
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from optim.numerics.checks import require


@dataclass(frozen=True, kw_only=True)
class Ddp:
    """Differential dynamic programming: second derivatives, bounds, augmented Lagrangian."""

    variant: Literal["constrained", "source"] = "constrained"
    """constrained: J, with goal, limits and clearance as constraints; source: the weights of the source's section 4.3,
    without constraints, for comparison: it hardly ever reaches the goal."""
    hessian: Literal["full", "gauss_newton"] = "full"
    """full: second derivatives of the dynamics and the distances from the first update of the multipliers on (DDP);
    gauss_newton: never (iLQR). On the twelve sample logs full takes 1477 iterations against 1942 and a tenth less
    time, to the same J within 0.02 %."""
    spacing: float = 0.35
    """Distance between knots of the result [m]; one integration step each."""
    coarse_spacing: float = 0.8
    """Distance between the knots of the first descent, and while segments are left out [m]."""
    max_iterations: int = 40
    """Iterations between two updates of the multipliers, at most [-]."""
    max_updates: int = 10
    """Updates of the multipliers in one descent, at most [-]."""
    max_rounds: int = 12
    """Descents at the final knots, at most [-]; each asks for the clearance that the last lacked between knots."""
    removals: int = 4
    """Maximum number of failed attempts to remove a segment, shortest first [-]."""
    goal_penalty: float = 1000.0
    """First penalty of the goal [1/m^2, 1/rad^2]; where a descent ends infeasible, others begin with 10 and 1000
    times this, and 100 and 1000 times `clearance_penalty`."""
    clearance_penalty: float = 10.0
    """First penalty of clearance and hitch angle [1/m^2, 1/rad^2]."""
    gradient_tolerance: float = 1e-3
    """Largest projected gradient |u - clip(u - dJ/du)| of a converged path, by steering and by length [1/rad, 1/m]."""
    goal_tolerance: float = 2e-8
    """Largest component by which the last state of a converged path misses the goal [m, rad]."""
    clearance_tolerance: float = 1e-5
    """Largest miss of clearance and of the hitch angle's limit at the knots of a converged path [m, rad]; they ask for
    2e-5 m more than required."""

    def __post_init__(self) -> None:
        require(
            self,
            "ddp",
            variant=("constrained or source", self.variant in ("constrained", "source")),
            hessian=("full or gauss_newton", self.hessian in ("full", "gauss_newton")),
            spacing=("more than 0 and at most 1 m", 0.0 < self.spacing <= 1.0),
            coarse_spacing=("at least the spacing and at most 1 m", self.spacing <= self.coarse_spacing <= 1.0),
            max_iterations=("1 or more", self.max_iterations >= 1),
            max_updates=("1 or more", self.max_updates >= 1),
            max_rounds=("1 or more", self.max_rounds >= 1),
            removals=("0 or more", self.removals >= 0),
            goal_penalty=("more than 0", self.goal_penalty > 0.0),
            clearance_penalty=("more than 0", self.clearance_penalty > 0.0),
            gradient_tolerance=("more than 0", self.gradient_tolerance > 0.0),
            goal_tolerance=("more than 0 and at most 1e-6", 0.0 < self.goal_tolerance <= 1e-6),
            clearance_tolerance=("more than 0 and at most 1e-4 m", 0.0 < self.clearance_tolerance <= 1e-4),
        )

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        """Improve `problem.initial`; ends, limits and `problem.required_clearance` are kept."""
        if self.variant == "source":
            return solve_source(problem, self.spacing, self.max_iterations, on_iterate)
        iterates = IterateStream.begin(problem, on_iterate)
        first, *others = self._first_schedules()
        descent, found = self._attempt(problem, first, partial(self._announce, iterates))
        while found is None and others:
            descent, found = self._attempt(problem, others.pop(0), partial(self._announce, iterates))
        return self._result(iterates, descent, found)

    def _attempt(
        self, problem: Problem, schedule: PenaltySchedule, on_step: OnStep
    ) -> tuple[Descent, FeasiblePath | None]:
        """Descend at coarse knots, leave out segments, then keep everything between fine knots too."""
        descent = settle(problem, knots_of(problem.vehicle, problem.initial, schedule.spacing), schedule, on_step)
        if not is_feasible(descent, schedule):
            return descent, None
        # the last is the best, unless it only exists between coarse knots
        for candidate in reversed(shed_segments(descent, schedule, self.removals, on_step)):
            descent = refined(candidate, self._last_schedule())
            found = polish(descent, self._last_schedule(), self.max_rounds, on_step)
            if found is not None:
                return descent, found
        return descent, None

    def _first_schedules(self) -> tuple[PenaltySchedule, ...]:
        """What is tried in turn until a path is found: low penalties go farther down, high ones keep to the ground."""
        low = PenaltySchedule(
            spacing=self.coarse_spacing,
            penalties=PerConstraint(self.goal_penalty, self.clearance_penalty, self.clearance_penalty),
            rounds=self.max_updates,
            iterations=self.max_iterations,
            gradient=1e-2,
            tolerances=PerConstraint(goal=2e-4, hitch=1e-3, clearance=1e-3),  # what comes after is exact
            curvature=self.hessian == "full",
        )
        high = self._high_penalties()
        highest = PerConstraint(100.0 * high.goal, 10.0 * high.hitch, 10.0 * high.clearance)
        coarse = [replace(low, penalties=penalties) for penalties in (low.penalties, high, highest)]
        return *coarse, *(replace(schedule, spacing=self.spacing) for schedule in coarse)

    def _last_schedule(self) -> PenaltySchedule:
        return PenaltySchedule(
            spacing=self.spacing,
            penalties=self._high_penalties(),
            rounds=max(1, self.max_updates // 2),
            iterations=self.max_iterations,
            gradient=self.gradient_tolerance,
            tolerances=self._tolerances(),
            curvature=self.hessian == "full",
            regularisation=0.0,
            second_from=0,
            reach=0.5,
        )

    def _high_penalties(self) -> PerConstraint:
        clearance = 100.0 * self.clearance_penalty
        return PerConstraint(10.0 * self.goal_penalty, clearance, clearance)

    def _tolerances(self) -> PerConstraint:
        return PerConstraint(self.goal_tolerance, self.clearance_tolerance, self.clearance_tolerance)

    def _announce(self, iterates: IterateStream, descent: Descent, step: float) -> None:
        iterates.emit(lambda number: self._iterate(number, descent, step))

    def _iterate(self, number: int, descent: Descent, step: float) -> Iterate:
        """The path of a descent after a step."""
        problem, residuals = descent.problem, descent.model.residuals(descent.trajectory.states)
        path = path_of(problem.vehicle, descent.knots, problem.initial)
        return Iterate(
            iteration=number,
            path=path,
            objective=objective(path, problem.weights),
            violation=max(residuals.violation),
            step=step,
            residuals=self._over_tolerance(descent, residuals),
        )

    def _over_tolerance(self, descent: Descent, residuals: Residuals) -> dict[str, float]:
        now, limit = residuals.complementary, self._tolerances()
        return {
            "projected gradient": descent.gradient / self.gradient_tolerance,
            "gap": descent.gap / LARGEST_DEFECT,
            "goal": now.goal / limit.goal,
            "hitch angle": now.hitch / limit.hitch,
            "clearance": now.clearance / limit.clearance,
        }

    def _result(self, iterates: IterateStream, descent: Descent, found: FeasiblePath | None) -> Result:
        """The path found where it is better, and why the last descent ended."""
        problem, path = descent.problem, descent.problem.initial
        if found is not None and found.objective < objective(path, problem.weights):
            path = found.path
        gradient = f"projected gradient {descent.gradient:.1e}"
        if found is None:
            stop, reason = Stop.INFEASIBLE, f"no path found keeps everything: {self._lacking(descent)}; {gradient}"
        elif descent.gradient <= self.gradient_tolerance:
            stop, reason = Stop.CONVERGED, gradient
        else:
            stop = Stop.STALLED if descent.stop is Stop.STALLED else Stop.ITERATION_LIMIT
            reason = f"all constraints are kept, yet it is not stationary: {gradient}"
        iterations, value = iterates.number, objective(path, problem.weights)
        residuals = {} if path is problem.initial else self._over_tolerance(descent, descent.residuals)
        iterates.emit(lambda number: Iterate(iteration=number, path=path, objective=value, residuals=residuals))
        return Result(path=path, stop=stop, reason=reason, iterations=iterations)

    def _lacking(self, descent: Descent) -> str:
        """What the last descent did not keep, in words."""
        over, limit, lacking = descent.residuals.violation, self._tolerances(), []
        if over.goal > limit.goal:
            lacking.append(f"the goal is missed by {over.goal:.2g} m or rad")
        if over.hitch > limit.hitch:
            lacking.append(f"the hitch angle is {over.hitch:.2g} rad beyond its limit")
        if over.clearance > limit.clearance:
            lacking.append(f"{over.clearance:.2g} m of clearance are missing")
        if descent.gap > LARGEST_DEFECT:
            lacking.append(f"shots do not meet by {descent.gap:.2g} m or rad")
        return ", ".join(lacking) or "clearance is missing between the knots"
