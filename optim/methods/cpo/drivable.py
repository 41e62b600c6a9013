"""From points to a stretch that truck and trailer can drive: a spline of continuous sharpness beside the points.

Points say nothing of steering, and their curvature is noisy. The stretch is a curve of the trailer's axle whose
curvature kappa is a cubic B-spline of the share t in [0, 1] of its length L. By the flat map steering angle and
steering rate follow from kappa, sigma = kappa' / L and kappa'' / L^2, all continuous. Coefficients c and length
solve, in Gauss-Newton steps,

    min  int |x - point|^2 / sigma_position^2 + (d2kappa/ds2)^2 / sigma_bend^2 + max(0, excess)^2 / sigma_limit^2 ds
    s.t. pose and curvature at both ends are those of the recorded stretch,

where the excess is that of |kappa|, |tan(phi)| and |dphi/ds| by their limits, less a small reserve; the integrals are
sums over the ends of the panels of the quadrature (`optim.methods.cpo.spline`), and the points are those of a spline
through them at the same share t. Reverse stretches are read from their end, in the order of the trailer's heading, as
the points are.
"""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optim.methods.cpo.spline import GAUSS_W, Basis, basis, positions, sampled
from optim.model.flat_map import state_from_flat
from optim.model.path import Segment, segment_from_states
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array

_POSITION, _BEND, _LIMIT = 0.05, 0.01, 0.002  # sigma_position [m], sigma_bend [1/m^3], sigma_limit [-]
_RESERVE = 0.01  # share of each limit that the fit leaves unused
_INTERVAL = 0.5  # [m] of the spline
_FEWEST = 6  # intervals of the spline: both ends of a short curve are given
_MOST_STEPS = 60  # Gauss-Newton steps
_SHORTEST, _LONGEST = 1e-2, 10.0  # a curve [m], and by the length of the points: others have fallen apart
_SMOOTHING = 3  # steps without limits
_SOFT, _HARDENING = 0.2, 0.3  # sigma_limit of the next step, and its factor from step to step, down to `_LIMIT`
_DECREASE = 1e-4  # Armijo's condition
_LEAST_DAMPING = 1e-12  # of the mean of the system's diagonal
_AT_REST = 1e-9  # a step that changes no coefficient [1/m] and no length [m] by more
_TINY = 1e-30  # of a complex step
_SMALLEST_SHARE = 1e-3  # of a step


@dataclass(frozen=True, eq=False, kw_only=True)
class Stretch:
    """A drivable stretch and how it relates to its points."""

    segment: Segment
    deviation: float
    """Largest distance of the curve from the points [m]."""
    gap: float
    """Distance of the curve from its end [m or rad]: rounding where the fit has converged."""


def steering(vehicle: Vehicle, kappa: NDArray, sigma: NDArray, curl: NDArray) -> tuple[NDArray, NDArray]:
    """tan(phi) [-] and dphi/ds [1/m] from curvature, dkappa/ds_f and d2kappa/ds_f2; for complex numbers too."""
    l, l_t, _ = vehicle.kinematics
    u = l_t * kappa
    q = 1.0 + u * u
    root = np.sqrt(q)
    tangent = l * (kappa + l_t * sigma / q) / root
    change = l * (sigma + l_t * curl / q - 2.0 * l_t * u * l_t * sigma**2 / q**2) / root - tangent * u * l_t * sigma / q
    return tangent, change / (root * (1.0 + tangent * tangent))


@dataclass(frozen=True, eq=False)
class _StretchFit:
    """The curve to fit, and the sums of squares of a guess: coefficients c (m,) and length [m]."""

    vehicle: Vehicle
    basis: Basis
    target: Array  # (P + 1, 2) what the ends of the panels are to be near
    start: Array  # (5,)
    end: Array  # (5,)

    def misfit(self, c: Array, length: float, limit: float) -> tuple[Array, Array]:
        """Residuals to minimise, shape (r,), and the gap at the end, which must vanish, shape (3,)."""
        position = positions(self.start, length * (self.basis.turn_nodes @ c), length)
        scale = math.sqrt(length / (len(position) - 1))
        beside = (position - self.target).T.ravel() * (scale / _POSITION)
        bend = self.basis.curl @ c * (scale / _BEND / length**2)
        loads = [value - (1.0 - _RESERVE) for value in _loads(self.vehicle, *self._bends(c, length))]
        beyond = np.maximum(0.0, np.concatenate(loads)) * (scale / limit)
        gap = np.append(position[-1], self.start[2] + length * (self.basis.turn[-1] @ c)) - self.end[:3]
        return np.concatenate([beside, bend, beyond]), gap

    def jacobian(self, c: Array, length: float, limit: float) -> tuple[Array, Array]:
        """Derivatives of `misfit` by (c, length), shapes (r, m + 1) and (3, m + 1); that of its scale is left out."""
        panels = len(self.basis.ends) - 1
        nodes = self.start[2] + length * (self.basis.turn_nodes @ c)
        weights = np.tile(GAUSS_W, panels) * length / panels
        turned = weights[:, None] * np.column_stack([length * self.basis.turn_nodes, self.basis.turn_nodes @ c])
        moves = np.zeros((2, panels + 1, turned.shape[1]))
        for k, (along, across) in enumerate(((np.cos(nodes), -np.sin(nodes)), (np.sin(nodes), np.cos(nodes)))):
            rows = across[:, None] * turned
            rows[:, -1] += weights * along / length
            moves[k, 1:] = np.cumsum(rows.reshape(panels, 4, -1).sum(axis=1), axis=0)
        scale = math.sqrt(length / panels)
        curl = self.basis.curl * (scale / _BEND / length**2)
        turn = np.append(length * self.basis.turn[-1], self.basis.turn[-1] @ c)
        rows = [
            moves.reshape(-1, turned.shape[1]) * (scale / _POSITION),
            np.column_stack([curl, -2.0 * (curl @ c) / length]),
            self._beyond(c, length) * (scale / limit),
        ]
        return np.concatenate(rows), np.concatenate([moves[:, -1], turn[None]])

    def _bends(self, c: Array, length: float) -> tuple[Array, Array, Array]:
        """Curvature and its first two derivatives by the axle's distance at the ends of the panels."""
        return self.basis.ends @ c, self.basis.slope @ c / length, self.basis.curl @ c / length**2

    def _beyond(self, c: Array, length: float) -> Array:
        """Derivatives of the excesses, 0 where there is none. Shape (3 (P + 1), m + 1)."""
        bends = self._bends(c, length)
        parts = [self.basis.ends, self.basis.slope / length, self.basis.curl / length**2]
        rows = [np.zeros((len(parts[0]), len(c) + 1)) for _ in range(3)]
        for i, part in enumerate(parts):
            # complex steps: exact to rounding
            moved = [value + _TINY * 1j * (k == i) for k, value in enumerate(bends)]
            loads = _loads(self.vehicle, *moved)
            for row, value in zip(rows, loads, strict=True):
                slope = np.where(np.real(value) > 1.0 - _RESERVE, np.imag(value) / _TINY, 0.0)
                row += slope[:, None] * np.column_stack([part, -i * bends[i] / length])
        return np.concatenate(rows)


def _loads(vehicle: Vehicle, kappa: NDArray, sigma: NDArray, curl: NDArray) -> tuple[NDArray, NDArray, NDArray]:
    """|kappa|, |tan(phi)| and |dphi/ds| by their limits; for complex numbers the sign is that of the real part."""
    tangent, rate = steering(vehicle, kappa, sigma, curl)
    bounds = (vehicle.max_kappa, math.tan(vehicle.max_steer), vehicle.max_steer_rate)
    kappa, tangent, rate = (
        value * np.sign(value.real) / bound for value, bound in zip((kappa, tangent, rate), bounds, strict=True)
    )
    return kappa, tangent, rate


def fit_points(vehicle: Vehicle, points: Array, start: Array, end: Array) -> tuple[Array, float, float]:
    """Coefficients, length [m] and largest deviation [m] of the curve through points (n, 2) between two flat states.

    start, end: (5,) x, y, heading, kappa, sigma; the headings' difference is the whole turn, unwrapped. Where limits
    and points cannot agree, the curve is the last one that came nearer to both.
    """
    fit, c, length = _first_guess(vehicle, points, start, end)
    damping = _LEAST_DAMPING
    for iteration in range(_MOST_STEPS):
        # limits come in by and by: at full weight, steps from an unsmoothed start do not come back
        hardness = iteration - _SMOOTHING
        limit = max(_LIMIT, _SOFT * _HARDENING**hardness) if hardness >= 0 else math.inf
        step, promised, price = _step(fit, c, length, limit, damping)
        before = _merit(fit, c, length, limit, price)
        share = min(1.0, 0.2 * length / max(abs(step[-1]), 1e-12))
        while _merit(fit, c + share * step[:-1], length + share * step[-1], limit, price) > before - share * promised:
            share *= 0.5
            if share < _SMALLEST_SHARE:
                break
        if share >= _SMALLEST_SHARE:
            c, length = c + share * step[:-1], length + share * step[-1]
            damping = max(_LEAST_DAMPING, 0.01 * damping)
            if limit == _LIMIT and np.abs(step).max() < _AT_REST:
                break
        elif np.abs(step).max() < _AT_REST or damping > 1.0:
            break
        else:  # other limits come in before the step has done anything: turn it towards the slope
            damping = max(1e-6, 100.0 * damping)
    position = positions(start, length * (fit.basis.turn_nodes @ c), length)
    return c, length, float(np.hypot(*(position - fit.target).T).max())


def _first_guess(vehicle: Vehicle, points: Array, start: Array, end: Array) -> tuple[_StretchFit, Array, float]:
    """The fit, and the coefficients and the length of the curve that the points themselves make."""
    from scipy.interpolate import CubicSpline  # takes a quarter of a second to load

    along = np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(points, axis=0).T))])
    length = float(along[-1])
    bases = basis(max(_FEWEST, math.ceil(length / _INTERVAL)))
    share = np.linspace(0.0, 1.0, len(bases.ends))
    through = CubicSpline(along / length, points)
    tangent = through(share, 1)
    kappa = np.gradient(np.unwrap(np.arctan2(tangent[:, 1], tangent[:, 0])), share) / length
    c = np.linalg.lstsq(bases.ends, kappa, rcond=None)[0]
    c[0], c[-1] = start[3], end[3]
    return _StretchFit(vehicle, bases, through(share), start, end), c, length


def _step(fit: _StretchFit, c: Array, length: float, limit: float, damping: float) -> tuple[Array, float, float]:
    """One Gauss-Newton step of (c, length), shape (m + 1,), the merit's predicted decrease, and the gap's price."""
    misfit, gap = fit.misfit(c, length, limit)
    rows, closing = fit.jacobian(c, length, limit)
    free = np.r_[1 : len(c) - 1, len(c)]  # the curvature at both ends is given
    rows, closing = rows[:, free], closing[:, free]
    size = len(free)
    system = np.zeros((size + 3, size + 3))
    system[:size, :size] = rows.T @ rows
    system[:size, :size] += damping * np.trace(system) / size * np.eye(size)
    system[size:, :size] = closing
    system[:size, size:] = closing.T
    solution = np.linalg.solve(system, -np.concatenate([rows.T @ misfit, gap]))
    step = np.zeros(len(c) + 1)
    step[free] = solution[:size]
    price = 2.0 * float(np.abs(solution[size:]).max()) + 1e-9
    promised = price * float(np.abs(gap).sum()) - float(misfit @ (rows @ solution[:size]))
    return step, _DECREASE * promised, price


def _merit(fit: _StretchFit, c: Array, length: float, limit: float, price: float) -> float:
    """Half the sum of squares and the gap at its price: what a step must lower."""
    if not length > 0.0:
        return math.inf
    misfit, gap = fit.misfit(c, length, limit)
    return 0.5 * float(misfit @ misfit) + price * float(np.abs(gap).sum())


def drivable_stretch(
    vehicle: Vehicle, direction: int, points: Array, start: Array, end: Array, spacing: float
) -> Stretch | None:
    """The stretch beside the points (n, 2), samples at most `spacing` [m] apart; None where the fit falls apart.

    Points, start and end are in the order of the trailer's heading; the segment is in that of driving.
    """
    with np.errstate(all="ignore"):  # a fit that falls apart is recognised by its result
        try:
            c, length, deviation = fit_points(vehicle, points, start, end)
        except np.linalg.LinAlgError:
            return None
        if not (np.isfinite(c).all() and _SHORTEST < length < _LONGEST * np.hypot(*np.diff(points, axis=0).T).sum()):
            return None
        s, flat = sampled(vehicle, c, length, start, spacing)
    gap = float(np.abs(flat[-1, :4] - end[:4]).max())
    flat[-1, :4] = end[:4]
    states, phi = state_from_flat(vehicle, flat)
    phi = _linear_between(s, phi)
    if direction < 0:
        s, states, phi = s[-1] - s[::-1], states[::-1], phi[::-1]
    return Stretch(segment=segment_from_states(direction, s, states, phi), deviation=deviation, gap=gap)


def _linear_between(s: Array, phi: Array) -> Array:
    """Steering whose straight lines between samples turn as much as the curve through the given samples."""
    from scipy.interpolate import CubicSpline  # takes a quarter of a second to load

    bend = CubicSpline(s, phi)(s, 2)
    h = np.diff(s)
    square = np.concatenate([[h[0] ** 2], h[:-1] * h[1:], [h[-1] ** 2]])
    return phi - square * bend / 12.0
