"""Clearance of truck and trailer in a scene: nearest points, swept clearance, linearised distances.

Distances are exact and signed: Euclidean when body and obstacle are apart, minus the least depth of penetration
when they overlap. Formulas and proofs stand with the kernels, in `optim.geometry.collision`, `sweep` and `separation`.
"""

from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from optim.geometry.collision import collides_kernel, witness_kernel
from optim.geometry.field import DistanceField, sample_field
from optim.geometry.separation import separation_table
from optim.geometry.sweep import first_violation_kernel, swept_kernel
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64, Int64, IntArray, frozen, frozen_int


class Witnesses(NamedTuple):
    """Place where each body is nearest to the obstacles (or deepest in one); index 0 the truck, 1 the trailer.

    Without obstacles the distance is inf, the polygon -1 and everything else nan.
    """

    distance: Float64[Array, "N 2"]
    """Signed distance [m]. Shape (N, 2)."""
    on_body: Float64[Array, "N 2 2"]
    """Point of the body [m]. Shape (N, 2, 2)."""
    on_obstacle: Float64[Array, "N 2 2"]
    """Point of the obstacle [m]; on_body - distance * normal. Shape (N, 2, 2)."""
    normal: Float64[Array, "N 2 2"]
    """Unit vector from the obstacle to the body. Shape (N, 2, 2)."""
    polygon: Int64[IntArray, "N 2"]
    """Index in Scene.polygons. Shape (N, 2)."""


def witnesses(scene: Scene, vehicle: Vehicle, states: Array) -> Witnesses:
    """Nearest points of both bodies and the obstacles for states (N, 4)."""
    table = witness_kernel(scene.packed, vehicle.footprints, vehicle.hitch_offset, frozen(states))
    return Witnesses(
        distance=table[..., 0],
        on_body=table[..., 1:3],
        on_obstacle=table[..., 3:5],
        normal=table[..., 5:7],
        polygon=frozen_int(table[..., 7]),
    )


def clearance(scene: Scene, vehicle: Vehicle, states: Array) -> Array:
    """Signed distance [m] of truck and trailer to the nearest obstacle for states (N, 4). Shape (N, 2)."""
    return witnesses(scene, vehicle, states).distance


def collides(scene: Scene, vehicle: Vehicle, states: Array, margin: float = 0.0) -> NDArray[np.bool_]:
    """Whether either body is nearer to an obstacle than the margin [m], for states (N, 4). Shape (N,).

    The same as `clearance(...).min(axis=1) < margin`, by separating axes and much faster. Touching is not a collision.
    """
    return collides_kernel(scene.packed, vehicle.footprints, vehicle.hitch_offset, frozen(states), float(margin))


def swept_clearance(scene: Scene, vehicle: Vehicle, s: Array, states: Array, phi: Array | None = None) -> Array:
    """Proven lower bound [m] of the signed distance of truck and trailer on each interval. Shape (N - 1, 2).

    Args:
        scene: the obstacles.
        vehicle: the vehicle that moves.
        s: truck arc length of the samples [m], not decreasing. Shape (N,).
        states: samples of a motion of the vehicle. Shape (N, 4).
        phi: its steering, linear in between [rad], shape (N,). Without it the vehicle's limits on phi and dphi/ds
            (and 0.1 %) bound what happens between samples; give it for paths that exceed them.
    """
    return swept_kernel(scene.packed, vehicle.footprints, vehicle.motion_limits, *_motion(s, states, phi))


def first_violation(
    scene: Scene, vehicle: Vehicle, s: Array, states: Array, margin: float, phi: Array | None = None
) -> int:
    """Index of the first interval whose `swept_clearance` is below the margin [m], -1 if there is none.

    Arguments as for `swept_clearance`. Samples that cannot come near anything are skipped; the answer is the same.
    """
    motion, place = _motion(s, states, phi), (scene.packed, vehicle.footprints, vehicle.motion_limits)
    return int(first_violation_kernel(*place, *motion, float(margin)))


def _motion(s: Array, states: Array, phi: Array | None) -> tuple[Array, Array, Array]:
    """Samples as the kernels of the sweep take them; no steering is an empty array."""
    return frozen(s), frozen(states), frozen(np.empty(0) if phi is None else phi)


class Separations(NamedTuple):
    """R linearised distances, ordered by state and body."""

    knot: Int64[IntArray, " R"]
    """Index of the state. Shape (R,)."""
    body: Int64[IntArray, " R"]
    """0 the truck, 1 the trailer. Shape (R,)."""
    polygon: Int64[IntArray, " R"]
    """Index in Scene.polygons; a pair has one or two rows, the nearer first. Shape (R,)."""
    distance: Float64[Array, " R"]
    """Signed distance [m]; of a second row, the height there. Shape (R,)."""
    gradient: Float64[Array, "R 4"]
    """Derivative by (x, y, theta, alpha). Shape (R, 4)."""


def separations(scene: Scene, vehicle: Vehicle, states: Array, reach: float, most: int = 6) -> Separations:
    """The distances of truck and trailer from all polygons nearer than `reach` [m], for states (N, 4).

    At most the `most` nearest polygons of each body in each state; the nearest is always among them.
    """
    table = separation_table(scene.packed, vehicle.footprints, vehicle.hitch_offset, states, reach, most)
    knot, body, polygon = frozen_int(table[:, :3].T)
    return Separations(knot, body, polygon, frozen(table[:, 3]), frozen(table[:, 4:]))


def distance_field(scene: Scene, resolution: float, bounds: tuple[float, float, float, float]) -> DistanceField:
    """Signed distance [m] of points to the union of the obstacles, negative inside, interpolated on a grid.

    Args:
        scene: the obstacles.
        resolution: distance between nodes [m].
        bounds: (x_min, y_min, x_max, y_max) of the nodes [m]; the last row and column may lie beyond.
    """
    return sample_field(scene.packed, scene.polygons, resolution, bounds)
