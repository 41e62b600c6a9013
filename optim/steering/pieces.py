"""The curve of two turns and a straight, sampled: seven pieces whose curvature is a cubic in arc length."""

import math

import numpy as np

from optim.numerics.kernel import kernel
from optim.steering.flat import GAUSS_W, GAUSS_X, hermite


@kernel(error_model="numpy")
def pieces_of(row, start, goal):
    """The curve of a row of `plan_turns` as seven cubics: length and c of kappa = c0 + c1 s + c2 s^2 + c3 s^3."""
    pieces = np.empty((7, 5))
    joints = (start[0], row[8], row[8], 0.0, 0.0, -row[9], -row[9], goal[3])
    for i in range(7):
        length = row[1 + i] if i < 3 else row[10 - i]
        s0 = start[1] if i == 0 else 0.0
        s1 = goal[4] if i == 6 else 0.0
        pieces[i, 0], pieces[i, 1], pieces[i, 2] = length, joints[i], s0
        pieces[i, 3], pieces[i, 4] = hermite(joints[i], s0, joints[i + 1], s1, max(length, 1e-9))
    return pieces


@kernel(error_model="numpy")
def bends(piece, s):
    """(heading from the piece's start, kappa, sigma) at the distance s along a piece."""
    c0, c1, c2, c3 = piece[1], piece[2], piece[3], piece[4]
    heading = s * (c0 + s * (c1 / 2.0 + s * (c2 / 3.0 + s * c3 / 4.0)))
    return heading, c0 + s * (c1 + s * (c2 + s * c3)), c1 + s * (2.0 * c2 + 3.0 * s * c3)


@kernel(error_model="numpy")
def displacement(piece, s0, s1, heading):
    """Displacement (x, y) from s0 to s1, which are close, on a piece that starts with `heading` (Gauss-Legendre)."""
    x, y = 0.0, 0.0
    for i in range(4):
        turned, _, _ = bends(piece, s0 + (s1 - s0) * GAUSS_X[i])
        x += GAUSS_W[i] * math.cos(heading + turned)
        y += GAUSS_W[i] * math.sin(heading + turned)
    return (s1 - s0) * x, (s1 - s0) * y


@kernel(error_model="numpy")
def truck_distance(piece, s0, s1, l_t):
    """Distance of the truck's rear axle from s0 to s1, which are close, on a piece (Gauss-Legendre)."""
    distance = 0.0
    for i in range(4):
        _, kappa, _ = bends(piece, s0 + (s1 - s0) * GAUSS_X[i])
        distance += GAUSS_W[i] * math.sqrt(1.0 + (l_t * kappa) ** 2)
    return (s1 - s0) * distance


@kernel(error_model="numpy")
def sample_turns(row, start, goal, spacing, lim):
    """The curve at equal distances of at most spacing along the truck's path: (length of that path, flat (n, 5))."""
    l_t = lim[1]
    pieces = pieces_of(row, start, goal)
    cells = 0
    for i in range(7):
        cells += 1 + int(pieces[i, 0] / (0.05 * l_t))
    # nodes: piece, distance along the piece, truck's distance, x, y, heading of the piece's start
    nodes = np.empty((cells + 1, 6))
    total, x, y, heading = 0.0, 0.0, 0.0, 0.0
    n = 0
    for i in range(7):
        count = 1 + int(pieces[i, 0] / (0.05 * l_t))
        for k in range(count):
            s0, s1 = pieces[i, 0] * k / count, pieces[i, 0] * (k + 1) / count
            nodes[n, 0], nodes[n, 1], nodes[n, 2], nodes[n, 3], nodes[n, 4], nodes[n, 5] = i, s0, total, x, y, heading
            dx, dy = displacement(pieces[i], s0, s1, heading)
            x, y, total, n = x + dx, y + dy, total + truck_distance(pieces[i], s0, s1, l_t), n + 1
        heading += bends(pieces[i], pieces[i, 0])[0]
    nodes[n, 2] = total
    count = max(1, math.ceil(total / spacing - 1e-9))
    flat = np.empty((count + 1, 5))
    n = 0
    for k in range(count + 1):
        s = total * k / count
        while n < cells - 1 and nodes[n + 1, 2] <= s:
            n += 1
        piece, first, heading = pieces[int(nodes[n, 0])], nodes[n, 1], nodes[n, 5]
        along, miss = first, nodes[n, 2] - s
        turned, kappa, sigma = bends(piece, along)
        for _ in range(6):  # Newton's method, quadratic: a small miss needs no second look
            along -= miss / math.sqrt(1.0 + (l_t * kappa) ** 2)
            turned, kappa, sigma = bends(piece, along)
            if abs(miss) < 1e-6:
                break
            miss = truck_distance(piece, first, along, l_t) - (s - nodes[n, 2])
        dx, dy = displacement(piece, first, along, heading)
        flat[k, 0], flat[k, 1] = nodes[n, 3] + dx, nodes[n, 4] + dy
        flat[k, 2], flat[k, 3], flat[k, 4] = heading + turned, kappa, sigma
    return total, flat
