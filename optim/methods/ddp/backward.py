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
from optim.numerics.arrays import Array, Float64
from optim.numerics.kernel import kernel


class Trajectory(NamedTuple):
    """States and controls along N stages."""

    states: Float64[Array, "S n"]
    """Shape (N + 1, n)."""
    controls: Float64[Array, "S-1 m"]
    """Shape (N, m)."""


class Expansion(NamedTuple):
    """Derivatives by z = (x, u) along N stages with n states and m controls. Writable; a model fills them."""

    fz: Float64[Array, "N n n+m"]
    """First derivatives of f. Shape (N, n, n + m)."""
    fzz: Float64[Array, "N _ n+m n+m"]
    """Second derivatives of the first r components of f, the others being linear; r = 0 for Gauss-Newton (iLQR). Shape
    (N, r, n + m, n + m)."""
    gap: Float64[Array, "N n"]
    """f(x, u) - next x. Shape (N, n)."""
    lz: Float64[Array, "N+1 n+m"]
    """First derivatives of l; the last row is the terminal cost's, 0 by u. Shape (N + 1, n + m)."""
    lzz: Float64[Array, "N+1 n+m n+m"]
    """Only the lower triangle is read. Shape (N + 1, n + m, n + m)."""
    bend: Float64[Array, "_ n n"]
    """The part of l_xx that only counts with full second derivatives, since it may be negative; none where r = 0.
    Shape (N + 1, n, n)."""
    metric: Float64[Array, "N+1 n n"]
    """What one unit of regularisation adds to l_xx. Shape (N + 1, n, n)."""
    control_metric: Float64[Array, " m"]
    """What it adds to the diagonal of l_uu. Shape (m,)."""
    low: Float64[Array, "N m"]
    """Lower bounds of du. Shape (N, m)."""
    high: Float64[Array, "N m"]
    """Shape (N, m)."""
    low_x: Float64[Array, "_ m n"]
    """Derivatives of `low` by the state; shape (N, m, n), or (0, m, n) for constant bounds."""
    high_x: Float64[Array, "_ m n"]
    """Derivatives of `high`, in the shape of `low_x`."""
    sizes: tuple[tuple[int, ...], tuple[int, ...], tuple[int, ...]]
    """Tuples of n, of m and of (n + m + 3) // 4 entries: the compiler knows their lengths, so that loops unroll (twice
    as fast)."""


class Policy(NamedTuple):
    """Feedback of a backward pass: du = k + K dx. Writable."""

    k: Float64[Array, "N m"]
    """Shape (N, m)."""
    gain: Float64[Array, "N m n"]
    """K. Shape (N, m, n)."""


class Outlook(NamedTuple):
    """What a backward pass promises of a step along its policy."""

    failed_stage: int
    """The stage whose Q_uu is not positive; -1 if the pass completed."""
    change: float
    """Expected change of the cost by a full step."""
    linear: float
    """The part of it that is linear in the step."""
    gradient: float
    """Largest projected gradient |u - clip(u - Q_u)|; infinite if the pass failed."""
    gap_slope: float
    """Largest |V_x| beside a gap."""


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


class _Value(NamedTuple):
    """Derivatives of the value function of the next stage."""

    x: Array  # V_x (n,)
    xx: Array  # V_xx (n, n)
    p: Array  # V_x + V_xx gap (n,)


class _Q(NamedTuple):
    """Derivatives of Q by z = (x, u); the second has its columns in blocks of four."""

    z: Array  # (n + m,)
    zz: Array  # (n + m, 4 blocks)


class _Space(NamedTuple):
    """What a stage works on; arrays of its own, since a view of one stage costs more than a copy."""

    f: Array  # f_z (n, 4 blocks)
    vf: Array  # V_xx f_z (n, 4 blocks)
    slope: Array  # (m,)
    row: Array  # (m, n)
    column: Array  # (m,)


# sums over the stages towards Outlook.change, .linear and .gap_slope; as three variables the compiler fuses products
# and sums in another way: of 800 random passes 158 end with another last digit
_CHANGE, _LINEAR, _GAP_SLOPE = 0, 1, 2


@kernel(fastmath={"contract"})
def backward_pass(e, regularisation, curvature, policy):
    """Fill the policy; the Outlook of a step along it.

    Args:
        e: the Expansion.
        regularisation: how often the metrics are added to the diagonals.
        curvature: whether p . f_zz and `bend` count: full DDP; without them, iLQR.
        policy: the Policy to fill.
    """
    stages, n, m, wide = e.fz.shape[0], len(e.sizes[0]), len(e.sizes[1]), 4 * len(e.sizes[2])
    curved = e.fzz.shape[1] if curvature else 0
    value = _Value(np.empty(n), np.empty((n, n)), np.empty(n))
    q = _Q(np.empty(n + m), np.empty((n + m, wide)))
    quu, qu, low, high = np.empty((m, m)), np.empty(m), np.empty(m), np.empty(m)
    held, chol = np.empty(m, np.int64), np.zeros((m, m))
    step, gain = np.empty(m), np.empty((m, n))
    space = _Space(np.zeros((n, wide)), np.empty((n, wide)), np.empty(m), np.empty((m, n)), np.empty(m))
    gradient, newton, trial = np.empty(m), np.empty(m), np.empty(m)
    sums, linear, square, largest = np.zeros(3), 0.0, 0.0, 0.0
    for i in range(n):
        value.x[i] = e.lz[stages, i]
        for j in range(n):
            value.xx[i, j] = e.lzz[stages, i, j] + regularisation * e.metric[stages, i, j]
    for k in range(stages - 1, -1, -1):
        _across_gap(e, k, value, sums)
        _propagate(e, k, value, curved, regularisation, q, space)
        for i in range(m):
            qu[i], low[i], high[i], step[i] = q.z[n + i], e.low[k, i], e.high[k, i], 0.0
            largest = max(largest, abs(min(max(-qu[i], low[i]), high[i])))
            for j in range(m):
                quu[i, j] = q.zz[n + max(i, j), n + min(i, j)]
        if not box_qp(quu, qu, low, high, step, held, chol, gradient, newton, trial, e.sizes[1]):
            return Outlook(k, 0.0, 0.0, np.inf, 0.0)
        _feedback(e, k, q, quu, held, chol, gain, space)
        for i in range(m):
            policy.k[k, i] = step[i]
            linear += step[i] * qu[i]
            for j in range(m):
                square += 0.5 * step[i] * quu[i, j] * step[j]
            for j in range(n):
                policy.gain[k, i, j] = gain[i, j]
        _value_function(e, q, quu, step, gain, value, space)
    return Outlook(-1, sums[_CHANGE] + (linear + square), sums[_LINEAR] + linear, largest, sums[_GAP_SLOPE])


@kernel(inline="always")
def _across_gap(e, k, value, sums):
    """p = V_x + V_xx gap, and what closing the gap changes."""
    vx, vxx, p = value.x, value.xx, value.p
    n = len(e.sizes[0])
    for i in range(n):
        p[i] = vx[i]
    for j in range(n):
        gap = e.gap[k, j]
        if gap != 0.0:
            sums[_GAP_SLOPE] = max(sums[_GAP_SLOPE], abs(vx[j]))
            sums[_CHANGE] += gap * vx[j]
            sums[_LINEAR] += gap * vx[j]
            for i in range(n):
                p[i] += vxx[i, j] * gap
                sums[_CHANGE] += 0.5 * e.gap[k, i] * vxx[i, j] * gap


@kernel(inline="always")
def _propagate(e, k, value, curved, regularisation, q, space):
    """Q's derivatives at stage k, four columns at a time, so that their sums stay in registers."""
    vxx, p, qz, qzz, f, vf = value.xx, value.p, q.z, q.zz, space.f, space.vf
    n, m, blocks = len(e.sizes[0]), len(e.sizes[1]), len(e.sizes[2])
    for i in range(n):
        for j in range(n + m):
            f[i, j] = e.fz[k, i, j]
    for i in range(n):
        for block in range(blocks):
            j = 4 * block
            a0, a1, a2, a3 = 0.0, 0.0, 0.0, 0.0
            for c in range(n):
                left = vxx[i, c]
                a0 += left * f[c, j]
                a1 += left * f[c, j + 1]
                a2 += left * f[c, j + 2]
                a3 += left * f[c, j + 3]
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
                left = f[c, i]
                a0 += left * vf[c, j]
                a1 += left * vf[c, j + 1]
                a2 += left * vf[c, j + 2]
                a3 += left * vf[c, j + 3]
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
def _feedback(e, k, q, quu, held, chol, gain, space):
    """K: free controls minimise, held ones follow their bound."""
    qzz, column = q.zz, space.column
    n, m, moving = len(e.sizes[0]), len(e.sizes[1]), e.low_x.shape[0] > 0
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
def _value_function(e, q, quu, k, gain, value, space):
    """V_x and V_xx of a stage."""
    qz, qzz, vx, vxx, slope, row = q.z, q.zz, value.x, value.xx, space.slope, space.row
    n, m = len(e.sizes[0]), len(e.sizes[1])
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
