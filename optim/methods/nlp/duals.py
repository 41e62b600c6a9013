"""Exact collision constraints through the duals of the distance, and the values they start from.

Body k is the rectangle { R z + t : G z <= g }, G = [I; -I], g = (a, b, a, b), t its centre; obstacle m is the polygon
{ y : A y <= b_m } with unit rows. Their distance is at least d exactly if multipliers lambda, mu >= 0 exist with

    -g . mu + (A t - b_m) . lambda >= d,    G' mu + R' A' lambda = 0,    |A' lambda| <= 1

(Zhang, Liniger, Borrelli 2018). A' lambda is then the unit normal from obstacle to body, and the multipliers of a
pair start from the exact witness normal: without that, interior point methods lose their way in crowded scenes.
"""

from dataclasses import dataclass

import numpy as np

from optim.model.clearance import separations
from optim.model.problem import Problem
from optim.numerics.arrays import Array, Int64, IntArray

_MOST = 12  # polygons near one body at one knot; others join once a solution violates them


@dataclass(frozen=True, eq=False)
class Pairs:
    """P pairs of a body at a knot and an obstacle."""

    knot: Int64[IntArray, " P"]
    """Index of the knot. Shape (P,)."""
    body: Int64[IntArray, " P"]
    """0 the truck, 1 the trailer. Shape (P,)."""
    polygon: Int64[IntArray, " P"]
    """Index in Scene.polygons. Shape (P,)."""

    def keys(self) -> set[tuple[int, int, int]]:
        """Knot, body, polygon of each."""
        return set(zip(self.knot.tolist(), self.body.tolist(), self.polygon.tolist(), strict=True))

    @staticmethod
    def of(keys: set[tuple[int, int, int]]) -> "Pairs":
        """The pairs with these keys, in order."""
        table = np.array(sorted(keys), dtype=np.int64).reshape(-1, 3)
        return Pairs(table[:, 0], table[:, 1], table[:, 2])


def pairs_within(problem: Problem, states: Array, required: Array, reach: float) -> Pairs:
    """The pairs whose clearance is less than required plus `reach` [m]; the ends are left out, they are fixed."""
    rows = separations(problem.scene, problem.vehicle, states, float(required.max()) + reach, _MOST)
    near = rows.distance < required[rows.knot, rows.body] + reach
    inside = near & (rows.knot > 0) & (rows.knot < len(states) - 1)
    columns = (rows.knot[inside], rows.body[inside], rows.polygon[inside])
    return Pairs.of(set(zip(*(column.tolist() for column in columns), strict=True)))


def half_planes(polygon: Array, origin: Array, length: float) -> tuple[Array, Array]:
    """Unit outward normals A, shape (n, 2), and offsets b, shape (n,), of a convex counter-clockwise polygon.

    Coordinates are relative to `origin` and in units of `length`.
    """
    vertices = (polygon - origin) / length
    edge = np.roll(vertices, -1, axis=0) - vertices
    normal = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.hypot(*edge.T)[:, None]
    return normal, np.sum(normal * vertices, axis=1)


def starting_multipliers(a: Array, normal: Array, heading: float) -> tuple[Array, Array]:
    """lambda (n,) and mu (4,) whose normal A' lambda is the witness normal, for a polygon's unit normals A (n, 2).

    The normal lies between those of the two edges that meet at the vertex farthest along it.
    """
    count = len(a)
    before = np.roll(np.arange(count), 1)
    crossing = a[before, 0] * a[:, 1] - a[before, 1] * a[:, 0]
    share_before = (normal[0] * a[:, 1] - normal[1] * a[:, 0]) / crossing
    share_own = (a[before, 0] * normal[1] - a[before, 1] * normal[0]) / crossing
    best = int(np.argmax(np.minimum(share_before, share_own)))
    multipliers = np.zeros(count)
    multipliers[before[best]] = max(share_before[best], 0.0)
    multipliers[best] = max(share_own[best], 0.0)
    c, s = np.cos(heading), np.sin(heading)
    w = np.array([c * normal[0] + s * normal[1], c * normal[1] - s * normal[0]])
    return multipliers, np.concatenate([np.maximum(-w, 0.0), np.maximum(w, 0.0)])
