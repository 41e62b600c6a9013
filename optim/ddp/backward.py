"""The backward pass: value function and feedback from arrays of derivatives, for any model.

Stages k = 0 .. N - 1 with n states x and m controls u; a gap is what the dynamics miss the next state by:

    x[k+1] + gap[k] = f_k(x[k], u[k]),     minimise  sum_k l_k(x[k], u[k]) + l_N(x[N])
    low_k + low_x_k dx  <=  du  <=  high_k + high_x_k dx        (bounds may move with the state)

With p = V_x + V_xx gap of the next stage, the field's letters (Tassa, Mansard and Todorov 2014):

    Q_x  = l_x + f_x' p        Q_xx = l_xx + f_x' V_xx f_x + p . f_xx
    Q_u  = l_u + f_u' p        Q_uu = l_uu + f_u' V_xx f_u + p . f_uu      Q_ux likewise

    du = k + K dx   minimises Q within the bounds
    V_x = Q_x + K' Q_uu k + K' Q_u + Q_ux' k      V_xx = Q_xx + K' Q_uu K + K' Q_ux + Q_ux' K

A control held by a bound follows the bound: its row of K is the bound's own derivative. Regularisation adds a multiple
of given metrics to all l_xx and l_uu: a proximal term, which holds back the way that states and controls move.
"""

from typing import NamedTuple

import numpy as np
from numba import njit

from optim.arrays import Array
from optim.ddp.boxqp import AT_LOW, FREE, box_qp, solve_factored


class Expansion(NamedTuple):
    """Derivatives along a trajectory of N stages, n states and m controls. Writable; a model fills them."""

    fx: Array
    """Shape (N, n, n)."""
    fu: Array
    """Shape (N, n, m)."""
    second: Array
    """Second derivatives of the first r components of f by (x, u), the others being linear; r = 0 for Gauss-Newton
    (iLQR). Shape (N, r, n + m, n + m)."""
    gap: Array
    """f(x, u) - next x. Shape (N, n)."""
    lx: Array
    """Shape (N + 1, n); the last row is the terminal cost's."""
    lu: Array
    """Shape (N, m)."""
    lxx: Array
    """Shape (N + 1, n, n)."""
    lux: Array
    """Shape (N, m, n)."""
    luu: Array
    """Shape (N, m, m)."""
    low: Array
    """Bounds of du. Shape (N, m)."""
    high: Array
    """Shape (N, m)."""
    low_x: Array
    """Their derivatives by the state; shape (N, m, n), or (0, m, n) for constant bounds."""
    high_x: Array
    """As `low_x`."""
    bend: Array
    """The part of l_xx that only counts with full second derivatives, since it may be negative; none where r = 0.
    Shape (N + 1, n, n)."""
    metric: Array
    """What one unit of regularisation adds to l_xx. Shape (N + 1, n, n)."""
    control_metric: Array
    """And to the diagonal of l_uu. Shape (m,)."""
    sizes: tuple[tuple[int, ...], tuple[int, ...]]
    """Tuples of n and of m entries: their lengths are known to the compiler, so that loops unroll (twice as fast)."""


class Policy(NamedTuple):
    """What a backward pass gives: du = k + K dx, and the value function's expansion. Writable."""

    k: Array
    """Shape (N, m)."""
    gain: Array
    """K. Shape (N, m, n)."""
    vx: Array
    """Shape (N + 1, n)."""
    vxx: Array
    """Shape (N + 1, n, n)."""


def new_expansion(stages: int, n: int, m: int, curved: int = 0, moving_bounds: bool = False) -> Expansion:
    """Arrays of zeros, bounds at infinity; `curved` is the r of `Expansion.second`."""
    moving = stages if moving_bounds else 0
    return Expansion(
        fx=np.zeros((stages, n, n)),
        fu=np.zeros((stages, n, m)),
        second=np.zeros((stages, curved, n + m, n + m)),
        gap=np.zeros((stages, n)),
        lx=np.zeros((stages + 1, n)),
        lu=np.zeros((stages, m)),
        lxx=np.zeros((stages + 1, n, n)),
        lux=np.zeros((stages, m, n)),
        luu=np.zeros((stages, m, m)),
        low=np.full((stages, m), -np.inf),
        high=np.full((stages, m), np.inf),
        low_x=np.zeros((moving, m, n)),
        high_x=np.zeros((moving, m, n)),
        bend=np.zeros((stages + 1 if curved else 0, n, n)),
        metric=np.zeros((stages + 1, n, n)),
        control_metric=np.ones(m),
        sizes=((0,) * n, (0,) * m),
    )


def new_policy(stages: int, n: int, m: int) -> Policy:
    return Policy(
        np.zeros((stages, m)), np.zeros((stages, m, n)), np.zeros((stages + 1, n)), np.zeros((stages + 1, n, n))
    )


@njit(cache=True)
def _propagate(e, k, vxx, p, curved, regularisation, vf, qx, qu, qxx, qux, quu):
    """Q's derivatives at stage k; vf is space of shape (n, n + m)."""
    n, m = len(e.sizes[0]), len(e.sizes[1])
    for i in range(n):
        for j in range(n + m):
            vf[i, j] = 0.0
    for i in range(n):
        for c in range(n):
            value = vxx[i, c]
            if value != 0.0:
                for j in range(n):
                    vf[i, j] += value * e.fx[k, c, j]
                for j in range(m):
                    vf[i, n + j] += value * e.fu[k, c, j]
    for i in range(n):
        qx[i] = e.lx[k, i]
        for j in range(i + 1):
            qxx[i, j] = e.lxx[k, i, j] + regularisation * e.metric[k, i, j]
            if curved > 0:
                qxx[i, j] += e.bend[k, i, j]
    for i in range(m):
        qu[i] = e.lu[k, i]
        for j in range(n):
            qux[i, j] = e.lux[k, i, j]
        for j in range(m):
            quu[i, j] = e.luu[k, i, j]
        quu[i, i] += regularisation * e.control_metric[i]
    for c in range(n):
        for i in range(n):
            value = e.fx[k, c, i]
            if value != 0.0:
                qx[i] += value * p[c]
                for j in range(i + 1):
                    qxx[i, j] += value * vf[c, j]
        for i in range(m):
            value = e.fu[k, c, i]
            if value != 0.0:
                qu[i] += value * p[c]
                for j in range(n):
                    qux[i, j] += value * vf[c, j]
                for j in range(m):
                    quu[i, j] += value * vf[c, n + j]
    for c in range(curved):
        value = p[c]
        for i in range(n):
            for j in range(i + 1):
                qxx[i, j] += value * e.second[k, c, i, j]
        for i in range(m):
            for j in range(n):
                qux[i, j] += value * e.second[k, c, n + i, j]
            for j in range(m):
                quu[i, j] += value * e.second[k, c, n + i, n + j]


@njit(cache=True)
def _feedback(sizes, gain, qux, chol, held, quu, low_x, high_x, moving, column):
    """K: free controls minimise, held ones follow their bound."""
    n, m = len(sizes[0]), len(sizes[1])
    for j in range(n):
        for i in range(m):
            gain[i, j] = 0.0
            if held[i] != FREE and moving:
                gain[i, j] = low_x[i, j] if held[i] == AT_LOW else high_x[i, j]
        for i in range(m):
            column[i] = 0.0
            if held[i] == FREE:
                column[i] = -qux[i, j]
                for c in range(m):
                    if held[c] != FREE:
                        column[i] -= quu[i, c] * gain[c, j]
        solve_factored(chol, column, sizes[1])
        for i in range(m):
            if held[i] == FREE:
                gain[i, j] = column[i]


@njit(cache=True)
def _value_function(sizes, qx, qu, qxx, qux, quu, k, gain, vx, vxx, row):
    """V_x and V_xx of a stage; row is space of shape (m, n)."""
    n, m = len(sizes[0]), len(sizes[1])
    for i in range(m):
        slope = qu[i]
        for j in range(n):
            row[i, j] = qux[i, j]
        for c in range(m):
            slope += quu[i, c] * k[c]
            for j in range(n):
                row[i, j] += quu[i, c] * gain[c, j]
        qu[i] = slope  # Q_u + Q_uu k from here on
    for i in range(n):
        total = qx[i]
        for c in range(m):
            total += gain[c, i] * qu[c] + qux[c, i] * k[c]
        vx[i] = total
        for j in range(i + 1):
            entry = qxx[i, j]
            for c in range(m):
                entry += gain[c, i] * row[c, j] + qux[c, i] * gain[c, j]
            vxx[i, j] = entry
            vxx[j, i] = entry


@njit(cache=True)
def backward_pass(e, regularisation, curvature, policy, report):
    """Fill the policy; the stage whose Q_uu is not positive, or -1 when all went well.

    Args:
        e: the Expansion.
        regularisation: how often the metrics are added to the diagonals.
        curvature: whether p . f_xx and the like count: full DDP; without them, iLQR.
        policy: the Policy to fill.
        report: filled with the expected change of the cost, its part that is linear in the step, the largest
            projected gradient |u - clip(u - Q_u)|, and the largest |V_x| beside a gap. Shape (4,).
    """
    stages, n, m = e.fx.shape[0], len(e.sizes[0]), len(e.sizes[1])
    curved = e.second.shape[1] if curvature else 0
    moving = e.low_x.shape[0] > 0
    vf, qxx, quu = np.empty((n, n + m)), np.empty((n, n)), np.empty((m, m))
    qux, row, qx, qu, p = np.empty((m, n)), np.empty((m, n)), np.empty(n), np.empty(m), np.empty(n)
    chol, work, column, held = np.zeros((m, m)), np.empty((3, m)), np.empty(m), np.empty(m, np.int64)
    report[:] = 0.0
    policy.vx[stages] = e.lx[stages]
    policy.vxx[stages] = e.lxx[stages]
    policy.vxx[stages] += regularisation * e.metric[stages]
    for k in range(stages - 1, -1, -1):
        vx, vxx = policy.vx[k + 1], policy.vxx[k + 1]
        for i in range(n):
            p[i] = vx[i]
            gap = e.gap[k, i]
            if gap != 0.0:
                report[3] = max(report[3], abs(vx[i]))
                report[0] += gap * vx[i]
                report[1] += gap * vx[i]
        for j in range(n):
            gap = e.gap[k, j]
            if gap != 0.0:
                for i in range(n):
                    p[i] += vxx[i, j] * gap
                    report[0] += 0.5 * e.gap[k, i] * vxx[i, j] * gap
        _propagate(e, k, vxx, p, curved, regularisation, vf, qx, qu, qxx, qux, quu)
        step = policy.k[k]
        for i in range(m):
            report[2] = max(report[2], abs(min(max(-qu[i], e.low[k, i]), e.high[k, i])))
            step[i] = 0.0
        if not box_qp(quu, qu, e.low[k], e.high[k], step, held, chol, work, e.sizes[1]):
            return k
        low_x, high_x = (e.low_x[k], e.high_x[k]) if moving else (row, row)
        _feedback(e.sizes, policy.gain[k], qux, chol, held, quu, low_x, high_x, moving, column)
        for i in range(m):
            report[0] += step[i] * qu[i]
            report[1] += step[i] * qu[i]
            for j in range(m):
                report[0] += 0.5 * step[i] * quu[i, j] * step[j]
        _value_function(e.sizes, qx, qu, qxx, qux, quu, step, policy.gain[k], policy.vx[k], policy.vxx[k], row)
    return -1
