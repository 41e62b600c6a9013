"""Kernels: what holds at a knot (clearance, hitch angle, goal), as terms of the augmented Lagrangian.

With the multiplier lambda and the penalty rho, after Powell, Hestenes and Rockafellar:

    c <= 0:  (max(0, lambda + rho c)^2 - lambda^2) / (2 rho)          c = 0:  lambda c + rho c^2 / 2
"""

import math
from typing import NamedTuple

from optim.geometry.collision import rectangle
from optim.geometry.polygons import PackedScene
from optim.methods.ddp.features import OTHER, POINT, SIDE, contact_of
from optim.numerics.arrays import Array, Float64, Int64, IntArray
from optim.numerics.kernel import kernel

NEAREST = 0.01
"""Least slack [m, rad] that the metric distinguishes from none."""
CLOSEST = 1e-3
"""Distance of two points [m] below which the curvature 1 / d of their distance no longer grows."""


class PerConstraint(NamedTuple):
    """One number for each kind of constraint: penalties, tolerances, residuals."""

    goal: float
    """[m, rad]"""
    hitch: float
    """[rad]"""
    clearance: float
    """[m]"""


class Residuals(NamedTuple):
    """The largest residuals of each kind of constraint."""

    complementary: PerConstraint
    """What decides convergence: for the inequalities |max(c, -lambda / rho)|, which also sees a force where nothing
    touches."""
    violation: PerConstraint
    """What decides feasibility: for the inequalities max(c, 0)."""


class ClearanceRows(NamedTuple):
    """Features of bodies and polygons that are near each other (`optim.methods.ddp.features`), ordered by knot."""

    first: Int64[IntArray, " _"]
    """Knot k owns the rows first[k] to first[k + 1] - 1. Shape (N + 2,)."""
    body: Int64[IntArray, " R"]
    """0 the truck, 1 the trailer. Shape (R,)."""
    polygon: Int64[IntArray, " R"]
    """Shape (R,)."""
    feature: Int64[IntArray, " R"]
    """Shape (R,)."""
    multiplier: Float64[Array, " R"]
    """Shape (R,)."""


class Lagrangian(NamedTuple):
    """Penalties, multipliers of everything but the clearance rows, and what the constraints ask for."""

    penalty: PerConstraint
    """rho [1/m^2, 1/rad^2]."""
    goal: Float64[Array, " 4"]
    """Shape (4,)."""
    goal_multiplier: Float64[Array, " 4"]
    """Shape (4,)."""
    max_hitch: float
    """Largest hitch angle [rad]."""
    hitch_multiplier: Float64[Array, "S 2"]
    """Multipliers of alpha <= limit and -alpha <= limit at each knot. Shape (N + 1, 2)."""
    required: Float64[Array, "S 2"]
    """Clearance of truck and trailer at each knot [m]. Shape (N + 1, 2)."""


class Bodies(NamedTuple):
    """Truck and trailer."""

    footprints: Float64[Array, "2 3"]
    """Footprints of truck and trailer, as in `Vehicle.footprints`."""
    hitch_offset: float
    """M [m]."""


class Constraints(NamedTuple):
    """Everything that the terms of a knot are made of."""

    scene: PackedScene
    bodies: Bodies
    rows: ClearanceRows
    lagrangian: Lagrangian


class _Force(NamedTuple):
    """What a clearance row does to its knot."""

    value: float  # lambda + rho c, or 0
    penalty: float
    slack: float  # distance from where the row is felt [m]


@kernel
def knot_terms(scene, bodies, rows, lagrangian, states, k, derive, e):
    """The terms of knot k. With derive > 0 their derivatives by x, y, theta, alpha are added to the Expansion.

    derive 1 adds the Gauss-Newton part rho c_x c_x' only, derive 2 the curvature of the distances to `bend`. A row
    that is not felt yet adds c_x c_x' / slack to the metric: without it, steps along a flat valley run into walls
    that the quadratic model does not see, and no line search helps.
    """
    last = states.shape[0] - 1
    total = 0.0
    if 0 < k < last:
        total = _hitch_terms(total, lagrangian, states, k, derive, e)
    penalty = lagrangian.penalty.clearance
    for row in range(rows.first[k], rows.first[k + 1]):
        body, multiplier = rows.body[row], rows.multiplier[row]
        rect = rectangle(scene, bodies.footprints, bodies.hitch_offset, states, k, body)
        contact = contact_of(scene, rows.polygon[row], rows.feature[row], rect)
        force = max(0.0, multiplier + penalty * (lagrangian.required[k, body] - contact.distance))
        total += (force * force - multiplier * multiplier) / (2.0 * penalty)
        if derive > 0:
            slack = contact.distance - lagrangian.required[k, body] - multiplier / penalty
            row_force = _Force(force, penalty, slack)
            _add_row(scene.origin, bodies.hitch_offset, states, k, body, contact, row_force, derive == 2, e)
    if k == last:
        total = _goal_terms(total, lagrangian, states, k, derive, e)
    return total


@kernel
def _hitch_terms(total, lagrangian, states, k, derive, e):
    """`total` and the terms of the hitch angle."""
    penalty, limit = lagrangian.penalty.hitch, lagrangian.max_hitch
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
    return total


@kernel
def _goal_terms(total, lagrangian, states, k, derive, e):
    """`total` and the terms of the goal."""
    penalty = lagrangian.penalty.goal
    for i in range(4):
        miss, multiplier = states[k, i] - lagrangian.goal[i], lagrangian.goal_multiplier[i]
        total += (multiplier + 0.5 * penalty * miss) * miss
        if derive > 0:
            e.lz[k, i] += multiplier + penalty * miss
            e.lzz[k, i, i] += penalty
    return total


@kernel
def _add_row(origin, offset, states, k, body, contact, row, curvature, e):
    """Derivatives of a clearance term; with `curvature`, those of the distance as well; without force, the metric."""
    nx, ny, force = contact.nx, contact.ny, row.value
    # b relative to the rear axle and to the body's reference point
    ax, ay = contact.bx + origin[0] - states[k, 0], contact.by + origin[1] - states[k, 1]
    rx, ry = ax, ay
    if body == 1:
        rx, ry = ax + offset * math.cos(states[k, 2]), ay + offset * math.sin(states[k, 2])
    lever, turn = ny * ax - nx * ay, ny * rx - nx * ry
    slope = (nx, ny, lever, turn if body == 1 else 0.0)
    if force <= 0.0:
        for i in range(4):
            for j in range(4):
                e.metric[k, i, j] += slope[i] * slope[j] / max(row.slack, NEAREST)
        return
    for i in range(4):
        e.lz[k, i] -= force * slope[i]
        for j in range(4):
            e.lzz[k, i, j] += row.penalty * slope[i] * slope[j]
    if not curvature or offset != 0.0 or contact.kind == OTHER:
        return
    # psi = theta (truck) or theta + alpha (trailer)
    bend = -(nx * rx + ny * ry)
    if contact.kind == SIDE:
        bend = -(bend + contact.distance)  # -n . (r - o), since r - o = (r - b) + d n
        last = 4 if body == 1 else 3
        for i in range(2, last):
            e.bend[k, 0, i] += force * ny
            e.bend[k, i, 0] += force * ny
            e.bend[k, 1, i] -= force * nx
            e.bend[k, i, 1] -= force * nx
    elif contact.kind == POINT:
        way = -ny * -ry + nx * rx  # t . J (b - r), t = (-ny, nx)
        across = (-ny, nx, way, way if body == 1 else 0.0)
        for i in range(4):
            for j in range(4):
                e.bend[k, i, j] -= force * across[i] * across[j] / max(contact.distance, CLOSEST)
    for i in range(2, 4 if body == 1 else 3):
        for j in range(2, 4 if body == 1 else 3):
            e.bend[k, i, j] -= force * bend


@kernel
def residuals(constraints, states, update):
    """The Residuals; `update` moves lambda."""
    scene, bodies, rows, lagrangian = constraints
    penalty, limit = lagrangian.penalty, lagrangian.max_hitch
    goal_miss, hitch_miss, clearance_miss, hitch_over, clearance_short = 0.0, 0.0, 0.0, 0.0, 0.0
    last = states.shape[0] - 1
    for i in range(4):
        miss = states[last, i] - lagrangian.goal[i]
        goal_miss = max(goal_miss, abs(miss))
        if update:
            lagrangian.goal_multiplier[i] += penalty.goal * miss
    for k in range(1, last):
        for side in range(2):
            sign = 1.0 if side == 0 else -1.0
            c, multiplier = sign * states[k, 3] - limit, lagrangian.hitch_multiplier[k, side]
            hitch_miss, hitch_over = max(hitch_miss, abs(max(c, -multiplier / penalty.hitch))), max(hitch_over, c)
            if update:
                lagrangian.hitch_multiplier[k, side] = max(0.0, multiplier + penalty.hitch * c)
        for row in range(rows.first[k], rows.first[k + 1]):
            rect = rectangle(scene, bodies.footprints, bodies.hitch_offset, states, k, rows.body[row])
            distance = contact_of(scene, rows.polygon[row], rows.feature[row], rect).distance
            c = lagrangian.required[k, rows.body[row]] - distance
            clearance_miss = max(clearance_miss, abs(max(c, -rows.multiplier[row] / penalty.clearance)))
            clearance_short = max(clearance_short, c)
            if update:
                rows.multiplier[row] = max(0.0, rows.multiplier[row] + penalty.clearance * c)
    return Residuals(
        PerConstraint(goal_miss, hitch_miss, clearance_miss), PerConstraint(goal_miss, hitch_over, clearance_short)
    )
