"""Flat map between the vehicle's states and the path of the trailer's axle (Esteban Cabezos 2020, section 2.1.3).

The flat output is the centre of the trailer's axle, (x_f, y_f), with the trailer's heading theta_f, its curvature
kappa = dtheta_f/ds_f and sharpness sigma = dkappa/ds_f along the signed arc length s_f of the trailer's heading.
It exists for a hitch over the rear axle only (M = 0).
"""

import numpy as np

from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array


def not_flat(vehicle: Vehicle) -> str:
    """Reason why a method that needs the flat map cannot work with a vehicle, for users; empty if it can."""
    if vehicle.hitch_offset == 0.0:
        return ""
    needed = "this method needs the hitch over the rear axle (hitch_offset 0)"
    return f"hitch_offset is {vehicle.hitch_offset:g} m; {needed}."


def require_flat(vehicle: Vehicle) -> None:
    """Raise ValueError for a hitch that is not over the rear axle."""
    if vehicle.hitch_offset != 0.0:
        raise ValueError(
            f"vehicle: hitch_offset is {vehicle.hitch_offset:g} m; the flat map, and with it the local planner, "
            "exists for 0 only (hitch over the rear axle)"
        )


def flat_from_state(vehicle: Vehicle, states: Array, phi: Array) -> Array:
    """Trailer axle (x_f, y_f, theta_f, kappa, sigma) of states (..., 4) and steering (...). Shape (..., 5)."""
    require_flat(vehicle)
    l, l_t, _ = vehicle.kinematics
    x, y, theta, alpha = np.moveaxis(np.asarray(states, float), -1, 0)
    heading = theta + alpha
    u = -np.tan(alpha)  # l_t kappa
    q = 1.0 + u * u
    sigma = (np.tan(phi) * np.sqrt(q) / l - u / l_t) * q / l_t
    return np.stack([x - l_t * np.cos(heading), y - l_t * np.sin(heading), heading, u / l_t, sigma], axis=-1)


def state_from_flat(vehicle: Vehicle, flat: Array) -> tuple[Array, Array]:
    """States (..., 4) and steering (...) of the flat states (..., 5); the inverse of `flat_from_state`."""
    require_flat(vehicle)
    l, l_t, _ = vehicle.kinematics
    x, y, heading, kappa, sigma = np.moveaxis(np.asarray(flat, float), -1, 0)
    u = l_t * kappa
    q = 1.0 + u * u
    fold = np.arctan(u)
    phi = np.arctan(l * (kappa + l_t * sigma / q) / np.sqrt(q))
    states = [x + l_t * np.cos(heading), y + l_t * np.sin(heading), heading + fold, -fold]
    return np.stack(states, axis=-1), phi
