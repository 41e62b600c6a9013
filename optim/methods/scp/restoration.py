"""Second-order correction: from a trial step back onto the dynamics and out of the obstacles.

A step of the linearised problem misses the true constraints by the square of its length. Newton's method with the
change that the model of the objective likes best,

    min 1/2 dz' (F'F + ridge) dz   s.t.   defects + J dz = 0,    distance + gradient . dz = required  where it is less,
                                          and likewise for hitch angles and steering rates beyond their limits,

removes that error without touching what the step gained; step lengths stay, since equal ones couple a whole segment.
Without it the trust region must shrink until the square of the step is small against its gain: measured on a reverse
bay, 60 sub-problems did not reach what 8 reach with it. With |dz|^2 in place of the model, the steering answers a
violation at one knot with a kink there, whose cost (dphi/ds)^2 undoes the gain.
"""

from dataclasses import dataclass, replace

import numpy as np
from scipy import sparse
from scipy.linalg import solve_banded

from optim.knots.transcription import Knots, defects
from optim.methods.scp.linearisation import Scales
from optim.methods.scp.subproblem import KnotLimits
from optim.model.clearance import separations
from optim.model.problem import Problem
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, BoolArray, IntArray

_RIDGE = 1e-3  # curvature of every unknown in scaled units, so that those that J does not see stay near
_SLACK = 1e-10  # keeps the system regular where two rows say the same
_MOST_HOLDS = 3  # times that more steering angles are held at their limit
_STATES = 6  # unknowns of a knot and the interval after it: x, y, theta, alpha, phi, h


@dataclass(frozen=True, eq=False)
class _BrokenRows:
    """Constraints that a point breaks, linearised: gradient entries by row and unknown, and what is missing."""

    row: IntArray
    column: IntArray
    value: Array
    missing: Array
    """What each row lacks, in scaled units."""
    knot: IntArray
    """Knot that each row belongs to."""


def restore(problem: Problem, knots: Knots, factor: Array, scales: Scales, limits: KnotLimits) -> Knots:
    """One Newton step towards the dynamics, the required clearances and the limits.

    Steering angles that it would push beyond their limit are held there, and the rest makes up for them: cut off
    afterwards, they leave 0.4 of the defects, step after step.

    factor: F of the model, shape (K - 1, 5, 5), as in `Linearisation`.
    """
    most, held = problem.vehicle.max_steer, np.zeros(len(knots.phi), dtype=bool)
    for _ in range(_MOST_HOLDS):
        change = _newton_step(problem, knots, factor, scales, limits, held)
        steer = knots.phi + scales.angle * change[:, 4]
        beyond = ~held & (np.abs(steer) > most)
        if not beyond.any():
            break
        held |= beyond
        knots = replace(knots, phi=np.where(beyond, np.clip(steer, -most, most), knots.phi))
    else:
        change = _newton_step(problem, knots, factor, scales, limits, held)
    zeros = np.zeros(len(knots.h))
    return moved(knots, problem.vehicle, change[:, :4], change[:, 4], zeros, scales, limits)


def _newton_step(
    problem: Problem, knots: Knots, factor: Array, scales: Scales, limits: KnotLimits, held: BoolArray
) -> Array:
    """Changes of x, y, theta, alpha, phi (and 0 of h) in scaled units; phi stays where `held`. Shape (K, 6)."""
    gaps, jacobian = defects(problem.vehicle, knots)
    count, steps = len(knots.phi), len(knots.h)
    unit = np.concatenate([scales.state, [scales.angle, scales.angle, scales.step]])
    jac = jacobian * unit / scales.state[:, None]
    jac[knots.gear == 0, :, 4:] = 0.0
    broken = _joined(
        [
            _clearance_rows(problem, knots, scales, limits),
            _hitch_rows(problem.vehicle, knots, scales),
            _rate_rows(problem.vehicle, knots, scales, held),
        ]
    )
    total = _STATES * count
    right = np.concatenate([np.zeros(total), -(gaps / scales.state).ravel(), broken.missing])
    system = _system(factor, jac, broken, held)
    # along the path: the unknowns of a knot, its rows' multipliers, those of the interval after it
    place = np.concatenate(
        [np.repeat(np.arange(count), _STATES), np.repeat(np.arange(steps), 4) + 0.6, broken.knot + 0.3]
    )
    order = np.argsort(place, kind="stable")
    change = np.empty(len(right))
    change[order] = _solve_banded(system, order, right[order])
    return change[:total].reshape(count, _STATES)


def _clearance_rows(problem: Problem, knots: Knots, scales: Scales, limits: KnotLimits) -> _BrokenRows:
    rows = separations(problem.scene, problem.vehicle, knots.states, float(limits.required.max()))
    short = limits.required[rows.knot, rows.body] - rows.distance
    keep = np.flatnonzero((short > 0.0) & (rows.knot > 0) & (rows.knot < len(knots.phi) - 1))
    knot, gradient = rows.knot[keep], rows.gradient[keep] * scales.state / scales.length
    row = np.repeat(np.arange(len(keep)), 4)
    column = (_STATES * knot[:, None] + np.arange(4)).ravel()
    return _BrokenRows(row, column, gradient.ravel(), short[keep] / scales.length, knot)


def _hitch_rows(vehicle: Vehicle, knots: Knots, scales: Scales) -> _BrokenRows:
    """Hitch angles beyond their limit; the ends' cannot be changed."""
    excess = hitch_excess(vehicle, knots) / scales.angle
    knot = np.flatnonzero(excess)
    alpha = _STATES * knot + 3
    return _BrokenRows(np.arange(len(knot)), alpha, -np.sign(knots.states[knot, 3]), excess[knot], knot)


def _rate_rows(vehicle: Vehicle, knots: Knots, scales: Scales, held: BoolArray) -> _BrokenRows:
    """Changes of the steering angle beyond their limit on an interval, whose length stays, unless both are held."""
    excess = rate_excess(vehicle, knots) / scales.angle
    knot = np.flatnonzero((excess > 0.0) & ~(held[:-1] & held[1:]))
    sign = np.sign(knots.phi[knot + 1] - knots.phi[knot])
    row = np.repeat(np.arange(len(knot)), 2)
    phi = (_STATES * knot[:, None] + np.array([4, 4 + _STATES])).ravel()
    return _BrokenRows(row, phi, np.stack([sign, -sign], axis=1).ravel(), excess[knot], knot)


def hitch_excess(vehicle: Vehicle, knots: Knots) -> Array:
    """Excess of hitch angles over their limit, 0 at the ends [rad]. Shape (K,)."""
    excess = np.maximum(np.abs(knots.states[:, 3]) - vehicle.max_hitch, 0.0)
    excess[[0, -1]] = 0.0
    return excess


def rate_excess(vehicle: Vehicle, knots: Knots) -> Array:
    """Excess of the change of steering angle on each interval [rad]. Shape (K - 1,)."""
    allowed = np.where(knots.gear != 0, vehicle.max_steer_rate * knots.h, np.inf)
    return np.maximum(np.abs(np.diff(knots.phi)) - allowed, 0.0)


def _joined(parts: list[_BrokenRows]) -> _BrokenRows:
    starts = np.cumsum([0, *(len(part.missing) for part in parts)])
    return _BrokenRows(
        np.concatenate([part.row + start for part, start in zip(parts, starts, strict=False)]),
        np.concatenate([part.column for part in parts]),
        np.concatenate([part.value for part in parts]),
        np.concatenate([part.missing for part in parts]),
        np.concatenate([part.knot for part in parts]),
    )


def moved(knots: Knots, vehicle: Vehicle, q: Array, phi: Array, h: Array, scales: Scales, limits: KnotLimits) -> Knots:
    """The knots after a step in scaled units; phi and h are cut off at their limits."""
    steer = np.clip(knots.phi + scales.angle * phi, -vehicle.max_steer, vehicle.max_steer)
    lengths = np.clip(knots.h + scales.step * h, limits.shortest, limits.longest)
    states = knots.states + scales.state * q
    states[0], states[-1] = knots.states[0], knots.states[-1]
    for run in knots.runs:
        lengths[run] = lengths[run].mean()  # equal to the last digit, not to the solver's tolerance
    return Knots(states, steer, np.where(knots.gear != 0, lengths, 0.0), knots.gear)


def _system(factor: Array, jac: Array, broken: _BrokenRows, held: BoolArray) -> sparse.coo_matrix:
    """[[F'F + ridge, J'], [J, -slack]]; what is fixed, both ends' states and all step lengths, has curvature 1 only."""
    steps, total = len(jac), _STATES * len(held)
    start = _STATES * np.arange(steps)
    inputs = np.stack([start + 2, start + 3, start + 4, start + 10], axis=1)  # theta, alpha, phi_k, phi_{k+1}
    curvature = np.einsum("kij,kil->kjl", factor[:, :, :4], factor[:, :, :4])
    row = total + 4 * np.arange(steps)[:, None] + np.arange(4)
    free = np.ones(total, dtype=bool)
    free[:4] = free[total - _STATES : total - 2] = free[5::_STATES] = False
    free[4::_STATES] = ~held
    upper = [
        (row, start[:, None] + column + 0 * row, jac[:, :, j])
        for j, column in ((0, 0), (1, 1), (2, 2), (3, 3), (4, 4), (5, 10))
    ]
    upper.append((row, start[:, None] + _STATES + np.arange(4), np.full((steps, 4), -1.0)))
    upper.append((total + 4 * steps + broken.row, broken.column, broken.value))
    rows, columns, values = (np.concatenate([np.ravel(part[i]) for part in upper]) for i in range(3))
    columns = columns.astype(np.int64)
    values = np.where(free[columns], values, 0.0)
    block_rows, block_columns = np.repeat(inputs, 4, axis=1).ravel(), np.tile(inputs, (1, 4)).ravel()
    blocks = np.where(free[block_rows] & free[block_columns], curvature.ravel(), 0.0)
    size = total + 4 * steps + len(broken.missing)
    diagonal = np.concatenate([np.where(free, _RIDGE, 1.0), np.full(size - total, -_SLACK)])
    everywhere = np.arange(size)
    return sparse.coo_matrix(
        (
            np.concatenate([values, values, blocks, diagonal]),
            (
                np.concatenate([rows, columns, block_rows, everywhere]),
                np.concatenate([columns, rows, block_columns, everywhere]),
            ),
        ),
        shape=(size, size),
    )


def _solve_banded(system: sparse.coo_matrix, order: IntArray, right: Array) -> Array:
    """LU of the system with its unknowns in this order, in which only neighbours along the path are coupled."""
    rank = np.empty(len(order), dtype=np.int64)
    rank[order] = np.arange(len(order))
    rows, columns = rank[system.row], rank[system.col]
    width = int(np.abs(rows - columns).max())
    band = np.zeros((2 * width + 1, len(order)))
    np.add.at(band, (width + rows - columns, columns), system.data)
    return solve_banded((width, width), band, right, overwrite_ab=True, check_finite=False)
