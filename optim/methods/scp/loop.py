"""The loop of successive convexification at the knots: model, step, second-order correction, accept or reject.

The merit that a step must lower is the augmented Lagrangian of the true problem, in scaled units,

    m(z) = J(z) + lambda . g(z) + w/2 |g(z)|^2 + sum over knots and bodies  mu v(z) + w/2 v(z)^2

with the defects g of the dynamics and the missing clearance v >= 0 (and w/2 e^2 of limits exceeded by e); the
sub-problem minimises its convex model with virtual control and slack in the places of g and v. The ratio of actual to
predicted decrease accepts or rejects and steers the trust region; the multipliers are those of the accepted
sub-problem (Oguri 2023, SCvx*, updates them by w g instead: the same to first order where the virtual control
vanishes, and slower where it does not), the weight w grows while the violation does not fall.
"""

from dataclasses import dataclass, replace

import numpy as np

from optim.knots.between import missing_at_knots
from optim.knots.rounds import Outcome, Report, Tell
from optim.knots.transcription import STEP_RANGE, VANISHED, Knots, defects, objective_of
from optim.methods.scp.linearisation import Linearisation, Scales, linearise
from optim.methods.scp.restoration import hitch_excess, moved, rate_excess, restore
from optim.methods.scp.subproblem import Limits, Penalty, Step, solve_subproblem
from optim.model.problem import Problem
from optim.model.result import Stop
from optim.numerics.arrays import Array


@dataclass(frozen=True, kw_only=True)
class LoopOptions:
    """Constants of the loop; what they mean to users is said in `optim.methods.scp.method`."""

    solver: str
    max_iterations: int
    tolerance: float
    feasibility: float
    trust_region: float
    weight: float
    corrections: int
    time_limit: float


_LEAST_RADIUS, _LARGEST_RADIUS = 1e-4, 10.0  # relative to the first
_ACCEPT_ABOVE, _SHRINK_BELOW, _GROW_ABOVE = 1e-3, 0.25, 0.7  # ratio of actual to predicted decrease (Oguri 2023)
_AT_BOUND = 0.9  # share of the radius from which on a step counts as held by the trust region
_LARGEST_WEIGHT = 1e8  # at which the violation is all that counts
# a step that small, in scaled units, whose decrease is as predicted: the next would gain less than a third of the
# tolerance (largest share seen on the sample logs: 0.29), and costs as much as this one
_SETTLED, _SETTLED_RATIO = 0.1, 0.5
_NEARLY = 1e-2  # violation at which a vanished segment need not wait for convergence: merging opens a gap anyway
_PATIENCE = 12  # sub-problems at the largest weight that do not halve the violation: nothing near is feasible
_FEWER = 0.3  # a violation that has not fallen to this share after a step makes the weight grow


@dataclass(frozen=True, eq=False)
class _Point:
    """Knots with the values of everything that the merit is made of, in scaled units."""

    knots: Knots
    objective: float
    defects: Array  # (K - 1, 4)
    missing: Array  # (K, 2)
    excess: Array  # (2 K - 1,), of hitch angles and steering rates, which only corrections can cause

    @property
    def violation(self) -> float:
        """The largest of all."""
        return max(float(np.abs(self.defects).max()), float(self.missing.max()), float(self.excess.max()))

    def merit(self, penalty: Penalty) -> float:
        """m of the module's docstring."""
        smooth = (penalty.dynamics * self.defects).sum() + (penalty.clearance * self.missing).sum()
        square = (self.defects**2).sum() + (self.missing**2).sum() + (self.excess**2).sum()
        return self.objective + float(smooth) + 0.5 * penalty.weight * float(square)


class _Patience:
    """Ends a hopeless search: at the largest weight the violation is all that counts, and it does not fall."""

    def __init__(self) -> None:
        self.least, self.waited = np.inf, 0

    def is_over(self, violation: float, weight: float) -> bool:
        if weight < _LARGEST_WEIGHT or violation < 0.5 * self.least:
            self.least, self.waited = violation, 0
        else:
            self.waited += 1
        return self.waited >= _PATIENCE


class Loop:
    """Successive convexification of one problem from given knots; call it as `optim.knots.rounds.AtKnots`."""

    def __init__(self, problem: Problem, spacing: float, options: LoopOptions) -> None:
        self.problem, self.options = problem, options
        self.scales = Scales.of(problem.vehicle, problem.weights, spacing)
        self.spacing = spacing
        self.solver_s = 0.0
        self._last: tuple[Knots, Penalty] | None = None
        self._sound: _Point | None = None
        self._near: tuple[Linearisation, Limits] | None = None

    def __call__(self, knots: Knots, required: Array, tell: Tell) -> Outcome:
        options = self.options
        shortest, longest = (share * self.spacing for share in STEP_RANGE)
        limits = Limits(required=required, shortest=shortest, longest=longest)
        point = self._evaluate(knots, limits)
        penalty, radius = self._first_penalty(knots), 1.0
        curvature, patience, self._sound, self._near = 1.0, _Patience(), None, None
        for iteration in range(1, options.max_iterations + 1):
            near = linearise(self.problem, point.knots, self.scales, penalty.dynamics, self._reach(limits, radius))
            near = replace(near, factor=near.factor * np.sqrt(curvature))
            self._near = near, limits
            step = self._solve(near, limits, penalty, radius)
            if step.status != "optimal":
                if self.solver_s >= options.time_limit:
                    return self._end(point, penalty, Stop.TIME_LIMIT, iteration)
                radius *= 0.25
                if radius < _LEAST_RADIUS:
                    return self._end(point, penalty, Stop.FAILED, iteration, f"the solver says: {step.status}")
                continue
            predicted = point.merit(penalty) - _model(near, step, penalty)
            trial = self._corrected(point, near, step, limits, penalty)
            actual = point.merit(penalty) - trial.merit(penalty)
            size, reach = _size(step), step.reach / options.trust_region
            accepted = actual > 0.0 and actual >= _ACCEPT_ABOVE * predicted
            optimality = self._optimality(point, predicted, actual, size)
            converged = optimality <= 1.0
            tell(self._report(trial, optimality, size, accepted, radius, step.solver_s))
            if accepted:
                before, point = point.violation, trial
                penalty = self._updated(penalty, step, point, before)
                self._remember(point)
                if point.violation <= _NEARLY and _has_vanished(point.knots, VANISHED * self.spacing):
                    return self._end(point, penalty, Stop.CONVERGED, iteration)
            if point.violation <= options.feasibility:
                if converged:
                    return self._end(point, penalty, Stop.CONVERGED, iteration)
            elif converged:
                polished = self._polished(point, near, limits)
                if polished.violation <= options.feasibility:
                    tell(self._report(polished, optimality, 0.0, True, radius, 0.0))
                    return self._end(polished, penalty, Stop.CONVERGED, iteration)
                if penalty.weight >= _LARGEST_WEIGHT:
                    return self._end(point, penalty, Stop.INFEASIBLE, iteration)
                penalty = replace(penalty, weight=min(10.0 * penalty.weight, _LARGEST_WEIGHT))
            elif patience.is_over(point.violation, penalty.weight):
                return self._end(point, penalty, Stop.INFEASIBLE, iteration)
            ratio = actual / predicted if predicted > 0.0 else 1.0
            curvature = _next_curvature(curvature, ratio, at_bound=reach > _AT_BOUND * radius)
            radius = _next_radius(radius, reach, ratio)
            if radius < _LEAST_RADIUS:
                return self._end(point, penalty, Stop.STALLED, iteration)
            if self.solver_s >= options.time_limit:
                return self._end(point, penalty, Stop.TIME_LIMIT, iteration)
        return self._end(point, penalty, Stop.ITERATION_LIMIT, options.max_iterations)

    def _first_penalty(self, knots: Knots) -> Penalty:
        """Weight and multipliers to begin with: those of the last solution where it goes on from its knots."""
        if self._last is not None and self._last[0] is knots:
            return self._last[1]
        return Penalty(self.options.weight, np.zeros((len(knots.h), 4)), np.zeros((len(knots.phi), 2)))

    def _evaluate(self, knots: Knots, limits: Limits) -> _Point:
        vehicle = self.problem.vehicle
        gaps, _ = defects(vehicle, knots)
        missing = missing_at_knots(self.problem, knots, limits.required)
        value = objective_of(knots, self.problem.weights) / self.scales.cost
        excess = np.concatenate([hitch_excess(vehicle, knots), rate_excess(vehicle, knots)]) / self.scales.angle
        return _Point(knots, value, gaps / self.scales.state, missing / self.scales.length, excess)

    def _reach(self, limits: Limits, radius: float) -> float:
        """Obstacles farther than this are left out of the model; a step that meets one is turned down [m]."""
        return float(limits.required.max()) + 1.5 * self.scales.length * max(1.0, min(radius, 2.0))

    def _solve(self, near: Linearisation, limits: Limits, penalty: Penalty, radius: float) -> Step:
        remaining = max(self.options.time_limit - self.solver_s, 1e-3)
        trust = self.options.trust_region * radius
        vehicle, solver = self.problem.vehicle, self.options.solver
        step = solve_subproblem(vehicle, near, self.scales, limits, penalty, trust, solver, remaining)
        self.solver_s += step.solver_s
        return step

    def _corrected(self, point: _Point, near: Linearisation, step: Step, limits: Limits, penalty: Penalty) -> _Point:
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

    def _restored(self, point: _Point, near: Linearisation, limits: Limits) -> _Point:
        return self._evaluate(restore(self.problem, point.knots, near.factor, self.scales, limits), limits)

    def _polished(self, point: _Point, near: Linearisation, limits: Limits) -> _Point:
        """Newton steps onto the constraints whatever they do to the merit, which has nothing left to gain."""
        for _ in range(3):
            if point.violation <= self.options.feasibility:
                break
            point = self._restored(point, near, limits)
        return point

    def _updated(self, penalty: Penalty, step: Step, point: _Point, before: float) -> Penalty:
        """Multipliers of the accepted sub-problem; a larger weight where the violation has not fallen."""
        clearance = np.maximum(penalty.clearance + penalty.weight * point.missing, 0.0)
        stuck = point.violation > max(self.options.feasibility, _FEWER * before)
        weight = min(2.0 * penalty.weight, _LARGEST_WEIGHT) if stuck else penalty.weight
        return Penalty(weight, step.multipliers, clearance)

    def _optimality(self, point: _Point, predicted: float, actual: float, size: float) -> float:
        """What is left to gain over what may be left: at most 1 where the loop has converged.

        Either the model has nothing to offer, or the step was small and did what it promised.
        """
        tolerance = self.options.tolerance
        gain = max(predicted, 0.0) / (tolerance * max(1.0, abs(point.objective)))
        small = size / (_SETTLED * np.sqrt(tolerance / 1e-5))
        return float(min(gain, small)) if actual >= _SETTLED_RATIO * predicted else gain

    def _report(
        self,
        told: _Point,
        optimality: float,
        size: float,
        accepted: bool,
        radius: float,
        solver_s: float,
    ) -> Report:
        options = self.options
        residuals = {
            "optimality": optimality,
            "defect": float(np.abs(told.defects).max()) / options.feasibility,
            "clearance": float(told.missing.max()) / options.feasibility,
        }
        return Report(
            knots=told.knots,
            objective=told.objective * self.scales.cost,
            violation=told.violation,
            step=size,
            residuals=residuals,
            accepted=accepted,
            trust_region=radius,
            solver_s=solver_s,
        )

    def _remember(self, point: _Point) -> None:
        """Keep the best point seen that keeps everything: what a loop that does not converge can still give back."""
        if point.violation <= self.options.feasibility and (
            self._sound is None or point.objective < self._sound.objective
        ):
            self._sound = point

    def _end(self, point: _Point, penalty: Penalty, stop: Stop, iterations: int, word: str = "") -> Outcome:
        if stop not in (Stop.CONVERGED, Stop.FAILED) and point.violation > self.options.feasibility:
            if self._near is not None:
                self._remember(self._polished(point, *self._near))
            if self._sound is not None:
                point, stop = self._sound, Stop.STALLED if stop is Stop.INFEASIBLE else stop
        self._last = (point.knots, penalty)
        defect, missing = float(np.abs(point.defects).max()), float(point.missing.max()) * self.scales.length
        short = f"largest defect {defect:.1e}, clearance short by {missing:.1e} m"
        reasons = {
            Stop.CONVERGED: "converged",
            Stop.INFEASIBLE: f"no clear and drivable path near this one: {short}",
            Stop.STALLED: f"no step lowers the merit any more: {short}",
            Stop.ITERATION_LIMIT: f"the sub-problems were not enough: {short}",
            Stop.TIME_LIMIT: f"out of time: {short}",
            Stop.FAILED: word,
        }
        return Outcome(knots=point.knots, stop=stop, reason=reasons[stop], iterations=iterations)


def _model(near: Linearisation, step: Step, penalty: Penalty) -> float:
    """The convex model's value at the step: what the sub-problem minimised, and the objective it began with."""
    root = 1.0 / np.sqrt(penalty.weight)
    linear = near.g_phi @ step.phi + near.g_h @ step.h
    square = sum(float((part**2).sum()) for part in (step.r, step.nu, step.zeta))
    smooth = root * float((penalty.dynamics * step.nu).sum() + (penalty.clearance * step.zeta).sum())
    return near.objective + float(linear) + 0.5 * square + smooth


def _size(step: Step) -> float:
    """Largest change of an unknown, in scaled units."""
    return max(float(np.abs(part).max()) for part in (step.q, step.phi, step.h))


def _next_radius(radius: float, reach: float, ratio: float) -> float:
    """Smaller where the model was wrong, than the step too; larger where it was right and the step at its bound."""
    if ratio < _SHRINK_BELOW:
        return 0.5 * min(radius, reach)
    return min(3.0 * radius, _LARGEST_RADIUS) if ratio > _GROW_ABOVE and reach > _AT_BOUND * radius else radius


def _next_curvature(curvature: float, ratio: float, at_bound: bool) -> float:
    """The share of the model's curvature to keep: making it convex adds some, and the ratio tells how much.

    Where the step minimises the model along itself, true over model curvature is 2 - ratio. Halves the number of
    sub-problems where convergence is slow (41 to 21 on a dock, 16 to 11 on an angled bay).
    """
    if ratio < _SHRINK_BELOW:
        return min(1.0, 4.0 * curvature)
    if ratio > 1.2 and not at_bound:
        return max(0.05, curvature * max(0.4, 2.0 - ratio))
    return min(1.0, 1.5 * curvature) if ratio < 0.8 else curvature


def _has_vanished(knots: Knots, shortest: float) -> bool:
    return knots.num_cusps > 0 and float(knots.lengths.min()) < shortest
