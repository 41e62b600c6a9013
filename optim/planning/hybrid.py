"""Hybrid A* in four dimensions: position, truck heading and hitch angle, with an exact connection to the goal.

After D. Dolgov and others, *Path Planning for Autonomous Vehicles in Unknown Semi-structured Environments*, 2010:
nodes keep the state they were reached in, cells only decide which of them compete. The heuristic is the larger of
the way round the obstacles in the plane and the local planner's length from its look-up table, so it knows both
walls and the vehicle; neither it nor the cells make the path optimal. Every few nodes the one nearest to the goal
is joined to it by the local planner, in either gear.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import dijkstra

from optim.geometry.collision import point_kernel
from optim.model.flat_map import flat_from_state, state_from_flat
from optim.model.path import Segment, segment_from_states
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, frozen
from optim.planning.lookup import Table, lookup_table
from optim.planning.protocol import (
    CONNECTION_SPACING,
    GiveUp,
    PlannedPath,
    PlanningProblem,
    assemble,
    clear_connection,
    extent,
    never,
)
from optim.planning.search_kernels import STEP, cell_of, expand, heuristic, primitive, push, slot_of
from optim.steering.flat import Flat

_AROUND_GRID = 0.5  # [m]: size of the cells of the way round obstacles


@dataclass(frozen=True, kw_only=True)
class HybridAStar:
    """Motion primitives on a grid; lengths given in l_t scale with the distance from hitch to trailer axle."""

    max_nodes: int = 400_000
    """Maximum number of nodes."""
    cell: float = 0.1
    """Size of a cell [l_t]."""
    heading_cells: int = 48
    """Cells in heading, over a full turn."""
    hitch_cells: int = 12
    """Cells in hitch angle, over twice its limit."""
    primitive: float = 0.25
    """Length of a primitive [l_t]."""
    targets: int = 5
    """Steering angles that primitives aim at."""
    cusp_cost: float = 5.0
    """Length that a gear change counts for [m]."""
    reverse_cost: float = 0.05
    """Length that 1 m in reverse counts for beyond itself [-]."""
    steer_cost: float = 0.5
    """Weight on the square of the steering angle, by length [1/rad^2]."""
    weight: float = 1.5
    """Weight on the heuristic: above 1 the search hurries [-]."""
    chunk: int = 8
    """Nodes expanded between two tries of an exact connection."""
    longest_connection: float = 5.0
    """Longest connection to the goal [l_t]."""
    table: Callable[[Vehicle], Table] = lookup_table
    """Look-up table of a vehicle's local planner; see `optim.planning.lookup`."""
    spare_steer: float = 0.9
    """Share of the steering limit and of the hitch limit that primitives use [-]."""

    @property
    def name(self) -> str:
        """Name in tables and lists."""
        return "Hybrid A*"

    def plan(self, problem: PlanningProblem, seed: int, give_up: GiveUp = never) -> PlannedPath | None:
        """The first path found. The seed shifts the cells: another seed, another path."""
        search = _Search(self, problem, seed)
        if math.isinf(search.nodes[0, 6]):
            return None
        expanded, tried, best = 0, -1, math.inf
        while not give_up():
            popped = search.expand(self.chunk)
            popped = popped[popped >= 0]
            if len(popped) == 0:
                return None
            expanded += len(popped)
            nearest = int(popped[np.argmin(search.nodes[popped, 6])])
            if nearest == tried or search.nodes[nearest, 6] > max(2.0 * best, 2.0 * problem.vehicle.hitch_to_axle):
                continue
            tried, best = nearest, min(best, search.nodes[nearest, 6])
            last = search.connect(nearest)
            if last is not None:
                return assemble([*search.way_to(nearest), last], expanded)
        return None


class _Search:
    """Nodes of one search and what its kernel needs."""

    def __init__(self, options: HybridAStar, problem: PlanningProblem, seed: int) -> None:
        vehicle = problem.vehicle
        self.options, self.problem, self.l_t = options, problem, vehicle.hitch_to_axle
        table = options.table(vehicle)
        field, field_frame = way_round(problem)
        self.guide = (field, field_frame, table.values, table.cell, table.bend)
        self.motion = vehicle.motion_limits
        self.limits = (
            vehicle.max_steer,
            options.spare_steer * vehicle.max_hitch,
            options.spare_steer * vehicle.max_steer_rate,
        )
        top = options.spare_steer * vehicle.max_steer
        self.targets = np.linspace(-top, top, options.targets)
        length = options.primitive * self.l_t
        self.lengths = (length, math.ceil(length / STEP) + 1)
        size = options.cell * self.l_t
        x0, y0, _, _ = extent(problem, 4.0 * self.l_t)
        shift = np.random.default_rng(seed).random(2) * size
        self.frame = (
            x0 - 8.0 * self.l_t - float(shift[0]),
            y0 - 8.0 * self.l_t - float(shift[1]),
            size,
            2.0 * math.pi / options.heading_cells,
            2.0 * vehicle.max_hitch / options.hitch_cells,
        )
        self.goal = tuple(float(value) for value in problem.goal[:4])
        self.nodes, self.links = np.empty((options.max_nodes, 7)), np.zeros((options.max_nodes, 3), dtype=np.int64)
        self.heap = np.empty((options.max_nodes, 2))
        places = 1 << (2 * options.max_nodes - 1).bit_length()
        self.keys, self.best = np.full(places, -1, dtype=np.int64), np.empty(places)
        self.sizes = np.zeros(3, dtype=np.int64)
        self._add_root()

    def _add_root(self) -> None:
        states, phi = state_from_flat(self.problem.vehicle, np.array(self.problem.start))
        self.nodes[0, :4], self.nodes[0, 4], self.nodes[0, 5], self.links[0, 0] = states, phi, 0.0, -1
        x, y, theta, alpha = states.tolist()
        self.nodes[0, 6] = heuristic(x, y, theta, alpha, self.goal, self.l_t, *self.guide)
        key = cell_of(x, y, theta, alpha, 0, self.frame)
        slot = slot_of(self.keys, key)
        self.keys[slot], self.best[slot] = key, 0.0
        self.sizes[:] = 1, push(self.heap, 0, self.nodes[0, 6], 0), 1

    def expand(self, count: int) -> Any:
        """Numbers of the nodes expanded next."""
        options, problem = self.options, self.problem
        world = (problem.scene.packed, problem.vehicle.footprints, self.motion, float(problem.margin))
        costs = (options.cusp_cost, options.reverse_cost, options.steer_cost, options.weight)
        return expand(
            count, self.sizes, self.nodes, self.links, self.heap, self.keys, self.best, world,
            self.limits, costs, self.targets, self.lengths, self.frame, self.goal, self.guide,
        )  # fmt: skip

    def connect(self, number: int) -> Segment | None:
        """The exact connection from a node to the goal, in the gear that gives the shorter one."""
        node, gear_before = self.nodes[number], self.links[number, 1]
        found = []
        for gear in (1, -1):
            phi = node[4] if gear == gear_before else self._holding(node[3])
            start = Flat(*flat_from_state(self.problem.vehicle, node[:4], np.asarray(phi)).tolist())
            longest = self.options.longest_connection * self.l_t
            edge = clear_connection(self.problem, start, self.problem.goal, gear, longest)
            if edge is not None:
                is_turned = gear_before not in (0, gear)
                found.append(
                    (edge.trailer_length + self.options.cusp_cost * is_turned, edge.segment(CONNECTION_SPACING))
                )
        return min(found, key=lambda pair: pair[0])[1] if found else None

    def _holding(self, alpha: float) -> float:
        """The steering that keeps a hitch angle: the one of sharpness 0 [rad]."""
        kappa = -math.tan(alpha) / self.l_t
        return float(state_from_flat(self.problem.vehicle, np.array([0.0, 0.0, 0.0, kappa, 0.0]))[1])

    def way_to(self, number: int) -> list[Segment]:
        """The primitives from the root to a node."""
        pieces = []
        while number != 0:
            parent, gear, target = self.links[number].tolist()
            before = self.links[parent, 1]
            steer = float(self.targets[target])
            phi0 = steer if before in (0, -gear) else float(self.nodes[parent, 4])
            s, states = np.empty(self.lengths[1]), np.empty((self.lengths[1], 4))
            phi, kinematics = np.empty(self.lengths[1]), self.motion[:3]
            start, length, rate = self.nodes[parent], self.lengths[0], self.limits[2]
            primitive(start, float(gear), phi0, steer, length, rate, kinematics, s, states, phi)
            pieces.append(segment_from_states(gear, s, states, phi))
            number = parent
        return pieces[::-1]


def way_round(problem: PlanningProblem) -> tuple[Array, tuple[float, float, float]]:
    """Distance of the truck's rear axle to its goal in the plane round the obstacles, on a grid; and the grid.

    A cell is open where its centre is as far from obstacles as the axle must be at least, in whatever heading: the
    trailer, half its width to each side and the margin, but for half a cell's diagonal. inf where there is no way.
    """
    x0, y0, x1, y1 = extent(problem, 6.0 * problem.vehicle.hitch_to_axle)
    size = _AROUND_GRID
    nx, ny = math.ceil((x1 - x0) / size) + 1, math.ceil((y1 - y0) / size) + 1
    i, j = np.indices((nx, ny))
    centres = np.stack([x0 + (i.ravel() + 0.5) * size, y0 + (j.ravel() + 0.5) * size], axis=1)
    near = 0.5 * problem.vehicle.trailer_width + problem.margin - 0.75 * size
    is_open = (point_kernel(problem.scene.packed, frozen(centres)) >= near).reshape(nx, ny)
    number = np.arange(nx * ny).reshape(nx, ny)
    rows, columns, lengths = [], [], []
    for di, dj in ((1, 0), (0, 1), (1, 1), (1, -1)):
        a = (slice(0, nx - di), slice(max(0, -dj), ny - max(0, dj)))
        b = (slice(di, nx), slice(max(0, dj), ny - max(0, -dj)))
        both = is_open[a] & is_open[b]
        rows.append(number[a][both])
        columns.append(number[b][both])
        lengths.append(np.full(len(rows[-1]), size * math.hypot(di, dj)))
    links = (np.concatenate(rows), np.concatenate(columns))
    graph = coo_array((np.concatenate(lengths), links), shape=(nx * ny, nx * ny)).tocsr()
    goal, _ = state_from_flat(problem.vehicle, np.array(problem.goal))
    at = number[min(max(int((goal[0] - x0) / size), 0), nx - 1), min(max(int((goal[1] - y0) / size), 0), ny - 1)]
    field = dijkstra(graph, directed=False, indices=int(at))
    return np.ascontiguousarray(field.reshape(nx, ny).round(6)), (float(x0), float(y0), size)
