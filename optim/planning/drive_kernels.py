"""Compiled: driving in closed loop along a reference line, forward and in reverse, until it goes wrong or arrives.

The reference is a straight line with a heading. Pure pursuit at a look-ahead distance gives the curvature that would
bring a point of the combination back to it: forward the truck's rear axle, whose steering follows at once; in reverse
the trailer's axle, which cannot be steered directly. There the wanted curvature kappa* stands for a wanted hitch
angle, -atan(l_t kappa*), and the steering that brings the trailer's curvature to it exponentially,

    sigma = d (kappa* - kappa) / settle,   tan(phi) = l (kappa + l_t sigma / q) / sqrt(q),   q = 1 + (l_t kappa)^2,

cancels the unstable motion of the hitch, so the closed loop is stable in either gear. Steering and its rate are
limited as the vehicle's are; the reached state counts, not the requested one.
"""

import math

import numpy as np

from optim.geometry.sweep import first_violation_kernel
from optim.model.kinematics import rk4
from optim.numerics.kernel import kernel
from optim.planning.lookup import metric


@kernel
def steering(state, gear, line, law, kinematics):
    """The steering angle that the law asks for [rad], within its limit.

    line: x, y, heading of travel's line along the trailer's or truck's heading; law: look-ahead [m], settle [m],
    largest wanted curvature of the trailer [1/m], largest steering angle [rad].
    """
    l, l_t = kinematics[0], kinematics[1]
    theta, alpha = state[2], state[3]
    heading = theta + alpha if gear < 0 else theta
    x, y = state[0], state[1]
    if gear < 0:
        x, y = x - l_t * math.cos(heading), y - l_t * math.sin(heading)
    c, s = math.cos(line[2]), math.sin(line[2])
    across = c * (y - line[1]) - s * (x - line[0])
    turn = heading - line[2]
    turn -= 2.0 * math.pi * np.rint(turn / (2.0 * math.pi))
    # the point on the line at the look-ahead distance in the direction of travel, seen from the axle
    ahead = math.sqrt(max(law[0] * law[0] - across * across, (0.3 * law[0]) ** 2))
    along, off = gear * ahead, -across
    side = math.cos(turn) * off - math.sin(turn) * along
    bend = 2.0 * side / (along * along + off * off)
    if math.cos(turn) < 0.0:  # it drives away from the heading of the line: as sharp a turn as there is
        bend = -math.copysign(1e3, turn) * gear
    if gear > 0:
        return min(max(math.atan(l * bend), -law[3]), law[3])
    bend = min(max(bend, -law[2]), law[2])
    kappa = -math.tan(alpha) / l_t
    q = 1.0 + (l_t * kappa) ** 2
    sigma = gear * (bend - kappa) / law[1]
    return min(max(math.atan(l * (kappa + l_t * sigma / q) / math.sqrt(q)), -law[3]), law[3])


@kernel
def drive(start, phi0, is_free, gear, line, length, step, law, limits, kinematics, s, states, phi):
    """Fill s, states and phi with a closed-loop drive; returns the number of samples before it ends.

    It ends after `length` [m], where it has passed the line's point, or before the hitch angle leaves its limit.
    limits: largest hitch angle [rad], largest steering rate [rad/m]. With is_free the steering begins as wanted.
    """
    x, y, theta, alpha = start[0], start[1], start[2], start[3]
    states[0, 0], states[0, 1], states[0, 2], states[0, 3] = x, y, theta, alpha
    phi[0], s[0] = phi0, 0.0
    if is_free:
        phi[0] = steering(states[0], gear, line, law, kinematics)
    count = min(int(length / step), s.size - 1)
    c, si = math.cos(line[2]), math.sin(line[2])
    for i in range(count):
        wanted = steering(states[i], gear, line, law, kinematics)
        phi[i + 1] = phi[i] + min(max(wanted - phi[i], -limits[1] * step), limits[1] * step)
        x, y, theta, alpha = rk4(
            x, y, theta, alpha, phi[i], phi[i + 1], step, gear, kinematics[0], kinematics[1], kinematics[2]
        )
        if abs(alpha) > limits[0]:
            return i + 1
        s[i + 1] = step * (i + 1)
        states[i + 1, 0], states[i + 1, 1], states[i + 1, 2], states[i + 1, 3] = x, y, theta, alpha
        axle_x, axle_y = x, y
        if gear < 0:
            axle_x -= kinematics[1] * math.cos(theta + alpha)
            axle_y -= kinematics[1] * math.sin(theta + alpha)
        turn = theta - line[2] if gear > 0 else theta + alpha - line[2]
        passed = gear * (c * (axle_x - line[0]) + si * (axle_y - line[1]))
        if passed > 0.0 and math.cos(turn) > 0.9:
            return i + 2
    return count + 1


@kernel
def free_samples(count, s, states, phi, world):
    """Number of the first `count` samples that are clear of obstacles, between samples too."""
    scene, footprints, motion, margin = world
    hit = first_violation_kernel(scene, footprints, motion, s[:count], states[:count], phi[:count], margin)
    return count if hit < 0 else hit + 1


@kernel
def distances(nodes, count, sample, is_from, values, cell, bend, cost_weight):
    """The table's distance of each node from or to a sample (flat x, y, theta, kappa), and the way to the node.

    nodes: (n, 6 or more) flat x, y, theta, kappa at columns 5 to 8, cost at 9.
    """
    out = np.empty(count)
    for i in range(count):
        x, y, theta, kappa = nodes[i, 5], nodes[i, 6], nodes[i, 7], nodes[i, 8]
        if is_from:
            out[i] = metric(values, cell, bend, x, y, theta, kappa, sample[0], sample[1], sample[2], sample[3])
        else:
            out[i] = metric(values, cell, bend, sample[0], sample[1], sample[2], sample[3], x, y, theta, kappa)
        out[i] = np.rint((out[i] + cost_weight * nodes[i, 9]) * 1e6)
    return out
