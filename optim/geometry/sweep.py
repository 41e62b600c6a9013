"""Compiled kernels: clearance between the samples of a motion, by bounds that are proven below.

The motion is that of truck and trailer through the samples (a segment of a path): phi is continuous, |dphi/ds| is
bounded on each interval (see `curvature_bounds`), s is the truck's arc length. A body's point z moves along p(s; z).
The tuple `limits` is (l, l_t, M, max_steer, max_steer_rate).

**Motion bounds.** With k >= |dtheta/ds| and k' >= |d2theta/ds2| on the interval, l_t the hitch's distance to the
trailer's axle, M that of the hitch behind the truck's axle, h the hitch, and R the farthest corner of a body from
its reference point (truck: rear axle c; trailer: h):

    truck    c' = d e(theta)      |p'| <= 1 + R k =: v           |p''| <= k + R (k' + k^2) =: a
    trailer  |h'| <= 1 + |M| k    |h''| <= k + |M| (k' + k^2)
             theta_t' = -(d sin(alpha) + M theta' cos(alpha)) / l_t    |theta_t'| <= (S + |M| k) / l_t =: k_t
             |theta_t''| <= ((1 + |M| k) |alpha'| + |M| k') / l_t =: k_t',    |alpha'| <= k + k_t
             |p'| <= |h'| + R k_t =: v    |p''| <= |h''| + R (k_t' + k_t^2) =: a

since p = r + rot(b) z gives p'' = r'' + rot(b) (b'' J z - b'^2 z) and |b'' J z - b'^2 z| = |z| sqrt(b''^2 + b'^4).
S bounds |sin(alpha)|: |alpha| <= max(|alpha_0|, |alpha_1|) + D/2 (k + (1 + |M| k) / l_t), D the interval's length.

**Clearance on an interval.** Let O be a convex obstacle, n(s) unit vectors, and
g(s) = min over z in the body, w in O of f(s; z, w), f = n . (p(s; z) - w). Any such g is at most the signed distance.
Let n turn evenly by an angle delta (0: a fixed separating direction). Then

    f'' = -(delta/D)^2 f + 2 n' . p' + n . p'' <= (delta/D)^2 max(0, -f) + 2 |delta| v / D + a

and a function with f'' <= C lies above its chord minus C D^2 / 8. A minimum of such functions does too, so

    signed distance >= min(g(0), g(D)) - (a D^2 / 8 + |delta| v D / 4)                                (*)

whenever the right side is >= 0: were the least value m of g negative, then m >= right side - delta^2 |m| / 8 and so
|m| (1 - delta^2 / 8) <= 0, a contradiction for delta <= 1. If it is negative, m >= right side / (1 - delta^2 / 8).
With delta = 0, (*) is the distance from O to the convex hull of both footprints, seen along n and inflated by
a D^2 / 8. That hull alone is not tight: while a long body turns by b, the hull fills the wedge between both of its
sides, up to a quarter of its length times b (3 cm for a trailer at 0.1 m); an obstacle's corner beside it
is seen without that loss when n turns with the body. Taken is the largest of four bounds: n fixed to
the witness normal of either end, or across the way of the body's nearest point (corner passes corner), and n turning
from the one witness normal to the other; and of the bound of Lipschitz,
(distance(0) + distance(D) - v D) / 2, which also makes `first_violation` agree with `swept_kernel`.
"""

import math

import numpy as np

from optim.geometry.collision import box_distance, gap_along, nearest_polygon, rectangle, signed_distance
from optim.numerics.kernel import kernel

_MOST_UNTRIED = 4  # intervals checked one by one before the reach is tried again
_SLACK = 1.001  # the audit relaxes the limits by 0.1 %, so a motion may use that much


@kernel
def curvature_bounds(length, turn, phi0, phi1, wheelbase, max_steer, max_rate):
    """Bounds k of |dtheta/ds| and k' of |d2theta/ds2| on an interval of given length, where theta turns by `turn`.

    With known steering (phi0, phi1 finite) phi is linear: both follow exactly. Without, phi takes somewhere the
    value with which an arc turns as much (mean value theorem), and it stays within the limits on phi and dphi/ds; where
    that value is itself beyond max_steer, the steering is assumed not to be sharper anywhere on the interval.
    """
    if phi0 == phi0 and phi1 == phi1:
        steer = max(abs(phi0), abs(phi1))
        rate = abs(phi1 - phi0) / length
    else:
        mean = math.atan(wheelbase * abs(turn) / length)
        rate = _SLACK * max_rate
        steer = max(mean, min(mean + rate * length, _SLACK * max_steer))
    tangent = math.tan(steer)
    return tangent / wheelbase, rate * (1.0 + tangent * tangent) / wheelbase


@kernel
def motion_bounds(body, radius, length, alpha, k, k1, l_t, offset):
    """(v, a) of the module's notation: bounds of |p'| and |p''| of all points of one body; alpha = max |alpha_i|."""
    if body == 0:
        return 1.0 + radius * k, k + radius * (k1 + k * k)
    m = abs(offset)
    hitch = 1.0 + m * k
    alpha = min(alpha + 0.5 * length * (k + hitch / l_t), 0.5 * math.pi)
    kt = (math.sin(alpha) + m * k) / l_t
    kt1 = (hitch * (k + kt) + m * k1) / l_t
    return hitch + radius * kt, k + m * (k1 + k * k) + radius * (kt1 + kt * kt)


@kernel
def pair_bound(scene, k, rect0, rect1, length, v, a, enough):
    """A lower bound of the signed distance to polygon k over an interval; any value >= enough may stand for more."""
    d0, bx, by, _, _, n0x, n0y = signed_distance(scene, k, rect0)
    d1, _, _, _, _, n1x, n1y = signed_distance(scene, k, rect1)
    x0, y0, c0, s0, _, _ = rect0
    x1, y1, c1, s1, _, _ = rect1
    low = min(d0, d1)
    bound = 0.5 * (d0 + d1 - v * length)
    if bound >= enough:
        return bound
    bend = a * length * length / 8.0
    bound = max(bound, min(d0, gap_along(scene, k, rect1, n0x, n0y)) - bend)
    if bound >= enough:
        return bound
    bound = max(bound, min(gap_along(scene, k, rect0, n1x, n1y), d1) - bend)
    if bound >= enough or bound >= low - bend:
        return bound
    delta = abs(math.atan2(n0x * n1y - n0y * n1x, n0x * n1x + n0y * n1y))
    if delta <= 1.0:
        turning = low - bend - 0.25 * delta * v * length
        bound = max(bound, turning if turning >= 0.0 else turning / (1.0 - delta * delta / 8.0))
    if bound < enough:
        # across the way of the body's nearest point, for a corner that passes a corner
        along, across = c0 * (bx - x0) + s0 * (by - y0), c0 * (by - y0) - s0 * (bx - x0)
        wx = x1 + c1 * along - s1 * across - bx
        wy = y1 + s1 * along + c1 * across - by
        norm = math.copysign(math.hypot(wx, wy), wx * n0y - wy * n0x)
        if norm != 0.0:
            mx, my = -wy / norm, wx / norm
            passing = min(gap_along(scene, k, rect0, mx, my), gap_along(scene, k, rect1, mx, my))
            bound = max(bound, passing - bend)
    return bound


@kernel
def interval_bound(scene, rect0, rect1, length, v, a, guess, cap):
    """The polygon with the least bound below cap on an interval, and that bound; (-1, cap) if there is none."""
    polygon, best = -1, cap
    if guess >= 0:
        bound = pair_bound(scene, guess, rect0, rect1, length, v, a, best)
        if bound < best:
            polygon, best = guess, bound
    node = np.int64(0)
    while node < scene.item.size:
        # Lipschitz once more, with lower bounds of both distances (0 says nothing: they may overlap)
        apart0, apart1 = box_distance(scene, node, rect0), box_distance(scene, node, rect1)
        if min(apart0, apart1) > 0.0 and 0.5 * (apart0 + apart1 - v * length) > max(best, 0.0):
            node = scene.skip[node]
            continue
        k = scene.item[node]
        if k >= 0 and k != guess:
            bound = pair_bound(scene, k, rect0, rect1, length, v, a, best)
            if bound < best:
                polygon, best = k, bound
        node += 1
    return polygon, best


@kernel
def _radius(footprints, body):
    return math.hypot(max(footprints[body, 0], footprints[body, 1]), footprints[body, 2])


@kernel
def _check_interval(scene, footprints, limits, s, states, phi, i, body, guess, cap):
    """`interval_bound` of one body between the samples i and i + 1."""
    wheelbase, l_t, offset, max_steer, max_rate = limits
    j = i + 1
    rect0 = rectangle(scene, footprints, offset, states, i, body)
    rect1 = rectangle(scene, footprints, offset, states, j, body)
    length = s[j] - s[i]
    v, a = 0.0, 0.0
    if length > 0.0:  # at a cusp the same pose may be there twice
        phi0, phi1 = (phi[i], phi[j]) if phi.size else (math.nan, math.nan)
        turn = states[j, 2] - states[i, 2]
        k, k1 = curvature_bounds(length, turn, phi0, phi1, wheelbase, max_steer, max_rate)
        alpha = max(abs(states[i, 3]), abs(states[j, 3]))
        v, a = motion_bounds(body, _radius(footprints, body), length, alpha, k, k1, l_t, offset)
    return interval_bound(scene, rect0, rect1, length, v, a, guess, cap)


@kernel
def swept_kernel(scene, footprints, limits, s, states, phi):
    """The bound of each interval and body, inf without obstacles. Shape (N - 1, 2)."""
    out = np.empty((s.size - 1, 2))
    for body in range(2):
        guess = np.int64(-1)
        for i in range(s.size - 1):
            guess, out[i, body] = _check_interval(scene, footprints, limits, s, states, phi, i, body, guess, math.inf)
    return out


@kernel
def _fastest(footprints, limits, s, states, phi, body):
    """A bound v of |p'| over the whole motion, never less than the v of any of its intervals."""
    wheelbase, l_t, offset, max_steer, _ = limits
    k = math.tan(_SLACK * max_steer) / wheelbase if phi.size == 0 else 0.0
    for i in range(s.size - 1):
        if phi.size:
            k = max(k, math.tan(max(abs(phi[i]), abs(phi[i + 1]))) / wheelbase)
        elif s[i + 1] > s[i]:
            k = max(k, abs(states[i + 1, 2] - states[i, 2]) / (s[i + 1] - s[i]))
    if body == 0:
        return 1.0 + _radius(footprints, body) * k
    hitch = 1.0 + abs(offset) * k
    return hitch + _radius(footprints, body) * hitch / l_t


@kernel
def first_violation_kernel(scene, footprints, limits, s, states, phi, margin):
    """The first interval with a bound < margin for either body, -1 if none: conservative advancement.

    From a sample with the clearance c nothing can come closer than the margin within (c - margin) / v. Where that
    does not reach the next sample, the interval is checked; from there the reach is tried less often, for as many
    intervals as it has failed before, `_MOST_UNTRIED` at most.
    """
    found = s.size - 1
    for body in range(2):
        v = _fastest(footprints, limits, s, states, phi, body)
        i, guess, failures = np.int64(0), np.int64(-1), np.int64(0)
        while i < found:
            rect = rectangle(scene, footprints, limits[2], states, i, body)
            # no need to know more than takes us to the end, and rounding must not stop short of it
            cap = margin + 1.000001 * v * (s[found] - s[i]) + 1e-9
            polygon, c = nearest_polygon(scene, rect, guess, cap)
            if polygon >= 0:
                guess = polygon
            reach = s[i] + (c - margin) / v
            start = i
            while i < found and s[i + 1] <= reach:
                i += 1
            failures = failures + 1 if i == start else 0
            for _ in range(min(failures, _MOST_UNTRIED)):
                if i < found:
                    hit, _ = _check_interval(scene, footprints, limits, s, states, phi, i, body, guess, margin)
                    if hit >= 0:
                        found = i
                    else:
                        i += 1
    return found if found < s.size - 1 else -1
