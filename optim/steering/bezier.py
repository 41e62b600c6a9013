"""Seventh-order Bézier curve between two flat states, forward.

Eight control points match position, heading, curvature and sharpness at each end (Esteban Cabezos 2020, section
2.5: the lowest order for which curvature and sharpness stay continuous). With the curve's arc length near an end
scaled by a tangent length a, the derivatives by the parameter t in [0, 1] are there

    B' = a T        B'' = a^2 kappa N        B''' = a^3 (sigma N - kappa^2 T)

with the unit tangent T and normal N. What is left are the tangent lengths a0, a1: a grid relative to the distance
between the ends, then a pattern search. Kernels hold the curve by its power coefficients c (8, 2),
B(t) = sum c_i t^i, in the frame of the first state: origin, heading 0.
"""

import math

import numpy as np

from optim.numerics.arrays import Array
from optim.numerics.kernel import kernel
from optim.steering.flat import GAUSS_W, GAUSS_X, TOLERANCE, TWO_PI, CurveLimits, hermite, load, peak

_GRID = 6  # tangent lengths tried at each end,
_LOWEST, _STEP = -0.35, 0.25  # by the log of their ratio to the distance
_TRIES = 40  # of the pattern search
_COARSE = 24.0  # intervals of the curve at which a candidate of the search is checked
_SLOWEST = 0.1  # of |B'| by the distance: below it the curve is close to a cusp
_TARGETS = (0.995, 0.95)  # load that the search aims at on few samples; the second where many show more than 1
_SHORTEST = 1e-3  # [m] between the ends: below it no direction leads from one to the other
_HOPELESS = 2.2  # load of a candidate on the grid above which the pattern search rarely ends within the limits


@kernel(error_model="numpy")
def coefficients(start, goal, a0, a1, c):
    """Fill c (8, 2) for tangent lengths a0, a1 [m]; start = (k0, s0), goal = (x, y, theta, k1, s1)."""
    c[0, 0], c[0, 1] = 0.0, 0.0
    c[1, 0], c[1, 1] = a0, 0.0
    c[2, 0], c[2, 1] = 0.0, 0.5 * a0 * a0 * start[0]
    c[3, 0], c[3, 1] = -(a0**3) * start[0] ** 2 / 6.0, a0**3 * start[1] / 6.0
    cos, sin = math.cos(goal[2]), math.sin(goal[2])
    third, cube = -(goal[3] ** 2), a1**3
    for i in range(2):
        tangent, normal = (cos, -sin) if i == 0 else (sin, cos)
        r0 = goal[i] - (c[1, i] + c[2, i] + c[3, i])
        r1 = a1 * tangent - (c[1, i] + 2.0 * c[2, i] + 3.0 * c[3, i])
        r2 = a1 * a1 * goal[3] * normal - (2.0 * c[2, i] + 6.0 * c[3, i])
        r3 = cube * (third * tangent + goal[4] * normal) - 6.0 * c[3, i]
        c[4, i] = 35.0 * r0 - 15.0 * r1 + 2.5 * r2 - r3 / 6.0
        c[5, i] = -84.0 * r0 + 39.0 * r1 - 7.0 * r2 + 0.5 * r3
        c[6, i] = 70.0 * r0 - 34.0 * r1 + 6.5 * r2 - 0.5 * r3
        c[7, i] = -20.0 * r0 + 10.0 * r1 - 2.0 * r2 + r3 / 6.0


@kernel(error_model="numpy")
def derivatives(c, i, t):
    """Coordinate i of the curve at t, and its first to fourth derivative by t [m]."""
    c2, c3, c4, c5, c6, c7 = c[2, i], c[3, i], c[4, i], c[5, i], c[6, i], c[7, i]
    d0 = c[0, i] + t * (c[1, i] + t * (c2 + t * (c3 + t * (c4 + t * (c5 + t * (c6 + t * c7))))))
    d1 = 4.0 * c4 + t * (5.0 * c5 + t * (6.0 * c6 + t * 7.0 * c7))
    d1 = c[1, i] + t * (2.0 * c2 + t * (3.0 * c3 + t * d1))
    d2 = 2.0 * c2 + t * (6.0 * c3 + t * (12.0 * c4 + t * (20.0 * c5 + t * (30.0 * c6 + t * 42.0 * c7))))
    d3 = 6.0 * c3 + t * (24.0 * c4 + t * (60.0 * c5 + t * (120.0 * c6 + t * 210.0 * c7)))
    d4 = 24.0 * c4 + t * (120.0 * c5 + t * (360.0 * c6 + t * 840.0 * c7))
    return d0, d1, d2, d3, d4


@kernel(error_model="numpy")
def bends_at(c, t):
    """B [m], B' [m], kappa, sigma and dsigma/ds_f of the curve at t; seven numbers."""
    i = int(0.0 * t)  # not a literal 0, for which `derivatives` would be compiled a second time
    x, x1, x2, x3, x4 = derivatives(c, i, t)
    y, y1, y2, y3, y4 = derivatives(c, i + 1, t)
    w = max(x1 * x1 + y1 * y1, 1e-24)
    p = 1.0 / w
    speed = math.sqrt(w)
    cube = p / speed
    # kappa = n w^(-3/2) by t and then by arc length; dw and ddw are w' / w and w'' / w
    dw = 2.0 * p * (x1 * x2 + y1 * y2)
    ddw = 2.0 * p * (x2 * x2 + y2 * y2 + x1 * x3 + y1 * y3)
    n = cube * (x1 * y2 - y1 * x2)
    dn = cube * (x1 * y3 - y1 * x3)
    ddn = cube * (x2 * y3 - y2 * x3 + x1 * y4 - y1 * x4)
    slope = dn - 1.5 * n * dw
    bend = ddn - 3.0 * dn * dw + n * (3.75 * dw * dw - 1.5 * ddw)
    return x, y, x1, y1, n, slope / speed, p * (bend - 0.5 * slope * dw)


@kernel(error_model="numpy")
def curve_load(c, count, stride, slowest, stop, lim):
    """(largest load, length) from count + 1 samples; (load, inf) at the first one above stop.

    With stride 1 also the tops of the parabolas through three samples count, and a curve whose tangent turns by more
    than a right angle between two samples has a cusp: load inf. A longer stride, prime to count + 1, takes the same
    samples in another order: most candidates fail, neighbours are alike, and so it comes sooner to a bad one.
    `slowest` is the lower bound of |B'|. The trapezoidal rule is of order four for the length here, since B' and B''
    are orthogonal at the ends. count and stride are floats: a kernel is compiled again for every literal int.
    """
    worst, before, value, length = 0.0, 0.0, 0.0, 0.0
    dx, dy = 1.0, 0.0
    total = int(count) + 1
    for k in range(total):
        i = k * int(stride) % total
        _, _, x1, y1, kappa, sigma, curl = bends_at(c, i / count)
        speed = math.sqrt(x1 * x1 + y1 * y1)
        after = load(kappa, sigma, curl, lim)
        if not after <= stop or not slowest <= stop * speed:  # also where there is no number
            return max(after, slowest / speed), np.inf
        worst = max(worst, after)
        if stride == 1.0:
            if x1 * dx + y1 * dy <= 0.0:
                return np.inf, np.inf
            if k >= 2 and value >= before and value >= after:
                worst = max(worst, peak(before, value, after))
        dx, dy, before, value = x1, y1, value, after
        length += speed * (0.5 if i == 0 or i == total - 1 else 1.0)
    return worst, length / count


@kernel(error_model="numpy")
def search(start, goal, chord, target, lim, c):
    """(length by the chord, a0, a1 by the chord) of the shortest candidate found whose load is at most target.

    The length is inf where there is none. Tangent lengths come from a grid, then from a pattern search, which
    lowers the load until it is at most target, and then the length.
    """
    best, u0, u1 = 100.0 + _HOPELESS, 0.0, 0.0  # 100 + load stands for a candidate whose load is too large
    step, improved = _STEP, True
    for k in range(_GRID * _GRID + _TRIES):
        if k < _GRID * _GRID:
            # equal tangent lengths first: the better the best is early, the sooner the others are dropped
            v0 = _LOWEST + _STEP * (k % _GRID)
            v1 = _LOWEST + _STEP * ((k + k // _GRID) % _GRID)
        else:
            side = (k - _GRID * _GRID) % 4
            if side == 0:
                step *= 1.0 if improved and k > _GRID * _GRID else 0.5
                improved = False
                if step < 0.05 or best >= 100.0 + _HOPELESS:
                    break
            v0 = u0 + step * (1 - side if side % 2 == 0 else 0)
            v1 = u1 + step * (2 - side if side % 2 == 1 else 0)
        coefficients(start, goal, chord * math.exp(v0), chord * math.exp(v1), c)
        stop = target if best < 100.0 else best - 100.0
        worst, length = curve_load(c, _COARSE, 7.0, _SLOWEST * chord, stop, lim)
        value = length / chord if worst <= target else 100.0 + worst
        if value < best:
            best, u0, u1, improved = value, v0, v1, True
    return (best if best < 100.0 else np.inf), math.exp(u0), math.exp(u1)


def plan_bezier(start: Array, goal: Array, lim: CurveLimits, max_length: float) -> tuple[float, float, float]:
    """A short Bézier curve from the origin with heading 0 and start = (k0, s0) to goal (x, y, theta, k1, s1).

    Returns (length, tangent lengths a0, a1); the length is inf where none was found within the limits.
    """
    chord = math.hypot(goal[0], goal[1])
    if _SHORTEST < chord <= max_length:
        c = np.empty((8, 2))
        for target in _TARGETS:
            ratio, a0, a1 = search(start, goal, chord, target, lim, c)
            if ratio == math.inf or ratio * chord > max_length:
                break
            coefficients(start, goal, a0 * chord, a1 * chord, c)
            # the full check: four times as dense as the search's and every 0.2 m; half as slow will do, since the
            # slowest point may lie between those that the search looked at
            count, slowest, most = 96.0 + ratio * chord / 0.2, 0.5 * _SLOWEST * chord, 1.0 + TOLERANCE
            worst, length = curve_load(c, float(int(count)), 1.0, slowest, most, lim)
            if worst <= most:
                return length, a0 * chord, a1 * chord
    return math.inf, 0.0, 0.0


@kernel(error_model="numpy")
def sample_bezier(start, goal, a0, a1, spacing, lim):
    """The curve at equal distances of at most spacing along the truck's path: (length of that path, flat (n, 5))."""
    c = np.empty((8, 2))
    coefficients(start, goal, a0, a1, c)
    cells = 64
    nodes = np.empty((cells + 1, 2))  # truck's distance so far, and parameter by that distance
    total = 0.0
    for i in range(cells + 1):
        _, _, x1, y1, kappa, _, _ = bends_at(c, i / cells)
        nodes[i, 0], nodes[i, 1] = total, 1.0 / math.sqrt((x1 * x1 + y1 * y1) * (1.0 + (lim[1] * kappa) ** 2))
        total += truck_distance(c, i / cells, (i + 1) / cells, lim[1])
    total = nodes[cells, 0]
    count = max(1, math.ceil(total / spacing - 1e-9))
    flat = np.empty((count + 1, 5))
    cell, heading = 0, 0.0
    for k in range(count + 1):
        s = total * k / count
        while cell < cells - 1 and nodes[cell + 1, 0] < s:
            cell += 1
        first, width = cell / cells, nodes[cell + 1, 0] - nodes[cell, 0]
        s -= nodes[cell, 0]
        # the cubic through both nodes, then Newton's method: quadratic, so that a small miss needs no second look
        c2, c3 = hermite(0.0, nodes[cell, 1], 1.0 / cells, nodes[cell + 1, 1], width)
        t = first + s * (nodes[cell, 1] + s * (c2 + s * c3))
        x, y, x1, y1, kappa, sigma, _ = bends_at(c, t)
        for _ in range(4):
            miss = truck_distance(c, first, t, lim[1]) - s
            t -= miss / math.sqrt((x1 * x1 + y1 * y1) * (1.0 + (lim[1] * kappa) ** 2))
            x, y, x1, y1, kappa, sigma, _ = bends_at(c, t)
            if abs(miss) < 1e-6:
                break
        turned = math.atan2(y1, x1) - heading
        heading += turned - TWO_PI * round(turned / TWO_PI)
        flat[k, 0], flat[k, 1] = x, y
        flat[k, 2], flat[k, 3], flat[k, 4] = heading, kappa, sigma
    return total, flat


@kernel(error_model="numpy")
def truck_distance(c, t0, t1, l_t):
    """Distance of the truck's rear axle between two parameters at most 1/16 apart (Gauss-Legendre) [m]."""
    total = 0.0
    for i in range(4):
        _, _, x1, y1, kappa, _, _ = bends_at(c, t0 + (t1 - t0) * GAUSS_X[i])
        total += GAUSS_W[i] * math.sqrt((x1 * x1 + y1 * y1) * (1.0 + (l_t * kappa) ** 2))
    return (t1 - t0) * total
