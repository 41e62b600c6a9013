"""Linearised distances of both bodies from every obstacle near them, as optimisers at knots need them.

For a body and a convex obstacle with the witness normal n (unit, from the obstacle to the body, see
`optim.geometry.collision`), the signed distance is the height of the body above the obstacle along n, and by the
envelope theorem its derivative by the state is that of a point b fixed to the body, n held fixed:

    truck    d(distance)/d(x, y, theta, alpha) = (n, n . J (b - axle), 0)
    trailer                                      (n, n . J (b - axle), n . J (b - hitch)),  J the quarter turn.

Where a side of the body faces a side of the obstacle, one point is not enough: the linearisation does not see that
turning brings the other end of the side nearer, and the witness jumps from end to end between iterations. The two
sides overlap along their common direction in an interval; **each end of it gives a row**. Both are necessary
conditions of separation along n, and the smaller of the two heights is the distance.
"""

import math

import numpy as np

from optim.geometry.collision import box_distance, rectangle, separating_gap, signed_distance
from optim.geometry.polygons import PackedScene
from optim.numerics.arrays import Array, frozen
from optim.numerics.kernel import kernel

_COLUMNS = 8  # knot, body, polygon, distance, and the gradient's four
_ROOM = 256  # rows to begin with; where there are more, the table is filled again with room for all
_SHORTEST = 1e-3  # sides that overlap by less, as a share of the body's length, meet in a point


def separation_table(
    scene: PackedScene, footprints: Array, offset: float, states: Array, reach: float, most: int
) -> Array:
    """Distances of both bodies from every polygon nearer than `reach` [m], ordered by state and body.

    Args:
        scene: the obstacles.
        footprints: those of the vehicle. Shape (2, 3) [m].
        offset: distance of the hitch behind the rear axle [m].
        states: Shape (N, 4).
        reach: distance beyond which a polygon has no row [m].
        most: maximum number of polygons for each body in each state; the nearest is always among them.

    Returns rows of knot, body, polygon, signed distance [m] and its derivative by (x, y, theta, alpha). Shape (R, 8).
    """
    states, room = frozen(states), _ROOM
    while True:
        table = np.empty((room, _COLUMNS))
        count = separation_kernel(scene, footprints, offset, states, float(reach), int(most), table)
        if count <= room:
            return table[:count]
        room = 2 * count


@kernel
def separation_kernel(scene, footprints, offset, states, reach, most, table):
    """Fill the table with rows of (knot, body, polygon, distance, gradient); how many there are, also if too many."""
    near, order = np.empty(most), np.empty(most, np.int64)
    ends = np.empty((2, 3))
    count = 0
    for i in range(states.shape[0]):
        for body in range(2):
            rect = rectangle(scene, footprints, offset, states, i, body)
            for m in range(nearest_polygons(scene, rect, reach, near, order)):
                rows, nx, ny = contact(scene, order[m], rect, ends)
                for r in range(rows):
                    if r > 0 and ends[r, 0] >= reach:
                        continue
                    if count < table.shape[0]:
                        _fill(table[count], i, body, order[m], ends[r], nx, ny, scene.origin, states, offset)
                    count += 1
    return count


@kernel
def _fill(row, i, body, polygon, end, nx, ny, origin, states, offset):
    """One row of the table, of the height and the point of the body in `end`."""
    row[0], row[1], row[2], row[3] = i, body, polygon, end[0]
    ax, ay = end[1] + origin[0] - states[i, 0], end[2] + origin[1] - states[i, 1]
    row[4], row[5], row[6], row[7] = nx, ny, ny * ax - nx * ay, 0.0
    if body == 1:
        heading = states[i, 2]
        row[7] = ny * (ax + offset * math.cos(heading)) - nx * (ay + offset * math.sin(heading))


@kernel
def nearest_polygons(scene, rect, reach, near, order):
    """The polygons nearer than reach, nearest first, as many as the arrays hold; how many there are."""
    count, cap = 0, reach
    node = np.int64(0)
    while node < scene.item.size:
        if box_distance(scene, node, rect) > max(cap, 0.0):
            node = scene.skip[node]
            continue
        k = scene.item[node]
        if k >= 0 and separating_gap(scene, k, rect, cap) < cap:
            distance = signed_distance(scene, k, rect)[0]
            if distance < cap:
                place = count if count < near.size else count - 1
                while place > 0 and near[place - 1] > distance:
                    near[place], order[place] = near[place - 1], order[place - 1]
                    place -= 1
                near[place], order[place] = distance, k
                count = min(count + 1, near.size)
                if count == near.size:
                    cap = near[count - 1]
        node += 1
    return count


@kernel
def contact(scene, k, rect, ends):
    """Height and point of the body, nearest first, at one or two ends of where body and polygon face each other.

    Fills the rows of `ends` with (height, x, y); returns how many there are, and the normal.
    """
    cx, cy, c, s, hx, hy = rect
    distance, bx, by, _, _, nx, ny = signed_distance(scene, k, rect)
    ends[0, 0], ends[0, 1], ends[0, 2] = distance, bx, by
    # the body's side towards the polygon: its two lowest corners along n; tangent (-ny, nx)
    mu, mv = nx * c + ny * s, ny * c - nx * s
    eu, ev = -math.copysign(hx, mu), -math.copysign(hy, mv)
    fu, fv = (eu, -ev) if hy * abs(mv) <= hx * abs(mu) else (-eu, ev)
    x0, y0 = cx + eu * c - ev * s, cy + eu * s + ev * c
    x1, y1 = cx + fu * c - fv * s, cy + fu * s + fv * c
    # the polygon's side towards the body: its highest vertex and the higher one of its neighbours
    begin, end = scene.first[k], scene.first[k + 1]
    top, height = begin, -math.inf
    for i in range(begin, end):
        h = nx * scene.vertices[i, 0] + ny * scene.vertices[i, 1]
        if h > height:
            top, height = i, h
    before, after = top - 1 if top > begin else end - 1, top + 1 if top + 1 < end else begin
    left = nx * scene.vertices[before, 0] + ny * scene.vertices[before, 1]
    right = nx * scene.vertices[after, 0] + ny * scene.vertices[after, 1]
    other, level = (before, left) if left > right else (after, right)
    # where the two overlap along the tangent
    t0, t1 = -ny * x0 + nx * y0, -ny * x1 + nx * y1
    p0 = -ny * scene.vertices[top, 0] + nx * scene.vertices[top, 1]
    p1 = -ny * scene.vertices[other, 0] + nx * scene.vertices[other, 1]
    low, high = max(min(t0, t1), min(p0, p1)), min(max(t0, t1), max(p0, p1))
    if high - low <= _SHORTEST * (hx + hy):
        return 1, nx, ny
    witness = -ny * bx + nx * by
    is_low_nearer = abs(witness - low) <= abs(witness - high)
    for r in range(2):
        t = low if is_low_nearer == (r == 0) else high
        share, part = (t - t0) / (t1 - t0), (t - p0) / (p1 - p0)
        x, y = x0 + share * (x1 - x0), y0 + share * (y1 - y0)
        ends[r, 0] = nx * x + ny * y - (height + part * (level - height))
        ends[r, 1], ends[r, 2] = x, y
    return 2, nx, ny
