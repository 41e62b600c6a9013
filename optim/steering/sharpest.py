"""One turn of continuous sharpness, and the sharpest turns that a vehicle can drive, by deflection.

Notation as in `turns`: ramps of lengths l1 and l2, hold, peak curvature kp, deflection delta, start (k0, s0).
"""

import math

import numpy as np

from optim.numerics.kernel import kernel
from optim.steering.flat import GAUSS_W, GAUSS_X, TWO_PI, hermite, shortest_ramp

ROWS = 10
"""Rows of a family of turns: one slowed turn, eight peaks, one hold."""
_PEAKS = 8
CELLS = 40
"""Cells of the grid of deflections, and of headings of the straight, for a full circle."""


@kernel(error_model="numpy")
def peak_curvature(deflection, k0, s0, l1, hold, l2):
    """kp of a turn from its deflection [1/m]."""
    return (deflection - 0.5 * l1 * k0 - s0 * l1 * l1 / 12.0) / (0.5 * (l1 + l2) + hold)


@kernel(error_model="numpy")
def ramp_end(heading, k0, s0, k1, length, panels):
    """Displacement along a ramp from (k0, s0) to (k1, 0) that starts with `heading`.

    With `panels` > 0 nine nodes on each of 1 + panels |turn| panels: to rounding for 1; with 0 four nodes.
    """
    c2, c3 = hermite(k0, s0, k1, 0.0, length)
    count = 1 + int(panels * length * (abs(k0) + abs(k1) + 0.2 * abs(s0) * length))
    first, last = (4, 13) if panels > 0.0 else (0, 4)
    x, y = 0.0, 0.0
    for panel in range(count):
        for i in range(first, last):
            s = length * (panel + GAUSS_X[i]) / count
            angle = heading + s * (k0 + s * (s0 / 2.0 + s * (c2 / 3.0 + s * c3 / 4.0)))
            x += GAUSS_W[i] * math.cos(angle)
            y += GAUSS_W[i] * math.sin(angle)
    return length * x / count, length * y / count


@kernel(error_model="numpy")
def turn_end(deflection, k0, s0, l1, hold, l2, panels):
    """End (x, y) of a turn from the origin with heading 0."""
    kp = peak_curvature(deflection, k0, s0, l1, hold, l2)
    x, y = ramp_end(0.0, k0, s0, kp, l1, panels)
    heading = 0.5 * l1 * (k0 + kp) + s0 * l1 * l1 / 12.0
    dx, dy = arc_end(heading, kp, hold)
    ex, ey = ramp_end(heading + hold * kp, kp, 0.0, 0.0, l2, panels)
    return x + dx + ex, y + dy + ey


@kernel(error_model="numpy")
def arc_end(heading, kappa, length):
    """Displacement along an arc that starts with `heading`."""
    half = 0.5 * length * kappa
    chord = length * (math.sin(half) / half if abs(half) > 1e-6 else 1.0 - half * half / 6.0)
    return chord * math.cos(heading + half), chord * math.sin(heading + half)


@kernel(error_model="numpy")
def sharpest_turns(k0, s0, first, lim, max_length, table):
    """Fill ROWS rows (reach, l1, hold, l2) of `table` from row `first` on for each of two families; the least length.

    Family 0 turns right (kp from min(k0, 0) down), family 1 left (kp from max(k0, 0) up), to the curvature that
    turns are held at. The reach is the deflection to that side, -delta or delta; it increases from row to row. Rows
    that are left repeat the last one; a family without any has reach inf. A family ends with its first turn longer than
    max_length.
    """
    least = np.inf
    for family in range(2):
        side = 2.0 * family - 1.0
        base = side * max(side * k0, 0.0)
        row = first + ROWS * family
        n = row
        l1, l2, held = 0.0, 0.0, lim[5]
        for i in range(-1, _PEAKS):
            if i < 0 and base != 0.0:
                continue
            kp = base + (side * lim[5] - base) * (max(i, 0) / (_PEAKS - 1.0)) ** 2
            for part in range(2):
                k = k0 if part == 0 else kp
                length = shortest_ramp(k, s0 * (1 - part), kp * (1 - part), 1.13, lim)
                l1, l2 = (length, l2) if part == 0 else (l1, length)
            if i < 0:  # slower unwinding of k0 turns less far to this side
                l1 *= 1.4
            reach = side * (0.5 * l1 * (k0 + kp) + s0 * l1 * l1 / 12.0 + 0.5 * l2 * kp)
            if abs(reach) < np.inf and (n == row or reach > table[n - 1, 0]) and side * kp <= lim[5]:
                table[n, 0], table[n, 1], table[n, 2], table[n, 3] = reach, l1, 0.0, l2
                n += 1
                least, held = min(least, l1 + l2), abs(kp)
                if i >= 0 and l1 + l2 > max_length:
                    break
        reach = np.inf
        if n > row:
            reach, l1, l2 = max(TWO_PI, table[n - 1, 0] + 0.1), table[n - 1, 1], table[n - 1, 3]
        hold = (reach - table[max(n - 1, 0), 0]) / max(held, 1e-6)
        for k in range(n, row + ROWS):
            table[k, 0], table[k, 1], table[k, 2], table[k, 3] = reach, l1, hold, l2
    return least


@kernel(error_model="numpy")
def tabulated(table, row, reach):
    """(l1, hold, l2) of the turn of the family from `row` on, interpolated."""
    i = row + 1
    while i < row + ROWS - 1 and table[i, 0] < reach:
        i += 1
    w = (reach - table[i - 1, 0]) / max(table[i, 0] - table[i - 1, 0], 1e-9)
    w = min(max(w, 0.0), 1.0)
    return (
        table[i - 1, 1] + w * (table[i, 1] - table[i - 1, 1]),
        table[i - 1, 2] + w * (table[i, 2] - table[i - 1, 2]),
        table[i - 1, 3] + w * (table[i, 3] - table[i - 1, 3]),
    )


@kernel(error_model="numpy")
def tabulate_ends(k0, s0, offset, row, side, max_length, table, ends):
    """Fill rows of `ends` with (x, y, length) of the turns of the family from `row` on; length inf outside it.

    There are 2 CELLS + 1 of them for each family. The one at position i has the deflection
    (i - CELLS) 2 pi / CELLS + offset.
    """
    x, y, heading, ex, ey, kp = 0.0, 0.0, 0.0, 0.0, 0.0, 0.0
    is_known = False
    for i in range(2 * CELLS + 1):
        deflection = (i - CELLS) * TWO_PI / CELLS + offset
        reach = side * deflection
        k = row // ROWS * (2 * CELLS + 1) + i
        ends[k, 2] = np.inf
        if not table[row, 0] <= reach <= table[row + ROWS - 1, 0]:
            continue
        l1, hold, l2 = tabulated(table, row, reach)
        if l1 + hold + l2 > max_length:
            continue
        ends[k, 2] = l1 + hold + l2
        if hold == 0.0 or not is_known:  # the ramps of all turns with a hold are the same
            kp = peak_curvature(deflection, k0, s0, l1, hold, l2)
            heading = 0.5 * l1 * (k0 + kp) + s0 * l1 * l1 / 12.0
            x, y = ramp_end(0.0, k0, s0, kp, l1, 0.0)
            ex, ey = ramp_end(0.0, kp, 0.0, 0.0, l2, 0.0)
            is_known = hold > 0.0
        dx, dy = arc_end(heading, kp, hold)
        cos, sin = math.cos(heading + hold * kp), math.sin(heading + hold * kp)
        ends[k, 0], ends[k, 1] = x + dx + cos * ex - sin * ey, y + dy + sin * ex + cos * ey
