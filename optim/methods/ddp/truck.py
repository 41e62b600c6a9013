"""Kernels: the truck with one trailer as stages of an optimal-control problem.

State (x, y, theta, alpha, phi, L) with the steering angle phi and the length L of the segment being driven; controls
(phi+, L+), the next steering angle and the length of the segment that begins.

    driving, gear d = +1 or -1      (x, y, theta, alpha)+ = one Runge-Kutta step of length h = share L, phi linear
                                    phi+ = first control, L+ = L
        cost    w_length h + w_steer h (phi^2 + phi phi+ + phi+^2) / 3 + w_rate (phi+ - phi)^2 / h
        bounds  |phi+| <= max_steer and |phi+ - phi| <= max_steer_rate h: they move with the state
    standing (d = 0)                the pose stays; phi and L become the controls: a gear change, or the start
        cost    w_jump (phi+ - phi)^2, 0 at the start

One length per segment instead of one per step: where the knots lie on a segment hardly matters to J, so free
steps would leave as many directions without curvature as there are knots. With the next steering angle as the
control both limits of the steering are bounds, kept exactly at every iterate; J is the one of `optim.model.objective`.
"""

from typing import NamedTuple

import numpy as np

from optim.knots.step import VARIABLES, empty_jet, step_jet
from optim.methods.ddp.constraints import knot_terms
from optim.model.kinematics import rk4
from optim.numerics.arrays import Array, Float64
from optim.numerics.kernel import kernel

STATES, CONTROLS, CURVED = 6, 2, 4
LEVER = 10.0
"""Distance from the hitch [m] at which turning counts as moving."""
STATE_METRIC = (1.0, 1.0, 25.0, 25.0)
"""What moving by 1 m, or by 1 rad, weighs against each other: a corner of a body is some 5 m from the hitch."""
_PLACE = (2, 3, 4, 6, 5)  # of theta, alpha, phi0, phi1, h in z = (state, control)


class StageWeights(NamedTuple):
    """Weights of J at driving stages."""

    length: float
    """[1/m]"""
    steer: float
    """[1/(m rad^2)]"""
    rate: float
    """[m/rad^2]"""


class Stages(NamedTuple):
    """What is driven at each of the N stages."""

    gear: Float64[Array, " N"]
    """+1, -1, or 0 for standing. Shape (N,)."""
    share: Float64[Array, " N"]
    """Step length as a share of the segment's length; 0 for standing. Shape (N,)."""
    jump: Float64[Array, " N"]
    """Weight of the squared jump of phi at standing stages [1/rad^2]. Shape (N,)."""
    shortest: Float64[Array, " N"]
    """Least length that a standing stage may choose [m]. Shape (N,)."""
    longest: Float64[Array, " N"]
    """Largest one. Shape (N,)."""
    toll: Float64[Array, " N"]
    """Added to the weight of length at driving stages [1/m]; to press a segment out of the path. Shape (N,)."""
    weights: StageWeights
    max_steer: float
    """[rad]"""
    max_steer_rate: float
    """[rad/m]"""
    kinematics: tuple[float, float, float]
    """l, l_t, M [m]."""


@kernel
def _next_state(st, k, x, u0, u1, out):
    d = st.gear[k]
    if d == 0.0:
        for i in range(4):
            out[i] = x[i]
        out[4], out[5] = u0, u1
        return
    h = st.share[k] * x[5]
    l, l_t, offset = st.kinematics
    out[0], out[1], out[2], out[3] = rk4(x[0], x[1], x[2], x[3], x[4], u0, h, d, l, l_t, offset)
    out[4], out[5] = u0, x[5]


@kernel
def _stage_cost(st, k, x, u0):
    change = u0 - x[4]
    if st.gear[k] == 0.0:
        return st.jump[k] * change * change
    h = st.share[k] * x[5]
    square = (x[4] * x[4] + x[4] * u0 + u0 * u0) / 3.0
    weights = st.weights
    return h * (weights.length + st.toll[k] + weights.steer * square) + weights.rate * change * change / h


@kernel
def _bounds(st, k, x):
    """Lowest and highest phi+; and whether each is the rate's limit."""
    low, high, low_rate, high_rate = -st.max_steer, st.max_steer, False, False
    if st.gear[k] != 0.0:
        most = st.max_steer_rate * st.share[k] * x[5]
        if x[4] - most > low:
            low, low_rate = x[4] - most, True
        if x[4] + most < high:
            high, high_rate = x[4] + most, True
    return low, high, low_rate, high_rate


@kernel
def roll_out(st, constraints, e, now, policy, step, reach, into):
    """Drive with u + step k + K dx, gaps closed by the share `step`; the augmented Lagrangian of where that leads.

    Infinite when a knot moves by more than `reach` [m, or rad times LEVER]: what is farther off is not in the list of
    rows, and obstacles may not be jumped over.

    Args:
        st: the Stages.
        constraints: the Constraints.
        e: the Expansion at `now`, of which the gaps count.
        now: the Trajectory to start from.
        policy: the Policy.
        step: from 0 to 1.
        reach: as above.
        into: the Trajectory to fill.
    """
    states, controls, out, out_u = now.states, now.controls, into.states, into.controls
    stages, (scene, bodies, rows, lagrangian) = st.gear.size, constraints
    out[0] = states[0]
    total = 0.0
    for k in range(stages):
        x = out[k]
        low, high, _, _ = _bounds(st, k, x)
        u0, u1 = controls[k, 0] + step * policy.k[k, 0], controls[k, 1] + step * policy.k[k, 1]
        for i in range(STATES):
            dx = x[i] - states[k, i]
            u0 += policy.gain[k, 0, i] * dx
            u1 += policy.gain[k, 1, i] * dx
        u0 = min(max(u0, low), high)
        if st.gear[k] == 0.0:
            u1 = min(max(u1, st.shortest[k]), st.longest[k])
        out_u[k, 0], out_u[k, 1] = u0, u1
        total += _stage_cost(st, k, x, u0)
        _next_state(st, k, x, u0, u1, out[k + 1])
        for i in range(STATES):
            out[k + 1, i] -= (1.0 - step) * e.gap[k, i]
        moved = max(abs(out[k + 1, 0] - states[k + 1, 0]), abs(out[k + 1, 1] - states[k + 1, 1]))
        moved = max(moved, LEVER * abs(out[k + 1, 2] - states[k + 1, 2]))
        moved = max(moved, LEVER * abs(out[k + 1, 3] - states[k + 1, 3]))
        if not moved <= reach:
            return np.inf
        total += knot_terms(scene, bodies, rows, lagrangian, out, k + 1, 0, e)
    return total


@kernel
def expand(st, constraints, now, curvature, e):
    """Fill the Expansion at a Trajectory; its augmented Lagrangian."""
    stages, states = st.gear.size, now.states
    scene, bodies, rows, lagrangian = constraints
    following, jet, derive = np.empty(STATES), empty_jet(), 2 if curvature else 1
    e.lz[:] = 0.0
    e.lzz[:] = 0.0
    e.bend[:] = 0.0
    e.metric[:] = 0.0
    for k in range(stages + 1):
        for i in range(4):
            e.metric[k, i, i] = STATE_METRIC[i]
    total = 0.0
    for k in range(stages):
        total += knot_terms(scene, bodies, rows, lagrangian, states, k, derive, e)
        total += _stage_cost(st, k, states[k], now.controls[k, 0])
        if st.gear[k] == 0.0:
            _expand_standing(st, e, k, now, following)
        else:
            _expand_driving(st, e, k, now, curvature, jet, following)
        for i in range(STATES):
            miss = following[i] - states[k + 1, i]
            # rounding does not count as a gap, or it would be carried along for ever
            e.gap[k, i] = miss if abs(miss) > 1e-12 else 0.0
    total += knot_terms(scene, bodies, rows, lagrangian, states, stages, derive, e)
    return total


@kernel
def _expand_standing(st, e, k, now, following):
    """Dynamics, cost and bounds of a gear change or the start, and the next state."""
    x, u0, u1 = now.states[k], now.controls[k, 0], now.controls[k, 1]
    for i in range(4):
        e.fz[k, i, i] = 1.0
        following[i] = x[i]
    e.fz[k, 4, 6], e.fz[k, 5, 7] = 1.0, 1.0
    following[4], following[5] = u0, u1
    slope, bend = 2.0 * st.jump[k] * (u0 - x[4]), 2.0 * st.jump[k]
    e.lz[k, 4] -= slope
    e.lz[k, 6] = slope
    e.lzz[k, 4, 4] += bend
    e.lzz[k, 6, 6] = bend
    e.lzz[k, 6, 4] = -bend
    e.low[k, 0], e.high[k, 0] = -st.max_steer - u0, st.max_steer - u0
    e.low[k, 1], e.high[k, 1] = st.shortest[k] - u1, st.longest[k] - u1


@kernel
def _expand_driving(st, e, k, now, curvature, jet, following):
    """Dynamics, cost and bounds of an integration step, and the next state."""
    x, u0, w = now.states[k], now.controls[k, 0], st.share[k]
    step_jet((x[2], x[3], x[4], u0, w * x[5]), st.gear[k], st.kinematics, curvature, jet)
    _drive_dynamics(e, k, w, jet, curvature)
    for i in range(4):
        following[i] = x[i] + jet.value[i]
    following[4], following[5] = u0, x[5]
    _drive_cost(st, e, k, w, x, u0)
    low, high, low_rate, high_rate = _bounds(st, k, x)
    e.low[k, 0], e.high[k, 0] = low - u0, high - u0
    e.low[k, 1], e.high[k, 1] = 0.0, 0.0
    rate = st.max_steer_rate * w
    e.low_x[k, 0, 4], e.low_x[k, 0, 5] = (1.0, -rate) if low_rate else (0.0, 0.0)
    e.high_x[k, 0, 4], e.high_x[k, 0, 5] = (1.0, rate) if high_rate else (0.0, 0.0)


@kernel
def _drive_dynamics(e, k, w, jet, curvature):
    """The step's derivatives by state and control: h = w L, theta and alpha include themselves."""
    gradient, hessian = jet.gradient, jet.hessian
    e.fz[k, 0, 0], e.fz[k, 1, 1], e.fz[k, 5, 5] = 1.0, 1.0, 1.0
    e.fz[k, 4, 6] = 1.0
    for o in range(4):
        e.fz[k, o, 2], e.fz[k, o, 3], e.fz[k, o, 4] = gradient[o, 0], gradient[o, 1], gradient[o, 2]
        e.fz[k, o, 6] = gradient[o, 3]
        e.fz[k, o, 5] = w * gradient[o, 4]
        if curvature:
            for i in range(VARIABLES):
                for j in range(VARIABLES):
                    scale = (w if i == 4 else 1.0) * (w if j == 4 else 1.0)
                    e.fzz[k, o, _PLACE[i], _PLACE[j]] = scale * hessian[o, i, j]


@kernel
def _drive_cost(st, e, k, w, x, u0):
    """Derivatives of a driving stage's cost by phi (4), L (5) and the next phi."""
    h, phi = w * x[5], x[4]
    steer, pull = st.weights.steer, st.weights.rate
    rate = (u0 - phi) / h
    square = (phi * phi + phi * u0 + u0 * u0) / 3.0
    left, right = (2.0 * phi + u0) / 3.0, (phi + 2.0 * u0) / 3.0
    e.lz[k, 4] += steer * h * left - 2.0 * pull * rate
    e.lz[k, 5] += w * (st.weights.length + st.toll[k] + steer * square - pull * rate * rate)
    e.lz[k, 6] = steer * h * right + 2.0 * pull * rate
    bend = 2.0 * steer * h / 3.0 + 2.0 * pull / h
    e.lzz[k, 4, 4] += bend
    e.lzz[k, 6, 6] = bend
    e.lzz[k, 7, 7] = 1.0  # L+ is held here and changes nothing, but Q_uu must stay positive
    e.lzz[k, 6, 4] = steer * h / 3.0 - 2.0 * pull / h
    e.lzz[k, 5, 5] += 2.0 * pull * rate * rate * w * w / h
    by_left, by_right = w * (steer * left + 2.0 * pull * rate / h), w * (steer * right - 2.0 * pull * rate / h)
    e.lzz[k, 4, 5] += by_left
    e.lzz[k, 5, 4] += by_left
    e.lzz[k, 6, 5] = by_right
