"""crocoddyl on the DDP problem: the part that it can state, with a model of equal derivatives.

crocoddyl's box solvers keep constant bounds of the controls and nothing else, so the constraints are the terms of our
augmented Lagrangian (goal, hitch angle, clearance, and the steering angle too, see `stage_kernels`), and the outer
iteration is ours: same multipliers, same penalties, same order. What is compared is one descent at knots 0.35 m apart
from the recorded path to the same tolerances; no segments left out, no clearance between the knots, which is ours
alone. Its model is written in Python round our compiled kernels of a stage; the time in these calls is told apart.
"""

import importlib
import time
from dataclasses import dataclass, field, replace
from typing import Any, cast

import numpy as np

import optim.methods  # noqa: F401 - whole, before parts of it that import each other
from optim.arrays import Array
from optim.ddp.augmented import Descent, Plan, descend, start_descent
from optim.ddp.backward import new_policy
from optim.ddp.model import TruckModel, knots_from
from optim.ddp.search import required_clearance
from optim.methods.transcription import Knots, knots_of, objective_of
from optim.problem import Problem
from tools.bench.peers.common import SPACING, least
from tools.bench.peers.stage_kernels import stage_slopes, stage_value

PLAN = Plan(
    spacing=SPACING,
    penalties=(1000.0, 10.0, 10.0),
    rounds=10,
    iterations=40,
    gradient=1e-2,
    tolerances=(2e-4, 1e-3, 1e-3),
    reach=1.0,
)
"""That of our first descent, but at the fine knots."""
REACH = 3.0
"""Obstacles nearer than this [m] are in crocoddyl's list: unlike ours it may take long steps between two lists."""
STOP = 1e-6
"""crocoddyl's tolerance on the decrease that is still expected; ours is on the projected gradient, see `PLAN`."""


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
    bound: float = 0.0
    """What it would take if its model were compiled into it [s]: its own iteration on a linear-quadratic problem of
    the same size, our kernels for the whole path once in each iteration, and nothing else."""


@dataclass(eq=False)
class Shared:
    """What the models of all stages share."""

    model: TruckModel
    steer: Array
    states: Array
    clock: list[float] = field(default_factory=lambda: [0.0])

    def place(self) -> tuple[Any, ...]:
        model = self.model
        scene, footprints = model.problem.scene.packed, model.problem.vehicle.footprints
        return model.stages, scene, footprints, model.rows, model.lagrangian, model.expansion, self.steer, self.states


def ours(problem: Problem, curvature: bool = False) -> Outcome:
    """Our own descent with this plan."""
    knots = knots_of(problem.vehicle, problem.recorded, SPACING)
    began, steps = time.process_time(), 0

    def count(descent: Descent, step: float) -> None:
        nonlocal steps
        steps += 1

    plan = replace(PLAN, curvature=curvature)
    descent = start_descent(problem, knots, required_clearance(problem, knots), plan)
    descend(descent, plan, count)
    seconds = time.process_time() - began
    return Outcome(
        objective=descent.value,
        residuals=descent.residuals.violation,
        iterations=steps,
        seconds=seconds,
        knots=descent.knots,
    )


def theirs(problem: Problem) -> Outcome:
    """crocoddyl's BoxFDDP in our outer iteration."""
    crocoddyl: Any = importlib.import_module("crocoddyl")
    knots = knots_of(problem.vehicle, problem.recorded, SPACING)
    began, iterations = time.process_time(), 0
    start = start_descent(problem, knots, required_clearance(problem, knots), replace(PLAN, reach=REACH))
    model, states = start.model, start.states
    shared = Shared(model, np.zeros((len(states), 2)), states.copy())
    controls = _controls(model, states, start.controls)
    stages = _models(crocoddyl, shared)
    shooting = crocoddyl.ShootingProblem(states[0], stages[:-1], stages[-1])
    shooting.nthreads = 1
    scalars, before, over = model.lagrangian.scalars, (np.inf,) * 3, np.inf
    for number in range(PLAN.rounds):
        model.refresh(states)
        solver = crocoddyl.SolverBoxFDDP(shooting)
        solver.th_stop = STOP if number + 1 == PLAN.rounds else max(STOP, 10.0 ** (-2 - 2 * number))
        solver.solve(list(states), list(controls), PLAN.iterations, False, 1.0 if number == 0 else 1e-9)
        iterations += solver.iter
        states, controls = np.array(list(solver.xs)), np.array(list(solver.us))
        over = _update_steering(shared, states)
        residuals = model.residuals(states, update=True)
        now = residuals.complementary
        now = (now[0], max(now[1], over), now[2])
        if all(value <= limit for value, limit in zip(now, PLAN.tolerances, strict=True)) and solver.stop <= STOP:
            break
        for i in range(3):
            if now[i] > max(0.25 * before[i], PLAN.tolerances[i]):
                scalars[i] *= PLAN.growth
        before = now
    seconds = time.process_time() - began
    ended = knots_from(states, knots)
    violation = model.residuals(states, update=False).violation
    return Outcome(
        objective=objective_of(ended, problem.weights),
        residuals=(violation[0], max(violation[1], over), violation[2]),
        iterations=iterations,
        seconds=seconds,
        knots=ended,
        in_model=shared.clock[0],
        bound=iterations
        * (
            _iteration(crocoddyl, len(controls))
            + _kernels(start_descent(problem, knots, required_clearance(problem, knots), PLAN))
        ),
    )


def _iteration(crocoddyl: Any, stages: int) -> float:
    """CPU time of an iteration of its solver on a linear-quadratic problem, everything in C++ [s]."""
    rng = np.random.default_rng(0)
    a, b = np.eye(6) + 0.1 * rng.standard_normal((6, 6)), rng.standard_normal((6, 2))
    model = crocoddyl.ActionModelLQR(
        a, b, np.eye(6), np.eye(2), np.zeros((6, 2)), np.zeros(6), np.zeros(6), np.zeros(2)
    )
    model.u_lb, model.u_ub = np.full(2, -1e3), np.full(2, 1e3)
    problem = crocoddyl.ShootingProblem(np.ones(6), [model] * stages, model)
    problem.nthreads = 1
    solver = crocoddyl.SolverBoxFDDP(problem)
    solver.setCandidate([np.ones(6)] * (stages + 1), [np.zeros(2)] * stages, False)
    return least(lambda: (solver.computeDirection(True), solver.tryStep(1.0)), 50)


def _kernels(descent: Descent) -> float:
    """CPU time of derivatives and a roll-out of our model [s]."""
    model, states, controls = descent.model, descent.states, descent.controls
    policy, out = new_policy(len(controls), 6, 2), (np.empty_like(states), np.empty_like(controls))
    model.expand(states, controls, False)
    derivatives = least(lambda: model.expand(states, controls, False), 50)
    return derivatives + least(lambda: model.roll_out(states, controls, policy, 1.0, out), 50)


def _controls(model: TruckModel, states: Array, controls: Array) -> Array:
    """Our controls as w."""
    out, st = controls.copy(), model.stages
    drives = st.gear != 0.0
    reach = st.limits[1] * st.share[drives] * states[:-1][drives, 5]
    out[drives, 0] = np.clip((controls[drives, 0] - states[:-1][drives, 4]) / reach, -1.0, 1.0)
    return out


def _update_steering(shared: Shared, states: Array) -> float:
    """Multipliers of |phi| <= max_steer; the largest residual."""
    penalty, limit = shared.model.lagrangian.scalars[1], shared.model.stages.limits[0]
    excess = np.stack([states[:, 4] - limit, -states[:, 4] - limit], axis=1)
    worst = float(np.abs(np.maximum(excess, -shared.steer / penalty)).max())
    shared.steer[:] = np.maximum(0.0, shared.steer + penalty * excess)
    return worst


def _models(crocoddyl: Any, shared: Shared) -> list[Any]:
    """One action model for each stage, and one for the end."""
    state, st = crocoddyl.StateVector(6), shared.model.stages
    value, slopes = cast(Any, stage_value), cast(Any, stage_slopes)  # kernels, called with a tuple of arguments

    class Stage(crocoddyl.ActionModelAbstract):
        def __init__(self, k: int, controls: int) -> None:
            crocoddyl.ActionModelAbstract.__init__(self, state, controls, 1)
            self.k, self.none = k, np.zeros(2)
            self.out, self.fz, self.lz, self.lzz = np.zeros(6), np.zeros((6, 8)), np.zeros(8), np.zeros((8, 8))

        def calc(self, data: Any, x: Array, u: Array | None = None) -> None:
            entered = time.process_time()
            shared.states[self.k] = x
            place, w = shared.place(), self.none if u is None or not len(u) else u
            cost = value(*place, self.k, w, self.out)
            data.cost = cost
            data.xnext = self.out if self.k < st.gear.size else x
            shared.clock[0] += time.process_time() - entered

        def calcDiff(self, data: Any, x: Array, u: Array | None = None) -> None:
            entered = time.process_time()
            shared.states[self.k] = x
            place, w = shared.place(), self.none if u is None or not len(u) else u
            slopes(*place, self.k, w, self.fz, self.lz, self.lzz)
            data.Lx, data.Lxx = self.lz[:6], self.lzz[:6, :6]
            if self.k < st.gear.size:
                data.Fx, data.Fu = self.fz[:, :6], self.fz[:, 6:]
                data.Lu, data.Luu, data.Lxu = self.lz[6:], self.lzz[6:, 6:], self.lzz[:6, 6:]
            shared.clock[0] += time.process_time() - entered

    out = []
    for k in range(st.gear.size):
        stage = Stage(k, 2)
        if st.gear[k] == 0.0:
            stage.u_lb, stage.u_ub = (
                np.array([s * st.limits[0], b[k]]) for s, b in ((-1, st.shortest), (1, st.longest))
            )
        else:
            stage.u_lb, stage.u_ub = np.array([-1.0, -1e-9]), np.array([1.0, 1e-9])
        out.append(stage)
    return [*out, Stage(st.gear.size, 2)]
