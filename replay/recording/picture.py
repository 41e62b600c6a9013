"""Shapes to draw, without the viewer: frames, filled areas, dashes, swept area. Metres, y up."""

from collections.abc import Iterable, Sequence
from typing import NamedTuple

import numpy as np
import shapely
from numpy.typing import NDArray
from shapely.geometry.base import BaseGeometry

from optim.model.path import Path, Segment
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle, body_corners
from optim.numerics.arrays import Array

_SWEEP_SPACING = 0.25  # [m] between footprints that make the swept area; hulls fill in, a bend cuts off millimetres
_SIMPLIFY = 0.01  # [m]: nobody sees a centimetre, and a path shrinks to a tenth


class Frame(NamedTuple):
    """Extent of a view, an axis-parallel rectangle [m]."""

    x0: float
    y0: float
    x1: float
    y1: float

    @property
    def width(self) -> float:
        """Extent in x [m]."""
        return self.x1 - self.x0

    @property
    def height(self) -> float:
        """Extent in y [m]."""
        return self.y1 - self.y0

    @property
    def size(self) -> float:
        """The larger of width and height [m]."""
        return max(self.width, self.height)

    @property
    def box(self) -> BaseGeometry:
        """The frame as a polygon."""
        return shapely.box(*self)

    def grown(self, left: float, bottom: float, right: float, top: float) -> "Frame":
        """The frame with its sides moved outwards [m]."""
        return Frame(self.x0 - left, self.y0 - bottom, self.x1 + right, self.y1 + top)


def frame_around(scene: Scene, areas: Iterable[BaseGeometry]) -> Frame:
    """The whole scene where the manoeuvre fills a good part of it, else the manoeuvre with its neighbourhood.

    Never much narrower or flatter than a screen's panel, so that labels find room.
    """
    x0, y0, x1, y1 = shapely.total_bounds(list(areas))
    reach = 0.35 * max(x1 - x0, y1 - y0) + 3.0
    outlines = [scene.boundary] if scene.boundary is not None else list(scene.polygons)
    if outlines:
        points = np.concatenate(outlines)
        low, high = points.min(axis=0), points.max(axis=0)
        x0, y0 = max(x0 - reach, min(low[0], x0)), max(y0 - reach, min(low[1], y0))
        x1, y1 = min(x1 + reach, max(high[0], x1)), min(y1 + reach, max(high[1], y1))
    pad = 0.02 * max(x1 - x0, y1 - y0) + 0.5
    frame = Frame(float(x0) - pad, float(y0) - pad, float(x1) + pad, float(y1) + pad)
    wide = max(0.0, 0.9 * frame.height - frame.width) / 2
    tall = max(0.0, 0.4 * frame.width - frame.height) / 2
    return frame.grown(wide, tall, wide, tall)


def fill(geometry: BaseGeometry, frame: Frame, resolution: float) -> np.ndarray:
    """Mask of the frame's cells with their centre inside the geometry, row 0 at the bottom. Shape (H, W), bool.

    Even-odd rule: each edge flips every cell to the right of where it crosses the row's centre line.
    """
    columns, rows = (max(1, int(np.ceil(extent / resolution))) for extent in (frame.width, frame.height))
    flips = np.zeros((rows, columns + 1), np.int32)
    for ring in rings(geometry):
        x, y = (ring[:, 0] - frame.x0) / resolution - 0.5, (ring[:, 1] - frame.y0) / resolution - 0.5
        for xa, ya, xb, yb in zip(x, y, x[1:], y[1:], strict=False):
            first, last = sorted((int(np.ceil(ya)), int(np.ceil(yb))))
            first, last = max(first, 0), min(last, rows)
            if first < last:
                row = np.arange(first, last)
                crossing = np.ceil(xa + (row - ya) * (xb - xa) / (yb - ya))
                flips[row, np.clip(crossing, 0, columns).astype(int)] += 1
    return np.cumsum(flips, axis=1)[:, :columns] % 2 == 1


def rings(geometry: BaseGeometry) -> list[Array]:
    """Closed outlines of all polygons in the geometry, holes too. Each (n, 2)."""
    polygons = [part for part in shapely.get_parts(geometry) if part.geom_type == "Polygon"]
    return [shapely.get_coordinates(ring) for polygon in polygons for ring in (polygon.exterior, *polygon.interiors)]


def obstacle_area(scene: Scene) -> BaseGeometry:
    """All obstacles in one geometry; the walls outside a boundary are left out, the boundary is drawn instead."""
    area = shapely.union_all([shapely.Polygon(polygon) for polygon in scene.polygons])
    if scene.boundary is not None:
        area = shapely.intersection(area, shapely.Polygon(scene.boundary))
    return area


def swept_area(vehicle: Vehicle, path: Path) -> BaseGeometry:
    """The ground that truck and trailer pass over: hulls of consecutive footprints, joined."""
    corners = []
    for segment in path.segments:
        rows = np.searchsorted(segment.s, np.arange(0.0, segment.length, _SWEEP_SPACING))
        rows = np.unique(np.append(rows, segment.num_samples - 1))
        footprints = body_corners(vehicle, segment.states[rows])
        corners.append(np.concatenate([footprints[:-1], footprints[1:]], axis=2).reshape(-1, 8, 2))
    hulls = shapely.convex_hull(np.asarray(shapely.multipoints(np.concatenate(corners)), dtype=object))
    return shapely.simplify(shapely.union_all(hulls), _SIMPLIFY)


def thinned(points: Array) -> NDArray[np.float32]:
    """A polyline with the points left out that deviate by less than a centimetre. Shape (m, 2), float32."""
    line = shapely.simplify(shapely.LineString(points), _SIMPLIFY, preserve_topology=False)
    return shapely.get_coordinates(line).astype(np.float32)


def strips(segments: Sequence[Segment], dash: float) -> tuple[list[NDArray[np.float32]], list[NDArray[np.float32]]]:
    """Polylines of the forward and of the reverse segments; the reverse ones are cut into dashes of that length [m]."""
    forward, reverse = [], []
    for segment in segments:
        if segment.direction > 0:
            forward.append(thinned(segment.states[:, :2]))
            continue
        for start in np.arange(0.0, segment.length, 1.6 * dash):
            s = np.linspace(start, min(start + dash, segment.length), 6)
            dashes = [np.interp(s, segment.s, column) for column in (segment.x, segment.y)]
            reverse.append(np.stack(dashes, axis=1).astype(np.float32))
    return forward, reverse


def closed(corners: Array) -> Array:
    """A closed polyline round the corners (n, 2). Shape (n + 1, 2)."""
    return np.concatenate([corners, corners[:1]])
