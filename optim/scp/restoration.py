"""Second-order correction: from a trial step back onto the dynamics and out of the obstacles.

A step of the linearised problem misses the true constraints by the square of its length. Newton's method with the
change that the model of the objective likes best,

    min 1/2 dz' (F'F + ridge) dz   s.t.   defects + J dz = 0,    distance + gradient . dz = required  where it is less,

removes that error without touching what the step gained; step lengths stay, since equal ones couple a whole segment.
Without it the trust region must shrink until the square of the step is small against its gain: measured on a reverse
bay, 60 sub-problems did not reach what 8 reach with it. With |dz|^2 in place of the model, the steering answers a
violation at one knot with a kink there, whose cost (dphi/ds)^2 undoes the gain.
"""

import numpy as np
from scipy import sparse
from scipy.linalg import solve_banded

from optim.arrays import Array, IntArray
from optim.methods.transcription import Knots, defects
from optim.problem import Problem
from optim.scp.linearisation import Scales
from optim.scp.subproblem import Limits
from optim.separation import separations
from optim.vehicle import Vehicle

_RIDGE = 1e-3  # curvature of every unknown in scaled units, so that those that J does not see stay near
_SLACK = 1e-10  # keeps the system regular where two rows say the same
_STATES = 6  # unknowns of a knot and the interval after it: x, y, theta, alpha, phi, h


def restore(problem: Problem, knots: Knots, factor: Array, scales: Scales, limits: Limits) -> Knots:
    """One Newton step towards the dynamics and the required clearances; limits on phi are kept.

    factor: F of the model, shape (K - 1, 5, 5), as in `Linearisation`.
    """
    gaps, jacobian = defects(problem.vehicle, knots)
    count, steps = len(knots.phi), len(knots.h)
    unit = np.concatenate([scales.state, [scales.angle, scales.angle, scales.step]])
    jac = jacobian * unit / scales.state[:, None]
    jac[knots.gear == 0, :, 4:] = 0.0
    rows = separations(problem.scene, problem.vehicle, knots.states, float(limits.required.max()))
    short = limits.required[rows.knot, rows.body] - rows.distance
    keep = np.flatnonzero((short > 0.0) & (rows.knot > 0) & (rows.knot < count - 1))
    knot, gradient = rows.knot[keep], rows.gradient[keep] * scales.state / scales.length
    total = _STATES * count
    right = np.concatenate([np.zeros(total), -(gaps / scales.state).ravel(), short[keep] / scales.length])
    system = _system(factor, jac, knot, gradient, count)
    # along the path: the unknowns of a knot, its clearances' multipliers, those of the interval after it
    place = np.concatenate([np.repeat(np.arange(count), _STATES), np.repeat(np.arange(steps), 4) + 0.6, knot + 0.3])
    order = np.argsort(place, kind="stable")
    change = np.empty(len(right))
    change[order] = _solve_banded(system, order, right[order])
    change = change[:total].reshape(count, _STATES)
    return moved(knots, problem.vehicle, change[:, :4], change[:, 4], np.zeros(steps), scales, limits)


def moved(knots: Knots, vehicle: Vehicle, q: Array, phi: Array, h: Array, scales: Scales, limits: Limits) -> Knots:
    """The knots after a step in scaled units; phi and h are cut off at their limits."""
    steer = np.clip(knots.phi + scales.angle * phi, -vehicle.max_steer, vehicle.max_steer)
    lengths = np.clip(knots.h + scales.step * h, limits.shortest, limits.longest)
    states = knots.states + scales.state * q
    states[0], states[-1] = knots.states[0], knots.states[-1]
    for run in knots.runs:
        lengths[run] = lengths[run].mean()  # equal to the last digit, not to the solver's tolerance
    return Knots(states, steer, np.where(knots.gear != 0, lengths, 0.0), knots.gear)


def _system(factor: Array, jac: Array, knot: IntArray, gradient: Array, count: int) -> sparse.coo_matrix:
    """[[F'F + ridge, J'], [J, -slack]]; what is fixed, both ends' states and all step lengths, has curvature 1 only."""
    steps, total = len(jac), _STATES * count
    start = _STATES * np.arange(steps)
    inputs = np.stack([start + 2, start + 3, start + 4, start + 10], axis=1)  # theta, alpha, phi_k, phi_{k+1}
    curvature = np.einsum("kij,kil->kjl", factor[:, :, :4], factor[:, :, :4])
    row = total + 4 * np.arange(steps)[:, None] + np.arange(4)
    own = total + 4 * steps + np.arange(len(knot))
    free = np.ones(total, dtype=bool)
    free[:4] = free[total - _STATES : total - 2] = free[5::_STATES] = False
    upper = [
        (row, start[:, None] + column + 0 * row, jac[:, :, j])
        for j, column in ((0, 0), (1, 1), (2, 2), (3, 3), (4, 4), (5, 10))
    ]
    upper.append((row, start[:, None] + _STATES + np.arange(4), np.full((steps, 4), -1.0)))
    upper += [(own, _STATES * knot + c, gradient[:, c]) for c in range(4)]
    rows, columns, values = (np.concatenate([np.ravel(part[i]) for part in upper]) for i in range(3))
    columns = columns.astype(np.int64)
    values = np.where(free[columns], values, 0.0)
    block_rows, block_columns = np.repeat(inputs, 4, axis=1).ravel(), np.tile(inputs, (1, 4)).ravel()
    blocks = np.where(free[block_rows] & free[block_columns], curvature.ravel(), 0.0)
    size = total + 4 * steps + len(knot)
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
