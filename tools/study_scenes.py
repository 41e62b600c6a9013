"""Scarcer descriptions of the obstacles, for the study: what a method is shown instead of the exact polygons.

    discs    each convex polygon is covered by a row of discs along its longer side, each round a cell as wide as the
             polygon and 2 m or more in length: they contain the polygon and protrude from it, by 0.4 m beside a box
             2 m wide and by 0.9 m beside a fence. Nothing is missed, room is lost.
    points   only points on the outlines, a metre apart, as a range finder gives them: nothing protrudes, but there is
             nothing between the points.

The path that comes of it is judged in the true scene, by the same audit as every other.
"""

import dataclasses
import math
from dataclasses import dataclass
from typing import Final, Literal

import numpy as np

from optim.model.method import Method
from optim.model.problem import Problem
from optim.model.result import OnIterate, Result, ignore
from optim.model.scene import Scene, make_scene
from optim.numerics.arrays import Array

Description = Literal["discs", "points"]
DESCRIPTIONS: Final[tuple[Description, ...]] = ("discs", "points")
CORNERS: Final = 12
"""Of the polygon round a disc."""
LEAST_CELL: Final = 2.0
"""Length of the cell that a disc covers, at least [m]: else a fence would be a thousand of them."""
POINT_SPACING: Final = 1.0
"""Distance between points on an outline, at most [m]."""
_POINT_SIZE = 0.05  # [m]: a point is a square so large, since obstacles have an area


@dataclass(frozen=True, kw_only=True)
class Described:
    """A method that is shown a description of the obstacles instead of themselves."""

    method: Method
    description: Description

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        """What the method makes of the described problem: same recorded path, other obstacles."""
        return self.method.solve(described(problem, self.description), on_iterate)


def described(problem: Problem, description: Description) -> Problem:
    """The problem with its obstacles described so."""
    describe = discs if description == "discs" else points
    return dataclasses.replace(problem, scene=describe(problem.scene))


def discs(scene: Scene) -> Scene:
    """Every polygon covered by a row of discs."""
    return make_scene([disc for polygon in scene.polygons for disc in _row_of_discs(polygon)], frame=scene.frame)


def points(scene: Scene) -> Scene:
    """Every polygon's outline as points."""
    squares = [_square(point) for polygon in scene.polygons for point in _on_outline(polygon)]
    return make_scene(squares, frame=scene.frame)


def _row_of_discs(polygon: Array) -> list[Array]:
    """Polygons round discs that contain a polygon: discs round the cells of its smallest rectangle, in a row."""
    angle = _smallest_rectangle(polygon)
    turn = np.array([[math.cos(angle), math.sin(angle)], [-math.sin(angle), math.cos(angle)]])
    low, high = (polygon @ turn.T).min(axis=0), (polygon @ turn.T).max(axis=0)
    along = int(np.argmax(high - low))
    width, length = float((high - low)[1 - along]), float((high - low)[along])
    count = max(1, math.ceil(length / max(width, LEAST_CELL) - 1e-9))
    radius = 0.5 * math.hypot(length / count, width)
    centres = np.tile(0.5 * (low + high), (count, 1))
    centres[:, along] = low[along] + (np.arange(count) + 0.5) * length / count
    around = 2.0 * math.pi * np.arange(CORNERS) / CORNERS
    ring = radius / math.cos(math.pi / CORNERS) * np.stack([np.cos(around), np.sin(around)], axis=1)
    return [centre + ring for centre in centres @ turn]


def _smallest_rectangle(polygon: Array) -> float:
    """Heading of the rectangle of least area round a convex polygon: one of its edges lies along it [rad]."""
    edges = np.roll(polygon, -1, axis=0) - polygon
    angles = np.arctan2(edges[:, 1], edges[:, 0])
    areas = []
    for angle in angles:
        c, s = math.cos(angle), math.sin(angle)
        u, v = c * polygon[:, 0] + s * polygon[:, 1], c * polygon[:, 1] - s * polygon[:, 0]
        areas.append((u.max() - u.min()) * (v.max() - v.min()))
    return float(angles[int(np.argmin(areas))])


def _on_outline(polygon: Array) -> Array:
    """Points on the outline, corners included, at most `POINT_SPACING` apart. Shape (n, 2)."""
    found = []
    for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
        count = max(1, math.ceil(math.hypot(*(b - a)) / POINT_SPACING - 1e-9))
        found.append(a + (b - a) * (np.arange(count) / count)[:, None])
    return np.concatenate(found)


def _square(point: Array) -> Array:
    half = _POINT_SIZE / 2.0
    return point + np.array([[-half, -half], [half, -half], [half, half], [-half, half]])
