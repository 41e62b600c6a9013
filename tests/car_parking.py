"""The car-parking problem of Tassa, Mansard and Todorov 2014 (section V-B), as a `Model` of the core of DDP.

State (x, y, theta, v), controls (steering w, acceleration a), 500 steps of 0.03 s, wheelbase 2. With f = 0.03 v the
front wheels' way in a step:

    b = d + f cos w - sqrt(d^2 - f^2 sin^2 w)        x += b cos theta    y += b sin theta
    theta += asin(sin w f / d)                       v += 0.03 a
"""

import numpy as np
from numba import njit

from optim.methods.ddp.backward import Expansion, Policy, Trajectory, new_expansion
from optim.numerics.arrays import Array

STEPS, STEP, WHEELBASE = 500, 0.03, 2.0
START = np.array([1.0, 1.0, 1.5 * np.pi, 0.0])
LIMITS = np.array([0.5, 2.0])
CONTROL_COST = 1e-2 * np.array([1.0, 0.01])
FINAL_COST, FINAL_SMOOTH = np.array([0.1, 0.1, 1.0, 0.3]), np.array([0.01, 0.01, 0.01, 1.0])
RUNNING_COST, RUNNING_SMOOTH = 1e-3, 0.1


@njit(cache=True)
def advance(x, w, a, out):
    """One step from state x."""
    f, d = STEP * x[3], WHEELBASE
    root = np.sqrt(d * d - (f * np.sin(w)) ** 2)
    b = d + f * np.cos(w) - root
    out[0], out[1] = x[0] + b * np.cos(x[2]), x[1] + b * np.sin(x[2])
    out[2], out[3] = x[2] + np.arcsin(np.sin(w) * f / d), x[3] + STEP * a


@njit(cache=True)
def smooth_abs(x, p):
    return np.sqrt(x * x + p * p) - p


@njit(cache=True)
def running_cost(x, w, a):
    u = CONTROL_COST[0] * w * w + CONTROL_COST[1] * a * a
    return u + RUNNING_COST * (smooth_abs(x[0], RUNNING_SMOOTH) + smooth_abs(x[1], RUNNING_SMOOTH))


@njit(cache=True)
def final_cost(x):
    total = 0.0
    for i in range(4):
        total += FINAL_COST[i] * smooth_abs(x[i], FINAL_SMOOTH[i])
    return total


@njit(cache=True)
def _roll_out(states, controls, k, gain, step, out, out_u):
    out[0] = states[0]
    total = 0.0
    for t in range(STEPS):
        for i in range(2):
            u = controls[t, i] + step * k[t, i]
            for j in range(4):
                u += gain[t, i, j] * (out[t, j] - states[t, j])
            out_u[t, i] = min(max(u, -LIMITS[i]), LIMITS[i])
        total += running_cost(out[t], out_u[t, 0], out_u[t, 1])
        if abs(STEP * out[t, 3]) >= WHEELBASE:
            return np.inf
        advance(out[t], out_u[t, 0], out_u[t, 1], out[t + 1])
    return total + final_cost(out[STEPS])


class CarParking:
    """`optim.methods.ddp.algorithm.Model`."""

    def __init__(self, curvature: bool) -> None:
        self.expansion = new_expansion(STEPS, 4, 2, 3 if curvature else 0)

    def initial(self, seed: int = 0) -> Trajectory:
        """Small random controls, as in the source, and their roll-out."""
        controls = 0.1 * np.random.default_rng(seed).standard_normal((STEPS, 2))
        states = np.tile(START, (STEPS + 1, 1))
        out = Trajectory(np.empty_like(states), np.empty_like(controls))
        _roll_out(states, controls, np.zeros((STEPS, 2)), np.zeros((STEPS, 2, 4)), 0.0, *out)
        return out

    def roll_out(self, now: Trajectory, policy: Policy, step: float, into: Trajectory) -> float:
        return _roll_out(*now, policy.k, policy.gain, step, *into)

    def expand(self, now: Trajectory, curvature: bool) -> tuple[float, Expansion]:
        states, controls = now
        e, x, (w, a) = self.expansion, states[:-1], controls.T
        d, f, theta = WHEELBASE, STEP * x[:, 3], x[:, 2]
        s, c, ct, st = np.sin(w), np.cos(w), np.cos(theta), np.sin(theta)
        root = np.sqrt(d * d - (f * s) ** 2)
        b, b_f, b_w = d + f * c - root, c + f * s**2 / root, -f * s + f**2 * s * c / root
        e.fz[:, :, :4] = np.eye(4)
        e.fz[:, 0, 2], e.fz[:, 0, 3], e.fz[:, 0, 4] = -b * st, STEP * b_f * ct, b_w * ct
        e.fz[:, 1, 2], e.fz[:, 1, 3], e.fz[:, 1, 4] = b * ct, STEP * b_f * st, b_w * st
        e.fz[:, 2, 3], e.fz[:, 2, 4], e.fz[:, 3, 5] = STEP * s / root, c * f / root, STEP
        if curvature:
            self._curve(f, s, c, ct, st, root, (b, b_f, b_w))
        e.lz[:], e.lzz[:] = 0.0, 0.0
        e.lz[:-1, 4:], e.lzz[:-1, 4:, 4:] = 2 * CONTROL_COST * controls, np.diag(2 * CONTROL_COST)
        for i in range(2):
            norm = np.sqrt(x[:, i] ** 2 + RUNNING_SMOOTH**2)
            e.lz[:-1, i] = RUNNING_COST * x[:, i] / norm
            e.lzz[:-1, i, i] = RUNNING_COST * RUNNING_SMOOTH**2 / norm**3
        norm = np.sqrt(states[-1] ** 2 + FINAL_SMOOTH**2)
        e.lz[-1, :4], e.lzz[-1, :4, :4] = (
            FINAL_COST * states[-1] / norm,
            np.diag(FINAL_COST * FINAL_SMOOTH**2 / norm**3),
        )
        e.low[:], e.high[:] = -LIMITS - controls, LIMITS - controls
        cost = sum(running_cost(x[t], w[t], a[t]) for t in range(STEPS)) + final_cost(states[-1])
        return cost, e

    def _curve(self, f: Array, s: Array, c: Array, ct: Array, st: Array, root: Array, way: tuple) -> None:
        """Second derivatives by theta (2), v (3) and w (4)."""
        b, b_f, b_w = way
        cube = root**3
        b_ff = s**2 / root + f**2 * s**4 / cube
        b_fw = -s + 2 * f * s * c / root + f**3 * s**3 * c / cube
        b_ww = -f * c + f**2 * (c**2 - s**2) / root + f**4 * s**2 * c**2 / cube
        turn_ff, turn_fw = f * s**3 / cube, c / root + f**2 * s**2 * c / cube
        turn_ww = -s * f / root + f**3 * s * c**2 / cube
        second = self.expansion.fzz
        for o, (value, slope) in enumerate(((ct, -st), (st, ct))):
            second[:, o, 2, 2] = -b * value
            second[:, o, 2, 3] = second[:, o, 3, 2] = STEP * b_f * slope
            second[:, o, 2, 4] = second[:, o, 4, 2] = b_w * slope
            second[:, o, 3, 3] = STEP**2 * b_ff * value
            second[:, o, 3, 4] = second[:, o, 4, 3] = STEP * b_fw * value
            second[:, o, 4, 4] = b_ww * value
        second[:, 2, 3, 3] = STEP**2 * turn_ff
        second[:, 2, 3, 4] = second[:, 2, 4, 3] = STEP * turn_fw
        second[:, 2, 4, 4] = turn_ww
