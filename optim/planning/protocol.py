"""Input and output of every planner, so that one can replace another.

A planner is a frozen dataclass of options with one verb, `plan`. It knows no clock: whoever calls it says with
`give_up` when the search is to end.
"""

import itertools
import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Protocol

import numpy as np

from optim.model.clearance import first_violation
from optim.model.path import Path, Segment, merge, segment_from_states
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64, frozen
from optim.steering.connect import Connection, connections
from optim.steering.flat import Flat

CONNECTION_SPACING = 0.05
"""Distance between samples of exact connections [m]: phi is linear in between, and the audit integrates that."""
_CHECK_SPACING = 0.2  # [m]: distance between the samples between which a connection is checked

Pose = tuple[float, float, float]
"""x [m], y [m], yaw [rad] of one frame in another."""
GiveUp = Callable[[], bool]
"""Whether the search is to end; planners ask between two samples or expansions."""


def never() -> bool:
    """Search as long as the planner's own bound on effort allows."""
    return False


@dataclass(frozen=True, kw_only=True)
class Area:
    """A rectangle in which planners sample positions of the trailer's axle, and an interval of headings."""

    box: tuple[float, float, float, float]
    """Smallest x and y, largest x and y [m]."""
    heading: float = 0.0
    """Middle of the headings [rad]."""
    spread: float = math.pi
    """Largest distance of a heading from the middle [rad]."""
    weight: float = 1.0
    """Share of the samples, relative to the other areas [-]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class PlanningProblem:
    """Drive from start to goal within the vehicle's limits and clear of the scene."""

    vehicle: Vehicle
    scene: Scene
    start: Flat
    """The trailer's axle at the start, map frame."""
    goal: Flat
    """The trailer's axle at the goal, map frame."""
    areas: Sequence[Area]
    """Areas to sample in, in the frame whose pose in the map is `pose`."""
    pose: Pose = (0.0, 0.0, 0.0)
    """Pose in the map of the frame that the areas are given in."""
    margin: float = 0.2
    """Clearance to keep from every obstacle, between samples too [m]."""

    @cached_property
    def shares(self) -> Array:
        """Share of the samples of each area [-]. Shape (number of areas,)."""
        weights = np.array([area.weight for area in self.areas])
        return weights / weights.sum()


@dataclass(frozen=True, eq=False, kw_only=True)
class PlannedPath:
    """A path that a planner found, and how."""

    path: Path
    """Drivable, within the vehicle's limits and clear; samples at most 0.1 m apart."""
    nodes: Float64[Array, " K"]
    """Arc lengths at which the planner's nodes lie, both ends included [m]. Shape (K,)."""
    effort: int
    """Iterations of a random tree, expanded nodes of a graph search."""


class Planner(Protocol):
    """A search for a path; its options are its fields."""

    @property
    def name(self) -> str:
        """Name in tables and lists."""
        ...

    def plan(self, problem: PlanningProblem, seed: int, give_up: GiveUp = never) -> PlannedPath | None:
        """A path, or None where none is found within the planner's own bound on effort, or before `give_up()`.

        Where `give_up` stays False, the same problem and seed give the same path.
        """
        ...


def random_pose(problem: PlanningProblem, rng: np.random.Generator) -> Flat:
    """A random position and heading in one of the areas, with a straight hitch, map frame."""
    area = problem.areas[rng.choice(len(problem.areas), p=problem.shares)]
    x0, y0, x1, y1 = area.box
    turn = rng.uniform(-area.spread, area.spread)
    x, y = rng.uniform(x0, x1), rng.uniform(y0, y1)
    return place_flat(Flat(x, y, area.heading + turn, 0.0), problem.pose)


def assemble(pieces: Sequence[Segment], effort: int) -> PlannedPath:
    """The path of pieces that follow each other up to rounding and full turns of the heading.

    Each piece takes its first state from the end of the one before, so that joints are shared exactly.
    """
    joined: list[Segment] = []
    for piece in pieces:
        states = piece.states.copy()
        if joined:
            last = joined[-1].states[-1]
            states[:, 2] += 2.0 * math.pi * round((last[2] - states[0, 2]) / (2.0 * math.pi))
            states[0] = last
        joined.append(segment_from_states(piece.direction, piece.s, states, piece.phi))
    nodes = [0.0, *itertools.accumulate(piece.length for piece in pieces)]
    return PlannedPath(path=merge(joined), nodes=frozen(nodes), effort=effort)


def clear_connection(problem: PlanningProblem, start: Flat, end: Flat, gear: int, longest: float) -> Connection | None:
    """The shorter of the two shortest exact connections, of at most `longest` [m], that is clear of obstacles."""
    for edge in connections(problem.vehicle, start, end, gear, longest)[:2]:
        s, states, phi = edge.sample(_CHECK_SPACING)
        if first_violation(problem.scene, problem.vehicle, s, states, problem.margin, phi) < 0:
            return edge
    return None


def extent(problem: PlanningProblem, beyond: float) -> tuple[float, float, float, float]:
    """Smallest x and y, largest x and y of the map, or of start, goal and obstacles with room `beyond` [m]."""
    boundary = problem.scene.boundary
    if boundary is not None:
        points = boundary
    else:
        ends = np.array([problem.start[:2], problem.goal[:2]])
        points = np.concatenate([ends - beyond, ends + beyond, *problem.scene.polygons])
    (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return x0, y0, x1, y1


def place(points: Array, pose: Pose) -> Array:
    """Points of a frame in the frame in which its pose is given [m]. Shapes (n, 2)."""
    x, y, yaw = pose
    c, s = math.cos(yaw), math.sin(yaw)
    return np.stack([x + c * points[:, 0] - s * points[:, 1], y + s * points[:, 0] + c * points[:, 1]], axis=1)


def place_flat(flat: Flat, pose: Pose) -> Flat:
    """A flat state of a frame in the frame in which its pose is given."""
    x, y = place(np.array([[flat.x, flat.y]]), pose)[0]
    return Flat(float(x), float(y), flat.theta + pose[2], flat.kappa, flat.sigma)
