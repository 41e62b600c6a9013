"""Occupancy grids: what is checked, what becomes an obstacle, and what lies under a path."""

import numpy as np
from numpy.typing import NDArray

from optim.geometry.cover import cover_cells
from optim.model.vehicle import Vehicle, body_poses
from optim.numerics.arrays import Array
from replay.logs.meaning.planar import Refusal, planar
from replay.logs.meaning.read_options import ReadOptions
from replay.logs.messages.types import Grid
from replay.run.case import MapImage

MAX_CELLS = 64_000_000
"""Most cells of one grid."""
RESOLUTIONS = (0.01, 2.0)
"""Smallest and largest side of a cell [m]."""
MOST_UNKNOWN = 0.25
"""Share of a body's area from which it stands on unknown cells [-]. Less counts as a collision: in a narrow passage
noise in the poses moves a trailer's tail by decimetres."""
OUTSIDE = 127
"""`cells_at` of a point that lies outside the grid."""


def map_image(grid: Grid) -> tuple[MapImage, list[str]]:
    """The grid as checked data, and notes. Raises Refusal."""
    resolution = float(f"{grid.resolution:.7g}")  # float32 on the wire: 0.1 arrives as 0.10000000149
    if not RESOLUTIONS[0] <= resolution <= RESOLUTIONS[1]:
        text = f"info.resolution is {grid.resolution:.6g} m, expected {RESOLUTIONS[0]:g} to {RESOLUTIONS[1]:g}"
        raise Refusal("E_GRID_RESOLUTION", text)
    size = f"{grid.width} x {grid.height} cells"
    if grid.width == 0 or grid.height == 0:
        raise Refusal("E_GRID_EMPTY", f"the grid has {size}, expected at least 1 x 1")
    if grid.width * grid.height > MAX_CELLS:
        raise Refusal("E_GRID_LIMIT", f"the grid has {size}, expected at most {MAX_CELLS} in all")
    if grid.width * grid.height != len(grid.data):
        raise Refusal("E_GRID_SIZE", f"the grid has {size} and {len(grid.data)} values, expected one for each cell")
    cells = grid.data.reshape(grid.height, grid.width)
    if cells.min() < -1 or cells.max() > 100:
        row, column = (int(i) for i in np.argwhere((cells < -1) | (cells > 100))[0])
        text = f"cell ({column}, {row}) has the value {cells[row, column]}, expected -1 to 100"
        raise Refusal("E_GRID_VALUE", text)
    (origin,), notes = planar(grid.origin[None, :], "info.origin")
    if np.abs(origin[:2]).max() > 1e8:
        raise Refusal("E_RANGE", f"info.origin is ({origin[0]:.6g}, {origin[1]:.6g}) m, expected at most 1e8")
    x, y, yaw = (float(value) for value in origin)
    return MapImage(cells=cells, resolution=resolution, origin=(x, y, yaw)), notes


def outline(image: MapImage) -> Array:
    """The four corners of a grid [m], counter-clockwise from its origin. Shape (4, 2)."""
    height, width = image.cells.shape
    corners = np.array([[0.0, 0.0], [width, 0.0], [width, height], [0.0, height]]) * image.resolution
    x, y, yaw = image.origin
    c, s = np.cos(yaw), np.sin(yaw)
    return corners @ np.array([[c, s], [-s, c]]) + [x, y]


def obstacle_cells(image: MapImage, options: ReadOptions) -> NDArray[np.bool_]:
    """Mask of the cells that are obstacles. Shape (H, W)."""
    occupied = image.cells >= options.occupied_from
    return occupied | (image.cells < 0) if options.unknown == "obstacle" else occupied


def grid_polygons(image: MapImage, options: ReadOptions) -> list[Array]:
    """Convex polygons that cover every obstacle cell."""
    return cover_cells(obstacle_cells(image, options), image.resolution, image.origin)


def cells_at(image: MapImage, points: Array) -> NDArray[np.int8]:
    """Values of the cells at points (..., 2); `OUTSIDE` beyond the grid. Shape (...)."""
    x, y, yaw = image.origin
    c, s = np.cos(yaw), np.sin(yaw)
    local = (points - [x, y]) @ np.array([[c, -s], [s, c]]) / image.resolution
    height, width = image.cells.shape
    inside = np.asarray(np.all((local >= 0.0) & (local < [width, height]), axis=-1))
    column, row = np.moveaxis(np.where(inside[..., None], local, 0.0).astype(np.int64), -1, 0)
    return np.where(inside, image.cells[row, column], np.int8(OUTSIDE))


def check_under_path(image: MapImage, vehicle: Vehicle, states: Array, options: ReadOptions) -> None:
    """The recorded path must lie on known ground inside the map. states: (N, 4).

    Raises:
        Refusal: an axle outside the grid, or more than `MOST_UNKNOWN` of a body over unknown cells while those are
            obstacles.
    """
    if options.unknown == "free":
        return
    pose = body_poses(vehicle, states)
    heading = pose[:, 1, 2]
    axle = pose[:, 1, :2] - vehicle.hitch_to_axle * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    for name, points in (("truck's", pose[:, 0, :2]), ("trailer's", axle)):
        outside = np.flatnonzero(cells_at(image, points) == OUTSIDE)
        if len(outside):
            x, y = points[outside[0]]
            text = (
                f"the {name} axle is outside the map at ({x:.2f}, {y:.2f}) m, at {len(outside)} of {len(points)} poses"
            )
            raise Refusal("E_OUTSIDE_MAP", f"{text}; `--unknown free` takes the world outside for free")
    if not (image.cells == -1).any():
        return
    lattices = [_lattice(vehicle, body, image.resolution) for body in (0, 1)]
    for row, body in np.ndindex(len(pose), len(lattices)):
        points = _placed(lattices[body], pose[row, body])
        unknown = np.flatnonzero(cells_at(image, points) == -1)
        if len(unknown) > MOST_UNKNOWN * len(points):
            x, y = points[unknown[0]]
            share = f"{100.0 * len(unknown) / len(points):.0f} % of the {('truck', 'trailer')[body]}"
            text = f"pose {row} stands on unknown cells ({share}, for instance at ({x:.2f}, {y:.2f}) m)"
            raise Refusal("E_MAP_UNKNOWN", f"{text}; `--unknown free` takes unknown cells for free")


def _lattice(vehicle: Vehicle, body: int, spacing: float) -> Array:
    """Points that cover a body at about `spacing` [m], none on its rim, in the body's frame. Shape (n, 2)."""
    front, rear, half = vehicle.footprints[body]
    along, across = _inner(-rear, front, spacing), _inner(-half, half, spacing)
    return np.stack(np.meshgrid(along, across), axis=-1).reshape(-1, 2)


def _inner(low: float, high: float, spacing: float) -> Array:
    count = max(1, int(np.ceil((high - low) / max(spacing, 0.1))))
    return low + (np.arange(count) + 0.5) * (high - low) / count


def _placed(points: Array, pose: Array) -> Array:
    c, s = np.cos(pose[2]), np.sin(pose[2])
    return points @ np.array([[c, s], [-s, c]]) + pose[:2]
