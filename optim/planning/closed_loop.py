"""Closed-loop RRT: trees grown by driving, with a controller that tracks a reference line in either gear.

After Y. Kuwata and others, *Real-time Motion Planning with Applications to Autonomous Urban Driving*, 2009, and for
reversing trucks with trailers N. Evestedt, O. Ljungqvist and D. Axehill, 2016. A sample is a pose; the combination
is driven towards the line through it, from the nearest nodes by the look-up table of the local planner. What was
*reached* becomes nodes, every few metres, whether or not the sample was. One tree grows from the start and one from
the goal with time reversed: a path driven backwards is a path of the same system, so the same controller grows both.
New nodes are joined to the other tree by the exact local planner.
"""

import math
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from optim.model.flat_map import flat_from_state, state_from_flat
from optim.model.path import Segment, segment_from_states
from optim.model.vehicle import Vehicle
from optim.planning.drive_kernels import distances, drive, free_samples
from optim.planning.lookup import Table, lookup_table
from optim.planning.protocol import (
    CONNECTION_SPACING,
    GiveUp,
    PlannedPath,
    PlanningProblem,
    assemble,
    clear_connection,
    never,
    random_pose,
)
from optim.steering.flat import Flat

_STEP = 0.1  # [m]: step of the closed loop and of its samples, what the audit asks for
_SETTLED = 0.5  # [m]: shorter drives are not edges


@dataclass(frozen=True, kw_only=True)
class ClosedLoopRrt:
    """Drives in closed loop; lengths given in l_t scale with the distance from hitch to trailer axle."""

    max_iterations: int = 6000
    """Maximum number of samples."""
    neighbours: int = 3
    """Nodes from which a sample is driven to, in either gear, until one gives a new node."""
    look_ahead: float = 0.75
    """Look-ahead distance of the pursuit of the line, forward [l_t]."""
    look_behind: float = 1.25
    """The same in reverse, where hitch and steering lag behind: below 1 the loop oscillates [l_t]."""
    settle: float = 0.2
    """Distance in which the hitch angle settles by a factor e in reverse [l_t]."""
    longest: float = 3.0
    """Longest drive [l_t]."""
    node_spacing: float = 0.75
    """Distance between the nodes of a drive [l_t]."""
    bridges: int = 4
    """Nodes of the other tree that a new node may be joined to."""
    longest_bridge: float = 3.5
    """Longest connection between the trees [l_t]."""
    goal_bias: float = 0.2
    """Share of samples that are nodes of the other tree [-]."""
    straight: float = 0.3
    """Share of samples that lie straight ahead of or behind a node [-]."""
    cost_weight: float = 0.1
    """Distance that 1 m on the way to a node counts for, in the choice of the nearest [-]."""
    cusp_cost: float = 8.0
    """Length that a gear change counts for on that way [m]."""
    spare: float = 0.9
    """Share of the limits on steering, its rate and the hitch angle that the controller uses [-]."""
    table: Callable[[Vehicle], Table] = lookup_table
    """Look-up table of a vehicle's local planner; see `optim.planning.lookup`."""

    @property
    def name(self) -> str:
        """Name in tables and lists."""
        return "CL-RRT"

    def plan(self, problem: PlanningProblem, seed: int, give_up: GiveUp = never) -> PlannedPath | None:
        """The first path that the trees find; see `optim.planning.protocol.Planner`."""
        grower = _Grower(self, problem, seed)
        trees = (
            _DriveTree(problem, problem.start, self, is_from=True),
            _DriveTree(problem, problem.goal, self, is_from=False),
        )
        if not give_up():
            edge = grower.bridge(trees[0], 0, trees[1])
            if edge is not None:
                return assemble(edge, 0)
        for iteration in range(self.max_iterations):
            if give_up():
                return None
            tree, other = trees if iteration % 2 == 0 else trees[::-1]
            for index in grower.extend(tree, grower.draw(tree, other)):
                pieces = grower.bridge(tree, index, other)
                if pieces is not None:
                    return assemble(pieces, iteration + 1)
        return None


class _DriveTree:
    """Nodes with the drives that reached them. A tree from the goal drives in reversed time.

    Columns of `nodes`: x, y, theta, alpha, phi; flat x, y, theta, kappa; cost of the way.
    """

    def __init__(self, problem: PlanningProblem, root: Flat, options: ClosedLoopRrt, is_from: bool) -> None:
        state, phi = state_from_flat(problem.vehicle, np.array(root))
        self.nodes = np.empty((64, 10))
        self.nodes[0] = (*state, phi, *root[:4], 0.0)
        self.count = 1
        self.parents: list[int] = [-1]
        self.pieces: list[Segment | None] = [None]
        self.gears = [0]
        self.is_from, self.options, self.l_t = is_from, options, problem.vehicle.hitch_to_axle

    def add(self, parent: int, piece: Segment) -> int:
        """A node at the end of a drive from its parent, in the tree's own time."""
        if self.count == len(self.nodes):
            self.nodes = np.concatenate([self.nodes, np.empty_like(self.nodes)])
        x, y, theta, alpha = piece.states[-1].tolist()
        heading = theta + alpha
        axle = x - self.l_t * math.cos(heading), y - self.l_t * math.sin(heading)
        turned = self.gears[parent] not in (0, piece.direction)
        cost = self.nodes[parent, 9] + piece.length + turned * self.options.cusp_cost
        row = (x, y, theta, alpha, piece.phi[-1], *axle, heading, -math.tan(alpha) / self.l_t, cost)
        self.nodes[self.count] = row
        self.parents.append(parent)
        self.pieces.append(piece)
        self.gears.append(piece.direction)
        self.count += 1
        return self.count - 1

    def branch(self, index: int) -> list[Segment]:
        """Drives between the root and a node in the order and direction of travel."""
        found = []
        while (piece := self.pieces[index]) is not None:
            found.append(piece if self.is_from else _backwards(piece))
            index = self.parents[index]
        return found[::-1] if self.is_from else found

    def gear_of_travel(self, index: int) -> int:
        """Gear in which a path through the node is driven on the tree's side of it, 0 at the root."""
        return self.gears[index] if self.is_from else -self.gears[index]


class _Grower:
    """One search: samples, drives, bridges."""

    def __init__(self, options: ClosedLoopRrt, problem: PlanningProblem, seed: int) -> None:
        vehicle, l_t = problem.vehicle, problem.vehicle.hitch_to_axle
        self.options, self.problem, self.l_t = options, problem, l_t
        self.rng = np.random.default_rng(seed)
        self.table = options.table(vehicle)
        self.world = (problem.scene.packed, vehicle.footprints, vehicle.motion_limits, float(problem.margin))
        top = 0.7 * options.spare * vehicle.max_kappa
        self.law = (options.settle * l_t, top, options.spare * vehicle.max_steer)
        self.limits = (options.spare * vehicle.max_hitch, options.spare * vehicle.max_steer_rate)
        most = int(options.longest * l_t / _STEP) + 2
        self.buffers = np.empty(most), np.empty((most, 4)), np.empty(most)

    def draw(self, tree: _DriveTree, other: _DriveTree) -> Flat:
        """A pose to drive to: in one of the areas, at a node of the other tree, or straight on from a node."""
        choice = self.rng.random()
        if choice < self.options.goal_bias:
            return Flat(*other.nodes[self.rng.integers(other.count), 5:9].tolist())
        if choice < self.options.goal_bias + self.options.straight:
            node = tree.nodes[self.rng.integers(tree.count)]
            along = self.rng.uniform(-1.0, 1.0) * self.options.longest * self.l_t
            x, y, theta = node[5] + along * math.cos(node[7]), node[6] + along * math.sin(node[7]), node[7]
            return Flat(float(x), float(y), float(theta), 0.0)
        return random_pose(self.problem, self.rng)

    def nearest(self, tree: _DriveTree, to: Flat, count: int, is_from: bool, cost_weight: float) -> list[int]:
        """Nodes by the table's distance and the way to them, nearest first."""
        table = self.table
        far = distances(
            tree.nodes, tree.count, tuple(to[:4]), is_from, table.values, table.cell, table.bend, cost_weight
        )
        return np.argsort(far, kind="stable")[:count].tolist()

    def extend(self, tree: _DriveTree, sample: Flat) -> list[int]:
        """Drive from the nearest nodes towards the sample's line; indices of the nodes that were reached."""
        for parent in self.nearest(tree, sample, self.options.neighbours, True, self.options.cost_weight):
            node = tree.nodes[parent]
            dx, dy = sample.x - node[5], sample.y - node[6]
            gear = 1 if math.cos(node[7]) * dx + math.sin(node[7]) * dy > 0.0 else -1
            for each in (gear, -gear):
                found = self._drive(tree, parent, each, sample)
                if found:
                    return found
        return []

    def _drive(self, tree: _DriveTree, parent: int, gear: int, sample: Flat) -> list[int]:
        node, options = tree.nodes[parent], self.options
        s, states, phi = self.buffers
        is_free = tree.gears[parent] != gear
        line, kinematics = (sample.x, sample.y, sample.theta), self.problem.vehicle.kinematics
        if gear > 0:  # forward, the truck's rear axle follows the line
            ahead = self.l_t
            line = (sample.x + ahead * math.cos(sample.theta), sample.y + ahead * math.sin(sample.theta), sample.theta)
        law = ((options.look_ahead if gear > 0 else options.look_behind) * self.l_t, *self.law)
        count = drive(
            node[:4], float(node[4]), is_free, float(gear), line, options.longest * self.l_t, _STEP, law,
            self.limits, kinematics, s, states, phi,
        )  # fmt: skip
        if count < 2:
            return []
        count = free_samples(count, s, states, phi, self.world)
        spacing = max(1, round(options.node_spacing * self.l_t / _STEP))
        if (count - 1) * _STEP < _SETTLED:
            return []
        ends = list(range(spacing, count - spacing // 2, spacing)) + [count - 1]
        found, begin = [], 0
        for end in ends:
            stretch = slice(begin, end + 1)
            piece = segment_from_states(gear, s[stretch].copy(), states[stretch].copy(), phi[stretch].copy())
            parent = tree.add(parent, piece)
            found.append(parent)
            begin = end
        return found[::-1]

    def bridge(self, tree: _DriveTree, index: int, other: _DriveTree) -> list[Segment] | None:
        """The pieces of a whole path if the node can be joined to the other tree."""
        node = Flat(*tree.nodes[index, 5:9].tolist())
        for near in self.nearest(other, node, self.options.bridges, not tree.is_from, 0.0):
            first, last = (tree, other) if tree.is_from else (other, tree)
            ends = (index, near) if tree.is_from else (near, index)
            for gear in (1, -1):
                start, end = self._flat(first, ends[0], gear), self._flat(last, ends[1], gear)
                edge = clear_connection(self.problem, start, end, gear, self.options.longest_bridge * self.l_t)
                if edge is not None:
                    return [*first.branch(ends[0]), edge.segment(CONNECTION_SPACING), *last.branch(ends[1])]
        return None

    def _flat(self, tree: _DriveTree, index: int, gear: int) -> Flat:
        """The node as an end of a connection: its own steering where the gear stays, any where the vehicle stands."""
        node, before = tree.nodes[index], tree.gear_of_travel(index)
        if before == gear:
            flat = flat_from_state(self.problem.vehicle, node[:4], np.asarray(node[4]))
            return Flat(*flat.tolist())
        return Flat(*node[5:9].tolist())


def _backwards(piece: Segment) -> Segment:
    """The drive with time reversed."""
    s = piece.length - piece.s[::-1]
    return segment_from_states(-piece.direction, s, piece.states[::-1], piece.phi[::-1])
