"""Convex polygons: cleaning, convex parts of simple polygons, walls, and the packed form that the kernels read.

A polygon is an array of vertices [m], shape (n, 2), counter-clockwise, not closed. Edge i runs from vertex i to
vertex i + 1 and has the outward unit normal n_i; the polygon is {p : n_i . p <= b_i for all i}.
"""

import math
from collections.abc import Sequence
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike

from optim.numerics.arrays import Array, Float64, Int64, IntArray, frozen, frozen_int

MERGE_TOLERANCE = 1e-9
"""Vertices closer than this to their neighbour, or to the line through both neighbours, are dropped [m]."""


class PackedScene(NamedTuple):
    """Obstacles in flat read-only arrays, with a tree of axis-aligned boxes over them.

    The tree is stored in depth-first order: the first child of node i is i + 1, and `skip[i]` is the node to go
    on with when the box of node i is out of reach. There is one leaf per polygon, so a walk that is never pruned
    visits 2 M - 1 nodes. Coordinates are relative to `origin`, so that large map coordinates cost no digits.
    """

    origin: Float64[Array, " 2"]
    """Point of the map that coordinates are relative to [m]. Shape (2,)."""
    first: Int64[IntArray, " _"]
    """Polygon k owns the vertices first[k] to first[k + 1] - 1. Shape (M + 1,)."""
    vertices: Float64[Array, "V 2"]
    """Vertices of all polygons in a row [m]. Shape (V, 2)."""
    normals: Float64[Array, "V 2"]
    """Outward unit normal of the edge that starts at each vertex. Shape (V, 2)."""
    boxes: Float64[Array, "T 4"]
    """Smallest x, smallest y, largest x, largest y of each tree node [m]. Shape (T, 4), T = 2 M - 1."""
    skip: Int64[IntArray, " T"]
    """The node to go on with when that of a node is out of reach. Shape (T,)."""
    item: Int64[IntArray, " T"]
    """The polygon in a leaf, -1 for inner nodes. Shape (T,)."""


def clean_ring(vertices: ArrayLike) -> Array:
    """Counter-clockwise ring without repeated, collinear or closing vertices; may come back with fewer than 3.

    Spikes of no area are collinear and go as well.
    """
    ring = np.array(vertices, dtype=np.float64).reshape(-1, 2)
    while len(ring) >= 3:
        before, after = np.roll(ring, 1, axis=0), np.roll(ring, -1, axis=0)
        chord, step = after - before, ring - before
        height = np.abs(_cross(chord, step)) / np.maximum(np.hypot(*chord.T), 1e-300)
        needless = (np.hypot(*step.T) <= MERGE_TOLERANCE) | (height <= MERGE_TOLERANCE)
        # of neighbours only one at a time: each may be needless only while the other is there
        gone: list[int] = []
        for i in np.flatnonzero(needless).tolist():
            if not gone or (i - 1 > gone[-1] and (i + 1) % len(ring) != gone[0]):
                gone.append(i)
        if not gone:
            break
        ring = np.delete(ring, gone, axis=0)
    return ring if signed_area(ring) >= 0.0 else ring[::-1].copy()


def signed_area(ring: Array) -> float:
    """Area enclosed by a ring, positive when counter-clockwise [m^2]."""
    if len(ring) < 3:
        return 0.0
    local = ring - ring[0]
    return 0.5 * float(_cross(local, np.roll(local, -1, axis=0)).sum())


def is_convex(ring: Array) -> bool:
    """Whether a cleaned ring turns left at every vertex, and once round in total."""
    edges = np.roll(ring, -1, axis=0) - ring
    following = np.roll(edges, -1, axis=0)
    turn = np.arctan2(_cross(edges, following), (edges * following).sum(axis=1))
    return bool((turn > 0.0).all()) and abs(float(turn.sum()) - 2.0 * math.pi) < 1.0


def convex_parts(vertices: ArrayLike) -> list[Array]:
    """The convex parts of a simple polygon; a convex one comes back alone.

    Raises ValueError, without saying which polygon, for anything that is not a simple polygon with an area.
    """
    raw = np.asarray(vertices, dtype=np.float64)
    if raw.ndim != 2 or raw.shape[1] != 2:
        raise ValueError(f"its vertices have the shape {raw.shape}, expected (n, 2)")
    if not np.isfinite(raw).all():
        raise ValueError("a coordinate is not finite")
    ring = clean_ring(raw)
    if len(ring) < 3:
        raise ValueError(f"it has no area ({len(raw)} vertices, {len(ring)} of them distinct and not collinear)")
    if is_convex(ring):
        return [frozen(ring)]
    return [frozen(part) for part in _split(ring)]


def _split(ring: Array) -> list[Array]:
    """Constrained Delaunay triangles, joined across diagonals while convex (Hertel and Mehlhorn 1983)."""
    import shapely  # here: scenes of convex polygons, the usual case, do without

    outline = shapely.Polygon(ring)
    if not outline.is_valid:
        raise ValueError(f"it is not a simple polygon: {shapely.is_valid_reason(outline)}")
    number = {(float(x), float(y)): i for i, (x, y) in enumerate(ring)}
    parts: dict[int, list[int]] = {}
    owner: dict[tuple[int, int], int] = {}
    triangles = shapely.get_parts(shapely.constrained_delaunay_triangles(outline))
    for k, corners in enumerate(shapely.get_coordinates(triangles).reshape(-1, 4, 2)[:, :3]):
        loop = [number[float(x), float(y)] for x, y in (corners if signed_area(corners) > 0.0 else corners[::-1])]
        parts[k] = loop
        owner.update(dict.fromkeys(_edges(loop), k))
    diagonals = sorted((i, j) for i, j in owner if i < j and (j, i) in owner)
    for i, j in diagonals:
        one, other = owner[i, j], owner[j, i]
        loop = _joined(parts[one], parts[other], (i, j))
        if one != other and _turns_left(ring, loop):
            parts[one] = loop
            owner.update(dict.fromkeys(_edges(loop), one))
            del parts[other]
    rings = (clean_ring(ring[loop]) for loop in parts.values())
    return [part for part in rings if len(part) >= 3]


def _edges(loop: list[int]) -> list[tuple[int, int]]:
    return list(zip(loop, loop[1:] + loop[:1], strict=True))


def _joined(one: list[int], other: list[int], edge: tuple[int, int]) -> list[int]:
    """Both loops as one, without the edge that `one` runs along and `other` runs against."""
    i, j = one.index(edge[1]), other.index(edge[0])
    return one[i:] + one[:i] + (other[j:] + other[:j])[1:-1]


def _turns_left(ring: Array, loop: list[int]) -> bool:
    points = ring[loop]
    edges = np.roll(points, -1, axis=0) - points
    following = np.roll(edges, -1, axis=0)
    # slightly collinear corners are cleaned away afterwards, so they do not stand in the way here
    scale = np.maximum(np.hypot(*edges.T), np.hypot(*following.T))
    return bool((_cross(edges, following) >= -0.1 * MERGE_TOLERANCE * scale).all())


def walls(outline: Array, thickness: float) -> list[Array]:
    """One rectangle outside each edge of a convex outline, longer by `thickness` at both ends.

    Every point outside the outline and within `thickness` of it is in some wall, at sharp corners too: beside a
    corner each of its two walls covers a quarter of a disc, and the angle outside is less than two quarters.
    """
    following = np.roll(outline, -1, axis=0)
    tangent = (following - outline) / np.hypot(*(following - outline).T)[:, None]
    out = thickness * np.stack([tangent[:, 1], -tangent[:, 0]], axis=1)
    a, b = outline - thickness * tangent, following + thickness * tangent
    return [frozen(quad) for quad in np.stack([a, a + out, b + out, b], axis=1)]


def _cross(a: Array, b: Array) -> Array:
    return a[..., 0] * b[..., 1] - a[..., 1] * b[..., 0]


def pack(polygons: Sequence[Array]) -> PackedScene:
    """The packed form of convex counter-clockwise polygons (any number, none included)."""
    count = np.array([len(polygon) for polygon in polygons], dtype=np.int64)
    first = np.concatenate([[0], np.cumsum(count)]).astype(np.int64)
    vertices = np.concatenate([np.empty((0, 2)), *polygons])
    origin = np.round(vertices.mean(axis=0)) if len(polygons) else np.zeros(2)
    vertices = vertices - origin
    following = np.arange(len(vertices)) + 1
    following[first[1:] - 1] = first[:-1]
    edge = vertices[following] - vertices
    normals = np.stack([edge[:, 1], -edge[:, 0]], axis=1) / np.hypot(*edge.T)[:, None]
    if len(polygons):
        low, high = (op.reduceat(vertices, first[:-1], axis=0) for op in (np.minimum, np.maximum))
        boxes, skip, item = _tree(np.concatenate([low, high], axis=1))
    else:
        boxes, skip, item = np.empty((0, 4)), np.empty(0), np.empty(0)
    return PackedScene(
        origin=frozen(origin),
        first=frozen_int(first),
        vertices=frozen(vertices),
        normals=frozen(normals),
        boxes=frozen(boxes),
        skip=frozen_int(skip),
        item=frozen_int(item),
    )


def _tree(boxes: Array) -> tuple[Array, IntArray, IntArray]:
    """Halve the boxes along the longer side of their centres' extent, level by level, until each is alone.

    A subtree of m leaves takes 2 m - 1 nodes in depth-first order, so the places of all nodes are known beforehand
    and each level is a handful of array operations.
    """
    total = len(boxes)
    centres = 0.5 * (boxes[:, :2] + boxes[:, 2:])
    order = np.arange(total)
    node_boxes = np.empty((2 * total - 1, 4))
    skip, item = np.empty(2 * total - 1, dtype=np.int64), np.full(2 * total - 1, -1, dtype=np.int64)
    start, size, place = np.array([0]), np.array([total]), np.array([0])
    while len(start):
        ordered = boxes[order]
        spans = _spans(start, size)
        where = np.repeat(np.arange(len(start)), size)
        begin = np.concatenate([[0], np.cumsum(size)[:-1]])
        node_boxes[place, :2] = np.minimum.reduceat(ordered[spans, :2], begin, axis=0)
        node_boxes[place, 2:] = np.maximum.reduceat(ordered[spans, 2:], begin, axis=0)
        skip[place] = place + 2 * size - 1
        item[place[size == 1]] = order[start[size == 1]]
        points = centres[order[spans]]
        extent = np.maximum.reduceat(points, begin, axis=0) - np.minimum.reduceat(points, begin, axis=0)
        axis = (extent[:, 1] > extent[:, 0]).astype(int)
        order[spans] = order[spans][np.lexsort((points[np.arange(len(spans)), axis[where]], where))]
        parent = size > 1
        left = (size[parent] + 1) // 2
        start = np.stack([start[parent], start[parent] + left], axis=1).ravel()
        place = np.stack([place[parent] + 1, place[parent] + 2 * left], axis=1).ravel()
        size = np.stack([left, size[parent] - left], axis=1).ravel()
    return node_boxes, skip, item


def _spans(start: IntArray, size: IntArray) -> IntArray:
    """The indices start[i] .. start[i] + size[i] - 1, one span after the other."""
    offset = np.repeat(start - np.concatenate([[0], np.cumsum(size)[:-1]]), size)
    return np.arange(len(offset)) + offset
