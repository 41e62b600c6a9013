"""Dimensions, limits and footprints of the truck with one trailer.

A body's pose is (x, y, heading): of the truck at the centre of its rear axle, of the trailer at the hitch.
"""

import math
from dataclasses import dataclass, fields
from functools import cached_property
from types import MappingProxyType
from typing import Any, Final

import numpy as np

from optim.numerics.arrays import Array, frozen

BEYOND_AXLES: Final = MappingProxyType(
    {"truck_front": ("wheelbase", "rear axle"), "trailer_rear": ("hitch_to_axle", "hitch")}
)
"""Extents that reach an axle, or nearly: the field with the axle's distance, and where both are measured from."""
_LONGEST = 100.0  # [m]: no road vehicle's part is longer; catches millimetres
_MOST_STEERING = 36.0  # [rad] over one wheelbase: 1 rad/s of a truck that creeps at 0.1 m/s; catches degrees per metre
_WHEEL = 0.5  # [m]: a body may end by a wheel's radius before its axle
_EXTENT = (0.0, _LONGEST)  # [m]: range of the fields that _RANGES does not name
_RANGES: Final = MappingProxyType(
    {
        "max_steer": (0.01, 1.5),
        "max_hitch": (0.01, 1.57),
        "max_steer_rate": (1e-3, 1e3),
        "hitch_offset": (-5.0, 5.0),
        "wheelbase": (0.05, _LONGEST),
        "hitch_to_axle": (0.05, _LONGEST),
        "truck_width": (0.05, 20.0),
        "trailer_width": (0.05, 20.0),
    }
)  # smallest and largest value


@dataclass(frozen=True, kw_only=True)
class Vehicle:
    """Dimensions and limits in SI units; the defaults are a European semi-trailer combination.

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
            object.__setattr__(self, field.name, _checked(field.name, getattr(self, field.name)))
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
    def motion_limits(self) -> tuple[float, float, float, float, float]:
        """(l, l_t, M, max_steer, max_steer_rate), which bound the motion between samples, as the kernels take them."""
        return (*self.kinematics, self.max_steer, self.max_steer_rate)

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


def _checked(name: str, value: Any) -> float:
    """The value of a field as a float. Raises ValueError for a value that is not a number or out of range."""
    low, high = _RANGES.get(name, _EXTENT)
    is_number = isinstance(value, (int, float)) and not isinstance(value, bool)
    if not is_number or not low <= value <= high:
        text = f"{name} is {value!r}, expected a number from {low:g} to {high:g}"
        raise ValueError(f"vehicle: {text}{_guessed_unit(name, value) if is_number else ''}")
    return float(value)


def _guessed_unit(name: str, value: float) -> str:
    """The unit of a value out of range, and what may have gone wrong."""
    low, high = _RANGES.get(name, _EXTENT)
    if name in ("max_steer", "max_hitch"):
        return " rad; is it in degrees?" if high < value <= 90.0 else " rad"
    if name == "max_steer_rate":
        return " rad/m"
    return " m; is it in millimetres?" if low <= value / 1000.0 <= high < value else " m"


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
