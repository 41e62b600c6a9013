"""The problem that every method solves: vehicle, scene, recorded path, weights, margin."""

from dataclasses import dataclass, field
from functools import cached_property

from optim.model.clearance import clearance, swept_clearance
from optim.model.objective import Weights
from optim.model.path import Path
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64


@dataclass(frozen=True, eq=False, kw_only=True)
class Problem:
    """Improve `recorded` in `scene` for `vehicle`: same first state, same last state, less J with `weights`."""

    vehicle: Vehicle
    scene: Scene
    recorded: Path
    weights: Weights = field(default_factory=Weights)
    margin: float = 0.1
    """Clearance to keep from every obstacle [m]: swept clearance >= min(margin, the recorded path's own)."""
    nodes: Float64[Array, " K"] | None = None
    """Arc lengths of the recorded path [m] at which the planner's tree nodes lie. Shape (K,), or None if unknown."""
    start: Path | None = None
    """Start of a method if not the recorded path: an earlier result for this problem.

    It has the ends of the recorded path (the last heading up to full turns) and keeps the required clearance, which
    stays that of the recorded path."""

    def __repr__(self) -> str:
        return f"Problem(recorded {self.recorded!r}, {self.scene!r}, margin {self.margin:g} m)"

    @property
    def initial(self) -> Path:
        """The path that a method begins with, and returns where it finds nothing better."""
        return self.recorded if self.start is None else self.start

    @cached_property
    def recorded_clearance(self) -> float:
        """Smallest swept clearance of the recorded path [m], both bodies; negative where it overlaps."""
        return path_clearance(self.vehicle, self.scene, self.recorded)

    @cached_property
    def required_clearance(self) -> float:
        """Swept clearance that a result must have [m]: the margin, or less where the recorded path itself has less.

        A recorded path that collides on its way does not lower the requirement below what its ends allow.
        """
        if self.recorded_clearance >= 0.0:
            return min(self.margin, self.recorded_clearance)
        ends = [self.recorded.start, self.recorded.goal]
        return max(0.0, min(self.margin, *(float(clearance(self.scene, self.vehicle, q[None]).min()) for q in ends)))


def path_clearance(vehicle: Vehicle, scene: Scene, path: Path) -> float:
    """Smallest swept clearance of a path [m]: a proven lower bound, both bodies, between samples too."""
    values = [
        swept_clearance(scene, vehicle, segment.s, segment.states, segment.phi).min() for segment in path.segments
    ]
    return float(min(values))
