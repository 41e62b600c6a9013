"""Visualisation markers as obstacles: which ones are there at a moment, and their footprints as convex polygons."""

from collections import Counter
from collections.abc import Callable, Iterable

import numpy as np

from optim.numerics.arrays import Array
from replay.base.errors import printable
from replay.logs.meaning.planar import NORM_REFUSED, Refusal, rotation
from replay.logs.messages.types import (
    ARROW,
    CUBE,
    CUBE_LIST,
    CYLINDER,
    DELETE,
    DELETE_ALL,
    FORGET,
    LINE_LIST,
    LINE_STRIP,
    MESH,
    SPHERE,
    TEXT,
    TRIANGLE_LIST,
    Marker,
)

MAX_POLYGONS = 100_000
"""Most obstacles of one map."""
THINNEST = 0.01
"""Lines and upright faces become walls at least this thick [m]."""
LARGEST = 1e8
"""No place, size or part of a quaternion may be larger [m]."""
_TINY_AREA = 1e-6  # [m2]; a footprint below it is a wall seen from above
_NAMES = {
    ARROW: "ARROW",
    7: "SPHERE_LIST",
    8: "POINTS",
    TEXT: "TEXT_VIEW_FACING",
    MESH: "MESH_RESOURCE",
    12: "ARROW_STRIP",
}

Markers = dict[tuple[str, int], Marker]


def apply_markers(state: Markers, message: Iterable[Marker]) -> None:
    """Change the markers that are there as one message says, by namespace and id."""
    spaces: dict[str, set[int]] | None = None  # what is in each namespace, once that is asked for
    for marker in message:
        key = marker.ns, marker.id
        if marker.action in (DELETE_ALL, FORGET):
            if spaces is None:
                spaces = {}
                for ns, number in state:
                    spaces.setdefault(ns, set()).add(number)
            latest = marker.header.stamp if marker.action == FORGET else 0
            for ns in [marker.ns] if marker.ns else list(spaces):
                gone = {i for i in spaces.get(ns, ()) if not latest or state[ns, i].header.stamp <= latest}
                for number in gone:
                    del state[ns, number]
                spaces.setdefault(ns, set()).difference_update(gone)
        elif marker.action == DELETE:
            if state.pop(key, None) is not None and spaces is not None:
                spaces[marker.ns].discard(marker.id)
        else:  # ADD, MODIFY (the same number), and 1, MODIFY's former number
            state[key] = marker
            if spaces is not None:
                spaces.setdefault(marker.ns, set()).add(marker.id)


def marker_polygons(markers: Iterable[Marker], height: float) -> tuple[list[Array], list[str]]:
    """Footprints of what is between the ground and `height` [m], each (n, 2) and convex; and notes.

    Raises:
        Refusal: a value that is not finite, a negative size, no unit quaternion, too many polygons.
    """
    polygons: list[Array] = []
    ignored: Counter[str] = Counter()
    for marker in markers:
        shape = _SHAPES.get(marker.type)
        if shape is None:
            ignored[_NAMES.get(marker.type, f"type {marker.type}")] += 1
            continue
        turn = _checked_rotation(marker)
        found = 0
        for solid in shape(marker.scale, marker.points):
            placed = solid @ turn.T + marker.pose[:3]
            if placed[:, 2].min() > height or placed[:, 2].max() < 0.0:
                continue
            footprint = _footprint(placed[:, :2])
            if footprint is not None:
                polygons.append(footprint)
                found += 1
        if not found:
            ignored["above the height limit, below the ground or empty"] += 1
        if len(polygons) > MAX_POLYGONS:
            raise Refusal("E_TOO_MANY_SHAPES", f"the markers make more than {MAX_POLYGONS} obstacles")
    return polygons, [f"markers that are not obstacles: {count}, {kind}" for kind, count in ignored.items()]


def _checked_rotation(marker: Marker) -> Array:
    name = f"marker {printable(marker.ns, 40)!r}/{marker.id}"
    for field, values in (("pose", marker.pose), ("scale", marker.scale), ("points", marker.points)):
        bad = np.argwhere(~(np.abs(values) <= LARGEST))
        if len(bad):
            place = f"{field}[{', '.join(map(str, bad[0]))}]"
            found = f"{values[tuple(bad[0])]:g}"
            raise Refusal("E_NONFINITE", f"{name}: {place} is {found}, expected a number up to {LARGEST:g}")
    if marker.scale.min() < 0.0:
        sizes = ", ".join(f"{size:g}" for size in marker.scale)
        raise Refusal("E_MARKER", f"{name}: scale is ({sizes}) m, expected none below 0")
    norm = float(np.linalg.norm(marker.pose[3:]))
    if norm == 0.0:
        return np.eye(3)  # never set: viewers take it for no rotation
    if abs(norm - 1.0) > NORM_REFUSED:
        raise Refusal("E_QUATERNION", f"{name}: its quaternion has the norm {norm:.6g}, expected 1")
    return rotation(marker.pose[3:] / norm)


# ---- solids in the marker's own frame: a list of points (n, 3) whose hull is the solid


def _cube(scale: Array, _: Array) -> list[Array]:
    signs = np.array([[x, y, z] for x in (-0.5, 0.5) for y in (-0.5, 0.5) for z in (-0.5, 0.5)])
    return [signs * scale] if scale.min() > 0.0 else []


def _cube_list(scale: Array, points: Array) -> list[Array]:
    return [corners + point for corners in _cube(scale, points) for point in points]


def _cylinder(scale: Array, _: Array) -> list[Array]:
    """A prism round the cylinder, or round the sphere: twelve sides that touch it from outside."""
    angle = np.pi / 6.0 * np.arange(12)
    ring = np.stack([np.cos(angle), np.sin(angle)], axis=1) * scale[:2] / 2.0 / np.cos(np.pi / 12.0)
    rings = [np.column_stack([ring, np.full(12, z)]) for z in (-scale[2] / 2.0, scale[2] / 2.0)]
    return [np.concatenate(rings)] if scale.min() > 0.0 else []


def _triangles(scale: Array, points: Array) -> list[Array]:
    return list((points[: len(points) // 3 * 3] * scale).reshape(-1, 3, 3))


def _line_list(scale: Array, points: Array) -> list[Array]:
    pairs = points[: len(points) // 2 * 2].reshape(-1, 2, 3)
    return [_wall(a, b, scale[0], (0.0, 0.0)) for a, b in pairs]


def _line_strip(scale: Array, points: Array) -> list[Array]:
    """A wall per piece; walls that meet reach half a width past their joint, so that corners have no gap."""
    if len(points) < 2:
        return []
    closed = len(points) > 2 and np.array_equal(points[0], points[-1])
    last = len(points) - 2
    joints = [(float(closed or k > 0), float(closed or k < last)) for k in range(last + 1)]
    pieces = zip(points[:-1], points[1:], joints, strict=True)
    return [_wall(a, b, scale[0], joint) for a, b, joint in pieces]


def _wall(a: Array, b: Array, width: float, joint: tuple[float, float]) -> Array:
    """The rectangle of one piece of line, lengthened by half a width at ends whose `joint` is 1. Shape (4, 3)."""
    half = max(width, THINNEST) / 2.0
    along = (b - a)[:2]
    length = float(np.hypot(*along))
    upright = length < 1e-9  # a pole: a square
    u = np.array([1.0, 0.0, 0.0]) if upright else np.array([*along / length, 0.0])
    v = np.array([-u[1], u[0], 0.0])
    a, b = a - half * max(joint[0], upright) * u, b + half * max(joint[1], upright) * u
    return np.stack([a - half * v, b - half * v, b + half * v, a + half * v])


_SHAPES: dict[int, Callable[[Array, Array], list[Array]]] = {
    CUBE: _cube,
    SPHERE: _cylinder,
    CYLINDER: _cylinder,
    LINE_STRIP: _line_strip,
    LINE_LIST: _line_list,
    CUBE_LIST: _cube_list,
    TRIANGLE_LIST: _triangles,
}


def _footprint(points: Array) -> Array | None:
    """Convex hull of points in the plane; a thin wall where it has no area, None where it is a point."""
    hull = convex_hull(points)
    x, y = hull.T
    if len(hull) > 2 and np.sum(x * np.roll(y, -1) - np.roll(x, -1) * y) / 2.0 > _TINY_AREA:
        return hull
    far = points[np.argmax(np.sum((points - points[0]) ** 2, axis=1))]
    near = points[np.argmax(np.sum((points - far) ** 2, axis=1))]
    if np.hypot(*(far - near)) < THINNEST:
        return None
    a, b = np.array([*near, 0.0]), np.array([*far, 0.0])
    return _wall(a, b, THINNEST, (0.0, 0.0))[:, :2]


def convex_hull(points: Array) -> Array:
    """Corners of the convex hull of points (n, 2), counter-clockwise. Shape (m, 2)."""
    order = sorted({(float(x), float(y)) for x, y in points})
    if len(order) < 3:
        return np.array(order)

    def chain(sequence: Iterable[tuple[float, float]]) -> list[tuple[float, float]]:
        line: list[tuple[float, float]] = []
        for p in sequence:
            while len(line) > 1 and _turn(line[-2], line[-1], p) <= 0.0:
                line.pop()
            line.append(p)
        return line[:-1]

    return np.array(chain(order) + chain(reversed(order)))


def _turn(a: tuple[float, float], b: tuple[float, float], c: tuple[float, float]) -> float:
    return (b[0] - a[0]) * (c[1] - a[1]) - (b[1] - a[1]) * (c[0] - a[0])
