"""Kernels: one stage of `optim.methods.ddp.truck` at a time, for libraries that own the loop over the stages.

The limits of the steering move with the state there; libraries with constant boxes get them by a change of control:
w in [-1, 1] with phi+ = phi + w max_steer_rate h while driving, which keeps the rate's limit; |phi| <= max_steer
becomes one more term of the augmented Lagrangian. Everything else is the same arithmetic, with Gauss-Newton terms.
"""

import numpy as np
from numba import njit

from optim.knots.step import empty_jet, step_jet
from optim.methods.ddp.constraints import knot_terms
from optim.methods.ddp.truck import CONTROLS, STATES, _drive_cost, _drive_dynamics, _next_state, _stage_cost

_SIZE = STATES + CONTROLS


@njit(cache=True)
def _steer_term(limit, penalty, multiplier, k, phi, gradient):
    """Of |phi| <= limit; its slope and curvature into gradient (2,)."""
    total, gradient[0], gradient[1] = 0.0, 0.0, 0.0
    for side in range(2):
        sign = 1.0 if side == 0 else -1.0
        force = max(0.0, multiplier[k, side] + penalty * (sign * phi - limit))
        total += (force * force - multiplier[k, side] ** 2) / (2.0 * penalty)
        gradient[0] += sign * force
        gradient[1] += penalty if force > 0.0 else 0.0
    return total


@njit(cache=True)
def stage_value(st, constraints, e, steer, states, k, w, out):
    """Cost of stage k at states[k] and control w, the next state into out (6,); behind the last stage its cost."""
    x, spare = states[k], np.empty(2)
    scene, bodies, rows, lagrangian = constraints
    total = knot_terms(scene, bodies, rows, lagrangian, states, k, 0, e)
    total += _steer_term(st.max_steer, lagrangian.penalty.hitch, steer, k, x[4], spare)
    if k == st.gear.size:
        return total
    if st.gear[k] == 0.0:
        u0, u1 = w[0], w[1]
    else:
        u0, u1 = x[4] + w[0] * st.max_steer_rate * st.share[k] * x[5], 0.0
    _next_state(st, k, x, u0, u1, out)
    return total + _stage_cost(st, k, x, u0)


@njit(cache=True)
def stage_slopes(st, constraints, e, steer, states, k, w, fz, lz, lzz):
    """Derivatives by (x, w): fz (6, 8), lz (8,), lzz (8, 8)."""
    x, spare = states[k], np.empty(2)
    scene, bodies, rows, lagrangian = constraints
    e.lz[k], e.lzz[k], e.metric[k] = 0.0, 0.0, 0.0
    knot_terms(scene, bodies, rows, lagrangian, states, k, 1, e)
    _steer_term(st.max_steer, lagrangian.penalty.hitch, steer, k, x[4], spare)
    e.lz[k, 4] += spare[0]
    e.lzz[k, 4, 4] += spare[1]
    bend, reach, u0 = 0.0, 0.0, 0.0
    if k < st.gear.size:
        e.fz[k] = 0.0
        if st.gear[k] == 0.0:
            u0 = w[0]
            slope, curve = 2.0 * st.jump[k] * (u0 - x[4]), 2.0 * st.jump[k]
            for i in range(4):
                e.fz[k, i, i] = 1.0
            e.fz[k, 4, 6], e.fz[k, 5, 7] = 1.0, 1.0
            e.lz[k, 4] -= slope
            e.lz[k, 6] = slope
            e.lzz[k, 4, 4] += curve
            e.lzz[k, 6, 6] = curve
            e.lzz[k, 6, 4] = -curve
            e.lzz[k, 7, 7] = 1e-6
        else:
            share = st.share[k]
            reach = st.max_steer_rate * share
            u0 = x[4] + w[0] * reach * x[5]
            jet = empty_jet()
            step_jet((x[2], x[3], x[4], u0, share * x[5]), st.gear[k], st.kinematics, False, jet)
            _drive_dynamics(e, k, share, jet, False)
            _drive_cost(st, e, k, share, x, u0)
            bend = e.lz[k, 6] * reach
    _change_control(e, k, st.gear.size, x, w, reach, bend, fz, lz, lzz)


@njit(cache=True)
def _change_control(e, k, stages, x, w, reach, bend, fz, lz, lzz):
    """From the next steering angle to w: d(phi+) = dphi + w reach dL + reach L dw, and the curvature of that.

    All else stays: the change of variables is one row `d` in the place of the unit row of phi+.
    """
    d = np.zeros(_SIZE)
    if reach > 0.0:
        d[4], d[5], d[6] = 1.0, w[0] * reach, reach * x[5]
    else:
        d[6] = 1.0
    at = e.lzz[k]
    for i in range(_SIZE):
        own = 0.0 if i == 6 else 1.0
        lz[i] = own * e.lz[k, i] + d[i] * e.lz[k, 6]
        for j in range(i + 1):
            other = 0.0 if j == 6 else 1.0
            value = own * other * at[i, j] + own * at[max(i, 6), min(i, 6)] * d[j]
            value += d[i] * (other * at[max(j, 6), min(j, 6)] + at[6, 6] * d[j])
            lzz[i, j] = lzz[j, i] = value
    lzz[5, 6] += bend
    lzz[6, 5] += bend
    if k < stages:
        for o in range(STATES):
            for i in range(_SIZE):
                fz[o, i] = (0.0 if i == 6 else 1.0) * e.fz[k, o, i] + e.fz[k, o, 6] * d[i]
