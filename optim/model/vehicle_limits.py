"""The vehicle's limits on steering angle, hitch angle and steering rate: how much of them a motion uses."""

from typing import NamedTuple

import numpy as np

from optim.model.path import Path, Segment
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64


class LimitedQuantity(NamedTuple):
    """A quantity with its limit. N samples, or intervals."""

    name: str
    values: Float64[Array, " N"]
    """Magnitudes [unit]. Shape (N,)."""
    limit: float
    """Largest magnitude allowed [unit]."""
    unit: str

    def keeps(self, slack: float = 0.0) -> bool:
        """Whether no value exceeds the limit by more than `slack`, a share of it [-]."""
        return bool(self.values.max() <= self.limit * (1.0 + slack))


def limited_quantities(
    vehicle: Vehicle, phi: Array, alpha: Array, rate: Array
) -> tuple[LimitedQuantity, LimitedQuantity, LimitedQuantity]:
    """Steering angle (N,) [rad], hitch angle (N,) [rad] and steering rate (M,) [rad/m], each with its limit."""
    return (
        LimitedQuantity("steering angle", np.abs(phi), vehicle.max_steer, "rad"),
        LimitedQuantity("hitch angle", np.abs(alpha), vehicle.max_hitch, "rad"),
        LimitedQuantity("steering rate", np.abs(rate), vehicle.max_steer_rate, "rad/m"),
    )


def steering_rates(segment: Segment) -> Array:
    """dphi/ds between neighbouring samples [rad/m]. Shape (n - 1,)."""
    return np.diff(segment.phi) / np.diff(segment.s)


def within_limits(vehicle: Vehicle, path: Path, slack: float) -> bool:
    """Whether a path keeps the vehicle's limits; `slack` is relative, such as 1e-3."""
    rates = np.concatenate([steering_rates(segment) for segment in path.segments])
    quantities = limited_quantities(vehicle, path.samples.phi, path.samples.states[:, 3], rates)
    return all(quantity.keeps(slack) for quantity in quantities)
