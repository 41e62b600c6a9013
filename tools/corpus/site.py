"""What a yard of the corpus is made of: obstacles, the request, and how its log holds them.

Everything is given in the site's own frame, x along the aisle and y away from the dock, and placed in the map
by the site's pose, so that one and the same kind of yard can lie straight or slanted in the map.
"""

import math
from dataclasses import dataclass, field
from typing import Literal

import numpy as np

from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array
from optim.planning.protocol import Area, Pose, place
from optim.steering.flat import Flat


@dataclass(frozen=True, kw_only=True)
class Box:
    """An upright box: a parked trailer, a container, a wall. A CUBE marker in shape maps."""

    x: float
    y: float
    """Centre [m]."""
    length: float
    """Extent along its own heading [m]."""
    width: float
    yaw: float = 0.0
    height: float = 4.0
    bottom: float = 0.0
    """Height of its underside above the ground [m]: what is above the vehicle is no obstacle."""
    kind: str = "obstacle"

    def parts(self) -> list[Array]:
        """Its convex footprint, counter-clockwise, in one list; none where the vehicle passes below it."""
        if self.bottom > OVERHEAD:
            return []
        a, b = self.length / 2.0, self.width / 2.0
        return [place(np.array([[-a, -b], [a, -b], [a, b], [-a, b]]), (self.x, self.y, self.yaw))]


@dataclass(frozen=True, kw_only=True)
class Wall:
    """A fence or a kerb along a line. A LINE_STRIP marker in shape maps."""

    points: tuple[tuple[float, float], ...]
    width: float = 0.2
    kind: str = "fence"

    def parts(self) -> list[Array]:
        """A rectangle for each stretch, longer by half the width at both ends, so that corners are closed."""
        rectangles = []
        for (x0, y0), (x1, y1) in zip(self.points, self.points[1:], strict=False):
            length, yaw = math.hypot(x1 - x0, y1 - y0) + self.width, math.atan2(y1 - y0, x1 - x0)
            middle = Box(x=(x0 + x1) / 2, y=(y0 + y1) / 2, length=length, width=self.width, yaw=yaw)
            rectangles += middle.parts()
        return rectangles


@dataclass(frozen=True, kw_only=True)
class Block:
    """A convex polygon, counter-clockwise: a building with cut corners. A TRIANGLE_LIST marker in shape maps."""

    points: tuple[tuple[float, float], ...]
    kind: str = "building"

    def parts(self) -> list[Array]:
        """The polygon itself."""
        return [np.array(self.points)]


Obstacle = Box | Wall | Block

OVERHEAD = 4.2
"""What hangs wholly above this height [m] is no obstacle."""


@dataclass(frozen=True, kw_only=True)
class Shapes:
    """The log holds the obstacles as markers."""

    removed: tuple[Box, ...] = ()
    """Drawn by a first message and deleted by a second one, before the path: not there any more."""


@dataclass(frozen=True, kw_only=True)
class Grid:
    """The log holds the obstacles as an occupancy grid."""

    resolution: float = 0.2
    """Size of a cell [m]."""
    yaw: float = 0.0
    """Heading of the grid's x axis in the map [rad]."""
    speckles: int = 0
    """Number of single occupied cells that no obstacle explains, as a range finder leaves them."""
    unknown: tuple[Box, ...] = ()
    """Areas that were never seen."""
    solid: bool = True
    """False: only the faces of obstacles are occupied and what is behind them is unknown."""


@dataclass(frozen=True, kw_only=True)
class Site:
    """One log of the corpus before it is planned: the yard, the request, and the form of the log."""

    name: str
    title: str
    """What there is to see, for the table of logs."""
    special: str
    """What the log holds that others do not."""
    obstacles: tuple[Obstacle, ...]
    bounds: tuple[float, float, float, float]
    """The ground of the site: smallest x and y, largest x and y [m]. The planner does not leave it."""
    start: Flat
    """Trailer axle at the start, site frame."""
    goal: Flat
    """Trailer axle at the goal, site frame."""
    areas: tuple[Area, ...]
    map: Shapes | Grid
    vehicle: Vehicle = field(default_factory=Vehicle)
    pose: Pose = (0.0, 0.0, 0.0)
    """Pose of the site's frame in the map."""
    has_trailer_path: bool = True
    has_path_nodes: bool = True
    has_stamps: bool = False
    """Poses carry a stamp each; else that of the message."""
    spacing: float = 0.25
    """Poses of the logged path are at most this far apart [m]."""
    pose_noise: float = 0.0
    """Standard deviation of what is added to the logged positions [m]; headings get 0.26 rad/m of it."""
    compression: Literal["zstd", "lz4", "none"] = "zstd"
    """Of the file's chunks."""
    is_chunked: bool = True
    cusps: tuple[int, int] = (1, 5)
    """Smallest and largest number of gear changes that the recorded path may have."""
    length: tuple[float, float] = (40.0, 150.0)
    """Smallest and largest length that the recorded path may have [m]."""
    clearance: float = 0.2
    """What the planner keeps from obstacles [m]."""
    seed: int = 0
    """First seed of the planner; those that follow are tried where it finds no path within the ranges above."""
    noise: int = 0
    """Seed of the map's noise, and the hour at which the log was made."""
    planner: str = "RRT"
    """Name of the planner that makes the path: one of `tools.corpus.build.PLANNERS`."""
    source: str = ""
    """Where the scene is described, if elsewhere, and what was changed."""
    licence: str = ""
    """Of that description, an SPDX identifier."""


def footprints(site: Site) -> list[Array]:
    """Convex footprints of all obstacles in the map frame."""
    return [place(part, site.pose) for obstacle in site.obstacles for part in obstacle.parts()]


def ground(site: Site) -> Array:
    """Corners of the site's ground in the map frame, counter-clockwise. Shape (4, 2)."""
    x0, y0, x1, y1 = site.bounds
    return place(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]), site.pose)


TRAILER_LENGTH, TRAILER_WIDTH = 13.6, 2.55  # of parked trailers [m]


def parked_trailer(x: float, y: float, yaw: float = 0.0) -> Box:
    """A parked semi-trailer with the middle of its rear at (x, y)."""
    half = TRAILER_LENGTH / 2
    x, y = x + half * math.cos(yaw), y + half * math.sin(yaw)
    return Box(x=x, y=y, length=TRAILER_LENGTH, width=TRAILER_WIDTH, yaw=yaw, kind="trailer")


def parked_combination(x: float, y: float, yaw: float = 0.0) -> tuple[Box, Box]:
    """A parked trailer with its truck, the middle of the trailer's rear at (x, y)."""
    truck = Box(x=x + 14.0 * math.cos(yaw), y=y + 14.0 * math.sin(yaw), length=6.0, width=2.5, yaw=yaw, kind="truck")
    return parked_trailer(x, y, yaw), truck


def backed_up(x: float, y: float, yaw: float, vehicle: Vehicle) -> Flat:
    """The state of a straight combination whose trailer has the middle of its rear at (x, y)."""
    overhang = vehicle.trailer_rear - vehicle.hitch_to_axle
    return Flat(x + overhang * math.cos(yaw), y + overhang * math.sin(yaw), yaw, 0.0)
