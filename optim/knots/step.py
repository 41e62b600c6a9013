"""Kernel: one Runge-Kutta step of the vehicle with its first and second derivatives.

The step of `optim.model.kinematics.rk4` as a function of z = (theta, alpha, phi0, phi1, h); x and y enter by addition
only. Each intermediate quantity carries its gradient and its Hessian (lower triangle) by z, from stage to stage.
"""

import math
from typing import NamedTuple

import numpy as np

from optim.numerics.arrays import Array, Float64
from optim.numerics.kernel import kernel

VARIABLES = 5
"""theta, alpha, phi0, phi1, h."""


class StepJet(NamedTuple):
    """Change of (x, y, theta, alpha) over a step and its derivatives by (theta, alpha, phi0, phi1, h). Writable."""

    value: Float64[Array, " 4"]
    """Shape (4,)."""
    gradient: Float64[Array, "4 5"]
    """Shape (4, 5)."""
    hessian: Float64[Array, "4 5 5"]
    """Symmetric. Shape (4, 5, 5)."""
    slopes: Float64[Array, "6 6 5"]
    """Work space: those of one stage. Shape (6, 6, 5), as (quantity, gradient and Hessian rows, z)."""


@kernel
def empty_jet():
    """Arrays to fill."""
    return StepJet(
        np.empty(4), np.empty((4, VARIABLES)), np.empty((4, VARIABLES, VARIABLES)), np.empty((6, 6, VARIABLES))
    )


@kernel
def step_jet(z, d, kinematics, second, into):
    """Fill a StepJet.

    Args:
        z: (theta, alpha, phi0, phi1, h) [rad, m].
        d: the gear, +1 or -1.
        kinematics: (l, l_t, M) [m].
        second: whether to fill the Hessians.
        into: the StepJet.
    """
    theta, alpha, phi0, phi1, h = z
    value, gradient, hessian, jet = into.value, into.gradient, into.hessian, into.slopes
    for o in range(4):
        value[o] = 0.0
        for i in range(5):
            gradient[o, i] = 0.0
            for j in range(5):
                hessian[o, i, j] = 0.0
    # rows 0 to 3 of jet: derivatives of the slopes of x, y, theta, alpha; 4 and 5: of theta and alpha themselves
    for o in range(6):
        for i in range(6):
            for j in range(5):
                jet[o, i, j] = 0.0
    slopes = (0.0, 0.0, 0.0, 0.0)
    for stage in range(4):
        c = 0.0 if stage == 0 else (1.0 if stage == 3 else 0.5)
        weight = 1.0 if stage in (0, 3) else 2.0
        _move(h, c, slopes[2], slopes[3], second, jet)
        # q = q0 + c h k
        th, al = theta + c * h * slopes[2], alpha + c * h * slopes[3]
        slopes = _slopes(th, al, (1.0 - c) * phi0 + c * phi1, c, d, kinematics, second, jet)
        for o in range(4):
            value[o] += weight * slopes[o]
            for i in range(5):
                gradient[o, i] += weight * jet[o, 0, i]
                if second:
                    for j in range(i + 1):
                        hessian[o, i, j] += weight * jet[o, 1 + i, j]
    _close(h, second, value, gradient, hessian)


@kernel
def _move(h, c, k2, k3, second, jet):
    """Derivatives of theta and alpha after c h of the last stage's slopes k."""
    for o in range(4, 6):
        slope = k2 if o == 4 else k3
        for i in range(5):
            jet[o, 0, i] = c * h * jet[o - 2, 0, i]
        jet[o, 0, 4] += c * slope
        jet[o, 0, o - 4] += 1.0
        if second:
            for i in range(5):
                for j in range(i + 1):
                    jet[o, 1 + i, j] = c * h * jet[o - 2, 1 + i, j]
            for j in range(5):
                jet[o, 5, j] += c * jet[o - 2, 0, j]
            jet[o, 5, 4] += c * jet[o - 2, 0, 4]


@kernel
def _slopes(th, al, phi, c, d, kinematics, second, jet):
    """Slopes of one stage, and their derivatives into jet; c is the share of phi1 in phi."""
    l, l_t, offset = kinematics
    tangent = math.tan(phi)
    turn, turn1 = tangent / l, (1.0 + tangent * tangent) / l
    turn2 = 2.0 * tangent * turn1
    ct, st, ca, sa = math.cos(th), math.sin(th), math.cos(al), math.sin(al)
    lever = 1.0 + offset * ca / l_t
    by_al = -d * (ca - offset * sa * turn) / l_t
    by_al2 = d * (sa + offset * ca * turn) / l_t
    cross = d * offset * sa / l_t
    for i in range(5):
        ti, ai = jet[4, 0, i], jet[5, 0, i]
        pi = (1.0 - c) if i == 2 else (c if i == 3 else 0.0)
        jet[0, 0, i] = -d * st * ti
        jet[1, 0, i] = d * ct * ti
        jet[2, 0, i] = d * turn1 * pi
        jet[3, 0, i] = by_al * ai - d * lever * turn1 * pi
        if second:
            for j in range(i + 1):
                tj, aj = jet[4, 0, j], jet[5, 0, j]
                pj = (1.0 - c) if j == 2 else (c if j == 3 else 0.0)
                bend, fold = jet[4, 1 + i, j], jet[5, 1 + i, j]
                jet[0, 1 + i, j] = -d * (ct * ti * tj + st * bend)
                jet[1, 1 + i, j] = d * (ct * bend - st * ti * tj)
                jet[2, 1 + i, j] = d * turn2 * pi * pj
                jet[3, 1 + i, j] = (
                    by_al * fold + by_al2 * ai * aj + cross * turn1 * (ai * pj + aj * pi) - d * lever * turn2 * pi * pj
                )
    return d * ct, d * st, d * turn, -d * (sa / l_t + lever * turn)


@kernel
def _close(h, second, value, gradient, hessian):
    """The change is h / 6 times the sums of the stages, for theta and alpha added to where they begin."""
    share = h / 6.0
    for o in range(4):
        if second:
            for i in range(5):
                for j in range(i + 1):
                    hessian[o, i, j] *= share
            for j in range(5):
                hessian[o, 4, j] += gradient[o, j] / 6.0
            hessian[o, 4, 4] += gradient[o, 4] / 6.0
            for i in range(5):
                for j in range(i):
                    hessian[o, j, i] = hessian[o, i, j]
        for i in range(5):
            gradient[o, i] *= share
        gradient[o, 4] += value[o] / 6.0
        value[o] *= share
    gradient[2, 0] += 1.0
    gradient[3, 1] += 1.0
