"""The look-up table of distances that the local planner needs from pose to pose (Esteban Cabezos 2020, section 2.4).

The table holds the length of the trailer's path of the shortest *forward* connection from the origin, heading 0 and
curvature k0, to (x, y, theta) with curvature k1, for a grid of offsets and k0, k1 of -k, 0 and k. Two symmetries
are exact and used:

    mirror          length(x, y, theta; k0, k1) = length(x, -y, -theta; -k0, -k1): only y >= 0 is stored
    time reversal   reverse from A to B = forward from B to A

A path turned end to end is *not* one of them: the truck leads on one of the two ways only.

Between nodes the length is interpolated where all eight nodes round it have one and they differ by no more than the
motion from node to node explains; elsewhere the nearest node speaks. Beyond the grid, the distance back to it is
added. A table is valid for one vehicle; building one takes 10 to 20 s, so callers may keep it by its `table_key`.
"""

import math
from dataclasses import astuple, dataclass
from functools import lru_cache
from typing import Final

import numpy as np
from numpy.typing import ArrayLike

from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64, frozen
from optim.numerics.kernel import kernel
from optim.steering.bezier import plan_bezier
from optim.steering.connect import local_ends
from optim.steering.flat import Flat, curve_limits
from optim.steering.turns import plan_turns

HALF: Final = 15
"""Nodes of the grid on either side of the origin; fewer make a table that reaches less far."""
CELL: Final = 0.25
"""Distance between nodes, as a share of the distance from hitch to trailer axle [-]."""
HEADINGS: Final = 24
"""Nodes in heading, over a full turn."""
BEND: Final = 0.5
"""The curvature k, as a share of the largest [-]."""
LONGEST: Final = 12.0
"""Connections longer than this many hitch-to-axle lengths count as none [-]."""
_SPREAD: Final = 6.0  # cells: nodes round a cell that differ by more belong to different kinds of connections


@dataclass(frozen=True, eq=False)
class Table:
    """Lengths of connections of one vehicle."""

    values: Float64[Array, "3 3 columns rows headings"]
    """k0, k1 (-k, 0, k), x, y, heading. Length of the trailer's path [m], inf where there is no connection.
    Shape (3, 3, 2 half + 1, half + 1, HEADINGS)."""
    cell: float
    """Distance between nodes [m]."""
    bend: float
    """The curvature k [1/m]."""

    def forward(self, start: Flat, end: Flat) -> float:
        """Length of the shortest forward connection [m], about; inf where the table knows none."""
        return float(forward_length(self.values, self.cell, self.bend, *start[:4], *end[:4]))

    def reverse(self, start: Flat, end: Flat) -> float:
        """Length of the shortest reverse connection [m], about."""
        return self.forward(end, start)

    def distance(self, start: Flat, end: Flat) -> float:
        """Length of the shorter of both [m]; where neither is known, of a straight line and of turning on an arc."""
        return float(metric(self.values, self.cell, self.bend, *start[:4], *end[:4]))


def table_shape(half: int) -> tuple[int, int, int, int, int]:
    """Shape of `Table.values` with this many nodes on either side of the origin."""
    return 3, 3, 2 * half + 1, half + 1, HEADINGS


def table_of(vehicle: Vehicle, values: ArrayLike) -> Table:
    """The table of a vehicle from its lengths, as `build_table` gave them."""
    return Table(frozen(values), CELL * vehicle.hitch_to_axle, BEND * vehicle.max_kappa)


def table_key(vehicle: Vehicle, half: int = HALF) -> str:
    """Vehicle and grid in one line: with the code of the local planner, all that a table depends on."""
    return repr((astuple(vehicle), half, CELL, HEADINGS, BEND, LONGEST))


@lru_cache(maxsize=8)
def lookup_table(vehicle: Vehicle, half: int = HALF) -> Table:
    """The table of a vehicle, built at the first call (10 to 20 s) and remembered."""
    return build_table(vehicle, half)


def build_table(vehicle: Vehicle, half: int = HALF) -> Table:
    """The table of a vehicle; its lengths are rounded to 1 cm and to float32."""
    cell, bend = CELL * vehicle.hitch_to_axle, BEND * vehicle.max_kappa
    return table_of(vehicle, _lengths(vehicle, table_shape(half), cell, bend).astype(np.float32))


def node_pose(half: int, cell: float, i: int, j: int, k: int) -> tuple[float, float, float]:
    """Offset (x [m], y [m], heading [rad]) of a node of the grid."""
    return (i - half) * cell, j * cell, -math.pi + k * 2.0 * math.pi / HEADINGS


def exact_length(vehicle: Vehicle, start: Flat, end: Flat, longest: float) -> float:
    """Length of the trailer's path of the shortest forward connection [m], inf where there is none."""
    first, last = local_ends(start, end)
    lim = curve_limits(vehicle)
    rows = plan_turns(first, last, lim, longest)
    turns = float(rows[:, 0].min()) if len(rows) else math.inf
    return min(turns, float(plan_bezier(first, last, lim, min(longest, turns))[0]))


def _lengths(vehicle: Vehicle, shape: tuple[int, ...], cell: float, bend: float) -> Array:
    values = np.full(shape, math.inf)
    longest = LONGEST * vehicle.hitch_to_axle
    for index in np.ndindex(values.shape):
        a, b, i, j, k = index
        x, y, heading = node_pose(shape[3] - 1, cell, i, j, k)
        start, end = Flat(0.0, 0.0, 0.0, (a - 1) * bend), Flat(x, y, heading, (b - 1) * bend)
        if x == 0.0 and y == 0.0 and abs(heading) < 1e-9 and a == b:
            values[index] = 0.0
        else:
            values[index] = exact_length(vehicle, start, end, longest)
    return values.round(2)


@kernel
def forward_length(values, cell, bend, x0, y0, theta0, kappa0, x1, y1, theta1, kappa1):
    """The table's length from one flat state to another, forward."""
    half, headings = values.shape[3] - 1, values.shape[4]
    c, s = math.cos(theta0), math.sin(theta0)
    dx, dy = x1 - x0, y1 - y0
    x, y, turn = c * dx + s * dy, c * dy - s * dx, theta1 - theta0
    a = min(max(int(np.rint(kappa0 / bend)), -1), 1)
    b = min(max(int(np.rint(kappa1 / bend)), -1), 1)
    if y < 0.0:
        y, turn, a, b = -y, -turn, -a, -b
    u, v = x / cell + half, y / cell
    w = (turn + math.pi) / (2.0 * math.pi / headings)
    w -= math.floor(w / headings) * headings
    in_u, in_v = min(max(u, 0.0), 2.0 * half), min(v, 1.0 * half)
    beyond = math.hypot(u - in_u, v - in_v) * cell
    i, j, k = min(int(in_u), 2 * half - 1), min(int(in_v), half - 1), int(w) % headings
    p, q, r = in_u - i, in_v - j, w - math.floor(w)
    total, low, high = 0.0, np.inf, -np.inf
    for corner in range(8):
        di, dj, dk = corner & 1, (corner >> 1) & 1, corner >> 2
        value = values[a + 1, b + 1, i + di, j + dj, (k + dk) % headings]
        low, high = min(low, value), max(high, value)
        share = (p if di else 1.0 - p) * (q if dj else 1.0 - q) * (r if dk else 1.0 - r)
        if share > 0.0:
            total += share * value
    if high - low <= _SPREAD * cell:
        return total + beyond
    near_i, near_j, near_k = i + int(p > 0.5), j + int(q > 0.5), (k + int(r > 0.5)) % headings
    return values[a + 1, b + 1, near_i, near_j, near_k] + beyond


@kernel
def metric(values, cell, bend, x0, y0, theta0, kappa0, x1, y1, theta1, kappa1):
    """The shorter of both gears, or a guess where the table knows none."""
    there = forward_length(values, cell, bend, x0, y0, theta0, kappa0, x1, y1, theta1, kappa1)
    back = forward_length(values, cell, bend, x1, y1, theta1, kappa1, x0, y0, theta0, kappa0)
    length = min(there, back)
    turn = theta1 - theta0
    turn = abs(turn - 2.0 * math.pi * np.rint(turn / (2.0 * math.pi)))
    guess = math.hypot(x1 - x0, y1 - y0) + turn / bend
    return min(length, guess + 4.0 * cell)
