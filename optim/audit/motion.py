"""Motion between the samples of a path, for the audit: re-integration, the area swept, its clearance.

Notation: truck rear axle c = (x, y), heading theta, hitch angle alpha, trailer heading beta = theta + alpha,
steering phi, direction d, wheelbase l, hitch to trailer axle l_t, hitch M behind the rear axle (0 for a fifth
wheel); all along the arc length s of the rear axle, and a dash is d/ds:

    c' = d (cos theta, sin theta)    theta' = d tan(phi) / l
    alpha' = -d (sin(alpha) / l_t + (1 + M cos(alpha) / l_t) tan(phi) / l)

Over an interval of length D, a body with reference point r and heading b moves its point at distance at most
R from r along p = r + rot(b) q, so that p'' = r'' + rot(b) (b'' J q - b'^2 q), with J the quarter turn, and

    |p''| <= |r''| + R (|b''| + b'^2) <= m.

Linear interpolation between p(0) and p(D) is off by at most D^2 m / 8: let e(s) be the error, u the unit
vector along its largest value; u.e is a scalar function, 0 at both ends, |(u.e)''| <= m, so |u.e| is at most
s (D - s) m / 2. The interpolated point lies in the convex hull of the footprints at both ends. So **the area swept
lies within D^2 m / 8 of that hull**, with R the distance of the farthest corner, and the bounds

    truck    r = c: |r''| = |theta'| <= k, |b'| <= k, |b''| <= k1, where, phi being linear,
             k = tan(max|phi|) / l and k1 = |dphi/ds| (1 + tan(max|phi|)^2) / l
    trailer  r = c - M (cos theta, sin theta): |r''| <= k + |M| (k1 + k^2)
             b' = theta' + alpha' = -(d sin(alpha) + M cos(alpha) theta') / l_t, so |b'| <= (S + |M| k) / l_t
             b'' = -((d cos(alpha) - M sin(alpha) theta') alpha' + M cos(alpha) theta'') / l_t,
             so |b''| <= ((1 + |M| k) A + |M| k1) / l_t, where A bounds |alpha'| and S bounds |sin(alpha)|:
             S = min(1, |sin(alpha(0))| + D (1 / l_t + (1 + |M| / l_t) k)),  A = S / l_t + (1 + |M| / l_t) k

How much too wide is the hull? Any point of it is h = u a + (1 - u) b with a = r0 + rot(b0) qa of the first footprint
and b = r1 + rot(b1) qb of the second. The body is convex, so it holds q = u qa + (1 - u) qb, and linear interpolation
takes that point to h - u (1 - u) (rot(b0) - rot(b1)) (qa - qb). So **every point of the hull lies within
|b1 - b0| E / 4 + D^2 m / 8 of the area swept**, E the body's diagonal: of first order in D, on the inner side of a
turn, where the sides of a turning body leave a notch that the hull fills. A path may be rejected by the check of
clearance although it is free, but only if it comes nearer than that (`excess`) and twice the inflation.

The motion integrated from the stored start misses the stored end by the interval's defect, a body point by at
most |dr| + R |db|. That is added: the bound holds for the integrated motion, not only for exact samples.
"""

import math
from typing import NamedTuple

import numpy as np
import shapely

from optim.audit.data import Array, Float64, Int64, IntArray, PathData, SceneData, Shapes, VehicleData

BODIES = ("truck", "trailer")
PAIRS_AT_ONCE = 20_000
"""Overlapping pairs whose depth is computed in one go; bounds the memory (some 30 MB)."""


class Sweep(NamedTuple):
    """Signed distances of the inflated hulls, for M intervals and both bodies. Arrays have shape (M, 2)."""

    clearance: Float64[Array, "M 2"]
    """Distance from the nearest obstacle [m]; inf without any; minus penetration depth and inflation on overlap."""
    polygon: Int64[IntArray, "M 2"]
    """The obstacle concerned, -1 without obstacles."""
    room: Float64[Array, "M 2"]
    """Distance to the map's outline, from inside [m]; inf without an outline; negative outside."""
    inflation: Float64[Array, "M 2"]
    """Inflation of the hulls [m]."""


def integrate(vehicle: VehicleData, path: PathData, substep: float) -> tuple[Array, Array]:
    """All intervals at once from their stored starts, RK4, phi linear.

    Returns x, y, theta, alpha at the ends, shape (4, M), and the largest |alpha| on the way, shape (M,).
    """
    phi0, phi1, d = path.before[5], path.after[5], path.direction
    steps = max(1, math.ceil(float(path.ds.max()) / substep - 1e-6))
    h = path.ds / steps
    state, peak = path.before[1:5].copy(), np.abs(path.before[4])
    for i in range(steps):
        first, middle, last = (phi0 + (phi1 - phi0) * ((i + part) / steps) for part in (0.0, 0.5, 1.0))
        k1 = slope(vehicle, state, first, d)
        k2 = slope(vehicle, state + h / 2 * k1, middle, d)
        k3 = slope(vehicle, state + h / 2 * k2, middle, d)
        k4 = slope(vehicle, state + h * k3, last, d)
        state = state + h / 6 * (k1 + 2 * k2 + 2 * k3 + k4)
        peak = np.maximum(peak, np.abs(state[3]))
    return state, np.maximum(peak, np.abs(path.after[4]))


def slope(vehicle: VehicleData, state: Array, phi: Array, d: IntArray) -> Array:
    """d(x, y, theta, alpha)/ds, from the trailer's axle not slipping sideways. Shape (4, M)."""
    _, _, theta, alpha = state
    curvature = d * np.tan(phi) / vehicle.wheelbase
    sideways = d * np.sin(alpha) + vehicle.hitch_offset * curvature * np.cos(alpha)  # of the hitch, seen by the trailer
    return np.stack([d * np.cos(theta), d * np.sin(theta), curvature, -sideways / vehicle.hitch_to_axle - curvature])


def sweep(vehicle: VehicleData, scene: SceneData, path: PathData, defects: Array) -> Sweep:
    """Distances of the area swept in each interval; `defects` of x, y, theta, alpha have shape (4, M)."""
    corners = footprints(vehicle, path.samples)
    pairs = np.concatenate([corners[path.left], corners[path.left + 1]], axis=2)
    # of the points, whatever holds them: lines are made four times as quickly as sets of points
    hulls = np.asarray(shapely.convex_hull(shapely.linestrings(pairs.reshape(-1, 8, 2))))
    spread = inflation(vehicle, path, defects)
    distance, polygon = _signed_distances(hulls, scene.polygons)
    room = _distances_inside(hulls, scene.boundary)
    shape = spread.shape
    clearance, room = distance.reshape(shape) - spread, room.reshape(shape) - spread
    return Sweep(clearance, polygon.reshape(shape), room, spread)


def footprints(vehicle: VehicleData, samples: Array) -> Array:
    """Corners of truck and trailer for samples of shape (6, N). Shape (N, 2, 4, 2)."""
    _, x, y, theta, alpha, _ = samples
    offset = vehicle.hitch_offset
    hitch = x - offset * np.cos(theta), y - offset * np.sin(theta)
    truck = _box(x, y, theta, vehicle.truck_front, vehicle.truck_rear, vehicle.truck_width)
    trailer = _box(*hitch, theta + alpha, vehicle.trailer_front, vehicle.trailer_rear, vehicle.trailer_width)
    return np.stack([truck, trailer], axis=1)


def _box(x: Array, y: Array, heading: Array, front: float, rear: float, width: float) -> Array:
    ahead = np.stack([np.cos(heading), np.sin(heading)], axis=-1)
    left = np.stack([-ahead[:, 1], ahead[:, 0]], axis=-1) * (width / 2)
    middle = np.stack([x, y], axis=-1)
    nose, tail = middle + front * ahead, middle - rear * ahead
    return np.stack([tail - left, nose - left, nose + left, tail + left], axis=1)


def inflation(vehicle: VehicleData, path: PathData, defects: Array) -> Array:
    """Inflation of the hulls of both bodies [m], as derived above. Shape (M, 2)."""
    ds, before, after = path.ds, path.before, path.after
    wheelbase, l_t, offset = vehicle.wheelbase, vehicle.hitch_to_axle, abs(vehicle.hitch_offset)
    steer = np.maximum(np.abs(before[5]), np.abs(after[5]))
    k = np.where(steer < np.pi / 2, np.tan(steer) / wheelbase, np.inf)
    k1 = np.abs(after[5] - before[5]) / ds * (1.0 + (k * wheelbase) ** 2) / wheelbase
    fold = (1.0 + offset / l_t) * k
    sine = np.minimum(1.0, np.abs(np.sin(before[4])) + ds * (1.0 / l_t + fold))
    turn = (sine + offset * k) / l_t
    turn1 = ((1.0 + offset * k) * (sine / l_t + fold) + offset * k1) / l_t
    far = [
        np.hypot(max(vehicle.truck_front, vehicle.truck_rear), vehicle.truck_width / 2),
        np.hypot(max(vehicle.trailer_front, vehicle.trailer_rear), vehicle.trailer_width / 2),
    ]
    shift, heading, hitch = (
        np.hypot(defects[0], defects[1]),
        np.abs(defects[2]),
        np.abs(defects[2] + defects[3]),
    )
    truck = ds**2 / 8 * (k + far[0] * (k1 + k**2)) + shift + far[0] * heading
    trailer = ds**2 / 8 * (k + offset * (k1 + k**2) + far[1] * (turn1 + turn**2))
    return np.stack([truck, trailer + shift + offset * heading + far[1] * hitch], axis=1)


def excess(vehicle: VehicleData, path: PathData) -> Array:
    """Upper bound of the hulls' reach beyond linear interpolation of the motion, for both bodies [m]. Shape (M, 2)."""
    truck = np.abs(path.after[3] - path.before[3])
    trailer = np.abs(path.after[3] + path.after[4] - path.before[3] - path.before[4])
    diagonals = (
        math.hypot(vehicle.truck_front + vehicle.truck_rear, vehicle.truck_width),
        math.hypot(vehicle.trailer_front + vehicle.trailer_rear, vehicle.trailer_width),
    )
    return np.stack([truck, trailer], axis=1) * np.array(diagonals) / 4


def _signed_distances(hulls: Shapes, polygons: Shapes) -> tuple[Array, IntArray]:
    """Distance to the nearest polygon, and its index; on overlap minus the depth, of the deepest one."""
    nearest = np.full(len(hulls), -1)
    distance = np.full(len(hulls), np.inf)
    if len(polygons) == 0:
        return distance, nearest
    tree = shapely.STRtree(polygons)
    (which, found), away = tree.query_nearest(hulls, return_distance=True, all_matches=False)
    distance[which], nearest[which] = away, found
    touching = np.flatnonzero(distance == 0.0)
    rows, found = tree.query(hulls[touching], predicate="intersects")
    rows = touching[rows]
    starts = range(0, len(rows), PAIRS_AT_ONCE)
    parts = [slice(start, start + PAIRS_AT_ONCE) for start in starts]
    depths = [_depths(hulls[rows[part]], polygons[found[part]]) for part in parts]
    depth = np.concatenate([np.empty(0), *depths])
    order = np.argsort(depth, kind="stable")  # of a hull's several overlaps the deepest is written last, and stays
    distance[rows[order]], nearest[rows[order]] = -depth[order], found[order]
    return distance, nearest


def _depths(one: Shapes, other: Shapes) -> Array:
    """Distance to move one of two overlapping convex polygons to part them [m]. Shape (P,).

    The shortest such move is along the normal of an edge of either. What is not convex counts as its hull.
    """
    a, b = _padded(one), _padded(other)
    edges = np.concatenate([np.roll(a, -1, axis=1) - a, np.roll(b, -1, axis=1) - b], axis=1)
    lengths = np.hypot(edges[..., 0], edges[..., 1])
    normals = np.stack([edges[..., 1], -edges[..., 0]], axis=-1) / np.where(lengths > 0.0, lengths, 1.0)[..., None]
    along_a, along_b = (np.einsum("pec,pvc->pev", normals, points) for points in (a, b))
    forth, back = along_a.max(axis=2) - along_b.min(axis=2), along_b.max(axis=2) - along_a.min(axis=2)
    return np.where(lengths > 0.0, np.minimum(forth, back), np.inf).min(axis=1).clip(min=0.0)


def _padded(areas: Shapes) -> Array:
    """Vertices of the hulls, filled up by repeating each one's last vertex. Shape (P, largest number, 2)."""
    points, owner = shapely.get_coordinates(shapely.convex_hull(areas), return_index=True)
    counts = np.bincount(owner, minlength=len(areas))
    column = np.minimum(np.arange(counts.max())[None, :], counts[:, None] - 1)
    return points[(np.cumsum(counts) - counts)[:, None] + column]


def _distances_inside(hulls: Shapes, outline: shapely.Polygon | None) -> Array:
    """Distance of each hull to the outline from inside; of those not inside, minus how far they reach out."""
    if outline is None:
        return np.full(len(hulls), np.inf)
    shapely.prepare(outline)
    inside = shapely.covers(outline, hulls)
    room = np.where(inside, shapely.distance(hulls, shapely.get_exterior_ring(outline)), 0.0)
    points, owner = shapely.get_coordinates(hulls[~inside], return_index=True)
    beyond = np.full(int((~inside).sum()), np.finfo(float).tiny)  # never 0: it is outside
    np.maximum.at(beyond, owner, shapely.distance(shapely.points(points), outline))
    room[~inside] = -beyond
    return room
