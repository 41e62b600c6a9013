"""Convex polygons that cover the occupied cells of a grid: every cell, few polygons, little free area.

Two steps. *Rectangles*, which add nothing: each maximal run of occupied cells in a row or a column is widened as
far as all cells beside it are occupied; the largest of these rectangles are taken until every cell is covered.
*Hulls*: neighbours are replaced by their convex hull, cheapest first, while all hulls together add at most
`max_extra` of the occupied area, and while a hull touches no cell but occupied ones and their eight neighbours, so
that it protrudes by a cell's diagonal at most (half of it over the notches of a diagonal).

Cells are squares with integer corners here; (x, y) is (column, row).
"""

import heapq
import math
from itertools import repeat

import numpy as np
from numpy.typing import ArrayLike, NDArray

from optim.numerics.arrays import Array, IntArray, frozen

CellRing = list[tuple[int, int]]

_MOST_HULLS = 20_000  # tried, some 2 s; noise has too many, and the rest may stay rectangles
_MAX_SIDE = 30_000  # cells: what the products of coordinates below are safe for, and 900 million cells


def cover_cells(
    occupied: ArrayLike,
    resolution: float,
    origin: tuple[float, float, float] = (0.0, 0.0, 0.0),
    max_extra: float = 0.05,
) -> list[Array]:
    """Convex counter-clockwise polygons [m] that contain the square of every occupied cell.

    Args:
        occupied: boolean grid, row 0 at the origin. Shape (H, W).
        resolution: side of a cell [m].
        origin: corner of cell (0, 0) [m] and direction of the rows [rad], (x, y, yaw).
        max_extra: free area that the polygons may cover, as a share of the occupied area.
    """
    cells = np.ascontiguousarray(occupied, dtype=bool)
    if cells.ndim != 2 or max(cells.shape) > _MAX_SIDE:
        raise ValueError(f"occupied has the shape {cells.shape}, expected (rows, columns) up to {_MAX_SIDE} each")
    if not resolution > 0.0:
        raise ValueError(f"resolution is {resolution!r} m, expected a positive number")
    if not max_extra >= 0.0:
        raise ValueError(f"max_extra is {max_extra!r}, expected a share of the occupied area, 0 or more")
    boxes, owner = _rectangles(cells)
    kept, rings = _Hulls(cells, boxes, _neighbours(owner), max_extra * float(cells.sum())).merge()
    x, y, yaw = origin
    turn = resolution * np.array([[math.cos(yaw), math.sin(yaw)], [-math.sin(yaw), math.cos(yaw)]])
    rectangles = frozen(boxes[kept][:, [[0, 1], [2, 1], [2, 3], [0, 3]]] @ turn + [x, y])
    return [*rectangles, *(frozen(np.array(ring, dtype=np.float64) @ turn + [x, y]) for ring in rings)]


def _rectangles(cells: NDArray[np.bool_]) -> tuple[IntArray, NDArray[np.int32]]:
    """Maximal rectangles (x0, y0, x1, y1), ends exclusive, shape (R, 4); and per cell the first that covers it, or -1.

    Every cell lies in a run, and every run is covered when its turn has come.
    """
    rows, columns = _widened_runs(cells), _widened_runs(cells.T)
    columns = columns[:, [1, 0, 3, 2, 5, 4, 7, 6]]
    area = (rows[:, 6] - rows[:, 4]) * (rows[:, 7] - rows[:, 5])
    single = rows[area == 1]
    owner = np.full(cells.shape, -1, dtype=np.int32)
    owner[single[:, 1], single[:, 0]] = np.arange(len(single))
    # a run of one cell is widened to the very run of the other direction that the cell lies in
    runs = np.concatenate([rows[rows[:, 2] - rows[:, 0] > 1], columns[columns[:, 3] - columns[:, 1] > 1]])
    area = (runs[:, 6] - runs[:, 4]) * (runs[:, 7] - runs[:, 5])
    taken: list[int] = []
    order = np.argsort(-area, kind="stable")
    for index, (x0, y0, x1, y1, left, low, right, high) in zip(order.tolist(), runs[order].tolist(), strict=True):
        if (owner[y0:y1, x0:x1] < 0).any():
            block = owner[low:high, left:right]
            np.copyto(block, len(single) + len(taken), where=block < 0)
            taken.append(index)
    return np.concatenate([single[:, 4:], runs[taken, 4:]]), owner


def _widened_runs(cells: NDArray[np.bool_]) -> IntArray:
    """Maximal runs along rows, each followed by its widened rectangle: (x0, y0, x1, y1) twice. Shape (K, 8)."""
    height = len(cells)
    edges = np.diff(np.pad(cells, ((0, 0), (1, 1))).astype(np.int8), axis=1)
    y, x0 = np.nonzero(edges == 1)
    x1 = np.nonzero(edges == -1)[1]
    if not len(y):
        return np.empty((0, 8), dtype=np.int64)
    row = np.arange(height, dtype=np.int32)[:, None]
    empty_below = np.maximum.accumulate(np.where(cells, np.int32(-1), row), axis=0)
    empty_above = np.minimum.accumulate(np.where(cells, np.int32(height), row)[::-1], axis=0)[::-1]
    begin = np.concatenate([[0], np.cumsum(x1 - x0)[:-1]])
    low = np.maximum.reduceat(empty_below[cells], begin) + 1
    high = np.minimum.reduceat(empty_above[cells], begin)
    return np.stack([x0, y, x1, y + 1, x0, low, x1, high], axis=1).astype(np.int64)


def _neighbours(owner: NDArray[np.int32]) -> IntArray:
    """Pairs of rectangles that own cells beside each other, at corners too. Shape (P, 2), first < second."""
    shifts = (
        (owner[:, :-1], owner[:, 1:]),
        (owner[:-1], owner[1:]),
        (owner[:-1, :-1], owner[1:, 1:]),
        (owner[:-1, 1:], owner[1:, :-1]),
    )
    keys = []
    for one, other in shifts:
        apart = (one != other) & (one >= 0) & (other >= 0)
        a, b = one[apart].astype(np.int64), other[apart].astype(np.int64)
        keys.append(np.minimum(a, b) << 32 | np.maximum(a, b))
    key = np.unique(np.concatenate(keys))
    return np.stack([key >> 32, key & 0xFFFFFFFF], axis=1)


def _pair_costs(a: IntArray, b: IntArray, raster: "_Raster") -> tuple[Array, NDArray[np.bool_]]:
    """Area that the hull of two rectangles adds, for rows (x0, y0, x1, y1), and whether that is exact. Shape (P,).

    The hull is the common bounding box, each corner cut off by the line from the one rectangle's corner to the
    other's, unless one of them reaches into it. Other occupied cells in that box may fill what lies between: then it
    is a low guess, a quarter of what the box's empty cells would make if they lay evenly.
    """
    low, high = np.minimum(a, b), np.maximum(a, b)
    box = ((high[:, 2] - low[:, 0]) * (high[:, 3] - low[:, 1])).astype(float)
    hull = box.copy()
    for column, row, sign in ((0, 1, 1), (2, 1, -1), (0, 3, -1), (2, 3, 1)):
        cut = sign * (a[:, column] - b[:, column]) * (a[:, row] - b[:, row])
        hull -= 0.5 * np.maximum(-cut, 0)
    common = np.maximum(low[:, 2] - high[:, 0], 0) * np.maximum(low[:, 3] - high[:, 1], 0)
    area_a, area_b = ((r[:, 2] - r[:, 0]) * (r[:, 3] - r[:, 1]) for r in (a, b))
    union = area_a + area_b - common
    occupied = raster.occupied_in(np.concatenate([low[:, :2], high[:, 2:]], axis=1))
    guess = np.maximum(hull - occupied, 0.25 * (box - occupied) * hull / box)
    is_exact = occupied == union
    return np.where(is_exact, hull - union, guess), is_exact


class _Raster:
    """Counts of cells inside convex rings, by row sums."""

    def __init__(self, cells: NDArray[np.bool_]) -> None:
        across = np.pad(cells, 1)
        across = across[:, :-2] | across[:, 1:-1] | across[:, 2:]
        self._occupied = _row_sums(cells)
        self._far = _row_sums(~(across[:-2] | across[1:-1] | across[2:]))

    def occupied_in(self, boxes: IntArray) -> IntArray:
        """Number of occupied cells in each box (x0, y0, x1, y1). Shape (P,)."""
        total = np.pad(np.cumsum(self._occupied, axis=0), ((1, 0), (0, 0)))
        x0, y0, x1, y1 = boxes.T
        return total[y1, x1] - total[y0, x1] - total[y1, x0] + total[y0, x0]

    def survey(self, ring: CellRing) -> tuple[int, bool]:
        """Number of occupied cells wholly in the ring; whether all it touches is near one."""
        rows, left, right = _chords(ring)
        first = np.ceil(np.maximum(left[:-1], left[1:]) - 1e-9).astype(np.int64)
        last = np.floor(np.minimum(right[:-1], right[1:]) + 1e-9).astype(np.int64)
        inside = self._occupied[rows, np.maximum(first, last)] - self._occupied[rows, first]
        first = np.floor(np.minimum(left[:-1], left[1:]) + 1e-9).astype(np.int64)
        last = np.ceil(np.maximum(right[:-1], right[1:]) - 1e-9).astype(np.int64)
        return int(inside.sum()), not (self._far[rows, last] - self._far[rows, first]).any()


def _row_sums(cells: NDArray[np.bool_]) -> NDArray[np.int32]:
    sums = np.zeros((cells.shape[0], cells.shape[1] + 1), dtype=np.int32)
    np.cumsum(cells, axis=1, out=sums[:, 1:], dtype=np.int32)
    return sums


def _chords(ring: CellRing) -> tuple[IntArray, Array, Array]:
    """The rows that a ring crosses, and its left and right end on each line between rows, one more than rows.

    The ring starts with its lowest vertex, the leftmost of these, as `_hull` returns it.
    """
    top = max(y for _, y in ring)
    last = max(i for i, (_, y) in enumerate(ring) if y == top)
    first = min(i for i, (_, y) in enumerate(ring) if y == top)
    lines = np.arange(ring[0][1], top + 1)
    rising = ring[1 if ring[1][1] == ring[0][1] else 0 : first + 1]
    falling = [*ring[last:], ring[0]][::-1]
    right = np.interp(lines, [y for _, y in rising], [x for x, _ in rising])
    left = np.interp(lines, [y for _, y in falling], [x for x, _ in falling])
    return lines[:-1], left, right


def _hull(points: set[tuple[int, int]]) -> CellRing:
    """Strictly convex hull, counter-clockwise from the lowest point, the leftmost of these (Andrew 1979)."""
    ordered = sorted((y, x) for x, y in points)
    chains = []
    for sequence in (ordered, ordered[::-1]):
        chain: list[tuple[int, int]] = []
        for y, x in sequence:
            while len(chain) >= 2:
                (by, bx), (ay, ax) = chain[-1], chain[-2]
                if (bx - ax) * (y - by) - (by - ay) * (x - bx) > 0:
                    break
                chain.pop()
            chain.append((y, x))
        chains.append(chain[:-1])
    return [(x, y) for chain in chains for y, x in chain]


def _area(ring: CellRing) -> float:
    return 0.5 * sum(ax * by - ay * bx for (ax, ay), (bx, by) in zip(ring, ring[1:] + ring[:1], strict=True))


def _is_tiny(ring: CellRing) -> bool:
    """Whether a ring lies in a block of 2 x 2 cells."""
    low_y, high_y = ring[0][1], max(y for _, y in ring)
    return high_y - low_y <= 2 and max(x for x, _ in ring) - min(x for x, _ in ring) <= 2


class _Hulls:
    """Rectangles and the hulls that replace them, and what each pair of neighbours would cost if joined."""

    def __init__(self, cells: NDArray[np.bool_], boxes: IntArray, pairs: IntArray, budget: float) -> None:
        self._raster = _Raster(cells)
        self._left = budget
        self._boxes = boxes
        self._gone = np.zeros(len(boxes), dtype=bool)  # rectangles that have become part of a hull
        self._rings: dict[int, CellRing] = {}  # hulls, numbered on from the rectangles
        self._extra: dict[int, float] = {}
        self._next = len(boxes)
        costs, is_exact = _pair_costs(boxes[pairs[:, 0]], boxes[pairs[:, 1]], self._raster)
        order = np.argsort(costs, kind="stable")
        costs, pairs = costs[order], pairs[order]
        # price, whether it is exact, the pair, and once they have been looked up its hull and the area that adds
        self._heap: list[tuple[float, bool, int, int, CellRing | None, float]] = list(
            zip(costs.tolist(), is_exact[order].tolist(), *pairs.T.tolist(), repeat(None), repeat(0.0), strict=False)
        )
        heapq.heapify(self._heap)
        both = np.concatenate([pairs, pairs[:, ::-1]])
        order = np.argsort(both[:, 0], kind="stable")
        self._beside, self._beside_costs = both[order, 1], np.concatenate([costs, costs])[order]
        self._first = np.searchsorted(both[order, 0], np.arange(len(boxes) + 1))
        self._known: dict[int, dict[int, float]] = {}

    def merge(self) -> tuple[IntArray, list[CellRing]]:
        """Join the cheapest pair until the next is too dear or enough were tried.

        Returns the numbers of the rectangles left, and the hulls.
        The price of a pair of which one has grown is looked up when its turn would have come at the old price.
        """
        looked_at = 0
        while self._heap and looked_at < _MOST_HULLS:
            cost, is_exact, a, b, ring, extra = heapq.heappop(self._heap)
            if cost > self._left:
                break
            if not (self._is_there(a) and self._is_there(b)):
                continue
            if ring is None:
                ring = _hull({*self._ring(a), *self._ring(b)})
                looked_at += 1
                if is_exact and _is_tiny(ring):
                    extra = cost  # in noise most are: nothing to look up
                else:
                    inside, is_close = self._raster.survey(ring)
                    if not is_close:
                        continue
                    extra = _area(ring) - inside
                    cost = extra - self._extra.get(a, 0.0) - self._extra.get(b, 0.0)
                    self._costs(a)[b] = self._costs(b)[a] = cost
            if self._heap and cost > self._heap[0][0]:
                heapq.heappush(self._heap, (cost, True, a, b, ring, extra))
            elif cost <= self._left:
                self._left -= cost
                self._join(a, b, ring, extra)
        self._drop_swallowed()
        return np.flatnonzero(~self._gone), list(self._rings.values())

    def _is_there(self, k: int) -> bool:
        return k in self._rings if k >= len(self._boxes) else not self._gone[k]

    def _ring(self, k: int) -> CellRing:
        if k >= len(self._boxes):
            return self._rings[k]
        x0, y0, x1, y1 = self._boxes[k].tolist()
        return [(x0, y0), (x1, y0), (x1, y1), (x0, y1)]

    def _costs(self, k: int) -> dict[int, float]:
        """The price of joining k with each neighbour, as last known."""
        if k not in self._known:
            span = slice(self._first[k], self._first[k + 1])
            self._known[k] = dict(zip(self._beside[span].tolist(), self._beside_costs[span].tolist(), strict=True))
        return self._known[k]

    def _remove(self, k: int) -> None:
        if k >= len(self._boxes):
            del self._rings[k]
        else:
            self._gone[k] = True

    def _join(self, a: int, b: int, ring: CellRing, extra: float) -> None:
        self._remove(a)
        self._remove(b)
        new, self._next = self._next, self._next + 1
        self._rings[new], self._extra[new] = ring, extra
        beside = dict(self._costs(a))
        for k, cost in self._costs(b).items():
            beside[k] = min(cost, beside.get(k, math.inf))
        self._known[new] = {k: cost for k, cost in beside.items() if self._is_there(k)}
        for k, cost in self._known[new].items():
            self._costs(k)[new] = cost
            heapq.heappush(self._heap, (cost, False, new, k, None, 0.0))

    def _drop_swallowed(self) -> None:
        """Removes what lies wholly in a neighbour's hull."""
        for k in list(self._rings):
            if k in self._rings:
                corners = set(self._rings[k])
                for n in self._costs(k):
                    if self._is_there(n) and set(_hull({*corners, *self._ring(n)})) == corners:
                        self._remove(n)
