"""Problems for the contract tests: a random drivable path and obstacles that leave it room."""

import numpy as np
from paths import random_path

from optim.model.path import Path
from optim.model.problem import Problem
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle, body_corners


def blocks_beside(vehicle: Vehicle, path: Path, count: int, seed: int, room: float = 0.3) -> list[np.ndarray]:
    """Random convex blocks near the path whose distance from both bodies is at least `room` [m]."""
    import shapely

    rng = np.random.default_rng(seed)
    driven = shapely.union_all(shapely.polygons(body_corners(vehicle, path.samples.states[::4]).reshape(-1, 4, 2)))
    low, high = path.samples.states[:, :2].min(axis=0) - 14, path.samples.states[:, :2].max(axis=0) + 14
    blocks: list[np.ndarray] = []
    for _ in range(60 * count):
        if len(blocks) == count:
            break
        angle = np.sort(rng.uniform(0, 2 * np.pi, rng.integers(3, 7)))
        corners = rng.uniform(low, high) + rng.uniform(0.5, 4) * np.stack([np.cos(angle), np.sin(angle)], 1)
        block = shapely.Polygon(corners).convex_hull
        if block.area > 0.3 and block.distance(driven) > room:
            blocks.append(shapely.get_coordinates(block)[:-1])
    return blocks


def random_problem(
    seed: int, num_blocks: int = 8, lengths: tuple[float, ...] = (10.0, 18.0, 12.0), vehicle: Vehicle | None = None
) -> Problem:
    """A recorded path with needless turns and cusps between blocks."""
    vehicle = vehicle or Vehicle()
    path = random_path(vehicle, lengths, 1 if seed % 2 == 0 else -1, seed, spacing=0.1, turning=0.4)
    scene = make_scene(blocks_beside(vehicle, path, num_blocks, seed))
    return Problem(vehicle=vehicle, scene=scene, recorded=path)
