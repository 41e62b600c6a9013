"""Kinematics of the truck with one trailer in arc length, and their integration.

Notation (Esteban Cabezos 2020, sections 2.1.1-2.1.2, signs corrected):

    state   q = (x, y, theta, alpha)   centre of the truck's rear axle [m], truck heading [rad],
                                       hitch angle = trailer heading - truck heading [rad]
    control phi                        steering angle of the single-track front wheel [rad]
    s                                  arc length travelled by the rear axle [m], never decreasing
    d                                  direction, +1 forward, -1 reverse

    dx/ds = d cos(theta)        dtheta/ds = d tan(phi) / l
    dy/ds = d sin(theta)        dalpha/ds = -d (sin(alpha) / l_t + (1 + M cos(alpha) / l_t) tan(phi) / l)

with the wheelbase l, the distance l_t from the hitch to the trailer's axle, and the distance M of the hitch
behind the rear axle (0 for a fifth wheel over the axle, the only case that is differentially flat).
"""

import math

import numpy as np

from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, IntArray, frozen
from optim.numerics.kernel import kernel

LARGEST_STEP = 0.05
"""Largest step of the integration in roll-outs [m]."""


@kernel
def slope(theta, alpha, phi, d, l, l_t, offset):
    """dq/ds as four numbers; `derivative` is the same for arrays."""
    turn = math.tan(phi) / l
    fold = math.sin(alpha) / l_t + (1.0 + offset * math.cos(alpha) / l_t) * turn
    return d * math.cos(theta), d * math.sin(theta), d * turn, -d * fold


@kernel
def rk4(x, y, theta, alpha, phi0, phi1, ds, d, l, l_t, offset):
    """One Runge-Kutta step of order four over ds, phi linear from phi0 to phi1."""
    mid = 0.5 * (phi0 + phi1)
    a0, a1, a2, a3 = slope(theta, alpha, phi0, d, l, l_t, offset)
    b0, b1, b2, b3 = slope(theta + 0.5 * ds * a2, alpha + 0.5 * ds * a3, mid, d, l, l_t, offset)
    c0, c1, c2, c3 = slope(theta + 0.5 * ds * b2, alpha + 0.5 * ds * b3, mid, d, l, l_t, offset)
    e0, e1, e2, e3 = slope(theta + ds * c2, alpha + ds * c3, phi1, d, l, l_t, offset)
    w = ds / 6.0
    return (
        x + w * (a0 + 2.0 * b0 + 2.0 * c0 + e0),
        y + w * (a1 + 2.0 * b1 + 2.0 * c1 + e1),
        theta + w * (a2 + 2.0 * b2 + 2.0 * c2 + e2),
        alpha + w * (a3 + 2.0 * b3 + 2.0 * c3 + e3),
    )


@kernel
def roll_out_kernel(state0, s, phi, d, kinematics, max_step):
    """States at the arc lengths s; see `roll_out`."""
    l, l_t, offset = kinematics
    states = np.empty((s.size, 4))
    x, y, theta, alpha = state0[0], state0[1], state0[2], state0[3]
    states[0, 0], states[0, 1], states[0, 2], states[0, 3] = x, y, theta, alpha
    for k in range(1, s.size):
        length = s[k] - s[k - 1]
        steps = max(1, math.ceil(length / max_step - 1e-9))
        for i in range(steps):
            phi0 = phi[k - 1] + (phi[k] - phi[k - 1]) * (i / steps)
            phi1 = phi[k - 1] + (phi[k] - phi[k - 1]) * ((i + 1) / steps)
            x, y, theta, alpha = rk4(x, y, theta, alpha, phi0, phi1, length / steps, d, l, l_t, offset)
        states[k, 0], states[k, 1], states[k, 2], states[k, 3] = x, y, theta, alpha
    return states


def derivative(vehicle: Vehicle, states: Array, phi: Array, direction: Array | IntArray | int) -> Array:
    """dq/ds for states of shape (..., 4), steering and direction of shape (...). Shape (..., 4)."""
    l, l_t, offset = vehicle.kinematics
    theta, alpha = states[..., 2], states[..., 3]
    turn = np.tan(phi) / l
    fold = np.sin(alpha) / l_t + (1.0 + offset * np.cos(alpha) / l_t) * turn
    parts = np.broadcast_arrays(np.cos(theta), np.sin(theta), turn, -fold)
    return np.asarray(direction)[..., None] * np.stack(parts, axis=-1)


def jacobians(vehicle: Vehicle, states: Array, phi: Array, direction: Array | IntArray | int) -> tuple[Array, Array]:
    """Derivatives of `derivative`: A = d(dq/ds)/dq of shape (..., 4, 4) and B = d(dq/ds)/dphi of shape (..., 4)."""
    l, l_t, offset = vehicle.kinematics
    phi, d = np.broadcast_arrays(np.asarray(phi, float), np.asarray(direction, float))
    theta, alpha = states[..., 2], states[..., 3]
    turn, growth = np.tan(phi) / l, 1.0 / (l * np.cos(phi) ** 2)
    a = np.zeros((*np.broadcast_shapes(theta.shape, phi.shape), 4, 4))
    a[..., 0, 2] = -d * np.sin(theta)
    a[..., 1, 2] = d * np.cos(theta)
    a[..., 3, 3] = -d * (np.cos(alpha) - offset * np.sin(alpha) * turn) / l_t
    b = np.zeros(a.shape[:-1])
    b[..., 2] = d * growth
    b[..., 3] = -d * (1.0 + offset * np.cos(alpha) / l_t) * growth
    return a, b


def rk4_step(vehicle: Vehicle, state: Array, phi0: float, phi1: float, ds: float, direction: int) -> Array:
    """The state after ds [m] of travel, phi linear from phi0 to phi1; one step of order four. Shape (4,)."""
    x, y, theta, alpha = (float(value) for value in state)
    end = rk4(x, y, theta, alpha, float(phi0), float(phi1), float(ds), float(direction), *vehicle.kinematics)
    return np.array(end)


def rk4_step_jacobian(
    vehicle: Vehicle, states: Array, phi0: Array, phi1: Array, ds: Array, direction: Array | IntArray
) -> tuple[Array, Array]:
    """The step of `rk4_step` for N states at once, with its derivatives.

    Returns the next states, shape (N, 4), and their derivatives by (x, y, theta, alpha, phi0, phi1, ds),
    shape (N, 4, 7): the chain rule through the four stages.
    """
    states, phi0, phi1, ds = (np.asarray(value, float) for value in (states, phi0, phi1, ds))
    seed = np.zeros((len(states), 4, 7))
    seed[:, range(4), range(4)] = 1.0
    total, total_jacobian = np.zeros_like(states), np.zeros_like(seed)
    k, k_jacobian = np.zeros_like(states), np.zeros_like(seed)
    for fraction, weight in ((0.0, 1.0), (0.5, 2.0), (0.5, 2.0), (1.0, 1.0)):
        q = states + fraction * ds[:, None] * k
        q_jacobian = seed + fraction * ds[:, None, None] * k_jacobian
        q_jacobian[:, :, 6] += fraction * k
        phi = (1.0 - fraction) * phi0 + fraction * phi1
        k = derivative(vehicle, q, phi, direction)
        a, b = jacobians(vehicle, q, phi, direction)
        k_jacobian = a @ q_jacobian
        k_jacobian[:, :, 4] += (1.0 - fraction) * b
        k_jacobian[:, :, 5] += fraction * b
        total += weight * k
        total_jacobian += weight * k_jacobian
    jacobian = seed + ds[:, None, None] / 6.0 * total_jacobian
    jacobian[:, :, 6] += total / 6.0
    return states + ds[:, None] / 6.0 * total, jacobian


def roll_out(
    vehicle: Vehicle, state0: Array, s: Array, phi: Array, direction: int, max_step: float = LARGEST_STEP
) -> Array:
    """States at the arc lengths s (N,) [m] from state0 (4,), phi (N,) linear in between. Shape (N, 4).

    The steps of the integration are at most `max_step` [m]. Reverse driving amplifies an error in the hitch angle
    like exp(s / l_t): a long reverse roll-out of rounded steering angles does not end where the original did.
    """
    return roll_out_kernel(
        frozen(state0), frozen(s), frozen(phi), float(direction), vehicle.kinematics, float(max_step)
    )
