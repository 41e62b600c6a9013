"""What messages of any family are decoded to: plain arrays, as sent, nothing checked but lengths."""

from dataclasses import dataclass
from typing import Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optim.numerics.arrays import Array

Role = Literal["grid", "markers", "polygon", "path", "stream", "joints", "transforms"]
"""What a message is read as: three kinds of map, a path, one pose of a stream that makes a path, joint angles,
transforms between frames."""
MAP_ROLES: tuple[Role, ...] = ("grid", "markers", "polygon")
PATH_ROLES: tuple[Role, ...] = ("path", "stream")


class PayloadError(ValueError):
    """A payload that does not fit its type's layout; the text names the field."""


class Header(NamedTuple):
    """When and in which frame."""

    stamp: int
    """[ns]"""
    frame: str


@dataclass(frozen=True, eq=False, kw_only=True)
class Grid:
    """An occupancy grid."""

    header: Header
    resolution: float
    width: int
    height: int
    origin: Array
    """Position x, y, z [m] and quaternion x, y, z, w. Shape (7,)."""
    data: NDArray[np.int8]
    """-1 unknown, 0 free to 100 occupied, row by row from the origin. Shape (n,); n need not be width x height."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PoseSeries:
    """A path of n poses."""

    header: Header
    stamps: NDArray[np.int64]
    """[ns], shape (n,)."""
    poses: Array
    """Position x, y, z [m] and quaternion x, y, z, w. Shape (n, 7)."""
    frames: frozenset[str]
    """Every frame that a pose names."""
    speed: Array | None = None
    """Speed along the heading, negative in reverse [m/s], where the type has one. Shape (n,)."""
    steer: Array | None = None
    """Angle of the front wheel [rad], where the type has one. Shape (n,)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Marker:
    """A shape to draw, without colours, textures and meshes."""

    header: Header
    ns: str
    id: int
    type: int
    action: int
    pose: Array
    """Position x, y, z [m] and quaternion x, y, z, w. Shape (7,)."""
    scale: Array
    """[m], shape (3,)."""
    points: Array
    """[m], in the marker's own frame. Shape (n, 3)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Ring:
    """One polygon, closed from its last point to its first."""

    header: Header | None
    """None for types that have none."""
    points: Array
    """[m], shape (n, 3)."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Joints:
    """Positions of joints at one moment."""

    stamp: int
    """[ns]"""
    names: tuple[str, ...]
    positions: Array
    """[rad] for those that turn. Shape (n,); n need not be the number of names."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Transform:
    """The pose of one frame in another."""

    header: Header
    """Its frame is the one in which the pose is given."""
    child: str
    pose: Array
    """Position x, y, z [m] and quaternion x, y, z, w. Shape (7,)."""
