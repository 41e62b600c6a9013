"""What every planner is given and gives back, so that one can stand in for another."""

import itertools
import math
import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from typing import Protocol

import numpy as np

from optim.model.clearance import first_violation
from optim.model.path import Path, Segment, merge, segment_from_states
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, frozen
from optim.steering import Connection, connections
from optim.steering.flat import Flat
from tools.corpus.site import Area, Pose

CONNECTION_SPACING = 0.05
"""Distance between samples of exact connections [m]: phi is linear in between, and the audit integrates that."""
_CHECK_SPACING = 0.2  # [m]: of the samples between which a connection is checked


@dataclass(frozen=True, eq=False, kw_only=True)
class Task:
    """Drive from start to goal within the vehicle's limits and clear of the scene."""

    vehicle: Vehicle
    scene: Scene
    start: Flat
    """The trailer's axle at the start, map frame."""
    goal: Flat
    areas: Sequence[Area]
    """Where planners that sample may do so, in the frame whose pose in the map follows."""
    pose: Pose = (0.0, 0.0, 0.0)
    margin: float = 0.2
    """Clearance to keep from every obstacle, between samples too [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Plan:
    """A path of a planner and how it was found."""

    path: Path
    """Drivable, within the vehicle's limits and clear; samples at most 0.1 m apart."""
    nodes: Array
    """Arc lengths at which the planner's nodes lie, both ends included [m]. Shape (K,)."""
    effort: int
    """Iterations of a random tree, expanded nodes of a graph search."""


class Planner(Protocol):
    """One way of searching."""

    @property
    def name(self) -> str:
        """For tables."""
        ...

    def plan(self, task: Task, seed: int, time_limit: float = math.inf) -> Plan | None:
        """A path, or None where none is found within the planner's own bound on effort or the time limit [s].

        Where no time limit strikes, the same task and seed give the same path.
        """
        ...


def deadline(time_limit: float) -> Callable[[], bool]:
    """Tells whether so many seconds have passed since now."""
    end = time.monotonic() + time_limit
    return lambda: time.monotonic() > end


def assemble(pieces: Sequence[Segment], effort: int) -> Plan:
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
    return Plan(path=merge(joined), nodes=frozen(nodes), effort=effort)


def clear_connection(task: Task, start: Flat, end: Flat, gear: int, longest: float) -> Connection | None:
    """The shorter of the two shortest exact connections, of at most `longest` [m], that is clear of obstacles."""
    for edge in connections(task.vehicle, start, end, gear, longest)[:2]:
        s, states, phi = edge.sample(_CHECK_SPACING)
        if first_violation(task.scene, task.vehicle, s, states, task.margin, phi) < 0:
            return edge
    return None


def extent(task: Task, beyond: float) -> tuple[float, float, float, float]:
    """Smallest x and y, largest x and y of the map, or of start, goal and obstacles with room `beyond` [m]."""
    boundary = task.scene.boundary
    if boundary is not None:
        points = boundary
    else:
        ends = np.array([task.start[:2], task.goal[:2]])
        points = np.concatenate([ends - beyond, ends + beyond, *task.scene.polygons])
    (x0, y0), (x1, y1) = points.min(axis=0).tolist(), points.max(axis=0).tolist()
    return x0, y0, x1, y1
