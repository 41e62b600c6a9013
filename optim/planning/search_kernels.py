"""Compiled inner loop of Hybrid A*: motion primitives of the exact vehicle model, open and closed nodes.

A node is a state (x, y, theta, alpha) with the steering phi it was reached with. A primitive steers at a constant
rate from phi to a target and holds it there, in one gear; after a gear change it may begin with any phi, since the
vehicle stands still. Nodes of one cell of (x, y, theta, alpha, gear) compete: the cheapest stays.

Columns of `nodes`: x, y, theta, alpha, phi, cost of the way to it, heuristic; of `links`: parent, gear of the
primitive that led to it (0 for the root), number of its target. The heap is a binary heap of (key, node).
"""

import math

import numpy as np

from optim.geometry.sweep import first_violation_kernel
from optim.model.kinematics import rk4
from optim.numerics.kernel import kernel
from optim.planning.lookup import metric

STEP = 0.1
"""Samples of a primitive are so far apart [m]: what the audit asks for."""


@kernel
def primitive(node, gear, phi0, target, length, rate, kinematics, s, states, phi):
    """Fill s, states and phi (n samples) of a primitive from node's state; n - 1 steps of equal length."""
    states[0, 0], states[0, 1], states[0, 2], states[0, 3] = node[0], node[1], node[2], node[3]
    x, y, theta, alpha = node[0], node[1], node[2], node[3]
    count = s.size - 1
    ds = length / count
    s[0], phi[0] = 0.0, phi0
    for i in range(count):
        s[i + 1] = length * (i + 1) / count
        change = min(max(target - phi[i], -rate * ds), rate * ds)
        phi[i + 1] = phi[i] + change
        x, y, theta, alpha = rk4(
            x, y, theta, alpha, phi[i], phi[i + 1], ds, gear, kinematics[0], kinematics[1], kinematics[2]
        )
        states[i + 1, 0], states[i + 1, 1], states[i + 1, 2], states[i + 1, 3] = x, y, theta, alpha


@kernel
def push(heap, size, key, node):
    """Add to the heap of `size` entries, rows (key, node)."""
    i = size
    while i > 0:
        parent = (i - 1) // 2
        if heap[parent, 0] < key or (heap[parent, 0] == key and heap[parent, 1] <= node):
            break
        heap[i, 0], heap[i, 1] = heap[parent, 0], heap[parent, 1]
        i = parent
    heap[i, 0], heap[i, 1] = key, node
    return size + 1


@kernel
def pop(heap, size):
    """Take the least entry: (node, size left). Equal keys: the older node first."""
    node = int(heap[0, 1])
    size -= 1
    key, last = heap[size, 0], heap[size, 1]
    i = 0
    while 2 * i + 1 < size:
        child = 2 * i + 1
        if child + 1 < size and (
            heap[child + 1, 0] < heap[child, 0]
            or (heap[child + 1, 0] == heap[child, 0] and heap[child + 1, 1] < heap[child, 1])
        ):
            child += 1
        if key < heap[child, 0] or (key == heap[child, 0] and last <= heap[child, 1]):
            break
        heap[i, 0], heap[i, 1] = heap[child, 0], heap[child, 1]
        i = child
    heap[i, 0], heap[i, 1] = key, last
    return node, size


@kernel
def cell_of(x, y, theta, alpha, gear, frame):
    """Number of the cell of a state; frame: x0, y0, size [m], size in heading, size in hitch angle [rad]."""
    i = int((x - frame[0]) / frame[2])
    j = int((y - frame[1]) / frame[2])
    around = int(2.0 * math.pi / frame[3] + 0.5)
    k = math.floor(theta / frame[3]) % around
    a = math.floor(alpha / frame[4]) + 64
    return (((np.int64(i) * 65536 + j) * 1024 + k) * 128 + a) * 2 + (1 if gear > 0 else 0)


@kernel
def slot_of(keys, key):
    """Index of a key in an open-addressed table of 2^n places, or of the empty place (-1) for it."""
    mask = keys.size - 1
    i = ((key ^ (key >> 17)) * 40503 ^ (key >> 9)) & mask
    while keys[i] != -1 and keys[i] != key:
        i = (i + 1) & mask
    return i


@kernel
def around_obstacles(field, frame, x, y):
    """Distance round the obstacles to the goal from the field on a grid; frame: x0, y0, size. inf off the grid."""
    i, j = int((x - frame[0]) / frame[2]), int((y - frame[1]) / frame[2])
    if i < 0 or j < 0 or i >= field.shape[0] or j >= field.shape[1]:
        return np.inf
    return field[i, j]


@kernel
def heuristic(x, y, theta, alpha, goal, l_t, field, field_frame, values, cell, bend):
    """The larger of the way round obstacles and the look-up table's length, to goal (flat x, y, theta, kappa)."""
    heading = theta + alpha
    axle_x, axle_y = x - l_t * math.cos(heading), y - l_t * math.sin(heading)
    table = metric(
        values, cell, bend, axle_x, axle_y, heading, -math.tan(alpha) / l_t, goal[0], goal[1], goal[2], goal[3]
    )
    return max(around_obstacles(field, field_frame, x, y), table)


@kernel
def expand(count, sizes, nodes, links, heap, keys, best, world, limits, costs, targets, lengths, frame, goal, guide):
    """Pop and expand up to `count` nodes; returns the expanded ones' numbers, -1 where the heap ran empty.

    sizes: (number of nodes, of heap entries, of cells that have a node), changed; world: packed scene, footprints,
    sweep limits, margin; limits: max steer, max hitch, rate; costs: of a gear change, of reverse per metre, of
    steering, weight of the heuristic; lengths: of primitives, samples; guide: field, its frame, table's values, cell,
    bend.
    """
    scene, footprints, motion, margin = world
    field, field_frame, values, table_cell, bend = guide
    popped = np.full(count, -1, dtype=np.int64)
    s, phi = np.empty(lengths[1]), np.empty(lengths[1])
    states = np.empty((lengths[1], 4))
    kinematics = (motion[0], motion[1], motion[2])
    done = 0
    while done < count and sizes[1] > 0 and sizes[0] + 4 * targets.size < nodes.shape[0]:
        current, sizes[1] = pop(heap, sizes[1])
        node, before = nodes[current].copy(), links[current, 1]
        here = cell_of(node[0], node[1], node[2], node[3], before, frame)
        slot = slot_of(keys, here)
        if keys[slot] == here and best[slot] < node[5] - 1e-9:
            continue  # a cheaper way to this cell has been found since
        popped[done] = current
        done += 1
        for number in range(2 * targets.size):
            gear = 1 if number < targets.size else -1
            target = targets[number % targets.size]
            is_turned = before != 0 and gear != before
            phi0 = target if is_turned or before == 0 else node[4]
            primitive(node, float(gear), phi0, target, lengths[0], limits[2], kinematics, s, states, phi)
            last = s.size - 1
            folded = max(abs(states[last, 3]), abs(states[last // 2, 3]))
            if folded > limits[1]:
                continue
            cost = node[5] + lengths[0] * (1.0 + costs[2] * target * target) + is_turned * costs[0]
            if gear < 0:
                cost += costs[1] * lengths[0]
            x, y, theta, alpha = states[last, 0], states[last, 1], states[last, 2], states[last, 3]
            rest = heuristic(x, y, theta, alpha, goal, kinematics[1], field, field_frame, values, table_cell, bend)
            if not rest < np.inf:
                continue
            key = cell_of(x, y, theta, alpha, gear, frame)
            slot = slot_of(keys, key)
            if keys[slot] == key and best[slot] <= cost + 1e-9:
                continue
            if first_violation_kernel(scene, footprints, motion, s, states, phi, margin) >= 0:
                continue
            if keys[slot] == -1 and sizes[2] * 2 > keys.size:
                return popped
            sizes[2] += keys[slot] == -1
            keys[slot], best[slot] = key, cost
            new = sizes[0]
            sizes[0] += 1
            nodes[new, 0], nodes[new, 1], nodes[new, 2], nodes[new, 3] = x, y, theta, alpha
            nodes[new, 4], nodes[new, 5], nodes[new, 6] = phi[last], cost, rest
            links[new, 0], links[new, 1], links[new, 2] = current, gear, number % targets.size
            sizes[1] = push(heap, sizes[1], np.rint((cost + costs[3] * rest) * 1e6), new)
    return popped
