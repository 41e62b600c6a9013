"""Signed distance of points to the union of the obstacles, as a smooth interpolant with its own exact gradient.

Nodes hold the exact signed distance: to the nearest polygon outside, minus the depth below the boundary of the
*union* inside (a wall made of many boxes has no seams). Between nodes lies Keys' bicubic convolution (1981,
a = -1/2): it passes through the nodes, is continuously differentiable, and is exact for quadratics. Value and
gradient come from the same interpolant, so a line search never sees them disagree.
"""

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from optim.geometry.collision import point_kernel
from optim.geometry.polygons import PackedScene, pack
from optim.numerics.arrays import Array, Float64, frozen
from optim.numerics.kernel import kernel

_SNAP = 1e-6  # [m]: joins boxes that miss each other by rounding, as those of a turned grid do


@dataclass(frozen=True, eq=False, kw_only=True)
class DistanceField:
    """Distances at the nodes of a grid; beyond its edge the value of the nearest point on the edge holds."""

    values: Float64[Array, "rows columns"]
    """Signed distance at the nodes [m], inf everywhere without obstacles. Shape (rows, columns)."""
    origin: tuple[float, float]
    """The node values[0, 0] [m]."""
    resolution: float
    """Distance between neighbouring nodes [m]."""

    def evaluate(self, points: Array) -> tuple[Array, Array]:
        """Value, shape (...), and gradient by (x, y), shape (..., 2), at points (..., 2) [m]."""
        points = np.asarray(points, dtype=np.float64)
        table = _interpolate(self.values, *self.origin, self.resolution, frozen(points.reshape(-1, 2)))
        return table[:, 0].reshape(points.shape[:-1]), table[:, 1:].reshape(points.shape)


def sample_field(
    packed: PackedScene, polygons: Sequence[Array], resolution: float, bounds: tuple[float, float, float, float]
) -> DistanceField:
    """The distance field of obstacles over bounds = (x_min, y_min, x_max, y_max) [m].

    The last row and column of nodes, `resolution` [m] apart, may lie beyond the bounds. Raises ValueError for a
    resolution or bounds that make no grid.
    """
    x_min, y_min, x_max, y_max = (float(bound) for bound in bounds)
    if not (resolution > 0.0 and x_max > x_min and y_max > y_min and np.isfinite(bounds).all()):
        raise ValueError(
            f"distance field: resolution {resolution!r} and bounds {tuple(bounds)!r}, expected a positive "
            "resolution and finite (x_min, y_min, x_max, y_max) with x_min < x_max and y_min < y_max"
        )
    columns = math.ceil((x_max - x_min) / resolution - 1e-9) + 1
    rows = math.ceil((y_max - y_min) / resolution - 1e-9) + 1
    x, y = np.meshgrid(x_min + resolution * np.arange(columns), y_min + resolution * np.arange(rows))
    nodes = frozen(np.stack([x.ravel(), y.ravel()], axis=1))
    values = point_kernel(packed, nodes)
    inside = values < 0.0
    if inside.any():
        values[inside] = -_depth(polygons, nodes[inside])
    return DistanceField(values=frozen(values.reshape(rows, columns)), origin=(x_min, y_min), resolution=resolution)


def _depth(polygons: Sequence[Array], points: Array) -> Array:
    """Distance of points inside the union of the polygons to its boundary [m]. Shape (N,)."""
    import shapely

    union = shapely.union_all([shapely.Polygon(polygon) for polygon in polygons], grid_size=_SNAP)
    rings = [shapely.get_coordinates(ring) for ring in shapely.get_parts(shapely.get_rings(shapely.get_parts(union)))]
    edges = [np.stack([ring[:-1], ring[1:]], axis=1) for ring in rings]
    return np.abs(point_kernel(pack(list(np.concatenate(edges))), frozen(points)))


@kernel
def _weights(t):
    """Keys' four weights at t in [0, 1] and their derivatives by t."""
    t2, t3 = t * t, t * t * t
    value = (-0.5 * t + t2 - 0.5 * t3, 1.0 - 2.5 * t2 + 1.5 * t3, 0.5 * t + 2.0 * t2 - 1.5 * t3, 0.5 * (t3 - t2))
    slope = (-0.5 + 2.0 * t - 1.5 * t2, -5.0 * t + 4.5 * t2, 0.5 + 4.0 * t - 4.5 * t2, 1.5 * t2 - t)
    return value, slope


@kernel
def _interpolate(values, x_min, y_min, resolution, points):
    """Value and gradient at each point. Shape (N, 3)."""
    rows, columns = values.shape
    out = np.zeros((points.shape[0], 3))
    for i in range(points.shape[0]):
        if values[0, 0] == math.inf:  # no obstacles
            out[i, 0] = math.inf
            continue
        u = (points[i, 0] - x_min) / resolution
        v = (points[i, 1] - y_min) / resolution
        scale_x = 1.0 / resolution if 0.0 <= u <= columns - 1 else 0.0
        scale_y = 1.0 / resolution if 0.0 <= v <= rows - 1 else 0.0
        u, v = min(max(u, 0.0), columns - 1.0), min(max(v, 0.0), rows - 1.0)
        column, row = min(int(u), columns - 2), min(int(v), rows - 2)
        wx, dx = _weights(u - column)
        wy, dy = _weights(v - row)
        for a in range(4):
            j = min(max(row - 1 + a, 0), rows - 1)
            line, line_slope = 0.0, 0.0
            for b in range(4):
                value = values[j, min(max(column - 1 + b, 0), columns - 1)]
                line += wx[b] * value
                line_slope += dx[b] * value
            out[i, 0] += wy[a] * line
            out[i, 1] += wy[a] * line_slope * scale_x
            out[i, 2] += dy[a] * line * scale_y
    return out
