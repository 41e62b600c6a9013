"""Compiled kernels: a rectangle against the packed convex polygons of a scene, at single poses.

A rectangle is (cx, cy, c, s, hx, hy): its centre [m] in the scene's packed frame, the cosine and sine of its
heading, half length and half width [m]. With u = (c, s) and v = (-s, c) its extent in a direction n is
hx |n.u| + hy |n.v|, so the *gap* to a polygon along a unit n that points from the polygon to the rectangle is

    gap(n) = n . centre - hx |n.u| - hy |n.v| - max over the polygon's vertices w of n . w.

The signed distance is the largest gap over all n: the Euclidean distance when the two are apart, minus the least
depth of penetration when they overlap. In the second case, and to distinguish the two, the candidates are the
rectangle's two axes and **the normals of all the polygon's edges** (Esteban Cabezos 2020, section 2.6, tests two
axes of the obstacle: enough for rectangles only).
"""

import math

import numpy as np

from optim.numerics.kernel import kernel


@kernel
def rectangle(scene, footprints, offset, states, i, body):
    """The rectangle of the truck (body 0) or the trailer (body 1) in state i."""
    px, py, heading = states[i, 0] - scene.origin[0], states[i, 1] - scene.origin[1], states[i, 2]
    if body == 1:
        if offset != 0.0:
            px -= offset * math.cos(heading)
            py -= offset * math.sin(heading)
        heading += states[i, 3]
    c, s = math.cos(heading), math.sin(heading)
    front, rear = footprints[body, 0], footprints[body, 1]
    middle = 0.5 * (front - rear)
    return px + middle * c, py + middle * s, c, s, 0.5 * (front + rear), footprints[body, 2]


@kernel
def gap_along(scene, k, rect, nx, ny):
    """gap(n) of the rectangle to polygon k: at most the signed distance, for any unit n."""
    cx, cy, c, s, hx, hy = rect
    support = -math.inf
    for i in range(scene.first[k], scene.first[k + 1]):
        support = max(support, nx * scene.vertices[i, 0] + ny * scene.vertices[i, 1])
    return nx * cx + ny * cy - hx * abs(nx * c + ny * s) - hy * abs(ny * c - nx * s) - support


@kernel
def separating_gap(scene, k, rect, enough):
    """Separating-axis test: the largest gap over the candidate axes, or the first one found >= enough."""
    cx, cy, c, s, hx, hy = rect
    begin, end = scene.first[k], scene.first[k + 1]
    low_x, high_x, low_y, high_y = math.inf, -math.inf, math.inf, -math.inf
    for i in range(begin, end):
        dx, dy = scene.vertices[i, 0] - cx, scene.vertices[i, 1] - cy
        along, across = c * dx + s * dy, c * dy - s * dx
        low_x, high_x = min(low_x, along), max(high_x, along)
        low_y, high_y = min(low_y, across), max(high_y, across)
    gap = max(max(low_x, -high_x) - hx, max(low_y, -high_y) - hy)
    for i in range(begin, end):
        if gap >= enough:
            return gap
        nx, ny = scene.normals[i, 0], scene.normals[i, 1]
        reach = hx * abs(nx * c + ny * s) + hy * abs(ny * c - nx * s)
        gap = max(gap, nx * (cx - scene.vertices[i, 0]) + ny * (cy - scene.vertices[i, 1]) - reach)
    return gap


@kernel
def _own_axis(rect, low_x, high_x, low_y, high_y, in_x, out_x, in_y, out_y):
    """The rectangle's own axis of the largest gap: gap, normal away from the polygon, the polygon's vertex there."""
    _, _, c, s, hx, hy = rect
    gap, nx, ny, source = low_x - hx, -c, -s, in_x
    if -high_x - hx > gap:
        gap, nx, ny, source = -high_x - hx, c, s, out_x
    if low_y - hy > gap:
        gap, nx, ny, source = low_y - hy, s, -c, in_y
    if -high_y - hy > gap:
        gap, nx, ny, source = -high_y - hy, -s, c, out_y
    return gap, nx, ny, source


@kernel
def signed_distance(scene, k, rect):  # noqa: C901  one pass finds all of them
    """Distance, witness on the rectangle, witness on polygon k, unit normal from polygon to rectangle.

    Apart, the least distance is that of a polygon's vertex from the rectangle, or of the rectangle's corner
    deepest in an edge's outward half-plane from the inside of that edge: one pass over the vertices finds both.
    """
    cx, cy, c, s, hx, hy = rect
    begin, end = scene.first[k], scene.first[k + 1]
    best, best_x, best_y, vertex = math.inf, 0.0, 0.0, begin  # squared; nearest point in the rectangle's frame
    low_x, high_x, low_y, high_y = math.inf, -math.inf, math.inf, -math.inf
    in_x, in_y = begin, begin  # vertices that reach deepest along the rectangle's axes
    out_x, out_y = begin, begin
    for i in range(begin, end):
        dx, dy = scene.vertices[i, 0] - cx, scene.vertices[i, 1] - cy
        along, across = c * dx + s * dy, c * dy - s * dx
        if along < low_x:
            low_x, in_x = along, i
        if along > high_x:
            high_x, out_x = along, i
        if across < low_y:
            low_y, in_y = across, i
        if across > high_y:
            high_y, out_y = across, i
        near_x, near_y = min(max(along, -hx), hx), min(max(across, -hy), hy)
        squared = (along - near_x) ** 2 + (across - near_y) ** 2
        if squared < best:
            best, best_x, best_y, vertex = squared, near_x, near_y, i
    gap, nx, ny, source = _own_axis(rect, low_x, high_x, low_y, high_y, in_x, out_x, in_y, out_y)
    ox, oy = scene.vertices[source, 0], scene.vertices[source, 1]
    bx, by = ox + gap * nx, oy + gap * ny
    nearest, edge_nx, edge_ny, edge_bx, edge_by = math.inf, 0.0, 0.0, 0.0, 0.0
    for i in range(begin, end):
        mx, my = scene.normals[i, 0], scene.normals[i, 1]
        mu, mv = mx * c + my * s, my * c - mx * s
        ex, ey = -math.copysign(hx, mu), -math.copysign(hy, mv)  # corner deepest along -m
        qx, qy = cx + ex * c - ey * s, cy + ex * s + ey * c
        rx, ry = qx - scene.vertices[i, 0], qy - scene.vertices[i, 1]
        height = mx * rx + my * ry
        if height > gap:
            gap, nx, ny, bx, by = height, mx, my, qx, qy
            ox, oy = qx - height * mx, qy - height * my
        if 0.0 < height < nearest and mx * ry - my * rx >= 0.0:
            after = i + 1 if i + 1 < end else begin
            wx, wy = qx - scene.vertices[after, 0], qy - scene.vertices[after, 1]
            if mx * wy - my * wx <= 0.0:
                nearest, edge_nx, edge_ny, edge_bx, edge_by = height, mx, my, qx, qy
    if gap <= 0.0:
        return gap, bx, by, ox, oy, nx, ny
    distance = math.sqrt(best)
    if nearest <= distance:
        ox, oy = edge_bx - nearest * edge_nx, edge_by - nearest * edge_ny
        return nearest, edge_bx, edge_by, ox, oy, edge_nx, edge_ny
    ox, oy = scene.vertices[vertex, 0], scene.vertices[vertex, 1]
    bx, by = cx + c * best_x - s * best_y, cy + s * best_x + c * best_y
    if distance > 1e-9:  # else the separating axis stays the normal
        nx, ny = (bx - ox) / distance, (by - oy) / distance
    return distance, bx, by, ox, oy, nx, ny


@kernel
def box_distance(scene, node, rect):
    """A lower bound of the distance to everything below a tree node; 0 where neither gap is positive.

    The larger of two gaps: between the boxes along the map's axes (Euclidean), and along the rectangle's axes.
    """
    cx, cy, c, s, hx, hy = rect
    mx = 0.5 * (scene.boxes[node, 0] + scene.boxes[node, 2]) - cx
    my = 0.5 * (scene.boxes[node, 1] + scene.boxes[node, 3]) - cy
    rx = 0.5 * (scene.boxes[node, 2] - scene.boxes[node, 0])
    ry = 0.5 * (scene.boxes[node, 3] - scene.boxes[node, 1])
    ac, as_ = abs(c), abs(s)
    dx = max(abs(mx) - rx - hx * ac - hy * as_, 0.0)
    dy = max(abs(my) - ry - hx * as_ - hy * ac, 0.0)
    du = max(abs(c * mx + s * my) - hx - rx * ac - ry * as_, 0.0)
    dv = max(abs(c * my - s * mx) - hy - rx * as_ - ry * ac, 0.0)
    return math.sqrt(max(dx * dx + dy * dy, du * du + dv * dv))


@kernel
def nearest_polygon(scene, rect, guess, cap):
    """The polygon of the least signed distance below cap, and that distance; (-1, cap) if there is none.

    `guess`, a polygon or -1, is tried first: along a path the last answer is mostly still right and prunes the rest.
    """
    polygon, best = -1, cap
    if guess >= 0:
        distance = signed_distance(scene, guess, rect)[0]
        if distance < best:
            polygon, best = guess, distance
    node = np.int64(0)
    while node < scene.item.size:
        if box_distance(scene, node, rect) > max(best, 0.0):
            node = scene.skip[node]
            continue
        k = scene.item[node]
        if k >= 0 and k != guess and separating_gap(scene, k, rect, best) < best:
            distance = signed_distance(scene, k, rect)[0]
            if distance < best:
                polygon, best = k, distance
        node += 1
    return polygon, best


@kernel
def overlaps(scene, rect, margin):
    """Whether some polygon has a signed distance < margin (touching is not an overlap at margin 0)."""
    cx, cy, c, s, hx, hy = rect
    ac, as_ = abs(c), abs(s)
    reach = max(margin, 0.0)
    wide, high = hx * ac + hy * as_ + reach, hx * as_ + hy * ac + reach
    node = np.int64(0)
    while node < scene.item.size:
        mx = 0.5 * (scene.boxes[node, 0] + scene.boxes[node, 2]) - cx
        my = 0.5 * (scene.boxes[node, 1] + scene.boxes[node, 3]) - cy
        rx = 0.5 * (scene.boxes[node, 2] - scene.boxes[node, 0])
        ry = 0.5 * (scene.boxes[node, 3] - scene.boxes[node, 1])
        if (
            abs(mx) >= rx + wide
            or abs(my) >= ry + high
            or abs(c * mx + s * my) >= hx + reach + rx * ac + ry * as_
            or abs(c * my - s * mx) >= hy + reach + rx * as_ + ry * ac
        ):
            node = scene.skip[node]
            continue
        k = scene.item[node]
        if k >= 0:
            gap = separating_gap(scene, k, rect, margin)
            # between 0 and the margin no axis decides: two corners may face each other
            if gap < margin and (gap <= 0.0 or signed_distance(scene, k, rect)[0] < margin):
                return True
        node += 1
    return False


@kernel
def collides_kernel(scene, footprints, offset, states, margin):
    """`overlaps` for either body in each state. Shape (N,)."""
    hit = np.empty(states.shape[0], dtype=np.bool_)
    for i in range(states.shape[0]):
        hit[i] = False
        for body in range(1, -1, -1):  # the trailer is larger
            if not hit[i]:
                hit[i] = overlaps(scene, rectangle(scene, footprints, offset, states, i, body), margin)
    return hit


@kernel
def witness_kernel(scene, footprints, offset, states):
    """Per state and body: distance, witness on body, witness on obstacle, normal, polygon. Shape (N, 2, 8).

    Without obstacles the distance is inf, the polygon -1 and the rest nan.
    """
    out = np.full((states.shape[0], 2, 8), np.nan)
    ox, oy = scene.origin[0], scene.origin[1]
    for body in range(2):
        k = np.int64(-1)
        for i in range(states.shape[0]):
            rect = rectangle(scene, footprints, offset, states, i, body)
            k, distance = nearest_polygon(scene, rect, k, math.inf)
            out[i, body, 0], out[i, body, 7] = distance, k
            if k >= 0:
                _, bx, by, px, py, nx, ny = signed_distance(scene, k, rect)
                out[i, body, 1], out[i, body, 2] = bx + ox, by + oy
                out[i, body, 3], out[i, body, 4] = px + ox, py + oy
                out[i, body, 5], out[i, body, 6] = nx, ny
    return out


@kernel
def point_kernel(scene, points):
    """Least signed distance of each point to the polygons, inf without any. Shape (N,)."""
    out = np.empty(points.shape[0])
    k = np.int64(-1)
    for i in range(points.shape[0]):
        rect = (points[i, 0] - scene.origin[0], points[i, 1] - scene.origin[1], 1.0, 0.0, 0.0, 0.0)
        k, out[i] = nearest_polygon(scene, rect, k, math.inf)
    return out
