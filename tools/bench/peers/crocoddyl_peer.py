"""crocoddyl on the DDP problem: the part that it can state, with a model of equal derivatives.

crocoddyl's box solvers keep constant bounds of the controls and nothing else, so the constraints are the terms of our
augmented Lagrangian (goal, hitch angle, clearance, and the steering angle too, see `stage_kernels`), and the outer
iteration is ours: same multipliers, same penalties, same order. What is compared is one descent at knots 0.35 m apart
from the recorded path to the same tolerances; no segments left out, no clearance between the knots, which is ours
alone. Its model calls our compiled kernels of a stage, once from Python, with the time in these calls told apart, and
once from C++ (`crocoddyl_model.cpp`, built against the wheel), where nothing of an iteration is left in Python.
"""

import importlib
import time
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

from optim.knots.between import required_at_knots
from optim.knots.transcription import Knots, knots_of, objective_of
from optim.methods.ddp.algorithm import Descent, PenaltySchedule, descend, start_descent
from optim.methods.ddp.constraints import PerConstraint
from optim.methods.ddp.model import TruckModel, knots_from
from optim.methods.ddp.search import ROOM
from optim.model.problem import Problem
from optim.numerics.arrays import Array, IntArray
from tools.bench.peers.common import SPACING
from tools.bench.peers.crocoddyl_build import Shooting
from tools.bench.peers.stage_kernels import stage_slopes, stage_value
from tools.bench.peers.stage_pointers import new_table, write

SCHEDULE = PenaltySchedule(
    spacing=SPACING,
    penalties=PerConstraint(goal=1000.0, hitch=10.0, clearance=10.0),
    rounds=10,
    iterations=40,
    gradient=1e-2,
    tolerances=PerConstraint(goal=2e-4, hitch=1e-3, clearance=1e-3),
    reach=1.0,
)
"""That of our first descent, but at the fine knots."""
REACH = 3.0
"""Obstacles nearer than this [m] are in crocoddyl's list: unlike ours it may take long steps between two lists."""
STOP = 1e-6
"""crocoddyl's tolerance on the decrease that is still expected; ours is on the projected gradient, see `SCHEDULE`."""


@dataclass(kw_only=True)
class Outcome:
    """One descent."""

    objective: float
    residuals: tuple[float, ...]
    """Violations of goal, hitch angle (with steering angle), clearance."""
    iterations: int
    seconds: float
    knots: Knots
    in_model: float = 0.0
    """Of these in our kernels and the Python round them [s]."""


@dataclass(eq=False)
class Shared:
    """What the models of all stages share."""

    model: TruckModel
    steer: Array
    states: Array
    clock: list[float] = field(default_factory=lambda: [0.0])

    def place(self) -> tuple[Any, ...]:
        model = self.model
        return model.stages, model.constraints, model.expansion, self.steer, self.states


def ours(problem: Problem, curvature: bool = False) -> Outcome:
    """Our own descent with this schedule."""
    knots = knots_of(problem.vehicle, problem.recorded, SPACING)
    began, steps = time.process_time(), 0

    def count(descent: Descent, step: float) -> None:
        nonlocal steps
        steps += 1

    schedule = replace(SCHEDULE, curvature=curvature)
    descent = start_descent(problem, knots, required_at_knots(problem, knots, ROOM), schedule)
    descend(descent, schedule, count)
    seconds = time.process_time() - began
    return Outcome(
        objective=descent.objective,
        residuals=descent.residuals.violation,
        iterations=steps,
        seconds=seconds,
        knots=descent.knots,
    )


def theirs(problem: Problem, compiled: bool = False) -> Outcome:
    """crocoddyl's BoxFDDP in our outer iteration; `compiled`: with a model in C++ instead of Python."""
    knots = knots_of(problem.vehicle, problem.recorded, SPACING)
    began, iterations = time.process_time(), 0
    start = start_descent(problem, knots, required_at_knots(problem, knots, ROOM), replace(SCHEDULE, reach=REACH))
    model, (states, controls) = start.model, start.trajectory
    shared = Shared(model, np.zeros((len(states), 2)), states.copy())
    controls = _controls(model, states, controls)
    solver = _Compiled(shared) if compiled else _Interpreted(shared)
    before, over = PerConstraint(np.inf, np.inf, np.inf), np.inf
    for number in range(SCHEDULE.rounds):
        model.list_rows(states)
        tolerance = STOP if number + 1 == SCHEDULE.rounds else max(STOP, 10.0 ** (-2 - 2 * number))
        states, controls, count, stop = solver.solve(states, controls, tolerance, 1.0 if number == 0 else 1e-9)
        iterations += count
        over = _update_steering(shared, states)
        now = model.update_multipliers(states).complementary
        now = now._replace(hitch=max(now.hitch, over))
        if all(value <= limit for value, limit in zip(now, SCHEDULE.tolerances, strict=True)) and stop <= STOP:
            break
        model.set_penalty(SCHEDULE.raised(model.lagrangian.penalty, now, before))
        before = now
    solver.close()
    seconds = time.process_time() - began
    ended = knots_from(states, knots)
    violation = model.residuals(states).violation
    return Outcome(
        objective=objective_of(ended, problem.weights),
        residuals=(violation.goal, max(violation.hitch, over), violation.clearance),
        iterations=iterations,
        seconds=seconds,
        knots=ended,
        in_model=shared.clock[0],
    )


def theirs_compiled(problem: Problem) -> Outcome:
    """The same with a model in C++."""
    return theirs(problem, compiled=True)


class _Interpreted:
    """crocoddyl as it comes from Python: its solver compiled, an action model in Python for each stage."""

    def __init__(self, shared: Shared) -> None:
        self._crocoddyl: Any = importlib.import_module("crocoddyl")
        stages = _models(self._crocoddyl, shared)
        self._shooting = self._crocoddyl.ShootingProblem(shared.states[0], stages[:-1], stages[-1])
        self._shooting.nthreads = 1

    def solve(
        self, states: Array, controls: Array, tolerance: float, regularisation: float
    ) -> tuple[Array, Array, int, float]:
        """States, controls, iterations, stopping value."""
        solver = self._crocoddyl.SolverBoxFDDP(self._shooting)
        solver.th_stop = tolerance
        solver.solve(list(states), list(controls), SCHEDULE.iterations, False, regularisation)
        return np.array(list(solver.xs)), np.array(list(solver.us)), int(solver.iter), float(solver.stop)

    def close(self) -> None:
        """Nothing to give back."""


class _Compiled:
    """The same solver round a model in C++ that calls our kernels by their addresses."""

    def __init__(self, shared: Shared) -> None:
        self._shared, (self._table, self._numbers) = shared, new_table()
        write(shared.place(), self._table, self._numbers)
        self._shooting = Shooting(self._table, shared.states[0], _idle(shared.model), *_boxes(shared.model))

    def solve(
        self, states: Array, controls: Array, tolerance: float, regularisation: float
    ) -> tuple[Array, Array, int, float]:
        """States, controls, iterations, stopping value."""
        write(self._shared.place(), self._table, self._numbers)
        return self._shooting.solve(states, controls, tolerance, SCHEDULE.iterations, regularisation)

    def close(self) -> None:
        self._shooting.close()


def _idle(model: TruckModel) -> IntArray:
    """1 where a stage drives, and has one control: the second is idle and costs half its square. Shape (N,).

    With one control alone, BoxFDDP was seen to end rounds early (0.33 above the optimum on bay_02); with an idle one
    held by narrow bounds, its box QPs take several times as long.
    """
    return (model.stages.gear != 0.0).astype(np.int64)


def _boxes(model: TruckModel) -> tuple[Array, Array]:
    """Bounds of the controls, low and high. Shape (N, 2) each."""
    st, rests = model.stages, model.stages.gear == 0.0
    steer = np.where(rests, st.max_steer, 1.0)
    low, high = np.where(rests, st.shortest, -1.0), np.where(rests, st.longest, 1.0)
    return np.stack([-steer, low], axis=1), np.stack([steer, high], axis=1)


def _controls(model: TruckModel, states: Array, controls: Array) -> Array:
    """Our controls as w."""
    out, st = controls.copy(), model.stages
    drives = st.gear != 0.0
    reach = st.max_steer_rate * st.share[drives] * states[:-1][drives, 5]
    out[drives, 0] = np.clip((controls[drives, 0] - states[:-1][drives, 4]) / reach, -1.0, 1.0)
    return out


def _update_steering(shared: Shared, states: Array) -> float:
    """Multipliers of |phi| <= max_steer; the largest residual."""
    penalty, limit = shared.model.lagrangian.penalty.hitch, shared.model.stages.max_steer
    excess = np.stack([states[:, 4] - limit, -states[:, 4] - limit], axis=1)
    worst = float(np.abs(np.maximum(excess, -shared.steer / penalty)).max())
    shared.steer[:] = np.maximum(0.0, shared.steer + penalty * excess)
    return worst


def _models(crocoddyl: Any, shared: Shared) -> list[Any]:
    """One action model for each stage, and one for the end."""
    state, st = crocoddyl.StateVector(6), shared.model.stages
    value, slopes = cast(Any, stage_value), cast(Any, stage_slopes)  # kernels, called with a tuple of arguments

    class Stage(crocoddyl.ActionModelAbstract):
        def __init__(self, k: int, idle: bool) -> None:
            crocoddyl.ActionModelAbstract.__init__(self, state, 2, 1)
            self.k, self.idle, self.none = k, idle, np.zeros(2)
            self.out, self.fz, self.lz, self.lzz = np.zeros(6), np.zeros((6, 8)), np.zeros(8), np.zeros((8, 8))

        def calc(self, data: Any, x: Array, u: Array | None = None) -> None:
            entered = time.process_time()
            shared.states[self.k] = x
            place, w = shared.place(), self.none if u is None or not len(u) else u
            cost = value(*place, self.k, w, self.out)
            data.cost = cost + 0.5 * w[1] * w[1] if self.idle else cost
            data.xnext = self.out if self.k < st.gear.size else x
            shared.clock[0] += time.process_time() - entered

        def calcDiff(self, data: Any, x: Array, u: Array | None = None) -> None:
            entered = time.process_time()
            shared.states[self.k] = x
            place, w = shared.place(), self.none if u is None or not len(u) else u
            slopes(*place, self.k, w, self.fz, self.lz, self.lzz)
            data.Lx, data.Lxx = self.lz[:6], self.lzz[:6, :6]
            if self.k < st.gear.size:
                if self.idle:
                    self.lz[7], self.lzz[7, 7] = w[1], 1.0
                data.Fx, data.Fu = self.fz[:, :6], self.fz[:, 6:]
                data.Lu, data.Luu, data.Lxu = self.lz[6:], self.lzz[6:, 6:], self.lzz[:6, 6:]
            shared.clock[0] += time.process_time() - entered

    low, high = _boxes(shared.model)
    out = [Stage(k, bool(idle)) for k, idle in enumerate(_idle(shared.model))]
    for k, stage in enumerate(out):
        stage.u_lb, stage.u_ub = low[k], high[k]
    return [*out, Stage(st.gear.size, True)]
