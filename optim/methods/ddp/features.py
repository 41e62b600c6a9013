"""Kernels: clearance as smooth constraints between features of a body and a polygon.

The distance of two convex shapes apart is the least of the distances of each vertex of one from the other shape. Each
of these is once continuously differentiable, while their minimum has a kink wherever the nearest feature changes: a
force on the nearest point alone jumps from end to end of a long side along a wall, and no line search gets across.
So every feature that is near is a constraint of its own, with its own multiplier:

    a polygon's vertex from the body         feature >= 0, the vertex's index in the packed scene
    a body's corner from the polygon         CORNER - i, i = 0 .. 3
    both shapes, where they overlap          OVERLAP, by the separating axis: they may cross with no vertex inside

With the point b of the body nearest to the obstacle, n the unit normal from the obstacle to the body, t = J n the
quarter turn of n, p the rear axle, r the body's reference point and psi its heading, the derivatives are

    d_p = n,  d_psi = n . J (b - r)                and second ones, for a corner fixed to the body
    d_psi,psi = -n . (b - r)                       plus, where two vertices meet, (t . db)(t . db)' / d,
    for a vertex against a side of the body        d_p,psi = t,  d_psi,psi = -n . (r - o).
"""

import math
from typing import NamedTuple

import numpy as np

from optim.geometry.collision import rectangle, signed_distance
from optim.geometry.separation import nearest_polygons
from optim.numerics.kernel import kernel

CORNER, OVERLAP = -1, -5
POINT, SIDE, EDGE, OTHER = 0, 1, 2, 3  # what faces what: two points; a side of the body, a vertex; an edge, a corner


class Contact(NamedTuple):
    """Where a feature is nearest."""

    distance: float
    """Signed [m]."""
    bx: float
    """The point b of the body, relative to the scene's origin [m]."""
    by: float
    nx: float
    """The unit normal n from the obstacle to the body."""
    ny: float
    kind: int
    """POINT, SIDE, EDGE or OTHER."""


@kernel
def vertex_distance(scene, vertex, rect):
    """Contact of a polygon's vertex with a rectangle."""
    cx, cy, c, s, hx, hy = rect
    dx, dy = scene.vertices[vertex, 0] - cx, scene.vertices[vertex, 1] - cy
    u, v = c * dx + s * dy, c * dy - s * dx
    over_u, over_v = abs(u) - hx, abs(v) - hy
    if over_u > 0.0 and over_v > 0.0:
        distance = math.hypot(over_u, over_v)
        bu, bv = math.copysign(hx, u), math.copysign(hy, v)
        nu, nv, kind = (bu - u) / distance, (bv - v) / distance, POINT
    elif over_u > over_v:
        distance, bu, bv, nu, nv, kind = over_u, math.copysign(hx, u), v, -math.copysign(1.0, u), 0.0, SIDE
    else:
        distance, bu, bv, nu, nv, kind = over_v, u, math.copysign(hy, v), 0.0, -math.copysign(1.0, v), SIDE
    bx, by = cx + c * bu - s * bv, cy + s * bu + c * bv
    return Contact(distance, bx, by, c * nu - s * nv, s * nu + c * nv, kind)


@kernel
def corner_distance(scene, polygon, corner, rect):
    """Contact of a rectangle's corner with a polygon."""
    cx, cy, c, s, hx, hy = rect
    u = hx if corner in (1, 2) else -hx
    v = hy if corner >= 2 else -hy
    bx, by = cx + c * u - s * v, cy + s * u + c * v
    begin, end = scene.first[polygon], scene.first[polygon + 1]
    height, best = -math.inf, begin
    for i in range(begin, end):
        over = scene.normals[i, 0] * (bx - scene.vertices[i, 0]) + scene.normals[i, 1] * (by - scene.vertices[i, 1])
        if over > height:
            height, best = over, i
    nx, ny = scene.normals[best, 0], scene.normals[best, 1]
    if height <= 0.0:
        return Contact(height, bx, by, nx, ny, EDGE)
    # outside: the nearest point is on the edge, or a vertex; walk from the highest edge
    nearest, nearest_x, nearest_y, kind = math.inf, nx, ny, EDGE
    for i in range(begin, end):
        rx, ry = bx - scene.vertices[i, 0], by - scene.vertices[i, 1]
        squared = rx * rx + ry * ry
        if squared < nearest * nearest:
            nearest = math.sqrt(squared)
            if nearest > 0.0:
                nearest_x, nearest_y, kind = rx / nearest, ry / nearest, POINT
        mx, my = scene.normals[i, 0], scene.normals[i, 1]
        over = mx * rx + my * ry
        if 0.0 < over <= nearest and mx * ry - my * rx >= 0.0:
            after = i + 1 if i + 1 < end else begin
            if mx * (by - scene.vertices[after, 1]) - my * (bx - scene.vertices[after, 0]) <= 0.0:
                nearest, nearest_x, nearest_y, kind = over, mx, my, EDGE
    return Contact(nearest, bx, by, nearest_x, nearest_y, kind)


@kernel
def contact_of(scene, polygon, feature, rect):
    """Contact of one feature."""
    if feature >= 0:
        return vertex_distance(scene, feature, rect)
    if feature > OVERLAP:
        return corner_distance(scene, polygon, CORNER - feature, rect)
    distance, bx, by, _, _, nx, ny = signed_distance(scene, polygon, rect)
    return Contact(distance, bx, by, nx, ny, OTHER)


@kernel
def list_features(constraints, states, reach, most, new):
    """List the features nearer than `reach` at each knot; how many there are, also if too many for the arrays.

    Both ends of the path are given and have no rows.

    Args:
        constraints: the Constraints, with the rows of the last list; their multipliers are taken over, while a row
            that is new starts with 0.
        states: shape (N + 1, n).
        reach: [m].
        most: polygons near each body that are looked at, the nearest ones.
        new: the ClearanceRows to fill.
    """
    scene, bodies, old, _ = constraints
    near, order = np.empty(most), np.empty(most, np.int64)
    count = 0
    for k in range(states.shape[0]):
        new.first[k] = count
        if k == 0 or k == states.shape[0] - 1:
            continue
        for b in range(2):
            rect = rectangle(scene, bodies.footprints, bodies.hitch_offset, states, k, b)
            for m in range(nearest_polygons(scene, rect, reach, near, order)):
                p = order[m]
                begin, end = scene.first[p], scene.first[p + 1]
                for i in range(end - begin + 5):
                    code = begin + i if i < end - begin else CORNER - (i - end + begin)
                    if code == OVERLAP:
                        if near[m] > 0.0:
                            continue
                    elif contact_of(scene, p, code, rect).distance >= reach:
                        continue
                    if count < new.body.size:
                        new.body[count], new.polygon[count], new.feature[count], new.multiplier[count] = b, p, code, 0.0
                        for o in range(old.first[k], old.first[k + 1]):
                            if old.body[o] == b and old.feature[o] == code and old.polygon[o] == p:
                                new.multiplier[count] = old.multiplier[o]
                    count += 1
    new.first[states.shape[0]] = count
    return count
