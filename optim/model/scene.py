"""The obstacles of a map as convex polygons, and the clearance of truck and trailer from them.

Distances are exact and signed: Euclidean when body and obstacle are apart, minus the least depth of penetration when
they overlap. Formulas and proofs are where the kernels are, in `optim.geometry.collision` and `optim.geometry.sweep`.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import NamedTuple

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optim.geometry.collision import collides_kernel, witness_kernel
from optim.geometry.field import DistanceField, sample_field
from optim.geometry.polygons import PackedScene, convex_parts, pack, walls
from optim.geometry.sweep import first_violation_kernel, swept_kernel
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, IntArray, frozen, frozen_int

WALL_THICKNESS = 2.0
"""Depth of the walls round a map's outline [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """Obstacles of one map. `make_scene` builds it from any simple polygons."""

    polygons: tuple[Array, ...]
    """Convex, counter-clockwise, read-only vertices [m], each of shape (n, 2)."""
    boundary: Array | None = None
    """Outline of the map for drawing [m], shape (m, 2), counter-clockwise; its walls are among the polygons."""
    frame: str = "map"
    """Name of the coordinate frame."""

    @cached_property
    def packed(self) -> PackedScene:
        """The polygons and their tree of boxes, as the kernels read them."""
        return pack(self.polygons)


def make_scene(polygons: Sequence[ArrayLike], *, boundary: ArrayLike | None = None, frame: str = "map") -> Scene:
    """A scene of simple polygons, clockwise or not, closed or not; non-convex ones become several convex parts.

    `boundary`, a convex outline, adds walls 2 m thick just outside it. Raises ValueError that names the polygon's
    index and what is wrong with it (no area, crosses itself, not finite, wrong shape).
    """
    parts: list[Array] = []
    for index, polygon in enumerate(polygons):
        try:
            parts.extend(convex_parts(polygon))
        except ValueError as error:
            raise ValueError(f"obstacle {index}: {error}") from None
    if boundary is None:
        return Scene(polygons=tuple(parts), frame=frame)
    try:
        outline = convex_parts(boundary)
    except ValueError as error:
        raise ValueError(f"boundary: {error}") from None
    if len(outline) > 1:
        raise ValueError("boundary: it is not convex; give the forbidden area beside it as obstacles")
    parts.extend(walls(outline[0], WALL_THICKNESS))
    return Scene(polygons=tuple(parts), boundary=outline[0], frame=frame)


class Witnesses(NamedTuple):
    """Where each body is nearest to the obstacles (or deepest in one); index 0 the truck, 1 the trailer.

    Without obstacles the distance is inf, the polygon -1 and everything else nan.
    """

    distance: Array
    """Signed distance [m]. Shape (N, 2)."""
    on_body: Array
    """Point of the body [m]. Shape (N, 2, 2)."""
    on_obstacle: Array
    """Point of the obstacle [m]; on_body - distance * normal. Shape (N, 2, 2)."""
    normal: Array
    """Unit vector from the obstacle to the body. Shape (N, 2, 2)."""
    polygon: IntArray
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

    The same as `clearance(...).min(axis=1) < margin`, by separating axes and much faster. Touching is no collision.
    """
    return collides_kernel(scene.packed, vehicle.footprints, vehicle.hitch_offset, frozen(states), float(margin))


def swept_clearance(scene: Scene, vehicle: Vehicle, s: Array, states: Array, phi: Array | None = None) -> Array:
    """Proven lower bound [m] of the signed distance of truck and trailer on each interval. Shape (N - 1, 2).

    Args:
        s: truck arc length of the samples [m], not decreasing. Shape (N,).
        states: samples of a motion of the vehicle. Shape (N, 4).
        phi: its steering, linear in between [rad], shape (N,). Without it the vehicle's limits on phi and dphi/ds
            (and 0.1 %) bound what happens between samples; give it for paths that exceed them.
    """
    s, states, phi = _motion(s, states, phi)
    return swept_kernel(scene.packed, vehicle.footprints, _limits(vehicle), s, states, phi)


def first_violation(
    scene: Scene, vehicle: Vehicle, s: Array, states: Array, margin: float, phi: Array | None = None
) -> int:
    """Index of the first interval whose `swept_clearance` is below the margin [m], -1 if there is none.

    Arguments as for `swept_clearance`. Samples that cannot come near anything are skipped; the answer is the same.
    """
    s, states, phi = _motion(s, states, phi)
    found = first_violation_kernel(scene.packed, vehicle.footprints, _limits(vehicle), s, states, phi, float(margin))
    return int(found)


def _motion(s: Array, states: Array, phi: Array | None) -> tuple[Array, Array, Array]:
    return frozen(s), frozen(states), frozen(np.empty(0) if phi is None else phi)


def _limits(vehicle: Vehicle) -> tuple[float, float, float, float, float]:
    """What bounds the motion between samples: l, l_t, M, max_steer, max_steer_rate."""
    return (*vehicle.kinematics, vehicle.max_steer, vehicle.max_steer_rate)


def distance_field(scene: Scene, resolution: float, bounds: tuple[float, float, float, float]) -> DistanceField:
    """Signed distance [m] of points to the union of the obstacles, negative inside, interpolated on a grid.

    Args:
        resolution: distance between nodes [m].
        bounds: (x_min, y_min, x_max, y_max) of the nodes [m]; the last row and column may lie beyond.
    """
    return sample_field(scene.packed, scene.polygons, resolution, bounds)
