"""Successive convexification: the problem of `optim.knots.transcription` by a sequence of convex ones.

Source: Esteban Cabezos 2020, section 4.4 (non-linear optimisation); after SCvx (Mao, Szmuk, Acikmese 2018) and SCvx*
(Oguri 2023), with the curvature of the Lagrangian in the model and a second-order correction. The sub-problem
(`optim.methods.scp.statement`) is stated in cvxpy and solved by Clarabel; `optim.knots.rounds` takes care of the
clearance between knots and of redundant gear changes.

The loop: model, step, second-order correction, accept or reject. The ratio of actual to predicted decrease of the
merit (`optim.methods.scp.merit`) accepts or rejects and steers the trust region; the multipliers are those of the
accepted sub-problem (Oguri 2023, SCvx*, updates them by w g instead: the same to first order where the virtual control
vanishes, and slower where it does not), the weight w grows while the violation does not fall.
"""

import math
from dataclasses import dataclass, field, replace
from functools import partial
from typing import Literal

import numpy as np

from optim.knots.rounds import Announce, KnotSolution, improve
from optim.knots.transcription import STEP_RANGE, VANISHED, Knots
from optim.methods.scp.linearisation import Linearisation, Scales, linearise
from optim.methods.scp.merit import Point, evaluate, modelled_merit
from optim.methods.scp.restoration import moved, restore
from optim.methods.scp.subproblem import KnotLimits, Penalty, SubproblemSolution, solve_subproblem
from optim.methods.scp.trust_region import ACCEPT_ABOVE, LARGEST_WEIGHT, Patience, TrustRegion
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from optim.numerics.arrays import Array
from optim.numerics.checks import require

# a step that small, in scaled units, whose decrease is as predicted: the next would gain less than a third of the
# tolerance (largest share seen on the sample logs: 0.29), and costs as much as this one
_SETTLED, _SETTLED_RATIO = 0.1, 0.5
_NEARLY = 1e-2  # violation at which a vanished segment need not wait for convergence: merging opens a gap anyway
_FEWER = 0.3  # a violation that has not fallen to this share after a step makes the weight grow


@dataclass(frozen=True, kw_only=True)
class Scp:
    """Non-linear optimisation by successive convexification (cvxpy, Clarabel)."""

    spacing: float = 0.35
    """Distance between knots [m]; step lengths may become up to twice as long."""
    max_iterations: int = 60
    """Sub-problems in one solution, at most [-]."""
    tolerance: float = 1e-5
    """Largest decrease of J, as a share of it, that the convex model still predicts for a converged solution [-]."""
    feasibility: float = 1e-7
    """Largest defect and missing clearance of a converged solution [-], in units of 0.3 wheelbases and 0.2 rad."""
    trust_region: float = 1.0
    """First radius [-]: times 0.3 rad it bounds the change of steering, heading and hitch angle, times half the spacing
    that of step lengths."""
    weight: float = 1e4
    """First weight of the squared virtual control and slack [-]; it grows while the violation does not fall."""
    corrections: int = 3
    """Second-order corrections of a step, at most [-]."""
    removals: int = 3
    """Segments of the converged path whose removal is tried, shortest first [-]."""
    solver: Literal["clarabel", "piqp", "qoco", "osqp"] = "clarabel"
    """Solver of the sub-problems; others than Clarabel must be installed (pip install piqp qoco osqp)."""
    time_limit: float = math.inf
    """Time in the solver by its own account, all sub-problems together [s]. No limit by default: it would make the
    path depend on what else the machine does."""

    def __post_init__(self) -> None:
        require(
            self,
            "scp",
            spacing=("more than 0 m", self.spacing > 0.0),
            max_iterations=("1 or more", self.max_iterations >= 1),
            tolerance=("more than 0", self.tolerance > 0.0),
            feasibility=("more than 0", self.feasibility > 0.0),
            trust_region=("more than 0", self.trust_region > 0.0),
            weight=("more than 0", self.weight > 0.0),
            corrections=("0 or more", self.corrections >= 0),
            removals=("0 or more", self.removals >= 0),
            solver=("clarabel, piqp, qoco or osqp", self.solver in ("clarabel", "piqp", "qoco", "osqp")),
            time_limit=("more than 0 s", self.time_limit > 0.0),
        )

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        """Improve `problem.initial`; ends, limits and `problem.required_clearance` are kept."""
        at_knots = self.at_knots(problem)
        return improve(problem, at_knots, spacing=self.spacing, removals=self.removals, on_iterate=on_iterate)

    def at_knots(self, problem: Problem) -> "Convexification":
        """The optimiser of the problem at given knots."""
        return Convexification(problem, self)


@dataclass(kw_only=True)
class _Search:
    """Where the iterations from one set of knots stand."""

    point: Point
    penalty: Penalty
    trust: TrustRegion = field(default_factory=TrustRegion)
    patience: Patience = field(default_factory=Patience)
    failure: str = ""
    """The solver's word on the last sub-problem that it did not solve."""


class Convexification:
    """Successive convexification of one problem from given knots, an `optim.knots.rounds.KnotOptimizer`."""

    def __init__(self, problem: Problem, options: Scp) -> None:
        self.problem, self.options = problem, options
        self.scales = Scales.of(problem.vehicle, problem.weights, options.spacing)
        self.solver_s = 0.0
        self._last: tuple[Knots, Penalty] | None = None
        self._sound: Point | None = None
        self._near: tuple[Linearisation, KnotLimits] | None = None

    def __call__(self, knots: Knots, required: Array, announce: Announce) -> KnotSolution:
        """Iterate from these knots until converged, stuck or out of time; `required` (K, 2) [m] as in `improve`."""
        shortest, longest = (share * self.options.spacing for share in STEP_RANGE)
        limits = KnotLimits(required=required, shortest=shortest, longest=longest)
        self._sound, self._near = None, None
        search = _Search(point=self._evaluate(knots, limits), penalty=self._first_penalty(knots))
        for iteration in range(1, self.options.max_iterations + 1):
            stop = self._iteration(search, limits, announce)
            if stop is None and self._is_out_of_time:
                stop = Stop.TIME_LIMIT
            if stop is not None:
                return self._end(search, stop, iteration)
        return self._end(search, Stop.ITERATION_LIMIT, self.options.max_iterations)

    @property
    def _is_out_of_time(self) -> bool:
        return self.solver_s >= self.options.time_limit

    def _iteration(self, search: "_Search", limits: KnotLimits, announce: Announce) -> Stop | None:
        """Linearise, solve the sub-problem, correct its step, accept or reject it; why to stop, if that is so."""
        penalty, trust = search.penalty, search.trust
        near = self._linearise(search.point, penalty, limits, trust)
        step = self._solve(near, limits, penalty, trust.radius)
        if step.status != "optimal":
            return self._without_step(search, step)
        predicted = search.point.merit(penalty) - modelled_merit(near, step, penalty)
        trial = self._corrected(search.point, near, step, limits, penalty)
        actual = search.point.merit(penalty) - trial.merit(penalty)
        accepted = actual > 0.0 and actual >= ACCEPT_ABOVE * predicted
        optimality = self._optimality(search.point, predicted, actual, step.size)
        announce(trial.knots, self._iterate(trial, optimality, step, accepted, trust.radius))
        if accepted:
            self._accept(search, trial, step)
            if trial.violation <= _NEARLY and _has_vanished(trial.knots, VANISHED * self.options.spacing):
                return Stop.CONVERGED
        stop = self._converged(search, optimality, near, limits, announce)
        if stop is not None:
            return stop
        trust.update(actual / predicted if predicted > 0.0 else 1.0, step.reach / self.options.trust_region)
        return Stop.STALLED if trust.is_exhausted else None

    def _without_step(self, search: "_Search", step: SubproblemSolution) -> Stop | None:
        """Shrink the trust region after a sub-problem that was not solved."""
        if self._is_out_of_time:
            return Stop.TIME_LIMIT
        search.trust.shrink()
        search.failure = f"the solver says: {step.status}"
        return Stop.FAILED if search.trust.is_exhausted else None

    def _accept(self, search: "_Search", trial: Point, step: SubproblemSolution) -> None:
        before, search.point = search.point.violation, trial
        search.penalty = self._updated(search.penalty, step, trial, before)
        self._remember(trial)

    def _converged(
        self, search: "_Search", optimality: float, near: Linearisation, limits: KnotLimits, announce: Announce
    ) -> Stop | None:
        """Why to stop, by optimality and violation; where only the second is left, raise the weight."""
        point, penalty, feasibility = search.point, search.penalty, self.options.feasibility
        if point.violation <= feasibility:
            return Stop.CONVERGED if optimality <= 1.0 else None
        if not optimality <= 1.0:
            return Stop.INFEASIBLE if search.patience.is_over(point.violation, penalty.weight) else None
        polished = self._polished(point, near, limits)
        if polished.violation <= feasibility:
            announce(polished.knots, self._iterate(polished, optimality, None, True, search.trust.radius))
            search.point = polished
            return Stop.CONVERGED
        if penalty.weight >= LARGEST_WEIGHT:
            return Stop.INFEASIBLE
        search.penalty = replace(penalty, weight=min(10.0 * penalty.weight, LARGEST_WEIGHT))
        return None

    def _first_penalty(self, knots: Knots) -> Penalty:
        """Weight and multipliers to begin with: those of the last solution where this one continues from its knots."""
        if self._last is not None and self._last[0] is knots:
            return self._last[1]
        return Penalty(self.options.weight, np.zeros((len(knots.h), 4)), np.zeros((len(knots.phi), 2)))

    def _evaluate(self, knots: Knots, limits: KnotLimits) -> Point:
        return evaluate(self.problem, knots, self.scales, limits)

    def _linearise(self, point: Point, penalty: Penalty, limits: KnotLimits, trust: TrustRegion) -> Linearisation:
        """The model near a point; obstacles too far for it are left out, a step that meets one is rejected."""
        reach = float(limits.required.max()) + 1.5 * self.scales.length * max(1.0, min(trust.radius, 2.0))
        near = linearise(self.problem, point.knots, self.scales, penalty.dynamics, reach)
        near = replace(near, factor=near.factor * np.sqrt(trust.curvature))
        self._near = near, limits
        return near

    def _solve(self, near: Linearisation, limits: KnotLimits, penalty: Penalty, radius: float) -> SubproblemSolution:
        remaining = max(self.options.time_limit - self.solver_s, 1e-3)
        trust = self.options.trust_region * radius
        vehicle, solver = self.problem.vehicle, self.options.solver
        step = solve_subproblem(vehicle, near, self.scales, limits, penalty, trust, solver, remaining)
        self.solver_s += step.solver_s
        return step

    def _corrected(
        self, point: Point, near: Linearisation, step: SubproblemSolution, limits: KnotLimits, penalty: Penalty
    ) -> Point:
        """The point after the step, with second-order corrections as long as they lower the merit."""
        vehicle = self.problem.vehicle
        trial = moved(point.knots, vehicle, step.q, step.phi, step.h, self.scales, limits)
        best = latest = self._evaluate(trial, limits)
        for _ in range(self.options.corrections):
            if latest.violation <= 0.1 * self.options.feasibility:
                break
            latest = self._restored(latest, near, limits)
            if latest.merit(penalty) < best.merit(penalty):
                best = latest
        return best

    def _restored(self, point: Point, near: Linearisation, limits: KnotLimits) -> Point:
        return self._evaluate(restore(self.problem, point.knots, near.factor, self.scales, limits), limits)

    def _polished(self, point: Point, near: Linearisation, limits: KnotLimits) -> Point:
        """Newton steps onto the constraints whatever they do to the merit, which has nothing left to gain."""
        for _ in range(3):
            if point.violation <= self.options.feasibility:
                break
            point = self._restored(point, near, limits)
        return point

    def _updated(self, penalty: Penalty, step: SubproblemSolution, point: Point, before: float) -> Penalty:
        """Multipliers of the accepted sub-problem; a larger weight where the violation has not fallen."""
        clearance = np.maximum(penalty.clearance + penalty.weight * point.missing, 0.0)
        stuck = point.violation > max(self.options.feasibility, _FEWER * before)
        weight = min(2.0 * penalty.weight, LARGEST_WEIGHT) if stuck else penalty.weight
        return Penalty(weight, step.multipliers, clearance)

    def _optimality(self, point: Point, predicted: float, actual: float, size: float) -> float:
        """What is left to gain over what may be left: at most 1 where the loop has converged.

        Either the model has nothing to offer, or the step was small and did what it promised.
        """
        tolerance = self.options.tolerance
        gain = max(predicted, 0.0) / (tolerance * max(1.0, abs(point.objective)))
        small = size / (_SETTLED * np.sqrt(tolerance / 1e-5))
        return float(min(gain, small)) if actual >= _SETTLED_RATIO * predicted else gain

    def _iterate(
        self, point: Point, optimality: float, step: SubproblemSolution | None, accepted: bool, radius: float
    ) -> partial[Iterate]:
        """What there is to say of a point, reached by a step or by polishing alone."""
        residuals = {
            "optimality": optimality,
            "defect": float(np.abs(point.defects).max()) / self.options.feasibility,
            "clearance": float(point.missing.max()) / self.options.feasibility,
        }
        return partial(
            Iterate,
            objective=point.objective * self.scales.cost,
            violation=point.violation,
            step=0.0 if step is None else step.size,
            residuals=residuals,
            accepted=accepted,
            trust_region=radius,
            solver_s=0.0 if step is None else step.solver_s,
        )

    def _remember(self, point: Point) -> None:
        """Keep the best point seen that keeps everything: what a loop that does not converge can still give back."""
        if point.violation <= self.options.feasibility and (
            self._sound is None or point.objective < self._sound.objective
        ):
            self._sound = point

    def _end(self, search: "_Search", stop: Stop, iterations: int) -> KnotSolution:
        point = search.point
        if stop not in (Stop.CONVERGED, Stop.FAILED) and point.violation > self.options.feasibility:
            if self._near is not None:
                self._remember(self._polished(point, *self._near))
            if self._sound is not None:
                point, stop = self._sound, Stop.STALLED if stop is Stop.INFEASIBLE else stop
        self._last = (point.knots, search.penalty)
        defect, missing = float(np.abs(point.defects).max()), float(point.missing.max()) * self.scales.length
        short = f"largest defect {defect:.1e}, clearance short by {missing:.1e} m"
        reasons = {
            Stop.CONVERGED: "converged",
            Stop.INFEASIBLE: f"no clear and drivable path near this one: {short}",
            Stop.STALLED: f"no step lowers the merit any more: {short}",
            Stop.ITERATION_LIMIT: f"the sub-problems were not enough: {short}",
            Stop.TIME_LIMIT: f"out of time: {short}",
            Stop.FAILED: search.failure,
        }
        return KnotSolution(knots=point.knots, stop=stop, reason=reasons[stop], iterations=iterations)


def _has_vanished(knots: Knots, shortest: float) -> bool:
    return knots.num_cusps > 0 and float(knots.lengths.min()) < shortest
