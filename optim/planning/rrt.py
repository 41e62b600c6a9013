"""A bidirectional rapidly-exploring random tree over exact steering: feasible paths, not good ones.

One tree grows from the start, one from the goal, the latter along reversed time. A node is a flat state with
sharpness 0, so that the steering is continuous from edge to edge; an edge is one exact connection in one gear,
clear of obstacles between its samples too. The first path found is returned as it is, with all the needless turns
of the samples it happened to go through; the corpus needs such paths.
"""

import math
from dataclasses import dataclass

import numpy as np

from optim.model.clearance import first_violation
from optim.numerics.arrays import Array
from optim.planning.protocol import (
    CONNECTION_SPACING,
    GiveUp,
    PlannedPath,
    PlanningProblem,
    assemble,
    never,
    random_pose,
)
from optim.steering.connect import Connection, connections
from optim.steering.flat import Flat


@dataclass(frozen=True, eq=False, kw_only=True)
class Found:
    """Connections in the order of travel, and the number of samples that they took."""

    edges: tuple[Connection, ...]
    iterations: int


@dataclass(frozen=True, kw_only=True)
class Rrt:
    """Random curvature ramps and exact connections."""

    max_iterations: int = 600
    """Maximum number of samples."""
    neighbours: int = 3
    """Nodes that are extended towards a sample until one gives a new node."""
    shots: int = 8
    """Random curvatures and lengths per gear; those that end nearest to the sample are tried."""
    step: tuple[float, float] = (4.0, 15.0)
    """Shortest and longest shot [m of the trailer's axle]."""
    straight: float = 0.5
    """Share of shots that end with a straight hitch; the others end with any curvature."""
    max_bridge: float = 28.0
    """Longest edge between the trees [m of the trailer's axle]."""
    bridges: int = 6
    """Nodes of the other tree that a new node may be joined to."""
    heading_weight: float = 6.0
    """Distance that a difference of 1 rad in heading counts for [m]."""
    cost_weight: float = 0.12
    """Distance that 1 m on the way from the root to a node counts for [m]: short ways are extended first."""
    cusp_cost: float = 8.0
    """Length that a gear change counts for on that way [m]."""
    spacing: float = 0.2
    """Samples for the collision check are at most this far apart [m]."""

    @property
    def name(self) -> str:
        """Name in tables and lists."""
        return "RRT"

    def plan(self, problem: PlanningProblem, seed: int, give_up: GiveUp = never) -> PlannedPath | None:
        """The first path that the trees find; see `optim.planning.protocol.Planner`."""
        found = self.search(problem, seed, give_up)
        if found is None:
            return None
        return assemble([edge.segment(CONNECTION_SPACING) for edge in found.edges], found.iterations)

    def search(self, problem: PlanningProblem, seed: int, give_up: GiveUp = never) -> Found | None:
        """The edges of that path, or None after the maximum number of samples or once `give_up()`.

        The path keeps the vehicle's limits and the problem's margin from every obstacle, between samples too. The
        same seed gives the same path.
        """
        planner = _RrtGrower(problem, self, seed)
        trees = (
            _ConnectionTree(problem.start, self, forward_in_time=True),
            _ConnectionTree(problem.goal, self, forward_in_time=False),
        )
        for iteration in range(self.max_iterations):
            if give_up():
                return None
            tree, other = trees if iteration % 2 == 0 else trees[::-1]
            index = planner.extend(tree, random_pose(problem, planner.rng))
            if index is None:
                continue
            edges = planner.bridge(tree, index, other)
            if edges is not None:
                return Found(edges=tuple(edges), iterations=iteration + 1)
        return None


class _ConnectionTree:
    """Nodes with their parents, and the edge that joins each to its parent."""

    def __init__(self, root: Flat, options: Rrt, forward_in_time: bool) -> None:
        self.nodes = [root]
        self.parents = [-1]
        self.edges: list[Connection | None] = [None]
        self.forward_in_time = forward_in_time
        self.options = options
        self._table = np.empty((options.max_iterations + 1, 4))  # x, y, heading, cost of the way from the root
        self._table[0] = (*root[:3], 0.0)

    def add(self, node: Flat, parent: int, edge: Connection) -> int:
        before = self.edges[parent]
        turned = before is not None and before.direction != edge.direction
        cost = self._table[parent, 3] + edge.trailer_length + turned * self.options.cusp_cost
        self._table[len(self.nodes)] = (*node[:3], cost)
        self.nodes.append(node)
        self.parents.append(parent)
        self.edges.append(edge)
        return len(self.nodes) - 1

    def nearest(self, node: Flat, count: int) -> list[int]:
        """Indices of the nearest nodes by position, heading and cost of the way to them, nearest first."""
        table = self._table[: len(self.nodes)]
        far = _distance(table, node, self.options.heading_weight) + self.options.cost_weight * table[:, 3]
        return np.argsort(far.round(6), kind="stable")[:count].tolist()

    def branch(self, index: int) -> list[Connection]:
        """The edges from a node to the root."""
        edges = []
        while (edge := self.edges[index]) is not None:
            edges.append(edge)
            index = self.parents[index]
        return edges


class _RrtGrower:
    """One search: problem and options at hand for every edge."""

    def __init__(self, problem: PlanningProblem, options: Rrt, seed: int) -> None:
        self.problem, self.options = problem, options
        self.rng = np.random.default_rng(seed)

    def shots(self, parent: Flat, sample: Flat) -> list[tuple[Flat, int]]:
        """Ends of random curvature ramps out of the parent in both gears, nearest to the sample first."""
        options, rng = self.options, self.rng
        count = 2 * options.shots
        gear = np.repeat([1, -1], options.shots)
        length = rng.uniform(*options.step, count)
        limit = 0.85 * self.problem.vehicle.max_kappa
        kappa = np.where(rng.random(count) < options.straight, 0.0, rng.uniform(-limit, limit, count))
        ends = ramp_ends(parent, kappa.round(4), (gear * length).round(2))
        far = _distance(ends, sample, options.heading_weight)
        order = np.argsort(far.round(6), kind="stable")[: options.shots // 2]
        return [(Flat(*ends[i].round(4).tolist()), int(gear[i])) for i in order]

    def link(self, start: Flat, end: Flat, gear: int, longest: float) -> Connection | None:
        """The shortest connection that is clear of obstacles."""
        problem = self.problem
        for edge in connections(problem.vehicle, start, end, gear, longest)[:2]:
            s, states, _ = edge.sample(self.options.spacing)
            if first_violation(problem.scene, problem.vehicle, s, states, problem.margin) < 0:
                return edge
        return None

    def extend(self, tree: _ConnectionTree, sample: Flat) -> int | None:
        """Add one node in the direction of the sample; its index, or None."""
        for parent in tree.nearest(sample, self.options.neighbours):
            for node, gear in self.shots(tree.nodes[parent], sample):
                if tree.forward_in_time:
                    edge = self.link(tree.nodes[parent], node, gear, 1.5 * self.options.step[1])
                else:
                    edge = self.link(node, tree.nodes[parent], -gear, 1.5 * self.options.step[1])
                if edge is not None:
                    return tree.add(node, parent, edge)
        return None

    def bridge(self, tree: _ConnectionTree, index: int, other: _ConnectionTree) -> list[Connection] | None:
        """The whole path if the node can be joined to the other tree."""
        node = tree.nodes[index]
        for near in other.nearest(node, self.options.bridges):
            ends = (index, near) if tree.forward_in_time else (near, index)
            first, last = (tree, other) if tree.forward_in_time else (other, tree)
            for gear in (1, -1):
                edge = self.link(first.nodes[ends[0]], last.nodes[ends[1]], gear, self.options.max_bridge)
                if edge is not None:
                    return [*first.branch(ends[0])[::-1], edge, *last.branch(ends[1])]
        return None


def ramp_ends(start: Flat, kappa: Array, length: Array) -> Array:
    """Flat states at the ends of cubic curvature ramps from `start` to `kappa` over signed lengths [m].

    kappa(u) = k0 + (k1 - k0) (3 u^2 - 2 u^3) has slope 0 at both ends, u the share of the length. Shape (n, 5).
    """
    nodes, weights = np.polynomial.legendre.leggauss(10)
    u, step = 0.5 * (nodes + 1.0), (kappa - start.kappa)[:, None]
    turn = length[:, None] * (start.kappa * u + step * (u**3 - 0.5 * u**4))
    x = start.x + length * np.sum(0.5 * weights * np.cos(start.theta + turn), axis=1)
    y = start.y + length * np.sum(0.5 * weights * np.sin(start.theta + turn), axis=1)
    theta = start.theta + 0.5 * length * (start.kappa + kappa)
    return np.stack([x, y, theta, kappa, np.zeros_like(kappa)], axis=1)


def _distance(poses: Array, to: Flat, heading_weight: float) -> Array:
    """Distance of poses (n, 3 or more) in position and heading [m]. Shape (n,)."""
    turn = np.abs(np.mod(poses[:, 2] - to.theta + math.pi, 2.0 * math.pi) - math.pi)
    return np.hypot(poses[:, 0] - to.x, poses[:, 1] - to.y) + heading_weight * turn
