"""Continuous-sharpness turns: turn - straight - turn between two flat states, forward.

Notation (Esteban Cabezos 2020, section 2.5): kappa is the curvature of the trailer's path, sigma = dkappa/ds_f.
A turn takes the curvature from (k0, s0) over a ramp of length l1 to its peak kp, holds it for a length h >= 0,
and takes it over a ramp of length l2 to 0, where the straight begins. A ramp is a cubic in arc length with
sigma = 0 at both ends (but s0 at the outer one). Its *deflection* is the change of heading,

    delta = l1 (k0 + kp) / 2 + s0 l1^2 / 12 + h kp + l2 kp / 2,

linear in kp, so that kp follows from delta, l1, h, l2 in closed form. The last turn is the first one of the curve
driven backwards: heading + pi, curvature -k1, sharpness s1. Both turns meet in a common tangent of heading psi,

    f(psi) = e_psi x (P2(psi) - P1(psi)) = 0     with the straight e_psi . (P2 - P1) >= 0.

For each end the *sharpest* turns, the shortest ramps within the vehicle's limits, are tabulated by deflection, in
two families: kp above max(k0, 0), with a hold once kp is at its limit, and kp below min(k0, 0). These are the four
combinations of turn directions. Roots of f over the tables are then solved with ramps that are exactly as short as
the limits allow at their own kp. All angles in the frame of the first state: origin, heading 0.
"""

import math

import numpy as np

from optim.numerics.arrays import Array, frozen
from optim.numerics.kernel import kernel
from optim.steering.flat import TOLERANCE, TWO_PI, CurveLimits, ramp_load
from optim.steering.sharpest import CELLS, ROWS, peak_curvature, sharpest_turns, tabulate_ends, tabulated, turn_end

NUM_SOLUTIONS = 4
"""Maximum number of solutions for a pair of states."""
_NUM_ROOTS = 24


@kernel(error_model="numpy")
def tangent(psi, x1, y1, x2, y2, goal):
    """(f, straight) for the line heading psi: first turn's end (x1, y1), last turn's (x2, y2) in its own frame."""
    c, s = math.cos(goal[2]), math.sin(goal[2])
    dx, dy = goal[0] - c * x2 + s * y2 - x1, goal[1] - s * x2 - c * y2 - y1
    c, s = math.cos(psi), math.sin(psi)
    return c * dy - s * dx, c * dx + s * dy


@kernel(error_model="numpy")
def gap(psi, shift, start, goal, turns, panels):
    """(f, straight) with both turns' lengths (2, 3) given; panels as in `ramp_end`."""
    x1, y1 = turn_end(psi, start[0], start[1], turns[0, 0], turns[0, 1], turns[0, 2], panels)
    x2, y2 = turn_end(psi - goal[2] + shift, -goal[3], goal[4], turns[1, 0], turns[1, 1], turns[1, 2], panels)
    return tangent(psi, x1, y1, x2, y2, goal)


@kernel(error_model="numpy")
def family_gap(psi, shift, start, goal, family1, family2, table, turns):
    """(f, straight, length of both turns) with tabulated turns, which are written to turns (2, 3)."""
    for i in range(2):
        family = family1 if i == 0 else family2
        delta = psi if i == 0 else psi - goal[2] + shift
        row = (2 * i + family) * ROWS
        turns[i, 0], turns[i, 1], turns[i, 2] = tabulated(table, row, (2.0 * family - 1.0) * delta)
    f, straight = gap(psi, shift, start, goal, turns, 0.0)
    return f, straight, turns[0, 0] + turns[0, 1] + turns[0, 2] + turns[1, 0] + turns[1, 1] + turns[1, 2]


@kernel(error_model="numpy")
def refine(low, f_low, high, f_high, shift, start, goal, family1, family2, table, turns):
    """Root psi of f over tabulated turns in a bracket, to 1 cm of f (Illinois); (psi, straight, length, slope of f)."""
    psi, straight, length, slope = low, -np.inf, np.inf, 1.0
    for _ in range(10):
        slope = (f_high - f_low) / (high - low)
        psi = high - f_high / slope
        f, straight, length = family_gap(psi, shift, start, goal, family1, family2, table, turns)
        if abs(f) < 1e-2:
            break
        if (f > 0.0) == (f_high > 0.0):
            f_low *= 0.5
        else:
            low, f_low = high, f_high
        high, f_high = psi, f
    return psi, straight, length, slope


@kernel(error_model="numpy")
def tabulate_turns(start, goal, lim, max_length, table, ends):
    """Fill table (4 ROWS, 4) and ends (4 (2 CELLS + 1), 3) with the sharpest turns from both ends.

    Returns whether two of them can be part of a path that is not longer than max_length.
    """
    step = TWO_PI / CELLS
    budget = max_length  # of one turn: what the shortest possible other one leaves
    for end in range(2):
        k0, s0 = (start[0], start[1]) if end == 0 else (-goal[3], goal[4])
        sided = (lim[0], lim[1] * (1.0 - 2.0 * end), lim[2], lim[3], lim[4], lim[5])
        budget = max_length - sharpest_turns(k0, s0, 2 * end * ROWS, sided, budget, table)
        if not budget > 0.0:
            return False
    for k in range(4):
        end, family = k // 2, k % 2
        k0, s0 = (start[0], start[1]) if end == 0 else (-goal[3], goal[4])
        offset = (-goal[2] - math.floor(-goal[2] / step) * step) * end
        tabulate_ends(k0, s0, offset, k * ROWS, 2.0 * family - 1.0, max_length, table, ends)
    return True


@kernel(error_model="numpy")
def find_tangents(start, goal, lim, max_length, table, ends, turns, roots):  # noqa: C901  its parts share all state
    """Fill roots (n, 10) with (length, psi, shift, slope of f, turns (2 x 3)) of common tangents of tabulated turns.

    Returns their number. No root is sought where both ends of a cell make a path longer than max_length, nor kept
    where the straight is much shorter than 0: exact ramps bring little more. Work space: turns (2, 3).
    """
    step = TWO_PI / CELLS
    whole = math.floor(-goal[2] / step)
    num_roots = 0
    slack = 0.1 * lim[1]
    for choice in range(20):
        family1, family2, wrap = choice % 2, choice // 2 % 2, choice // 4 - 2
        shift = wrap * TWO_PI
        # the interval of psi that turns of both families reach; its end is looked at where a family begins there
        low, high, is_low_looked_at, is_high_looked_at = -np.inf, np.inf, False, False
        for i in range(2):
            family = family1 if i == 0 else family2
            row = (2 * i + family) * ROWS
            middle = (goal[2] - shift) * i
            inner, outer = table[row, 0], min(table[row + ROWS - 1, 0], TWO_PI)  # as far as `ends` go
            from_psi, to_psi = (middle + inner, middle + outer) if family == 1 else (middle - outer, middle - inner)
            if from_psi > low:
                low, is_low_looked_at = from_psi, family == 1
            if to_psi < high:
                high, is_high_looked_at = to_psi, family == 0
        if not high - low > 1e-9:
            continue
        first, last = math.floor(low / step), math.ceil(high / step)
        psi_before, f_before, straight_before, length_before = 0.0, np.nan, 0.0, np.inf
        for cell in range(first, last + 1):
            psi = min(max(cell * step, low), high)
            f, straight, length = np.nan, 0.0, np.inf
            if first < cell < last:
                i = family1 * (2 * CELLS + 1) + cell + CELLS
                j = (2 + family2) * (2 * CELLS + 1) + cell + whole + (wrap + 1) * CELLS
                length = ends[i, 2] + ends[j, 2]
                if length < np.inf:
                    f, straight = tangent(psi, ends[i, 0], ends[i, 1], ends[j, 0], ends[j, 1], goal)
            elif is_low_looked_at if cell == first else is_high_looked_at:
                f, straight, length = family_gap(psi, shift, start, goal, family1, family2, table, turns)
            length += max(straight, 0.0)
            is_wanted = max(straight, straight_before) > -4.0 * slack and min(length, length_before) <= max_length
            is_change = f * f_before <= 0.0 and f != f_before and psi > psi_before
            if is_change and is_wanted and num_roots < _NUM_ROOTS:
                root, along, shortest, slope = refine(
                    psi_before, f_before, psi, f, shift, start, goal, family1, family2, table, turns
                )
                if along > -slack:
                    roots[num_roots, 0], roots[num_roots, 1] = shortest + max(along, 0.0), root
                    roots[num_roots, 2], roots[num_roots, 3] = shift, slope
                    for k in range(6):
                        roots[num_roots, 4 + k] = turns[k // 3, k % 3]
                    num_roots += 1
            psi_before, f_before, straight_before, length_before = psi, f, straight, length
    return num_roots


@kernel(error_model="numpy")
def solve_tangent(psi, slope, shift, start, goal, turns):
    """Root of f near psi with the turns' lengths fixed, to rounding (secant from a slope); (psi, straight) or nan."""
    root, step, f_before = psi, np.inf, np.nan
    for _ in range(12):
        f, straight = gap(root, shift, start, goal, turns, 1.0)
        if abs(f) < 1e-12 or abs(step) < 1e-14:
            return root, straight
        if f_before == f_before:
            slope = (f - f_before) / step
        if slope == 0.0 or abs(root - psi) > 0.5:
            break
        step, f_before = -f / slope, f
        root += step
    return root, np.nan


@kernel(error_model="numpy")
def scale_ramps(delta, k0, s0, top, loads, turns, end):
    """Bring the loads of both ramps of a turn towards 1, and its hold to what the deflection then needs.

    Where the steering rate limits, and a ramp's deflection is given, its load falls with the cube of its length;
    where the steering angle limits, with little more than the length itself. The exponent is between.
    """
    for i in range(2):
        turns[end, 2 * i] *= 1.002 * math.sqrt(min(max(loads[end, i], 0.7), 1.5))
    if turns[end, 1] > 0.0:
        ramps = delta - 0.5 * turns[end, 0] * k0 - s0 * turns[end, 0] * turns[end, 0] / 12.0
        kp = min(abs(loads[end, 2]), top)
        turns[end, 1] = max(0.0, abs(ramps) / kp - 0.5 * (turns[end, 0] + turns[end, 2]))


@kernel(error_model="numpy")
def solve_turns(root, start, goal, lim, turns, loads, row):  # noqa: C901  one iteration over both turns
    """Solve a root of `find_tangents` exactly with ramps at the limits; fill `row` of `plan_turns`; whether it could.

    Work space: turns (2, 3) and loads (2, 4), of which the columns are the loads of both ramps, kp and delta.
    """
    psi, shift, slope, straight = root[1], root[2], root[3], 0.0
    for k in range(6):
        turns[k // 3, k % 3] = root[4 + k]
    for attempt in range(7):
        if attempt > 0:
            psi, straight = solve_tangent(psi, slope, shift, start, goal, turns)
            if not straight > -0.1 * lim[1]:
                return False
        count, worst = 12.0, 0.0
        while count < 100.0:
            worst = 0.0
            for k in range(4):
                end, part = k // 2, k % 2
                k0, s0, l_t = (start[0], start[1], lim[1]) if end == 0 else (-goal[3], goal[4], -lim[1])
                delta = psi if end == 0 else psi - goal[2] + shift
                kp = peak_curvature(delta, k0, s0, turns[end, 0], turns[end, 1], turns[end, 2])
                if part == 1:
                    k0, s0 = kp, 0.0
                sided = (lim[0], l_t, lim[2], lim[3], lim[4], lim[5])
                loads[end, part] = ramp_load(k0, s0, kp * (1 - part), turns[end, 2 * part], count, np.inf, sided)
                loads[end, 2], loads[end, 3] = kp, delta
                worst = max(worst, loads[end, part])
            if attempt == 0 or not worst <= 1.0 + TOLERANCE:
                break
            count += 52.0
        if attempt > 0 and worst <= 1.0 + TOLERANCE:
            if straight < -1e-10:
                return False
            row[7], row[8], row[9] = max(straight, 0.0), loads[0, 2], loads[1, 2]
            row[0] = row[7]
            for k in range(6):
                row[1 + k] = turns[k // 3, k % 3]
                row[0] += row[1 + k]
            return True
        for end in range(2):
            k0, s0 = (start[0], start[1]) if end == 0 else (-goal[3], goal[4])
            if attempt > 0:  # shorter only the first time
                loads[end, 0], loads[end, 1] = max(loads[end, 0], 1.0), max(loads[end, 1], 1.0)
            scale_ramps(loads[end, 3], k0, s0, lim[5], loads, turns, end)
    return False


def plan_turns(start: Array, goal: Array, lim: CurveLimits, max_length: float) -> Array:
    """Turn - straight - turn from the origin with heading 0 and start = (k0, s0) to goal (x, y, theta, k1, s1).

    Returns rows (length, l1, hold, l2 of the first turn, l1, hold, l2 of the last one from the goal backwards,
    straight, kp of the first, kp of the last turn driven backwards), none longer than max_length. Shape (n, 10).
    """
    turns, roots = np.empty((2, 3)), np.empty((_NUM_ROOTS, 10))
    table, ends = np.empty((4 * ROWS, 4)), np.empty((4 * (2 * CELLS + 1), 3))
    num_roots = 0
    if tabulate_turns(start, goal, lim, max_length, table, ends):
        num_roots = find_tangents(start, goal, lim, max_length, table, ends, turns, roots)
    rows, loads, n = np.empty((NUM_SOLUTIONS, 10)), np.empty((2, 4)), 0
    for k in roots[:num_roots, 0].argsort():
        if n == NUM_SOLUTIONS or roots[k, 0] > 1.05 * max_length:
            break
        if solve_turns(roots[k], start, goal, lim, turns, loads, rows[n]) and rows[n, 0] <= max_length:
            n += 1
    return frozen(rows[:n])
