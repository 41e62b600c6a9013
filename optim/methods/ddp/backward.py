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

from optim.methods.ddp.boxqp import AT_LOW, FREE, box_qp, solve_factored
from optim.numerics.arrays import Array
from optim.numerics.kernel import kernel


class Expansion(NamedTuple):
    """Derivatives by z = (x, u) along N stages with n states and m controls. Writable; a model fills them."""

    fz: Array
    """Of f. Shape (N, n, n + m)."""
    fzz: Array
    """Second ones of the first r components of f, the others being linear; r = 0 for Gauss-Newton (iLQR). Shape
    (N, r, n + m, n + m)."""
    gap: Array
    """f(x, u) - next x. Shape (N, n)."""
    lz: Array
    """Of l; the last row is the terminal cost's, 0 by u. Shape (N + 1, n + m)."""
    lzz: Array
    """Only the lower triangle is read. Shape (N + 1, n + m, n + m)."""
    bend: Array
    """The part of l_xx that only counts with full second derivatives, since it may be negative; none where r = 0.
    Shape (N + 1, n, n)."""
    metric: Array
    """What one unit of regularisation adds to l_xx. Shape (N + 1, n, n)."""
    control_metric: Array
    """And to the diagonal of l_uu. Shape (m,)."""
    low: Array
    """Bounds of du. Shape (N, m)."""
    high: Array
    """Shape (N, m)."""
    low_x: Array
    """Their derivatives by the state; shape (N, m, n), or (0, m, n) for constant bounds."""
    high_x: Array
    """As `low_x`."""
    sizes: tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]
    """Tuples of n, of m and of (n + m + 3) // 4 entries: the compiler knows their lengths, so that loops unroll (twice
    as fast)."""


class Policy(NamedTuple):
    """What a backward pass gives: du = k + K dx. Writable."""

    k: Array
    """Shape (N, m)."""
    gain: Array
    """K. Shape (N, m, n)."""


def new_expansion(stages: int, n: int, m: int, curved: int = 0, moving_bounds: bool = False) -> Expansion:
    """Arrays of zeros, bounds at infinity; `curved` is the r of `Expansion.fzz`."""
    moving = stages if moving_bounds else 0
    return Expansion(
        fz=np.zeros((stages, n, n + m)),
        fzz=np.zeros((stages, curved, n + m, n + m)),
        gap=np.zeros((stages, n)),
        lz=np.zeros((stages + 1, n + m)),
        lzz=np.zeros((stages + 1, n + m, n + m)),
        bend=np.zeros((stages + 1 if curved else 0, n, n)),
        metric=np.zeros((stages + 1, n, n)),
        control_metric=np.ones(m),
        low=np.full((stages, m), -np.inf),
        high=np.full((stages, m), np.inf),
        low_x=np.zeros((moving, m, n)),
        high_x=np.zeros((moving, m, n)),
        sizes=((0,) * n, (0,) * m, (0,) * ((n + m + 3) // 4)),
    )


def new_policy(stages: int, n: int, m: int) -> Policy:
    """The policy that changes nothing."""
    return Policy(np.zeros((stages, m)), np.zeros((stages, m, n)))


@kernel(inline="always")
def _propagate(e, k, vxx, p, curved, regularisation, f, vf, qz, qzz):
    """Q's derivatives by z at stage k; f and vf are space of shape (n, 4 blocks), qzz has that many columns too.

    Four columns at a time, so that their sums stay in registers.
    """
    n, m, blocks = len(e.sizes[0]), len(e.sizes[1]), len(e.sizes[2])
    for i in range(n):
        for j in range(n + m):
            f[i, j] = e.fz[k, i, j]
    for i in range(n):
        for block in range(blocks):
            j = 4 * block
            a0, a1, a2, a3 = 0.0, 0.0, 0.0, 0.0
            for c in range(n):
                value = vxx[i, c]
                a0 += value * f[c, j]
                a1 += value * f[c, j + 1]
                a2 += value * f[c, j + 2]
                a3 += value * f[c, j + 3]
            vf[i, j], vf[i, j + 1], vf[i, j + 2], vf[i, j + 3] = a0, a1, a2, a3
    for i in range(n + m):
        total = e.lz[k, i]
        for c in range(n):
            total += f[c, i] * p[c]
        qz[i] = total
        for block in range(i // 4 + 1):
            j = 4 * block
            a0, a1, a2, a3 = 0.0, 0.0, 0.0, 0.0
            for c in range(n):
                value = f[c, i]
                a0 += value * vf[c, j]
                a1 += value * vf[c, j + 1]
                a2 += value * vf[c, j + 2]
                a3 += value * vf[c, j + 3]
            qzz[i, j], qzz[i, j + 1], qzz[i, j + 2], qzz[i, j + 3] = a0, a1, a2, a3
        for j in range(i + 1):
            qzz[i, j] += e.lzz[k, i, j]
    for c in range(curved):
        for i in range(n + m):
            for j in range(i + 1):
                qzz[i, j] += p[c] * e.fzz[k, c, i, j]
    for i in range(n):
        if curved > 0:
            for j in range(i + 1):
                qzz[i, j] += e.bend[k, i, j]
        if regularisation > 0.0:
            for j in range(i + 1):
                qzz[i, j] += regularisation * e.metric[k, i, j]
    for i in range(m):
        qzz[n + i, n + i] += regularisation * e.control_metric[i]


@kernel(inline="always")
def _feedback(e, k, gain, qzz, chol, held, quu, moving, column):
    """K: free controls minimise, held ones follow their bound."""
    n, m = len(e.sizes[0]), len(e.sizes[1])
    for j in range(n):
        for i in range(m):
            gain[i, j] = 0.0
            if held[i] != FREE and moving:
                gain[i, j] = e.low_x[k, i, j] if held[i] == AT_LOW else e.high_x[k, i, j]
        for i in range(m):
            column[i] = 0.0
            if held[i] == FREE:
                column[i] = -qzz[n + i, j]
                for c in range(m):
                    if held[c] != FREE:
                        column[i] -= quu[i, c] * gain[c, j]
        solve_factored(chol, column, e.sizes[1])
        for i in range(m):
            if held[i] == FREE:
                gain[i, j] = column[i]


@kernel(inline="always")
def _value_function(sizes, qz, qzz, quu, k, gain, vx, vxx, slope, row):
    """V_x and V_xx of a stage; slope and row are space of shapes (m,) and (m, n)."""
    n, m = len(sizes[0]), len(sizes[1])
    for i in range(m):
        total = qz[n + i]
        for c in range(m):
            total += quu[i, c] * k[c]
        slope[i] = total
        for j in range(n):
            total = qzz[n + i, j]
            for c in range(m):
                total += quu[i, c] * gain[c, j]
            row[i, j] = total
    for i in range(n):
        total = qz[i]
        for c in range(m):
            total += gain[c, i] * slope[c] + qzz[n + c, i] * k[c]
        vx[i] = total
        for j in range(i + 1):
            total = qzz[i, j]
            for c in range(m):
                total += gain[c, i] * row[c, j] + qzz[n + c, i] * gain[c, j]
            vxx[i, j] = total
            vxx[j, i] = total


@kernel(fastmath={"contract"})
def backward_pass(e, regularisation, curvature, policy, report):
    """Fill the policy; the stage whose Q_uu is not positive, or -1 when all went well.

    Args:
        e: the Expansion.
        regularisation: how often the metrics are added to the diagonals.
        curvature: whether p . f_zz and `bend` count: full DDP; without them, iLQR.
        policy: the Policy to fill.
        report: filled with the expected change of the cost, its part that is linear in the step, the largest
            projected gradient |u - clip(u - Q_u)|, and the largest |V_x| beside a gap. Shape (4,).
    """
    stages, n, m = e.fz.shape[0], len(e.sizes[0]), len(e.sizes[1])
    curved = e.fzz.shape[1] if curvature else 0
    moving = e.low_x.shape[0] > 0
    # what a stage works on lies in arrays of its own: a view of one stage costs more than a copy
    wide = 4 * len(e.sizes[2])
    f, vf, qzz, qz, p = np.zeros((n, wide)), np.empty((n, wide)), np.empty((n + m, wide)), np.empty(n + m), np.empty(n)
    quu, qu, low, high = np.empty((m, m)), np.empty(m), np.empty(m), np.empty(m)
    step, gain, vx, vxx = np.empty(m), np.empty((m, n)), np.empty(n), np.empty((n, n))
    slope, row, chol = np.empty(m), np.empty((m, n)), np.zeros((m, m))
    column, held = np.empty(m), np.empty(m, np.int64)
    gradient, newton, trial = np.empty(m), np.empty(m), np.empty(m)
    report[:] = 0.0
    report[2] = np.inf  # until the pass has gone through
    linear, square, largest = 0.0, 0.0, 0.0
    for i in range(n):
        vx[i] = e.lz[stages, i]
        for j in range(n):
            vxx[i, j] = e.lzz[stages, i, j] + regularisation * e.metric[stages, i, j]
    for k in range(stages - 1, -1, -1):
        _across_gap(e, k, vx, vxx, p, report)
        _propagate(e, k, vxx, p, curved, regularisation, f, vf, qz, qzz)
        for i in range(m):
            qu[i], low[i], high[i], step[i] = qz[n + i], e.low[k, i], e.high[k, i], 0.0
            largest = max(largest, abs(min(max(-qu[i], low[i]), high[i])))
            for j in range(m):
                quu[i, j] = qzz[n + max(i, j), n + min(i, j)]
        if not box_qp(quu, qu, low, high, step, held, chol, gradient, newton, trial, e.sizes[1]):
            return k
        _feedback(e, k, gain, qzz, chol, held, quu, moving, column)
        for i in range(m):
            policy.k[k, i] = step[i]
            linear += step[i] * qu[i]
            for j in range(m):
                square += 0.5 * step[i] * quu[i, j] * step[j]
            for j in range(n):
                policy.gain[k, i, j] = gain[i, j]
        _value_function(e.sizes, qz, qzz, quu, step, gain, vx, vxx, slope, row)
    report[0] += linear + square
    report[1] += linear
    report[2] = largest
    return -1


@kernel(inline="always")
def _across_gap(e, k, vx, vxx, p, report):
    """p = V_x + V_xx gap, and what closing the gap changes."""
    n = len(e.sizes[0])
    for i in range(n):
        p[i] = vx[i]
    for j in range(n):
        gap = e.gap[k, j]
        if gap != 0.0:
            report[3] = max(report[3], abs(vx[j]))
            report[0] += gap * vx[j]
            report[1] += gap * vx[j]
            for i in range(n):
                p[i] += vxx[i, j] * gap
                report[0] += 0.5 * e.gap[k, i] * vxx[i, j] * gap
