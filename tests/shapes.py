"""Random convex polygons and vehicle states for the tests, and a signed distance by other means than ours."""

import numpy as np
import shapely


def random_convex(rng: np.random.Generator, centre: np.ndarray, size: float) -> np.ndarray:
    """A convex polygon of 3 to about 8 vertices, counter-clockwise."""
    points = centre + size * rng.normal(size=(int(rng.integers(3, 11)), 2))
    hull = shapely.orient_polygons(shapely.MultiPoint(points).convex_hull)
    assert isinstance(hull, shapely.Polygon)
    return np.asarray(hull.exterior.coords)[:-1]


def random_blocks(rng: np.random.Generator, count: int, spread: float = 30.0) -> list[np.ndarray]:
    """Convex polygons of all sizes, some overlapping, within `spread` of the origin."""
    return [random_convex(rng, rng.uniform(-spread, spread, 2), rng.uniform(0.2, 4.0)) for _ in range(count)]


def random_states(rng: np.random.Generator, count: int, spread: float = 35.0) -> np.ndarray:
    """Vehicle states anywhere, of any heading. Shape (count, 4)."""
    return np.column_stack(
        [rng.uniform(-spread, spread, (count, 2)), rng.uniform(-7.0, 7.0, count), rng.uniform(-1.0, 1.0, count)]
    )


def signed_distance(one: np.ndarray, other: np.ndarray) -> float:
    """Distance of two convex polygons by shapely; overlapping, minus the origin's depth in their difference set."""
    distance = shapely.distance(shapely.Polygon(one), shapely.Polygon(other))
    if distance > 0.0:
        return float(distance)
    difference = shapely.MultiPoint((one[:, None] - other[None]).reshape(-1, 2)).convex_hull
    return -float(shapely.distance(shapely.boundary(difference), shapely.Point(0.0, 0.0)))
