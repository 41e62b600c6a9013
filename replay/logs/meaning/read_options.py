"""Options of the reader, where a log leaves a choice."""

from dataclasses import dataclass
from typing import Literal

from optim.model.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True)
class ReadOptions:
    """Choices of the reader. Raises ValueError for a value out of range."""

    map_topic: str | None = None
    """Topic of the map; required where several topics hold one."""
    path_topic: str | None = None
    """Topic of the truck's path; required where the log leaves it open."""
    trailer_topic: str | None = None
    """Topic of the trailer axle's path; required where the log leaves it open."""
    case: int | None = None
    """Number of the one request that is read, counted from 0; all of them by default."""
    vehicle: Vehicle | None = None
    """Instead of the one in the log."""
    occupied_from: int = 65
    """Cells of an occupancy grid from this value up are obstacles, 1 to 100 [%]."""
    unknown: Literal["obstacle", "free"] = "obstacle"
    """Meaning of unknown cells, and of the world outside an occupancy grid."""
    height: float = 4.2
    """Markers wholly above this height are ignored [m]."""
    hitch_joint: str | None = None
    """Joint whose angle [rad] is the hitch's, trailer's heading minus truck's; by default the one whose name says
    so."""
    trailer_frame: str | None = None
    """Frame of the trailer in the log's transforms; by default the one whose name says so."""
    initial_hitch: float = 0.0
    """Hitch angle at the first pose, where the log does not give it [rad]: the trailer's heading minus the truck's,
    positive where the trailer is turned counter-clockwise from the truck, seen from above."""
    reference: Literal["rear-axle", "centre", "front-axle"] = "rear-axle"
    """Point of the truck that the poses of its path are of; centre: of its outline, (truck_front - truck_rear) / 2
    ahead of the rear axle."""
    reference_offset: float = 0.0
    """Distance of the poses ahead of that point [m]."""
    start_direction: Literal[1, -1] = 1
    """Gear of the first metre, where the log has no headings: 1 forward, -1 reverse."""
    margin: float = 0.1
    """Clearance that results must keep from obstacles [m], where the recorded path has it."""

    def __post_init__(self) -> None:
        if not 1 <= self.occupied_from <= 100:
            raise ValueError(f"occupied_from is {self.occupied_from}, expected 1 to 100 percent")
        if not abs(self.initial_hitch) < 1.57:
            raise ValueError(f"initial_hitch is {self.initial_hitch} rad, expected less than 1.57 in size")
        if not 0.0 <= self.margin <= 10.0:
            raise ValueError(f"margin is {self.margin} m, expected 0 to 10")
        if not 0.0 < self.height < 1e6:
            raise ValueError(f"height is {self.height} m, expected a positive number")
        if self.case is not None and self.case < 0:
            raise ValueError(f"case is {self.case}, expected 0 or more")
        if self.unknown not in ("obstacle", "free"):
            raise ValueError(f"unknown is {self.unknown!r}, expected 'obstacle' or 'free'")
        if self.reference not in ("rear-axle", "centre", "front-axle"):
            raise ValueError(f"reference is {self.reference!r}, expected 'rear-axle', 'centre' or 'front-axle'")
        if not abs(self.reference_offset) <= 30.0:
            raise ValueError(f"reference_offset is {self.reference_offset} m, expected at most 30 in size")
        if self.start_direction not in (1, -1):
            raise ValueError(f"start_direction is {self.start_direction!r}, expected 1 or -1")
