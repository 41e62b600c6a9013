"""The truck with one trailer: dimensions, limits, kinematics in arc length, flat map, footprints.

Notation (Esteban Cabezos 2020, sections 2.1.1-2.1.3, signs corrected):

    state   q = (x, y, theta, alpha)   centre of the truck's rear axle [m], truck heading [rad],
                                       hitch angle = trailer heading - truck heading [rad]
    control phi                        steering angle of the single-track front wheel [rad]
    s                                  arc length travelled by the rear axle [m], never decreasing
    d                                  direction, +1 forward, -1 reverse

    dx/ds = d cos(theta)        dtheta/ds = d tan(phi) / l
    dy/ds = d sin(theta)        dalpha/ds = -d (sin(alpha) / l_t + (1 + M cos(alpha) / l_t) tan(phi) / l)

with the wheelbase l, the distance l_t from the hitch to the trailer's axle, and the distance M of the hitch
behind the rear axle (0 for a fifth wheel over the axle, the only case that is differentially flat).

The flat output is the centre of the trailer's axle, (x_f, y_f), with the trailer's heading theta_f, its curvature
kappa = dtheta_f/ds_f and sharpness sigma = dkappa/ds_f along the signed arc length s_f of the trailer's heading.
"""

import math
from dataclasses import dataclass, fields
from functools import cached_property

import numpy as np

from optim.numerics.arrays import Array, IntArray, frozen
from optim.numerics.kernel import kernel

LARGEST_STEP = 0.05
"""Of the integration in roll-outs, if nothing else is said [m]."""
_UPPER_LIMIT = 100.0  # [m]: no road vehicle's part is longer; catches millimetres
_MOST_STEERING = 36.0  # [rad] over one wheelbase: 1 rad/s of a truck that creeps at 0.1 m/s; catches degrees per metre
_WHEEL = 0.5  # [m]: a body may end by a wheel's radius before its axle
BEYOND_AXLES = {"truck_front": ("wheelbase", "rear axle"), "trailer_rear": ("hitch_to_axle", "hitch")}
"""Extents of the bodies that reach an axle, or nearly: which distance of the axle, and from where both are measured."""


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """Dimensions and limits, SI units. The defaults are a European semi-trailer combination.

    Extents are measured along each body's own axis: the truck's from its rear axle, the trailer's from the hitch.
    """

    wheelbase: float = 3.6
    """Distance from the truck's rear axle to its front axle, l [m]."""
    truck_front: float = 5.0
    """Extent of the truck ahead of its rear axle [m]; the wheelbase or more."""
    truck_rear: float = 1.0
    """Extent of the truck behind its rear axle [m]."""
    truck_width: float = 2.55
    """Width of the truck [m]."""
    hitch_to_axle: float = 8.0
    """Distance from the hitch to the trailer's axle, l_t [m]."""
    trailer_front: float = 1.6
    """Extent of the trailer ahead of the hitch [m]."""
    trailer_rear: float = 12.0
    """Extent of the trailer behind the hitch [m]; hitch_to_axle or more."""
    trailer_width: float = 2.55
    """Width of the trailer [m]."""
    max_steer: float = 0.55
    """Largest steering angle, |phi| <= max_steer [rad]."""
    max_hitch: float = 1.0
    """Largest hitch angle, |alpha| <= max_hitch [rad]; below pi/2, and small enough to keep the bodies apart."""
    max_steer_rate: float = 0.5
    """Largest change of steering per metre of the truck's path, |dphi/ds| <= max_steer_rate [rad/m]."""
    hitch_offset: float = 0.0
    """Distance of the hitch behind the rear axle, M [m]; the flat map needs 0."""

    def __post_init__(self) -> None:
        for field in fields(self):
            value = getattr(self, field.name)
            low, high = _range_of(field.name)
            is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
            if not is_number or not low <= value <= high:
                text = f"{field.name} is {value!r}, expected a number from {low:g} to {high:g}"
                raise ValueError(f"vehicle: {text}{_guessed_unit(field.name, value) if is_number else ''}")
            object.__setattr__(self, field.name, float(value))
        for extent, (axle, origin) in BEYOND_AXLES.items():
            found, least = getattr(self, extent), getattr(self, axle)
            if found < least - _WHEEL:
                text = (
                    f"{extent} is {found!r}, expected {axle}, {least!r}, or more: both are measured from the {origin}"
                )
                raise ValueError(f"vehicle: {text}")
        most = _MOST_STEERING / self.wheelbase
        if self.max_steer_rate > most:
            text = f"max_steer_rate is {self.max_steer_rate!r} rad/m, expected at most {most:.3g} with that wheelbase"
            raise ValueError(f"vehicle: {text}; is it in degrees?")

    @property
    def kinematics(self) -> tuple[float, float, float]:
        """(l, l_t, M) [m], as the kernels take them."""
        return self.wheelbase, self.hitch_to_axle, self.hitch_offset

    @property
    def max_kappa(self) -> float:
        """Largest curvature of the trailer's path, tan(max_hitch) / l_t [1/m]."""
        return math.tan(self.max_hitch) / self.hitch_to_axle

    @cached_property
    def footprints(self) -> Array:
        """Rows truck, trailer: extent ahead of and behind the reference point, half width [m]. Shape (2, 3)."""
        return frozen(
            [
                [self.truck_front, self.truck_rear, self.truck_width / 2],
                [self.trailer_front, self.trailer_rear, self.trailer_width / 2],
            ]
        )

    @cached_property
    def outlines(self) -> Array:
        """Corners in each body's own frame: rear right, front right, front left, rear left. Shape (2, 4, 2)."""
        front, rear, half = self.footprints.T
        along = np.stack([-rear, front, front, -rear], axis=1)
        across = np.stack([-half, -half, half, half], axis=1)
        return frozen(np.stack([along, across], axis=2))


def _guessed_unit(name: str, value: float) -> str:
    """What may have gone wrong with a value that is too large; empty where nothing comes to mind."""
    low, high = _range_of(name)
    if name in ("max_steer", "max_hitch"):
        return " rad; is it in degrees?" if high < value <= 90.0 else " rad"
    if name == "max_steer_rate":
        return " rad/m"
    return " m; is it in millimetres?" if low <= value / 1000.0 <= high < value else " m"


def _range_of(name: str) -> tuple[float, float]:
    """The values that a field of Vehicle may take, inclusive."""
    ranges = {
        "max_steer": (0.01, 1.5),
        "max_hitch": (0.01, 1.57),
        "max_steer_rate": (1e-3, 1e3),
        "hitch_offset": (-5.0, 5.0),
        "wheelbase": (0.05, _UPPER_LIMIT),
        "hitch_to_axle": (0.05, _UPPER_LIMIT),
        "truck_width": (0.05, 20.0),
        "trailer_width": (0.05, 20.0),
    }
    return ranges.get(name, (0.0, _UPPER_LIMIT))


@kernel
def slope(theta, alpha, phi, d, l, l_t, offset):
    """dq/ds as four numbers: the kinematics as kernels drive them (`derivative` is the same for arrays)."""
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
    """States at the arc lengths s [m] from state0, phi linear between samples, steps of at most max_step [m].

    Reverse driving amplifies an error in the hitch angle like exp(s / l_t): do not expect a long reverse
    roll-out of rounded steering angles to end where the original did. Shape (N, 4).
    """
    return roll_out_kernel(
        frozen(state0), frozen(s), frozen(phi), float(direction), vehicle.kinematics, float(max_step)
    )


def not_flat(vehicle: Vehicle) -> str:
    """Why there are no flat map and no local planner for a vehicle, in a sentence for users; empty if there are."""
    if vehicle.hitch_offset == 0.0:
        return ""
    needed = "this method needs the hitch over the rear axle (hitch_offset 0)"
    return f"hitch_offset is {vehicle.hitch_offset:g} m; {needed}."


def _require_flat(vehicle: Vehicle) -> None:
    if vehicle.hitch_offset != 0.0:
        raise ValueError(
            f"vehicle: hitch_offset is {vehicle.hitch_offset:g} m; the flat map, and with it the local planner, "
            "exists for 0 only (hitch over the rear axle)"
        )


def flat_from_state(vehicle: Vehicle, states: Array, phi: Array) -> Array:
    """Trailer axle (x_f, y_f, theta_f, kappa, sigma) of states (..., 4) and steering (...). Shape (..., 5)."""
    _require_flat(vehicle)
    l, l_t, _ = vehicle.kinematics
    x, y, theta, alpha = np.moveaxis(np.asarray(states, float), -1, 0)
    heading = theta + alpha
    u = -np.tan(alpha)  # l_t kappa
    q = 1.0 + u * u
    sigma = (np.tan(phi) * np.sqrt(q) / l - u / l_t) * q / l_t
    return np.stack([x - l_t * np.cos(heading), y - l_t * np.sin(heading), heading, u / l_t, sigma], axis=-1)


def state_from_flat(vehicle: Vehicle, flat: Array) -> tuple[Array, Array]:
    """States (..., 4) and steering (...) of the flat states (..., 5); the inverse of `flat_from_state`."""
    _require_flat(vehicle)
    l, l_t, _ = vehicle.kinematics
    x, y, heading, kappa, sigma = np.moveaxis(np.asarray(flat, float), -1, 0)
    u = l_t * kappa
    q = 1.0 + u * u
    fold = np.arctan(u)
    phi = np.arctan(l * (kappa + l_t * sigma / q) / np.sqrt(q))
    states = [x + l_t * np.cos(heading), y + l_t * np.sin(heading), heading + fold, -fold]
    return np.stack(states, axis=-1), phi


def body_poses(vehicle: Vehicle, states: Array) -> Array:
    """(x, y, heading) of truck (rear axle) and trailer (hitch) for states (N, 4). Shape (N, 2, 3)."""
    x, y, theta, alpha = np.asarray(states, float).T
    offset = vehicle.hitch_offset
    truck = np.stack([x, y, theta], axis=1)
    trailer = np.stack([x - offset * np.cos(theta), y - offset * np.sin(theta), theta + alpha], axis=1)
    return np.stack([truck, trailer], axis=1)


def body_corners(vehicle: Vehicle, states: Array) -> Array:
    """Corners of truck and trailer, counter-clockwise from the rear right, for states (N, 4). Shape (N, 2, 4, 2)."""
    pose = body_poses(vehicle, states)
    c, s = np.cos(pose[..., 2])[..., None], np.sin(pose[..., 2])[..., None]
    along, across = vehicle.outlines[..., 0], vehicle.outlines[..., 1]
    x = pose[..., 0, None] + c * along - s * across
    y = pose[..., 1, None] + s * along + c * across
    return np.stack([x, y], axis=-1)
