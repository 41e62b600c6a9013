"""The hyperplane formulation (Fan, Murgovski, Liang 2023) in CasADi: a line (n, c) between body and obstacle.

For each pair: n . v <= c for the obstacle's vertices, n . corner >= c + d for the body's, |n| <= 1; three unknowns
instead of the eight or more of the dual one. Two variants: **all** pairs in one program for IPOPT; and the pairs
within `REACH` of the recorded path for fatrop, which wants stages: states (x, y, theta, alpha, phi, L), controls
(next phi, next L, lines), as in `optim.methods.ddp.truck`.
"""

import time
from dataclasses import dataclass
from typing import Any

import numpy as np

from optim.knots.transcription import Knots, knots_of
from optim.methods.nlp.duals import Pairs, pairs_within
from optim.methods.nlp.model import Units, step_function
from optim.model.clearance import witnesses
from optim.model.problem import Problem
from optim.model.scene import Scene
from optim.numerics.arrays import Array
from tools.bench.peers.common import SPACING, Answer, path_at
from tools.bench.peers.obca import all_pairs, ipopt_options

REACH = 3.0
"""Pairs whose clearance exceeds the required by less than this on the recorded path [m]."""
ROOM = 1e-2
"""By which the lines at the start are slack, in wheelbases."""


@dataclass(frozen=True, eq=False)
class Stage:
    """Symbols, bounds, start values and rows (expression, low, high) of one knot and the interval after it."""

    state: Any
    control: Any
    bounds: tuple[Array, Array, Array]
    """Low, high, start of state and control together."""
    rows: list[tuple[Any, Array, Array]]
    following: Any
    """The next state; None after the last knot."""


def lines_at_start(problem: Problem, knots: Knots, pairs: Pairs, units: Units) -> Array:
    """(n, c) of each pair from the exact witness normals, positions in `units`. Shape (P, 3)."""
    out = np.empty((len(pairs.knot), 3))
    for m in np.unique(pairs.polygon):
        polygon = problem.scene.polygons[m]
        mine = np.flatnonzero(pairs.polygon == m)
        near = witnesses(Scene(polygons=(polygon,)), problem.vehicle, knots.states[pairs.knot[mine]])
        normal = near.normal[np.arange(len(mine)), pairs.body[mine]]
        vertices = (polygon - units.origin) / units.length
        out[mine, :2] = normal
        out[mine, 2] = (vertices @ normal.T).max(axis=0)
    return out


def corners(problem: Problem, body: int, q: Any, length: float) -> Any:
    """The body's corners in units of `length`, as a 2 x 4 expression."""
    import casadi as ca

    vehicle = problem.vehicle
    heading = q[2] + (q[3] if body == 1 else 0.0)
    hitch = vehicle.hitch_offset / length if body == 1 else 0.0
    c, s = ca.cos(heading), ca.sin(heading)
    x, y = q[0] - hitch * ca.cos(q[2]), q[1] - hitch * ca.sin(q[2])
    points = vehicle.outlines[body] / length
    return ca.horzcat(*(ca.vertcat(x + c * a - s * b, y + s * a + c * b) for a, b in points.tolist()))


def stages(problem: Problem, knots: Knots, pairs: Pairs, units: Units) -> list[Stage]:
    """The problem, stage by stage."""
    import casadi as ca

    vehicle, length, count = problem.vehicle, units.length, len(knots.phi)
    step = step_function(vehicle, length)
    lines = lines_at_start(problem, knots, pairs, units)
    functions: dict[tuple[int, int], Any] = {}
    scaled_polygons = [(polygon - units.origin) / length for polygon in problem.scene.polygons]
    margin = problem.required_clearance / length
    at_knot = [np.flatnonzero(pairs.knot == k) for k in range(count)]
    share, most, own = np.zeros(count - 1), np.zeros(len(knots.runs)), np.zeros(count - 1, np.int64)
    for index, run in enumerate(knots.runs):
        share[run], most[index] = 1.0 / (run.stop - run.start), 2.0 * SPACING * (run.stop - run.start) / length
        own[run.start : min(run.stop + 1, count - 1)] = index
    out = []
    for k in range(count):
        index = int(own[min(k, count - 2)])
        x, mine = ca.SX.sym(f"x{k}", 6), at_knot[k]
        scaled = np.concatenate([(knots.states[k, :2] - units.origin) / length, knots.states[k, 2:]])
        start = np.concatenate([scaled, [knots.phi[k], knots.lengths[index] / length]])
        high = np.array([np.inf, np.inf, np.inf, vehicle.max_hitch, vehicle.max_steer, most[index]])
        low = np.concatenate([-high[:5], [0.005 * most[index]]])
        if k in (0, count - 1):
            low[:4] = high[:4] = scaled
        rows: list[tuple[Any, Array, Array]] = []
        own_lines = ca.SX.sym(f"n{k}", 3 * len(mine))
        for position, pair in enumerate(mine):
            line = own_lines[3 * position : 3 * position + 3]
            body, vertices = int(pairs.body[pair]), scaled_polygons[int(pairs.polygon[pair])]
            edges = len(vertices)
            if (body, edges) not in functions:
                functions[body, edges] = _pair_function(problem, body, edges, length)
            row_low = np.concatenate([np.full(edges, -np.inf), np.full(4, margin), [-np.inf]])
            row_high = np.concatenate([np.zeros(edges), np.full(4, np.inf), [1.0]])
            rows.append((functions[body, edges](x, line, vertices), row_low, row_high))
        control, following, first = own_lines, None, np.zeros(0)
        if k < count - 1:
            u = ca.SX.sym(f"u{k}", 2)
            control = ca.vertcat(u, own_lines)
            is_drive = knots.gear[k] != 0
            h = share[k] * x[5]
            next_length = x[5] if is_drive else u[1]
            reached = step(x[:4], ca.vertcat(x[4], u[0], h, int(knots.gear[k]))) if is_drive else x[:4]
            following = ca.vertcat(reached, u[0], next_length)
            after = int(own[min(k + 1, count - 2)])
            first = np.array([knots.phi[k + 1], knots.lengths[after] / length])
            if is_drive:
                rate = vehicle.max_steer_rate * length * h
                for part in (u[0] - x[4] - rate, x[4] - u[0] - rate):
                    rows.append((part, np.array([-np.inf]), np.array([0.0])))
        bound = np.full(len(first) + 3 * len(mine), np.inf)
        starts = np.concatenate([start, first, lines[mine].ravel()])
        bounds = (np.concatenate([low, -bound]), np.concatenate([high, bound]), starts)
        out.append(Stage(x, control, bounds, rows, following))
    return out


def _pair_function(problem: Problem, body: int, count: int, length: float) -> Any:
    """CasADi function (state, line, vertices) -> behind (count), before (4), squared norm (1)."""
    import casadi as ca

    x, line, vertices = ca.SX.sym("x", 6), ca.SX.sym("line", 3), ca.SX.sym("v", count, 2)
    normal, c = line[:2], line[2]
    behind = ca.mtimes(vertices, normal) - c
    before = ca.mtimes(corners(problem, body, x, length).T, normal) - c
    return ca.Function("pair", [x, line, vertices], [ca.vertcat(behind, before, ca.dot(normal, normal))])


def cost_of(problem: Problem, knots: Knots, parts: list[Stage], length: float) -> Any:
    """J, less the constant of the gear changes, over the scale of `optim.methods.nlp.model`."""
    weights, total = problem.weights, 0.0
    shares = np.zeros(len(knots.h))
    for run in knots.runs:
        shares[run] = 1.0 / (run.stop - run.start)
    for k, stage in enumerate(parts[:-1]):
        phi, following = stage.state[4], stage.control[0]
        change = following - phi
        if knots.gear[k] == 0:
            total += weights.jump * change * change
            continue
        h = shares[k] * stage.state[5] * length
        square = (phi * phi + phi * following + following * following) / 3.0
        total += h * (weights.length + weights.steer * square) + weights.rate * change * change / h
    return total / (weights.length * length + weights.rate / length)


def solve_ipopt(problem: Problem) -> Answer:
    """All pairs, IPOPT."""
    return _solve(problem, "ipopt", lambda knots, required: all_pairs(problem, knots))


def solve_fatrop(problem: Problem) -> Answer:
    """Pairs near the recorded path, fatrop."""
    return _solve(problem, "fatrop", lambda knots, required: pairs_within(problem, knots.states, required, REACH))


def solve_near(problem: Problem) -> Answer:
    """Pairs near the recorded path, IPOPT."""
    return _solve(problem, "ipopt", lambda knots, required: pairs_within(problem, knots.states, required, REACH))


def _solve(problem: Problem, plugin: str, choose: Any) -> Answer:
    import casadi as ca

    began = time.process_time()
    units = Units(origin=problem.recorded.start[:2].copy(), length=problem.vehicle.wheelbase)
    knots = knots_of(problem.vehicle, problem.recorded, SPACING)
    parts = stages(problem, knots, choose(knots, np.full((len(knots.phi), 2), problem.required_clearance)), units)
    rows: list[tuple[Any, Array, Array]] = []
    is_equation: list[bool] = []
    counts = []
    for stage, after in zip(parts, [*parts[1:], None], strict=True):
        if after is not None:
            rows.append((after.state - stage.following, np.zeros(6), np.zeros(6)))
        rows += stage.rows
        counts.append(sum(part.numel() for part, _, _ in stage.rows))
    for _, low, high in rows:
        is_equation += (np.asarray(low) == np.asarray(high)).tolist()
    low, high, start = (np.concatenate([stage.bounds[i] for stage in parts]) for i in range(3))
    nlp = {
        "x": ca.vertcat(*(ca.vertcat(stage.state, stage.control) for stage in parts)),
        "f": cost_of(problem, knots, parts, units.length),
        "g": ca.vertcat(*(part for part, _, _ in rows)),
    }
    if plugin == "ipopt":
        options = ipopt_options()
    else:
        options = {
            "print_time": False,
            "structure_detection": "manual",
            "N": len(parts) - 1,
            "nx": [6] * len(parts),
            "nu": [stage.control.numel() for stage in parts],
            "ng": counts,
            "equality": is_equation,
            "fatrop.print_level": 0,
            "fatrop.max_iter": 300,
            "fatrop.tolerance": 1e-6,
        }
    solver = ca.nlpsol("hyperplane", plugin, nlp, options)
    build_s = time.process_time() - began
    bounds = {"lbg": np.concatenate([part[1] for part in rows]), "ubg": np.concatenate([part[2] for part in rows])}
    found = solver(x0=start, lbx=low, ubx=high, **bounds)
    stats = solver.stats()
    solved = _knots(np.asarray(found["x"]).ravel(), parts, knots, units)
    return Answer(
        path=path_at(problem, solved),
        word=str(stats["return_status"]),
        iterations=int(stats["iter_count"]),
        build_s=build_s,
        size=f"{start.size} unknowns, {len(is_equation)} constraints",
    )


def _knots(x: Array, parts: list[Stage], like: Knots, units: Units) -> Knots:
    sizes = [6 + stage.control.numel() for stage in parts]
    first = np.concatenate([[0], np.cumsum(sizes)[:-1]]).astype(np.int64)
    table = x[first[:, None] + np.arange(6)]
    states = table[:, :4].copy()
    states[:, :2] = states[:, :2] * units.length + units.origin
    states[0], states[-1] = like.states[0], like.states[-1]
    h = np.zeros(len(like.h))
    for run in like.runs:
        h[run] = table[run.start, 5] * units.length / (run.stop - run.start)
    return Knots(states, table[:, 4].copy(), h, like.gear)
