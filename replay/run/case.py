"""One recorded request, understood: a problem and its origin."""

import pathlib
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, Literal

import numpy as np
from numpy.typing import NDArray

from optim.model.problem import Problem
from optim.numerics.arrays import Array, Float64, Int8
from replay.base.numbers import count

HitchSource = Literal["trailer path", "joint", "transform", "reconstructed"]


@dataclass(frozen=True, eq=False, kw_only=True)
class MapImage:
    """An occupancy grid as it was recorded, for drawing."""

    cells: Int8[NDArray[np.int8], "H W"]
    """Shape (H, W), read-only: -1 unknown, 0 free ... 100 occupied. Row 0 is the bottom row."""
    resolution: float
    """Side of a cell [m]."""
    origin: tuple[float, float, float]
    """(x [m], y [m], yaw [rad]) of the lower-left corner of cell (0, 0)."""


@dataclass(frozen=True, kw_only=True)
class ReadReport:
    """Distance of the problem's recorded path from the logged one, and notes about the log."""

    poses: int
    """Poses in the path message, before repeated ones are merged."""
    hitch: HitchSource
    """Source of the hitch angle."""
    max_deviation_m: float
    """Largest distance between a pose of the log and the recorded path [m]."""
    max_deviation_rad: float
    """Largest difference in heading between a pose of the log and the recorded path [rad]."""
    rms_deviation_m: float = 0.0
    """Root mean square of these distances over all poses of the log [m]."""
    rms_deviation_rad: float = 0.0
    """The same of the headings [rad]."""
    goal_hitch_sigma: float = 0.0
    """Standard deviation of a reconstructed hitch angle at the last pose, from the poses' noise [rad]; else 0."""
    notes: tuple[str, ...] = ()
    """One line each: warnings about the log, then what is wrong with the recorded path."""
    lost: bool = False
    """Part of the log could not be read."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Case:
    """One recorded request of one log."""

    name: str
    """File stem and number of the request, such as ``bay_01/0``."""
    log: pathlib.Path
    sha256: str
    """Digest of the whole log file, in hexadecimal digits."""
    problem: Problem
    read: ReadReport
    map: MapImage | None
    """None where the map was recorded as shapes."""
    frame: str
    """Coordinate frame of the map and of every path."""
    time_ns: int = 0
    """Time at which the path was logged [ns]."""
    logged: Float64[Array, "n 3"] | None = None
    """Poses as the log holds them, noise and all: x, y [m], heading [rad] of the truck's rear axle, in `frame`; for
    drawing. Shape (n, 3), read-only. None where a case comes from a results file."""
    reading: Mapping[str, Any] | None = None
    """Options that the log was read with, as plain data: the fields of `replay.logs.ReadOptions`. None where
    unknown."""

    def __repr__(self) -> str:
        path, obstacles = self.problem.recorded, len(self.problem.scene.polygons)
        driven = f"{path.length:.2f} m, {count(path.num_cusps, 'gear change')}"
        return f"Case({self.name!r}: {driven}, {count(obstacles, 'convex obstacle')})"
