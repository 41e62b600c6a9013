"""The transcription in CasADi's symbols, scaled: lengths in wheelbases, positions relative to the start.

Unknowns: the states of all knots, the steering of all knots, one length for each segment (its steps are equal), and
for each pair of body and obstacle the multipliers of `optim.methods.nlp.duals`.
"""

from dataclasses import dataclass
from typing import Any

import numpy as np

from optim.knots.transcription import Knots
from optim.methods.nlp.duals import Pairs, half_planes, starting_multipliers
from optim.model.clearance import witnesses
from optim.model.objective import Weights
from optim.model.problem import Problem
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle, body_poses
from optim.numerics.arrays import Array, Float64

_DUAL_START = 1e-2  # added to every multiplier at the start: an interior point method begins off its bounds


@dataclass(frozen=True, eq=False)
class Program:
    """min f(x) s.t. low_g <= g(x) <= high_g, low <= x <= high, in CasADi's terms."""

    nlp: dict[str, Any]
    """x, f and g as symbols."""
    start: Float64[Array, " x"]
    """x to begin with. Shape (size of x,), as `low` and `high`."""
    low: Float64[Array, " x"]
    high: Float64[Array, " x"]
    low_g: Float64[Array, " g"]
    """Shape (size of g,), as `high_g`."""
    high_g: Float64[Array, " g"]


@dataclass(frozen=True, eq=False)
class Units:
    """Units of the program."""

    origin: Float64[Array, " 2"]
    """Origin of positions [m]. Shape (2,)."""
    length: float
    """The unit of length [m]."""

    @staticmethod
    def of(problem: Problem) -> "Units":
        """Wheelbases from the first pose of the initial path."""
        return Units(origin=problem.initial.start[:2].copy(), length=problem.vehicle.wheelbase)


class _Columns:
    """Unknowns, or constraints, with their bounds, collected block by block."""

    def __init__(self) -> None:
        self.symbols: list[Any] = []
        self.low: list[Array] = []
        self.high: list[Array] = []
        self.start: list[Array] = []
        """First values of the unknowns; constraints have none."""

    def add(self, symbol: Any, low: Array, high: Array, start: Array | None = None) -> Any:
        """Take in a block and give its symbol back."""
        self.symbols.append(symbol)
        self.low.append(np.ravel(low))
        self.high.append(np.ravel(high))
        if start is not None:
            self.start.append(np.ravel(start))
        return symbol


def step_function(vehicle: Vehicle, length: float) -> Any:
    """CasADi function (q, phi0, phi1, h, d) -> q after one Runge-Kutta step, lengths in units of `length`."""
    import casadi as ca

    l, l_t, offset = (value / length for value in vehicle.kinematics)
    q, inputs = ca.SX.sym("q", 4), ca.SX.sym("u", 4)
    phi0, phi1, h, d = (inputs[i] for i in range(4))

    def slope(state: Any, phi: Any) -> Any:
        turn = ca.tan(phi) / l
        fold = ca.sin(state[3]) / l_t + (1.0 + offset * ca.cos(state[3]) / l_t) * turn
        return d * ca.vertcat(ca.cos(state[2]), ca.sin(state[2]), turn, -fold)

    middle = 0.5 * (phi0 + phi1)
    k0 = slope(q, phi0)
    k1 = slope(q + 0.5 * h * k0, middle)
    k2 = slope(q + 0.5 * h * k1, middle)
    k3 = slope(q + h * k2, phi1)
    return ca.Function("step", [q, inputs], [q + h / 6.0 * (k0 + 2.0 * k1 + 2.0 * k2 + k3)])


def pair_function(vehicle: Vehicle, body: int, edges: int, length: float) -> Any:
    """CasADi function (q, multipliers, half-planes) -> (distance, two equations, squared norm) of a pair."""
    import casadi as ca

    front, rear, half = vehicle.footprints[body] / length
    a, b, middle = 0.5 * (front + rear), half, 0.5 * (front - rear)
    q, multipliers, planes = ca.SX.sym("q", 4), ca.SX.sym("m", edges + 4), ca.SX.sym("p", 3 * edges)
    heading = q[2] + (q[3] if body == 1 else 0.0)
    c, s = ca.cos(heading), ca.sin(heading)
    offset = vehicle.hitch_offset / length if body == 1 else 0.0
    centre = [q[0] - offset * ca.cos(q[2]) + middle * c, q[1] - offset * ca.sin(q[2]) + middle * s]
    dual, mu = multipliers[:edges], multipliers[edges:]
    nx, ny = ca.dot(planes[:edges], dual), ca.dot(planes[edges : 2 * edges], dual)
    distance = nx * centre[0] + ny * centre[1] - ca.dot(planes[2 * edges :], dual)
    distance -= a * (mu[0] + mu[2]) + b * (mu[1] + mu[3])
    along, across = mu[0] - mu[2] + c * nx + s * ny, mu[1] - mu[3] + c * ny - s * nx
    out = ca.vertcat(distance, along, across, nx * nx + ny * ny)
    return ca.Function("pair", [q, multipliers, planes], [out])


def build(problem: Problem, knots: Knots, required: Array, pairs: Pairs, units: Units, step_range: Array) -> Program:
    """The program from these knots; step_range: least and largest step length [m]."""
    import casadi as ca

    vehicle, length = problem.vehicle, units.length
    x, g = _Columns(), _Columns()
    count = len(knots.phi)
    q = ca.MX.sym("q", 4, count)
    scaled = np.column_stack([(knots.states[:, :2] - units.origin) / length, knots.states[:, 2:]])
    low, high = np.full((count, 4), -np.inf), np.full((count, 4), np.inf)
    low[:, 3], high[:, 3] = -vehicle.max_hitch, vehicle.max_hitch
    low[[0, -1]] = high[[0, -1]] = scaled[[0, -1]]
    x.add(ca.vec(q), low, high, scaled)
    phi = x.add(
        ca.MX.sym("phi", count),
        np.full(count, -vehicle.max_steer),
        np.full(count, vehicle.max_steer),
        np.clip(knots.phi, -vehicle.max_steer, vehicle.max_steer),
    )
    runs = knots.runs
    steps = np.array([run.stop - run.start for run in runs])
    lengths = x.add(
        ca.MX.sym("lengths", len(runs)),
        steps * step_range[0] / length,
        steps * step_range[1] / length,
        np.clip(knots.lengths / length, 1.001 * steps * step_range[0] / length, None),
    )
    share = np.zeros((len(knots.h), len(runs)))
    for index, run in enumerate(runs):
        share[run, index] = 1.0 / steps[index]
    h = ca.mtimes(ca.DM(ca.sparsify(ca.DM(share))), lengths)
    cost = _objective(problem.weights, knots, phi, h, length)
    _dynamics(vehicle, knots, q, phi, h, g, length)
    _clearances(problem, knots, required, pairs, q, x, g, units)
    nlp = {"x": ca.vertcat(*x.symbols), "f": cost, "g": ca.vertcat(*g.symbols)}
    return Program(nlp, *(np.concatenate(parts) for parts in (x.start, x.low, x.high, g.low, g.high)))


def knots_at(x: Array, like: Knots, units: Units) -> Knots:
    """The knots in a vector of the program's unknowns; first and last state and the gears are those of `like`."""
    count = len(like.phi)
    states = x[: 4 * count].reshape(count, 4).copy()
    states[:, :2] = states[:, :2] * units.length + units.origin
    states[0], states[-1] = like.states[0], like.states[-1]
    h = np.zeros(len(like.h))
    for index, run in enumerate(like.runs):
        h[run] = x[5 * count + index] * units.length / (run.stop - run.start)
    return Knots(states, x[4 * count : 5 * count], h, like.gear)


def _objective(weights: Weights, knots: Knots, phi: Any, h: Any, length: float) -> Any:
    """J divided by the size of its terms, less the constant of the gear changes."""
    import casadi as ca

    drives, cusps = np.flatnonzero(knots.gear).tolist(), np.flatnonzero(knots.gear == 0).tolist()
    left, right, step = phi[drives], phi[[k + 1 for k in drives]], h[drives]
    change = right - left
    value = weights.length * length * ca.sum1(step)
    value += weights.steer * length / 3.0 * ca.sum1(step * (left * left + left * right + right * right))
    value += weights.rate / length * ca.sum1(change * change / step)
    if cusps:
        jump = phi[[k + 1 for k in cusps]] - phi[cusps]
        value += weights.jump * ca.sum1(jump * jump)
    scale = weights.length * length + weights.rate / length
    return value / (scale if scale > 0.0 else 1.0)


def _dynamics(vehicle: Vehicle, knots: Knots, q: Any, phi: Any, h: Any, g: _Columns, length: float) -> None:
    import casadi as ca

    drives, cusps = np.flatnonzero(knots.gear).tolist(), np.flatnonzero(knots.gear == 0).tolist()
    after = [k + 1 for k in drives]
    inputs = ca.horzcat(phi[drives], phi[after], h[drives], ca.DM(knots.gear[drives].astype(float))).T
    reached = step_function(vehicle, length).map(len(drives))(q[:, drives], inputs)
    zero = np.zeros(4 * len(drives))
    g.add(ca.vec(reached - q[:, after]), zero, zero)
    if cusps:
        zero = np.zeros(4 * len(cusps))
        g.add(ca.vec(q[:, [k + 1 for k in cusps]] - q[:, cusps]), zero, zero)
    change, most = phi[after] - phi[drives], vehicle.max_steer_rate * length * h[drives]
    for part in (change - most, -change - most):
        g.add(part, np.full(len(drives), -np.inf), np.zeros(len(drives)))


def _clearances(
    problem: Problem, knots: Knots, required: Array, pairs: Pairs, q: Any, x: _Columns, g: _Columns, units: Units
) -> None:
    """Multipliers and constraints of all pairs, grouped by body and number of edges."""
    import casadi as ca

    vehicle, scene = problem.vehicle, problem.scene
    planes = {int(m): half_planes(scene.polygons[m], units.origin, units.length) for m in np.unique(pairs.polygon)}
    edges = np.array([len(planes[int(m)][1]) for m in pairs.polygon], dtype=np.int64)
    headings = body_poses(vehicle, knots.states)[:, :, 2]
    normals = _normals(problem, knots, pairs)
    for body, count in sorted(set(zip(pairs.body.tolist(), edges.tolist(), strict=True))):
        mine = np.flatnonzero((pairs.body == body) & (edges == count))
        starts, data = [], []
        for p in mine:
            a, offsets = planes[int(pairs.polygon[p])]
            start = starting_multipliers(a, normals[p], float(headings[pairs.knot[p], body]))
            starts.append(np.concatenate(start) + _DUAL_START)
            data.append(np.concatenate([a[:, 0], a[:, 1], offsets]))
        width = count + 4
        symbol = ca.MX.sym(f"m{body}_{count}", width, len(mine))
        start = np.array(starts)
        x.add(ca.vec(symbol), np.zeros_like(start), np.full_like(start, np.inf), start)
        mapped = pair_function(vehicle, body, count, units.length).map(len(mine))
        rows = mapped(q[:, pairs.knot[mine].tolist()], symbol, ca.DM(np.array(data).T))
        low, high = np.zeros((len(mine), 4)), np.zeros((len(mine), 4))
        low[:, 0], high[:, 0] = required[pairs.knot[mine], body] / units.length, np.inf
        low[:, 3], high[:, 3] = -np.inf, 1.0
        g.add(ca.vec(rows), low, high)


def _normals(problem: Problem, knots: Knots, pairs: Pairs) -> Array:
    """Witness normal of each pair, from obstacle to body. Shape (P, 2)."""
    out = np.empty((len(pairs.knot), 2))
    for m in np.unique(pairs.polygon):
        alone = Scene(polygons=(problem.scene.polygons[m],))
        mine = np.flatnonzero(pairs.polygon == m)
        near = witnesses(alone, problem.vehicle, knots.states[pairs.knot[mine]])
        out[mine] = near.normal[np.arange(len(mine)), pairs.body[mine]]
    return out
