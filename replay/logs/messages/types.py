"""Message types, and the values that messages are decoded to: plain arrays, as sent, only lengths checked."""

from collections.abc import Callable
from dataclasses import dataclass
from typing import Any, ClassVar, Final, Literal, NamedTuple

import numpy as np
from numpy.typing import NDArray

from optim.numerics.arrays import Array

Role = Literal["grid", "markers", "polygon", "path", "stream", "joints", "transforms"]
"""Use of a message: three kinds of map, a path, one pose of a stream that makes a path, joint angles, transforms."""
MAP_ROLES: tuple[Role, ...] = ("grid", "markers", "polygon")
PATH_ROLES: tuple[Role, ...] = ("path", "stream")


class PayloadError(ValueError):
    """A payload that does not fit its message definition; the text names the field where it can."""


class DefinitionError(ValueError):
    """A message definition that cannot be read, or that is not the standard one."""


Decode = Callable[[bytes], Any]
"""Decodes one message to what its role asks for: `Grid`, `PoseSeries`, or a tuple of `Marker`, `Ring`, `Joints` or
`Transform`. Raises PayloadError."""


@dataclass(frozen=True, kw_only=True)
class MessageType:
    """A message type that is understood."""

    name: str
    role: Role
    """Use of its messages."""

    encodings: ClassVar[tuple[tuple[str, str], ...]]
    """Pairs of message encoding and encoding of the message definition that are read."""

    def decoder(self, encodings: tuple[str, str], definition: bytes) -> Decode:
        """The decoder for the messages of a channel.

        encodings: one of `encodings`. definition: the message definition that the channel's schema holds.

        Raises:
            DefinitionError: it cannot be read, or is not the standard one.
        """
        raise NotImplementedError


class Header(NamedTuple):
    """Time and frame of a message."""

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
    """Frames named by the poses."""
    speed: Array | None = None
    """Speed along the heading, negative in reverse [m/s], where the type has one. Shape (n,)."""
    steer: Array | None = None
    """Angle of the front wheel [rad], where the type has one. Shape (n,)."""


CUBE: Final = 1
SPHERE: Final = 2
CYLINDER: Final = 3
LINE_STRIP: Final = 4
LINE_LIST: Final = 5
CUBE_LIST: Final = 6
ARROW: Final = 0
TEXT: Final = 9
MESH: Final = 10
TRIANGLE_LIST: Final = 11
"""Values of `Marker.type`, as `visualization_msgs/msg/Marker` numbers them."""
ADD: Final = 0
DELETE: Final = 2
DELETE_ALL: Final = 3
FORGET: Final = 100
"""Values of `Marker.action`. `FORGET` is in no ROS message: delete what is not newer than the marker's stamp, in its
namespace, or in all of them where that is empty."""


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
