"""OpenSCvx on our problem: its penalised trust region with the adaptation of weights that it comes with.

All gear segments in one problem. Its nodes are our knots, and controls are held between them (ZOH), so that the
steering angle, a state, is piecewise linear as ours; the time dilation of an interval is its length. The gear is looked
up by the number of the node, which functions of one's own ("byof") are given; in a gear change the pose rests and the
control, scaled to reach from limit to limit, moves the steering. J is a state whose end is minimised. Clearance is the
exact distance in JAX, at nodes, of the `SLOTS` obstacles nearest to each body there.

What was tried: the default weight of the cost, 1e-2, moves the path by millimetres an iteration; with 1, and weights of
10 for virtual control and buffer, defects are those of the linearisation alone. A weight of the trust region of 1e-2
is faster at first, but ends in steps to and fro that leave defects which our audit turns down. Its integrator makes one
step of Tsitouras' method an interval, where the default is adaptive with 50 outputs: as exact at these step lengths.
"""

import contextlib
import importlib
import io
import os
import time
from typing import Any

import numpy as np

from optim.knots.transcription import Knots, knots_of
from optim.model.problem import Problem
from optim.numerics.arrays import Array
from tools.bench.peers.common import SPACING, Answer, path_at

SLOTS = 3
"""Obstacles nearest to each body at a node that have a row in a sub-problem."""
AROUND = 20.0
"""Bounds of positions lie this far [m] round the recorded path; it scales by them."""
ITERATIONS = 200
"""Sub-problems at most; OpenSCvx's own default."""
PATIENCE, GAIN = 10, 1e-4
"""It ends after so many sub-problems that do not lower J by this share: its own tests ask for steps near zero, and it
makes steps to and fro where distances have kinks, with weights that grow, as long as it may."""
DEFECT = 3e-5
"""Largest defect [m or rad] of an iterate that is given back: they come and go with the size of its steps."""
ALGORITHM = {"lam_cost": 1.0, "lam_vc": 10.0, "lam_vb": 10.0, "lam_prox": 5e-2, "ep_tr": 1e-5, "ep_vc": 1e-6}
"""Weights of cost, virtual control, virtual buffer and trust region, and tolerances."""


def distances(problem: Problem, body: int) -> Any:
    """JAX function of the state (x, y, theta, alpha): signed distances of a body to all polygons [m], exact. (M,)."""
    jnp: Any = importlib.import_module("jax.numpy")
    polygons = problem.scene.polygons
    most = max(len(polygon) for polygon in polygons)
    padded = np.stack([np.concatenate([p, np.repeat(p[-1:], most - len(p), axis=0)]) for p in polygons])
    sides = np.roll(padded, -1, axis=1) - padded
    normals, own = _normals(padded), _normals(problem.vehicle.outlines[body][None])[0]
    is_side = np.linalg.norm(sides, axis=2) > 0.0

    def function(q: Any) -> Any:
        turn, corners = _placed(jnp, problem, body, q)
        edges = jnp.roll(corners, -1, axis=0) - corners
        # the largest gap along a normal of the polygon or of the body: the distance where they overlap
        behind = jnp.einsum("mvi,mvki->mvk", normals, corners[None, None] - padded[:, :, None]).min(2)
        before = jnp.einsum("ki,mvki->mvk", own @ turn.T, padded[:, :, None] - corners[None, None]).min(1)
        gap = jnp.maximum(jnp.where(is_side, behind, -jnp.inf).max(1), before.max(1))
        # and where they do not, from the corners of each to the sides of the other
        there = _to_sides(jnp, corners[None, None], padded[:, :, None], sides[:, :, None]).min((1, 2))
        here = _to_sides(jnp, padded[:, :, None], corners[None, None], edges[None, None]).min((1, 2))
        apart = jnp.where(gap > 0.0, jnp.minimum(there, here), 1.0)  # a root of 0 has no slope
        return jnp.where(gap > 0.0, jnp.sqrt(apart), gap)

    return function


def _placed(jnp: Any, problem: Problem, body: int, q: Any) -> tuple[Any, Any]:
    """Rotation (2, 2) and corners (4, 2) of a body in a state."""
    heading, offset = (q[2] + q[3], problem.vehicle.hitch_offset) if body == 1 else (q[2], 0.0)
    c, s = jnp.cos(heading), jnp.sin(heading)
    turn = jnp.array([[c, -s], [s, c]])
    base = q[:2] - offset * jnp.array([jnp.cos(q[2]), jnp.sin(q[2])])
    return turn, base + np.asarray(problem.vehicle.outlines[body]) @ turn.T


def _normals(polygons: Array) -> Array:
    """Outward unit normals of the sides, 0 for those without length, for polygons (M, V, 2) in either sense."""
    following = np.roll(polygons, -1, axis=1)
    sides = following - polygons
    length = np.linalg.norm(sides, axis=2, keepdims=True)
    area = (polygons[..., 0] * following[..., 1] - polygons[..., 1] * following[..., 0]).sum(1)
    turned = np.stack([sides[..., 1], -sides[..., 0]], axis=2) * np.sign(area)[:, None, None]
    return turned / np.where(length > 0.0, length, 1.0)


def _to_sides(jnp: Any, points: Any, start: Any, along: Any) -> Any:
    """Squared distances of points to the sides that begin at `start` and go `along`, all (..., 2), broadcast."""
    square = (along * along).sum(-1)
    share = jnp.clip(((points - start) * along).sum(-1) / jnp.where(square > 0.0, square, 1.0), 0.0, 1.0)
    gap = points - start - share[..., None] * along
    return (gap * gap).sum(-1)


def state(problem: Problem, knots: Knots, clock: list[float]) -> Any:
    """The problem in OpenSCvx's terms; CPU time in cvxpy is added to `clock`."""
    ox: Any = importlib.import_module("openscvx")
    dfx: Any = importlib.import_module("diffrax")
    vehicle, drives = problem.vehicle, knots.gear != 0
    h = np.where(drives, knots.h, SPACING)  # of gear changes any: nothing depends on it there
    rate = ox.Control("rate", shape=(1,), parameterization="ZOH")
    rate.min, rate.max = np.array([-1.0]), np.array([1.0])
    change = np.diff(knots.phi) / np.where(drives, vehicle.max_steer_rate * h, 2.0 * vehicle.max_steer)
    rate.guess = np.append(change, 0.0).reshape(-1, 1)
    total, per_length = np.concatenate([[0.0], np.cumsum(h)]), len(knots.gear)
    length = ox.Time(
        initial=0.0,
        final=("free", float(total[-1])),
        min=0.0,
        max=3.0 * float(total[-1]),
        guess=total,
        time_dilation_min=0.01 * SPACING * per_length,
        time_dilation_max=2.0 * SPACING * per_length,
        time_dilation_guess=np.append(h, h[-1]) * per_length,
    )
    stated = ox.Problem(
        dynamics={},
        constraints=[],
        states=_states(ox, problem, knots),
        controls=[rate],
        N=len(knots.phi),
        time=length,
        byof={"dynamics": _dynamics(problem, knots), "nodal_constraints": _clearances(problem, len(knots.phi))},
        algorithm=dict(ALGORITHM),
        discretizer={"diffrax_kwargs": {"num_substeps": 2, "stepsize_controller": dfx.ConstantStepSize()}},
        solver=_solver(ox, clock),
        float_dtype="float64",
    )
    stated.settings.dev.printing = False
    return stated


def _states(ox: Any, problem: Problem, knots: Knots) -> list[Any]:
    """x, y, theta, alpha, phi, cost, in this order, with bounds, ends and start values."""
    vehicle, columns, cost = problem.vehicle, knots.states.T, _running_cost(problem, knots)
    low, high = columns.min(axis=1), columns.max(axis=1)
    ends: list[tuple[Any, Any]] = [(float(column[0]), float(column[-1])) for column in columns]
    free = ("free", 0.0)
    table: list[tuple[str, float, float, Array, tuple[Any, Any]]] = [
        ("x", low[0] - AROUND, high[0] + AROUND, columns[0], ends[0]),
        ("y", low[1] - AROUND, high[1] + AROUND, columns[1], ends[1]),
        ("theta", low[2] - 2.0, high[2] + 2.0, columns[2], ends[2]),
        ("alpha", -vehicle.max_hitch, vehicle.max_hitch, columns[3], ends[3]),
        ("phi", -vehicle.max_steer, vehicle.max_steer, knots.phi, (free, free)),
        ("cost", 0.0, 2.0 * cost[-1], cost, (0.0, ("minimize", float(cost[-1])))),
    ]
    out = []
    for name, least, most, guess, (first, last) in table:
        made = ox.State(name, shape=(1,))
        made.min, made.max = np.array([least]), np.array([most])
        made.initial, made.final, made.guess = [first], [last], np.array(guess).reshape(-1, 1)
        out.append(made)
    return out


def _dynamics(problem: Problem, knots: Knots) -> dict[str, Any]:
    """Derivatives by length of the states of `_states`; u is the rate, and the interval's length times their number."""
    jnp: Any = importlib.import_module("jax.numpy")
    vehicle, weights, intervals = problem.vehicle, problem.weights, len(knots.gear)
    l, l_t, offset = vehicle.kinematics
    gears, reach, fastest = jnp.asarray(np.append(knots.gear, 0)), 2.0 * vehicle.max_steer, vehicle.max_steer_rate

    def gear(node: Any) -> Any:
        return gears[jnp.atleast_1d(node)[0]]  # its roll-out has the number in an array

    def turn(x: Any) -> Any:
        return jnp.tan(x[4]) / l

    def swing(x: Any) -> Any:
        return -(jnp.sin(x[3]) / l_t + (1.0 + offset * jnp.cos(x[3]) / l_t) * turn(x))

    def steer(u: Any, node: Any) -> Any:
        return u[0] * jnp.where(gear(node) == 0, reach * intervals / u[1], fastest)

    def price(x: Any, u: Any, node: Any) -> Any:
        jump = weights.jump * (u[0] * reach) ** 2 * intervals / u[1]
        drive = weights.length + weights.steer * x[4] ** 2 + weights.rate * (u[0] * fastest) ** 2
        return jnp.where(gear(node) == 0, jump, drive)

    return {
        "x": lambda x, u, node, params: jnp.array([gear(node) * jnp.cos(x[2])]),
        "y": lambda x, u, node, params: jnp.array([gear(node) * jnp.sin(x[2])]),
        "theta": lambda x, u, node, params: jnp.array([gear(node) * turn(x)]),
        "alpha": lambda x, u, node, params: jnp.array([gear(node) * swing(x)]),
        "phi": lambda x, u, node, params: jnp.array([steer(u, node)]),
        "cost": lambda x, u, node, params: jnp.array([price(x, u, node)]),
    }


def _clearances(problem: Problem, count: int) -> list[dict[str, Any]]:
    """Missing clearance of each body to its `SLOTS` nearest obstacles, each by itself, at all nodes but the ends."""
    jnp: Any = importlib.import_module("jax.numpy")

    def missing(function: Any, slot: int) -> Any:
        return lambda x, u, node, params: problem.required_clearance - jnp.sort(function(x[:4]))[slot]

    slots, inside = range(min(SLOTS, len(problem.scene.polygons))), list(range(1, count - 1))
    functions = [distances(problem, body) for body in range(2)]
    return [{"constraint_fn": missing(function, slot), "nodes": inside} for function in functions for slot in slots]


def _solver(ox: Any, clock: list[float]) -> Any:
    """Its solver of sub-problems, as it comes, with the CPU time in cvxpy told."""

    class Solver(ox.PTRSolver):
        def initialize(self, *arguments: Any) -> None:
            began = time.process_time()
            super().initialize(*arguments)
            clock[0] += time.process_time() - began

        def solve(self) -> Any:
            began = time.process_time()
            result = super().solve()
            clock[0] += time.process_time() - began
            return result

    return Solver()


def solve(problem: Problem) -> Answer:
    """One solution from the recorded path."""
    os.environ.setdefault("XLA_FLAGS", "--xla_cpu_multi_thread_eigen=false intra_op_parallelism_threads=1")
    began, clock = time.process_time(), [0.0]
    knots = knots_of(problem.vehicle, problem.recorded, SPACING)
    with contextlib.redirect_stdout(io.StringIO()):  # it greets
        stated = state(problem, knots, clock)
        stated.initialize()
        build_s, cvxpy_s = time.process_time() - began, clock[0]
        x, u, word = _descend(stated)
    states, h = x[:, :4].copy(), np.where(knots.gear != 0, u[:-1, 1] / len(knots.gear), 0.0)
    states[0], states[-1] = knots.states[0], knots.states[-1]
    sizes = stated.solver.get_stats()
    return Answer(
        path=path_at(problem, Knots(states, x[:, 4].copy(), h, knots.gear)),
        word=word,
        iterations=int(stated.state.k) - 1,
        build_s=cvxpy_s,
        compile_s=build_s - cvxpy_s,
        size=f"{sizes['n_variables']} unknowns, {sizes['n_constraints']} constraints",
    )


def _descend(stated: Any) -> tuple[Array, Array, str]:
    """States and controls at the nodes, and how it ended: its own word, or ours where J falls no more."""
    best, least, waited, word = np.inf, np.inf, 0, "iterations were not enough"
    kept: tuple[Array, Array] = stated.state.x, stated.state.u
    for _ in range(ITERATIONS):
        told = stated.step()
        x, u = np.array(stated.state.x), np.array(stated.state.u)
        defect = float(np.abs(np.asarray(stated.state.x_prop())[:, :4] - x[1:, :4]).max())
        value, waited = float(x[-1, 5]), waited + 1
        if value < least * (1.0 - GAIN):
            least, waited = value, 0
        if defect <= DEFECT and value < best:
            best, kept = value, (x, u)
        if told["converged"] or waited >= PATIENCE:
            word = "converged" if told["converged"] else "J falls no more"
            break
    return kept[0], kept[1], word


def _running_cost(problem: Problem, knots: Knots) -> Array:
    """J up to each knot, without the constants of the gear changes. Shape (K,)."""
    weights, drives = problem.weights, knots.gear != 0
    h, left, right = np.where(drives, knots.h, 1.0), knots.phi[:-1], knots.phi[1:]
    square = (left * left + left * right + right * right) / 3.0
    pieces = weights.length * h + weights.steer * h * square + weights.rate * (right - left) ** 2 / h
    return np.concatenate([[0.0], np.cumsum(np.where(drives, pieces, weights.jump * (right - left) ** 2))])
