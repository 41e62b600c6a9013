"""Occupancy grids of the corpus: the yard as a mapping robot would have left it, quantised and a little noisy."""

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray
from scipy.ndimage import distance_transform_edt

from optim.model.flat_map import state_from_flat
from optim.model.vehicle import body_corners
from optim.numerics.arrays import Array
from optim.planning.protocol import Pose, place, place_flat
from tools.corpus.site import Grid, Site, footprints, ground

OCCUPIED, UNKNOWN = 65, -1
"""Cells from 65 up are obstacles, as in the map servers of ROS; -1 has never been seen."""

_BORDER = 1.0  # [m]: the grid reaches beyond the site's ground by this
_KEEP_OFF = 2.5  # [m]: no speckles nearer to the vehicle at start and goal


@dataclass(frozen=True, eq=False, kw_only=True)
class Cells:
    """An occupancy grid."""

    values: NDArray[np.int8]
    """-1, or occupancy from 0 to 100; row 0 is the lowest. Shape (H, W)."""
    resolution: float
    origin: Pose
    """Lower left corner of cell (0, 0), with the grid's yaw."""

    @property
    def blocked(self) -> NDArray[np.bool_]:
        """What a vehicle must not touch: occupied or unknown."""
        return (self.values >= OCCUPIED) | (self.values == UNKNOWN)


def draw_grid(site: Site) -> Cells | None:
    """The site's map as cells, with noise; None where its log holds shapes."""
    grid = site.map
    if not isinstance(grid, Grid):
        return None
    rng = np.random.default_rng(site.noise)
    origin, shape = _frame(ground(site), grid)
    centres = _centres(origin, shape, grid.resolution)
    half = grid.resolution / 2.0
    depth = _depth(footprints(site), centres, grid.resolution).reshape(shape)
    occupied = depth > -half
    values = np.where(occupied, rng.integers(80, 101, shape), 0).astype(np.int8)
    away = np.asarray(distance_transform_edt(~occupied, sampling=grid.resolution), dtype=np.float64)
    _blur(values, away, rng)
    if not grid.solid:  # a range finder sees faces only
        values[depth > 1.5 * grid.resolution] = UNKNOWN
    for area in grid.unknown:
        seen = _depth([place(part, site.pose) for part in area.parts()], centres, 0.0).reshape(shape)
        values[(seen > 0.0) & ~occupied] = UNKNOWN
    values[_depth([ground(site)], centres, 0.0).reshape(shape) < 0.0] = UNKNOWN
    candidates = (values >= 0) & ~occupied & (away > 0.3) & (away < 2.0)
    candidates &= ~(_depth(_ends(site), centres, _KEEP_OFF).reshape(shape) > -_KEEP_OFF)
    chosen = rng.choice(np.flatnonzero(candidates), grid.speckles, replace=False)
    values.ravel()[chosen] = rng.integers(OCCUPIED, 101, grid.speckles)
    return Cells(values=values, resolution=grid.resolution, origin=origin)


def _frame(corners: Array, grid: Grid) -> tuple[Pose, tuple[int, int]]:
    """Origin and number of rows and columns of the smallest grid over the ground."""
    turned = place(corners, (0.0, 0.0, -grid.yaw))
    low, high = turned.min(axis=0) - _BORDER, turned.max(axis=0) + _BORDER
    columns, rows = np.ceil((high - low) / grid.resolution - 1e-9).astype(int).tolist()
    x, y = place(np.array([low]), (0.0, 0.0, grid.yaw))[0].tolist()
    return (round(x, 3), round(y, 3), grid.yaw), (rows, columns)


def _centres(origin: Pose, shape: tuple[int, int], resolution: float) -> Array:
    """Centres of all cells in the map, row by row. Shape (H W, 2)."""
    rows, columns = np.indices(shape, dtype=np.float64)
    points = (np.stack([columns.ravel(), rows.ravel()], axis=1) + 0.5) * resolution
    return place(points, origin)


def _depth(polygons: list[Array], points: Array, reach: float) -> Array:
    """How far points (n, 2) lie inside the polygon they are deepest in [m], negative outside. Shape (n,).

    Measured from the lines of its edges: outside a corner it is less than the distance. -inf where nothing is
    nearer than `reach`.
    """
    deepest = np.full(len(points), -math.inf)
    for polygon in polygons:
        low, high = polygon.min(axis=0) - reach, polygon.max(axis=0) + reach
        near = np.flatnonzero(((points > low) & (points < high)).all(axis=1))
        along = np.roll(polygon, -1, axis=0) - polygon
        normal = np.stack([along[:, 1], -along[:, 0]], axis=1) / np.hypot(*along.T)[:, None]
        beyond = [points[near, 0] * n[0] + points[near, 1] * n[1] - n @ p for n, p in zip(normal, polygon, strict=True)]
        deepest[near] = np.maximum(deepest[near], -np.max(beyond, axis=0))
    return deepest.round(9)


def _blur(values: NDArray[np.int8], away: Array, rng: np.random.Generator) -> None:
    """A few half-believed cells beside the obstacles, all below the threshold."""
    ring = np.flatnonzero((away > 0.0) & (away < 0.5))
    some = rng.choice(ring, len(ring) // 8, replace=False)
    values.ravel()[some] = rng.integers(5, 50, len(some))


def _ends(site: Site) -> list[Array]:
    """Outlines of both bodies at start and goal."""
    flats = np.array([place_flat(flat, site.pose) for flat in (site.start, site.goal)])
    states, _ = state_from_flat(site.vehicle, flats)
    return list(body_corners(site.vehicle, states).reshape(4, 4, 2))
