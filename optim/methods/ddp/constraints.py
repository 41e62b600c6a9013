"""Kernels: what holds at a knot (clearance, hitch angle, goal), as terms of the augmented Lagrangian.

With the multiplier lambda and the penalty rho, after Powell, Hestenes and Rockafellar:

    c <= 0:  (max(0, lambda + rho c)^2 - lambda^2) / (2 rho)          c = 0:  lambda c + rho c^2 / 2
"""

import math
from typing import NamedTuple

from optim.geometry.collision import rectangle
from optim.methods.ddp.features import OTHER, POINT, SIDE, feature_distance
from optim.numerics.arrays import Array, IntArray
from optim.numerics.kernel import kernel

NEAREST = 0.01
"""Least slack [m, rad] that the metric tells from none."""
CLOSEST = 1e-3
"""Distance of two points [m] below which the curvature 1 / d of their distance no longer grows."""


class Rows(NamedTuple):
    """Features of bodies and polygons that are near each other (`optim.methods.ddp.features`), ordered by knot."""

    first: IntArray
    """Knot k owns the rows first[k] to first[k + 1] - 1. Shape (N + 2,)."""
    body: IntArray
    """0 the truck, 1 the trailer. Shape (R,)."""
    polygon: IntArray
    """Shape (R,)."""
    feature: IntArray
    """Shape (R,)."""
    multiplier: Array
    """Shape (R,)."""


class Lagrangian(NamedTuple):
    """Multipliers and penalties of everything but the clearance rows, and what the constraints ask for."""

    goal: Array
    """Shape (4,)."""
    goal_multiplier: Array
    """Shape (4,)."""
    hitch_multiplier: Array
    """Of alpha <= limit and -alpha <= limit at each knot. Shape (N + 1, 2)."""
    required: Array
    """Clearance of truck and trailer at each knot [m]. Shape (N + 1, 2)."""
    scalars: Array
    """Penalty of the goal, of the hitch angle, of the clearance; largest hitch angle [rad]. Shape (4,)."""


@kernel
def _add_row(scene, offset, states, k, body, contact, force, penalty, slack, curvature, e):
    """Derivatives of a clearance term; with `curvature`, those of the distance as well; without force, the metric."""
    distance, bx, by, nx, ny, kind = contact
    # b relative to the rear axle and to the body's reference point
    ax, ay = bx + scene.origin[0] - states[k, 0], by + scene.origin[1] - states[k, 1]
    rx, ry = ax, ay
    if body == 1:
        rx, ry = ax + offset * math.cos(states[k, 2]), ay + offset * math.sin(states[k, 2])
    lever, turn = ny * ax - nx * ay, ny * rx - nx * ry
    slope = (nx, ny, lever, turn if body == 1 else 0.0)
    if force <= 0.0:
        for i in range(4):
            for j in range(4):
                e.metric[k, i, j] += slope[i] * slope[j] / max(slack, NEAREST)
        return
    for i in range(4):
        e.lz[k, i] -= force * slope[i]
        for j in range(4):
            e.lzz[k, i, j] += penalty * slope[i] * slope[j]
    if not curvature or offset != 0.0 or kind == OTHER:
        return
    # psi = theta (truck) or theta + alpha (trailer)
    bend = -(nx * rx + ny * ry)
    if kind == SIDE:
        bend = -(bend + distance)  # -n . (r - o), since r - o = (r - b) + d n
        last = 4 if body == 1 else 3
        for i in range(2, last):
            e.bend[k, 0, i] += force * ny
            e.bend[k, i, 0] += force * ny
            e.bend[k, 1, i] -= force * nx
            e.bend[k, i, 1] -= force * nx
    elif kind == POINT:
        way = -ny * -ry + nx * rx  # t . J (b - r), t = (-ny, nx)
        across = (-ny, nx, way, way if body == 1 else 0.0)
        for i in range(4):
            for j in range(4):
                e.bend[k, i, j] -= force * across[i] * across[j] / max(distance, CLOSEST)
    for i in range(2, 4 if body == 1 else 3):
        for j in range(2, 4 if body == 1 else 3):
            e.bend[k, i, j] -= force * bend


@kernel
def knot_terms(scene, footprints, offset, rows, lagrangian, states, k, derive, e):
    """The terms of knot k. With derive > 0 their derivatives by x, y, theta, alpha are added to the Expansion.

    derive 1 adds the Gauss-Newton part rho c_x c_x' only, derive 2 the curvature of the distances to `bend`. A row
    that is not felt yet adds c_x c_x' / slack to the metric: without it, steps along a flat valley run into walls
    that the quadratic model does not see, and no line search helps.
    """
    total = 0.0
    penalty, limit = lagrangian.scalars[1], lagrangian.scalars[3]
    last = states.shape[0] - 1
    if 0 < k < last:
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            multiplier = lagrangian.hitch_multiplier[k, side]
            force = max(0.0, multiplier + penalty * (sign * states[k, 3] - limit))
            total += (force * force - multiplier * multiplier) / (2.0 * penalty)
            if derive > 0 and force > 0.0:
                e.lz[k, 3] += sign * force
                e.lzz[k, 3, 3] += penalty
            elif derive > 0:
                slack = limit - sign * states[k, 3] - multiplier / penalty
                e.metric[k, 3, 3] += 1.0 / max(slack, NEAREST)
    penalty = lagrangian.scalars[2]
    for row in range(rows.first[k], rows.first[k + 1]):
        body, multiplier = rows.body[row], rows.multiplier[row]
        rect = rectangle(scene, footprints, offset, states, k, body)
        contact = feature_distance(scene, rows.polygon[row], rows.feature[row], rect)
        force = max(0.0, multiplier + penalty * (lagrangian.required[k, body] - contact[0]))
        total += (force * force - multiplier * multiplier) / (2.0 * penalty)
        if derive > 0:
            slack = contact[0] - lagrangian.required[k, body] - multiplier / penalty
            _add_row(scene, offset, states, k, body, contact, force, penalty, slack, derive == 2, e)
    if k == last:
        penalty = lagrangian.scalars[0]
        for i in range(4):
            miss, multiplier = states[k, i] - lagrangian.goal[i], lagrangian.goal_multiplier[i]
            total += (multiplier + 0.5 * penalty * miss) * miss
            if derive > 0:
                e.lz[k, i] += multiplier + penalty * miss
                e.lzz[k, i, i] += penalty
    return total


@kernel
def residuals(scene, footprints, offset, rows, lagrangian, states, update):
    """Largest residuals of goal, hitch angle and clearance, and the violations of the last two; `update` moves lambda.

    The residuals of inequalities, |max(c, -lambda / rho)|, also see a force where nothing touches; their violations
    are max(c, 0).
    """
    goal_miss, hitch_miss, clearance_miss, hitch_over, clearance_short = 0.0, 0.0, 0.0, 0.0, 0.0
    last = states.shape[0] - 1
    for i in range(4):
        miss = states[last, i] - lagrangian.goal[i]
        goal_miss = max(goal_miss, abs(miss))
        if update:
            lagrangian.goal_multiplier[i] += lagrangian.scalars[0] * miss
    for k in range(1, last):
        for side in range(2):
            sign, penalty = 1.0 if side == 0 else -1.0, lagrangian.scalars[1]
            c, multiplier = sign * states[k, 3] - lagrangian.scalars[3], lagrangian.hitch_multiplier[k, side]
            hitch_miss, hitch_over = max(hitch_miss, abs(max(c, -multiplier / penalty))), max(hitch_over, c)
            if update:
                lagrangian.hitch_multiplier[k, side] = max(0.0, multiplier + penalty * c)
        penalty = lagrangian.scalars[2]
        for row in range(rows.first[k], rows.first[k + 1]):
            rect = rectangle(scene, footprints, offset, states, k, rows.body[row])
            distance = feature_distance(scene, rows.polygon[row], rows.feature[row], rect)[0]
            c = lagrangian.required[k, rows.body[row]] - distance
            clearance_miss = max(clearance_miss, abs(max(c, -rows.multiplier[row] / penalty)))
            clearance_short = max(clearance_short, c)
            if update:
                rows.multiplier[row] = max(0.0, rows.multiplier[row] + penalty * c)
    return goal_miss, hitch_miss, clearance_miss, hitch_over, clearance_short
