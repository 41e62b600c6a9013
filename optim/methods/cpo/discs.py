"""Discs that contain the bodies, and what the obstacles near them cost.

Each rectangle is covered by small discs round square cells along its outline and by larger ones inside. The union
contains the rectangle, so that what keeps clear of the discs keeps clear of the body, and it protrudes by a stated
excess only: a row of few large discs along the axis would protrude by half a metre beyond the bumpers, where a
docking trailer has none to give away.

The bodies stand where the flat map puts them: x_i is the trailer's axle, psi_i its heading, kappa_i its curvature,

    trailer's disc  p = x_i + (l_t + a) e(psi) + b n(psi)
    truck's disc    p = x_i + l_t e(psi) + a e(theta) + b n(theta),   theta = psi + atan(l_t kappa)

with a, b the disc's centre ahead and left of the hitch, e the unit vector and n its quarter turn.
"""

import math
from dataclasses import dataclass
from typing import NamedTuple

import numpy as np

from optim.geometry.field import DistanceField
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, BoolArray, Float64, Int64, IntArray, frozen, frozen_int


@dataclass(frozen=True, eq=False)
class Discs:
    """D discs fixed to the bodies."""

    body: Int64[IntArray, " D"]
    """0 the truck, 1 the trailer. Shape (D,)."""
    centre: Float64[Array, "D 2"]
    """Ahead and left of the hitch in the body's own frame [m]. Shape (D, 2)."""
    radius: Float64[Array, " D"]
    """Radius [m]. Shape (D,)."""
    width: Float64[Array, " D"]
    """Weight of a disc in the obstacle term [m]: its share of the outline. Shape (D,)."""


def covering_discs(vehicle: Vehicle, excess: float) -> Discs:
    """Discs that contain truck and trailer and protrude by at most `excess` [m]."""
    rows = [
        (body, *disc)
        for body, (front, rear, half) in enumerate(vehicle.footprints)
        for disc in _cover(-rear, front, half, excess)
    ]
    body, x, y, radius, width = np.array(rows).T
    return Discs(frozen_int(body), frozen(np.stack([x, y], axis=1)), frozen(radius), frozen(width))


def axle_point(vehicle: Vehicle) -> Discs:
    """The trailer's axle as a disc without extent: the source's view of the combination."""
    centre = frozen([[-vehicle.hitch_to_axle, 0.0]])
    return Discs(frozen_int([1]), centre, frozen([0.0]), frozen([1.0]))


def _cover(low: float, high: float, half: float, excess: float) -> list[tuple[float, float, float, float]]:
    """Discs (x, y, radius, width) that contain [low, high] x [-half, half] and protrude by at most `excess`."""
    across = 1
    while True:
        b = 2.0 * half / across
        along = max(1, math.ceil((high - low) / b - 1e-9))
        a = (high - low) / along
        radius = 0.5 * math.hypot(a, b)
        if radius - 0.5 * a <= excess:  # a <= b: the larger of both protrusions
            break
        across += 1
    discs = [
        (low + (i + 0.5) * a, (j + 0.5) * b - half, radius, b)
        for i in range(along)
        for j in range(across)
        if i in (0, along - 1) or j in (0, across - 1)
    ]
    if along > 2 and across > 2:
        discs += _cover(low + a, high - a, half - b, a)  # the ring round it leaves larger discs room to protrude
    return discs


class Nearness(NamedTuple):
    """The obstacle term and its derivatives by (x, y, psi, kappa) of each point, N points."""

    value: float
    gradient: Float64[Array, "N 4"]
    metric: Float64[Array, "N 4 4"]  # Gauss-Newton's share of the second derivatives


def obstacle_term(
    vehicle: Vehicle,
    discs: Discs,
    field: DistanceField,
    d_max: float,
    pose: Array,
    weight: Array,
    with_metric: bool = True,
) -> Nearness:
    """sum over points i, discs j of weight_i width_j max(0, d_max - (distance(p_ij) - radius_j))^2.

    pose: (N, 4) trailer axle x, y [m], heading psi [rad], curvature kappa [1/m]; weight: (N,). Without it the metric
    is 0.
    """
    l_t = vehicle.hitch_to_axle
    fold = np.arctan(l_t * pose[:, 3])
    hitch = pose[:, :2] + l_t * _unit(pose[:, 2])
    gradient, metric, value = np.zeros((len(pose), 4)), np.zeros((len(pose), 4, 4)), 0.0
    for body, heading in ((0, pose[:, 2] + fold), (1, pose[:, 2])):
        mine = discs.body == body
        if not mine.any():
            continue
        index, disc = _near(discs, mine, field, d_max, hitch, heading)
        ahead = _unit(heading[index])
        arm = discs.centre[disc, :1] * ahead + discs.centre[disc, 1:] * _quarter(ahead)
        points = hitch[index] + arm
        distance, slope = field.evaluate(points)
        short = np.maximum(0.0, d_max - distance + discs.radius[disc])
        factor = weight[index] * discs.width[disc]
        value += float(np.sum(factor * short**2))
        rows = np.zeros((len(index), 4))
        rows[:, :2] = slope
        rows[:, 2] = np.sum(slope * _quarter(points - pose[index, :2]), axis=1)
        if body == 0:
            rows[:, 3] = np.sum(slope * _quarter(arm), axis=1) * l_t / (1.0 + (l_t * pose[index, 3]) ** 2)
        for a in range(4):
            gradient[:, a] -= np.bincount(index, 2.0 * factor * short * rows[:, a], len(pose))
            for b in range(4 if with_metric else 0):
                active = 2.0 * factor * (short > 0.0) * rows[:, a] * rows[:, b]
                metric[:, a, b] += np.bincount(index, active, len(pose))
    return Nearness(value, gradient, metric)


def _near(
    discs: Discs, mine: BoolArray, field: DistanceField, d_max: float, hitch: Array, heading: Array
) -> tuple[IntArray, IntArray]:
    """Pairs of point and disc that may be nearer than d_max: a body far from everything has none."""
    low, high = discs.centre[mine].min(axis=0), discs.centre[mine].max(axis=0)
    middle = 0.5 * (low + high)
    reach = 0.5 * float(np.hypot(*(high - low))) + float(discs.radius[mine].max()) + d_max
    ahead = _unit(heading)
    distance, _ = field.evaluate(hitch + middle[0] * ahead + middle[1] * _quarter(ahead))
    # the interpolant's slope exceeds 1 by little, and only beside corners: two cells are room enough
    points = np.flatnonzero(distance < 1.1 * reach + 2.0 * field.resolution)
    own = np.flatnonzero(mine)
    return np.repeat(points, len(own)), np.tile(own, len(points))


def _unit(angle: Array) -> Array:
    return np.stack([np.cos(angle), np.sin(angle)], axis=-1)


def _quarter(vector: Array) -> Array:
    """The vector turned left by a right angle."""
    return np.stack([-vector[..., 1], vector[..., 0]], axis=-1)
