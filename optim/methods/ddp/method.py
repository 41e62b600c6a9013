"""Differential dynamic programming over gear segments of free length, constraints by an augmented Lagrangian.

Source: Esteban Cabezos 2020, section 4.3. What the source does with weights (the goal, obstacles) is done with
multipliers here, so that the goal is reached and the limits are kept exactly; its own formulation stays available as
`variant="source"`. See `optim.methods.ddp.truck` for stages, states and controls, `optim.methods.ddp.features` for the
clearance, `optim.methods.ddp.augmented` for the multipliers, `optim.methods.ddp.search` for what is done about
needless gear changes and clearance between the knots.
"""

from dataclasses import dataclass, replace
from typing import Literal

from optim.knots.transcription import knots_of, path_of
from optim.methods.ddp.augmented import Descent, Plan
from optim.methods.ddp.model import Residuals
from optim.methods.ddp.search import LARGEST_GAP, Finding, is_feasible, polish, refined, settle, shed_segments
from optim.methods.ddp.solver import End
from optim.methods.ddp.source import solve_source
from optim.model.objective import objective
from optim.model.path import Path
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
    """Segments whose removal may be tried in vain, shortest first [-]."""
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
        tell = _Teller(problem, self, on_iterate)
        first, *others = self._first_plans()
        descent, finding = self._attempt(problem, first, tell)
        while finding is None and others:
            descent, finding = self._attempt(problem, others.pop(0), tell)
        return tell.result(descent, finding)

    def _attempt(self, problem: Problem, plan: Plan, tell: "_Teller") -> tuple[Descent, Finding | None]:
        """Descend at coarse knots, leave out segments, then keep everything between fine knots too."""
        descent = settle(problem, knots_of(problem.vehicle, problem.initial, plan.spacing), plan, tell.step)
        if not is_feasible(descent, plan):
            return descent, None
        # the last is the best, unless it only exists between coarse knots
        for candidate in reversed(shed_segments(descent, plan, self.removals, tell.step)):
            descent = refined(candidate, self._last_plan())
            finding = polish(descent, self._last_plan(), self.max_rounds, tell.step)
            if finding is not None:
                return descent, finding
        return descent, None

    def _first_plans(self) -> tuple[Plan, ...]:
        """What is tried in turn until a path is found: low penalties go farther down, high ones keep to the ground."""
        loose = (2e-4, 1e-3, 1e-3)  # [m, rad]: what comes after is exact
        low = Plan(
            spacing=self.coarse_spacing,
            penalties=(self.goal_penalty, self.clearance_penalty, self.clearance_penalty),
            rounds=self.max_updates,
            iterations=self.max_iterations,
            gradient=1e-2,
            tolerances=loose,
            curvature=self.hessian == "full",
        )
        goal, hitch, clear = self._high_penalties()
        highest = (100.0 * goal, 10.0 * hitch, 10.0 * clear)
        coarse = [replace(low, penalties=penalties) for penalties in (low.penalties, (goal, hitch, clear), highest)]
        return *coarse, *(replace(plan, spacing=self.spacing) for plan in coarse)

    def _last_plan(self) -> Plan:
        return Plan(
            spacing=self.spacing,
            penalties=self._high_penalties(),
            rounds=max(1, self.max_updates // 2),
            iterations=self.max_iterations,
            gradient=self.gradient_tolerance,
            tolerances=(self.goal_tolerance, self.clearance_tolerance, self.clearance_tolerance),
            curvature=self.hessian == "full",
            regularisation=0.0,
            second_from=0,
            reach=0.5,
        )

    def _high_penalties(self) -> tuple[float, float, float]:
        return 10.0 * self.goal_penalty, 100.0 * self.clearance_penalty, 100.0 * self.clearance_penalty


class _Teller:
    """Numbers the iterates of all descents through, and puts the outcome into words."""

    def __init__(self, problem: Problem, options: Ddp, on_iterate: OnIterate) -> None:
        self.problem, self.options, self.on_iterate, self.count = problem, options, on_iterate, 0
        self.value = objective(problem.initial, problem.weights)
        on_iterate(Iterate(iteration=0, path=problem.initial, objective=self.value))

    def step(self, descent: Descent, size: float) -> None:
        self.count += 1
        if self.on_iterate is ignore:
            return
        residuals = descent.model.residuals(descent.states, update=False)
        path = path_of(self.problem.vehicle, descent.knots, self.problem.initial)
        self._tell(path, max(residuals.violation), size, self._over_tolerance(descent, residuals))

    def _tell(self, path: Path, violation: float, size: float, residuals: dict[str, float]) -> None:
        value = objective(path, self.problem.weights)
        self.on_iterate(
            Iterate(
                iteration=self.count,
                path=path,
                objective=value,
                violation=violation,
                step=size,
                residuals=residuals,
            )
        )

    def _over_tolerance(self, descent: Descent, residuals: Residuals) -> dict[str, float]:
        goal, hitch, clear = residuals.complementary
        return {
            "projected gradient": descent.gradient / self.options.gradient_tolerance,
            "gap": descent.gap / LARGEST_GAP,
            "goal": goal / self.options.goal_tolerance,
            "hitch angle": hitch / self.options.clearance_tolerance,
            "clearance": clear / self.options.clearance_tolerance,
        }

    def _lacking(self, descent: Descent) -> str:
        """What the last descent did not keep, in words."""
        goal, hitch, clear = descent.residuals.violation
        options, lacking = self.options, []
        if goal > options.goal_tolerance:
            lacking.append(f"the goal is missed by {goal:.2g} m or rad")
        if hitch > options.clearance_tolerance:
            lacking.append(f"the hitch angle is {hitch:.2g} rad beyond its limit")
        if clear > options.clearance_tolerance:
            lacking.append(f"{clear:.2g} m of clearance are missing")
        if descent.gap > LARGEST_GAP:
            lacking.append(f"shots do not meet by {descent.gap:.2g} m or rad")
        return ", ".join(lacking) or "clearance is missing between the knots"

    def result(self, descent: Descent, finding: Finding | None) -> Result:
        """The path found where it is better, and why it ended."""
        path = self.problem.initial
        if finding is not None and finding.value < self.value:
            path = finding.path
        gradient = f"projected gradient {descent.gradient:.1e}"
        if finding is None:
            stop, reason = Stop.INFEASIBLE, f"no path found keeps everything: {self._lacking(descent)}; {gradient}"
        elif descent.gradient <= self.options.gradient_tolerance:
            stop, reason = Stop.CONVERGED, gradient
        else:
            stop = Stop.STALLED if descent.end is End.STALLED else Stop.ITERATION_LIMIT
            reason = f"all constraints are kept, yet it is not stationary: {gradient}"
        self.count += 1
        final = self._over_tolerance(descent, descent.residuals) if path is not self.problem.initial else {}
        self._tell(path, 0.0, 0.0, final)
        return Result(path=path, stop=stop, reason=reason, iterations=self.count - 1)
