"""From points to a stretch that truck and trailer can drive: a spline of continuous sharpness beside the points.

Points say nothing of steering, and their curvature is noisy. The stretch is a curve of the trailer's axle whose
curvature kappa is a cubic B-spline of the share t in [0, 1] of its length L. By the flat map steering angle and
steering rate follow from kappa, sigma = kappa' / L and kappa'' / L^2, all continuous. Coefficients c and length
solve, in Gauss-Newton steps,

    min  sum |x(t_i) - point_i|^2 / sigma_position^2 + int (d2kappa/ds2)^2 ds / sigma_bend^2
         + sum max(0, excess)^2 / sigma_limit^2
    s.t. pose and curvature at both ends are those of the recorded stretch,

where the excess is that of |kappa|, |tan(phi)| and |dphi/ds| by their limits, less a small reserve. Reverse stretches
are read from their end, in the order of the trailer's heading, as the points are.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np
from scipy.interpolate import BSpline, CubicSpline

from optim.arrays import Array
from optim.path import Segment, segment_from_states
from optim.vehicle import Vehicle, state_from_flat

_GAUSS_X = 0.5 + 0.5 * np.array([-0.8611363115940526, -0.3399810435848563, 0.3399810435848563, 0.8611363115940526])
_GAUSS_W = 0.5 * np.array([0.3478548451374538, 0.6521451548625461, 0.6521451548625461, 0.3478548451374538])
_PANELS = 2  # of the quadrature per interval of the spline
_SHORTEST = 1e-2  # [m]
_SMOOTHING = 3  # steps without limits
_SOFT = 0.2  # weight of the limits after these, as `Trust.limit`


@dataclass(frozen=True, kw_only=True)
class Trust:
    """What the fit trades against each other."""

    position: float = 0.05
    """Deviation from a point that costs as much as the others [m]."""
    bend: float = 0.01
    """Size of d2kappa/ds2 per square root of a metre that costs as much [1/m^3.5]."""
    limit: float = 0.002
    """Relative excess of a limit that costs as much [-]."""
    reserve: float = 0.01
    """Share of each limit that the fit leaves unused [-]."""
    knots: float = 0.5
    """Length of the spline's intervals [m]."""
    max_iterations: int = 30
    """Gauss-Newton steps."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Stretch:
    """A drivable stretch and how it relates to its points."""

    segment: Segment
    deviation: float
    """Largest distance of the curve from the points [m]."""
    gap: float
    """By how much the curve misses its end [m or rad]: rounding where the fit has converged."""


class _Basis(NamedTuple):
    """The m splines of the basis at the P + 1 ends of the panels and at their 4 P Gauss nodes."""

    ends: Array  # (P + 1, m)
    slope: Array  # (P + 1, m) by t
    curl: Array  # (P + 1, m) second derivative by t
    turn: Array  # (P + 1, m) integral from t = 0
    turn_nodes: Array  # (4 P, m) the same at the Gauss nodes


def _spline(c: Array) -> BSpline:
    """Curvature by t; c: (m,) coefficients or (m, m), each column a spline."""
    count = len(c) - 3
    knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 1.0, count + 1), [1.0] * 3])
    return BSpline(knots, c, 3)


def _gauss_nodes(panels: int) -> Array:
    """Of all panels of [0, 1] in a row. Shape (4 panels,)."""
    return ((np.arange(panels)[:, None] + _GAUSS_X) / panels).ravel()


def _basis(count: int) -> _Basis:
    """For `count` intervals of the spline."""
    spline, panels = _spline(np.eye(count + 3)), _PANELS * count
    ends, nodes, turn = np.linspace(0.0, 1.0, panels + 1), _gauss_nodes(panels), spline.antiderivative()
    return _Basis(spline(ends), spline(ends, 1), spline(ends, 2), turn(ends), turn(nodes))


def steering(vehicle: Vehicle, kappa: Array, sigma: Array, curl: Array) -> tuple[Array, Array]:
    """tan(phi) [-] and dphi/ds [1/m] from curvature, dkappa/ds_f and d2kappa/ds_f2; for complex numbers too."""
    l, l_t, _ = vehicle.kinematics
    u = l_t * kappa
    q = 1.0 + u * u
    root = np.sqrt(q)
    tangent = l * (kappa + l_t * sigma / q) / root
    change = l * (sigma + l_t * curl / q - 2.0 * l_t * u * l_t * sigma**2 / q**2) / root - tangent * u * l_t * sigma / q
    return tangent, change / (root * (1.0 + tangent * tangent))


def fit_points(vehicle: Vehicle, points: Array, start: Array, end: Array, trust: Trust) -> tuple[Array, float, float]:
    """Coefficients, length [m] and largest deviation [m] of the curve through points (n, 2) between two flat states.

    start, end: (5,) x, y, heading, kappa, sigma; the headings' difference is the whole turn, unwrapped.
    """
    chords = np.hypot(*np.diff(points, axis=0).T)
    along = np.concatenate([[0.0], np.cumsum(chords)])
    length = float(along[-1])
    count = max(6, math.ceil(length / trust.knots))
    basis = _basis(count)
    t_ends = np.linspace(0.0, 1.0, len(basis.ends))
    through = CubicSpline(along / length, points)
    target, tangent = through(t_ends), through(t_ends, 1)
    kappa = np.gradient(np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0])), t_ends) / length
    kappa[0], kappa[-1] = start[3], end[3]
    c = np.linalg.lstsq(basis.ends, kappa, rcond=None)[0]
    c[0], c[-1] = start[3], end[3]
    for iteration in range(trust.max_iterations):
        # limits come in by and by: at full weight, steps from an unsmoothed start do not come back
        limit = max(trust.limit, _SOFT * 0.3 ** (iteration - _SMOOTHING)) if iteration >= _SMOOTHING else math.inf
        step = _step(vehicle, basis, c, length, target, start, end, trust, limit)
        share = min(1.0, 0.2 * length / max(abs(step[-1]), 1e-12))
        c[1:-1] += share * step[:-1]
        length += share * step[-1]
        if limit == trust.limit and np.abs(step).max() < 1e-11:
            break
    position = _positions(start, length * (basis.turn_nodes @ c), length)
    return c, length, float(np.hypot(*(position - target).T).max())


def _positions(start: Array, turn: Array, length: float) -> Array:
    """Positions at the ends of the panels from the turns at their Gauss nodes. Shape (P + 1, 2)."""
    heading = start[2] + turn
    steps = np.tile(_GAUSS_W, len(turn) // 4) * length / (len(turn) // 4)
    moves = (steps[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)).reshape(-1, 4, 2).sum(axis=1)
    return start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])


def _step(
    vehicle: Vehicle,
    basis: _Basis,
    c: Array,
    length: float,
    target: Array,
    start: Array,
    end: Array,
    trust: Trust,
    limit: float,
) -> Array:
    """One Gauss-Newton step of the free coefficients and the length. Shape (m - 1,)."""
    panels = len(basis.ends) - 1
    turn = length * (basis.turn_nodes @ c)
    position, nodes = _positions(start, turn, length), start[2] + turn
    weights = np.tile(_GAUSS_W, panels) * length / panels
    by_c = length * basis.turn_nodes
    by_length = basis.turn_nodes @ c
    turned = np.column_stack([by_c, by_length]) * weights[:, None]
    jacobian = np.empty((2, panels + 1, turned.shape[1]))
    for k, (along, across) in enumerate(((np.cos(nodes), -np.sin(nodes)), (np.sin(nodes), np.cos(nodes)))):
        rows = across[:, None] * turned
        rows[:, -1] += weights * along / length
        jacobian[k, 0] = 0.0
        jacobian[k, 1:] = np.cumsum(rows.reshape(panels, 4, -1).sum(axis=1), axis=0)
    scale = math.sqrt(length / panels)
    position_rows = jacobian.reshape(-1, turned.shape[1]) * (scale / trust.position)
    position_misfit = (position - target).T.ravel() * (scale / trust.position)
    curl = basis.curl / length**2
    bend = scale / trust.bend
    bend_rows = np.column_stack([curl, -2.0 * (curl @ c) / length]) * bend
    limit_rows, limit_misfit = _limits(vehicle, basis, c, length, trust.reserve, scale / limit)
    rows = np.concatenate([position_rows, bend_rows, limit_rows])
    misfit = np.concatenate([position_misfit, bend * (curl @ c), limit_misfit])
    closing = np.concatenate([jacobian[:, -1], np.append(length * basis.turn[-1], basis.turn[-1] @ c)[None]])
    gap = np.append(position[-1], start[2] + length * (basis.turn[-1] @ c)) - end[:3]
    free = np.r_[1 : len(c) - 1, len(c)]
    rows, closing = rows[:, free], closing[:, free]
    size = len(free)
    system = np.zeros((size + 3, size + 3))
    system[:size, :size] = rows.T @ rows
    system[:size, :size] += 1e-12 * np.trace(system) / size * np.eye(size)
    system[size:, :size] = closing
    system[:size, size:] = closing.T
    return np.linalg.solve(system, -np.concatenate([rows.T @ misfit, gap]))[:size]


def _limits(
    vehicle: Vehicle, basis: _Basis, c: Array, length: float, reserve: float, weight: float
) -> tuple[Array, Array]:
    """Rows and misfits of what exceeds a limit at the panel ends."""
    kappa, sigma, curl = basis.ends @ c, basis.slope @ c / length, basis.curl @ c / length**2
    inputs = [kappa, sigma, curl]
    slopes = []
    for k in range(3):  # complex steps: exact to rounding
        moved = [value + 1e-30j * (k == i) for i, value in enumerate(inputs)]
        slopes.append([part.imag / 1e-30 for part in (moved[0], *steering(vehicle, *moved))])
    values = [kappa, *steering(vehicle, *inputs)]
    bounds = [vehicle.max_kappa, math.tan(vehicle.max_steer), vehicle.max_steer_rate]
    rows, misfits = [], []
    for k, (value, bound) in enumerate(zip(values, bounds, strict=True)):
        beyond = np.abs(value) / bound - (1.0 - reserve)
        active = beyond > 0.0
        by = [np.sign(value[active]) * slopes[i][k][active] / bound for i in range(3)]
        parts = [basis.ends[active], basis.slope[active] / length, basis.curl[active] / length**2]
        by_c = sum(b[:, None] * part for b, part in zip(by, parts, strict=True))
        by_length = by[1] * (-sigma[active] / length) + by[2] * (-2.0 * curl[active] / length)
        rows.append(np.column_stack([by_c, by_length]) * weight)
        misfits.append(beyond[active] * weight)
    return np.concatenate(rows), np.concatenate(misfits)


def drivable_stretch(
    vehicle: Vehicle, direction: int, points: Array, start: Array, end: Array, trust: Trust, spacing: float
) -> Stretch | None:
    """The stretch beside the points (n, 2), samples at most `spacing` [m] apart; None where the fit falls apart.

    Points, start and end are in the order of the trailer's heading; the segment is in that of driving.
    """
    with np.errstate(all="ignore"):  # a fit that falls apart is recognised by its result
        try:
            c, length, deviation = fit_points(vehicle, points, start, end, trust)
        except np.linalg.LinAlgError:
            return None
        if not (np.isfinite(c).all() and _SHORTEST < length < 10.0 * np.hypot(*np.diff(points, axis=0).T).sum()):
            return None
        s, flat = _sampled(vehicle, c, length, start, spacing)
    gap = float(np.abs(flat[-1, :4] - end[:4]).max())
    flat[-1, :4] = end[:4]
    states, phi = state_from_flat(vehicle, flat)
    phi = _linear_between(s, phi)
    if direction < 0:
        s, states, phi = s[-1] - s[::-1], states[::-1], phi[::-1]
    return Stretch(segment=segment_from_states(direction, s, states, phi), deviation=deviation, gap=gap)


def _sampled(vehicle: Vehicle, c: Array, length: float, start: Array, spacing: float) -> tuple[Array, Array]:
    """Samples of the curve: the truck's distance [m], shape (n,), at most `spacing` apart, and flat states (n, 5)."""
    spline = _spline(c)
    turn = spline.antiderivative()
    # the truck's distance by the axle's is 1 / cos(alpha), at most that of the largest coefficient
    panels = math.ceil(length * math.hypot(1.0, vehicle.hitch_to_axle * np.abs(c).max()) / spacing)
    nodes, ends = _gauss_nodes(panels), np.linspace(0.0, 1.0, panels + 1)
    stretch = np.hypot(1.0, vehicle.hitch_to_axle * spline(nodes)).reshape(-1, 4) @ _GAUSS_W
    s = np.concatenate([[0.0], np.cumsum(stretch)]) * length / panels
    position = _positions(start, length * (turn(nodes) - turn(0.0)), length)
    heading = start[2] + length * (turn(ends) - turn(0.0))
    return s, np.column_stack([position, heading, spline(ends), spline(ends, 1) / length])


def _linear_between(s: Array, phi: Array) -> Array:
    """Steering whose straight lines between samples turn as much as the curve through the given samples."""
    bend = CubicSpline(s, phi)(s, 2)
    h = np.diff(s)
    square = np.concatenate([[h[0] ** 2], h[:-1] * h[1:], [h[-1] ** 2]])
    return phi - square * bend / 12.0
