"""Sabotage that one check sees and no other: with that check switched off, it passes."""

import math

import numpy as np
import shapely

from optim.audit.data import COLUMNS
from optim.model.kinematics import roll_out
from optim.model.path import roll_out_segment
from optim.model.vehicle import body_corners
from tools.attacks.saboteur.claims import (
    TOLERANCES,
    Claim,
    Damage,
    Rng,
    corners,
    direction,
    excess,
    inner,
    kind,
    segments,
    set_states,
    sign,
    some_segment,
    states_of,
    vehicle_of,
)


def moved_end(column: str, tolerance: float) -> Damage:
    """The recorded goal moves away from the path's by more than the tolerance; only its last sample counts."""

    def damage(claim: Claim, rng: Rng) -> bool:
        last = segments(claim, "recorded")[-1]
        ours = segments(claim)[-1]
        if column == "xy":
            shift = direction(rng) * tolerance * excess(rng)
            last["x"][-1], last["y"][-1] = ours["x"][-1] + shift[0], ours["y"][-1] + shift[1]
        else:
            last[column][-1] = ours[column][-1] + sign(rng) * tolerance * excess(rng)
        return True

    return damage


kind("goal position off by more than 1 cm", "goal", alone=True)(moved_end("xy", TOLERANCES.goal_position))
kind("goal heading off by more than 0.1 degrees", "goal", alone=True)(moved_end("theta", TOLERANCES.goal_angle))
kind("goal hitch angle off by more than 0.1 degrees", "goal", alone=True)(moved_end("alpha", TOLERANCES.goal_angle))
kind("goal hitch angle off by a full turn", "goal", alone=True)(moved_end("alpha", math.tau))


@kind("path ends before its goal", "goal", alone=True)
def _cut_short(claim: Claim, rng: Rng) -> bool:
    part = segments(claim)[-1]
    goal = states_of(part)[-1, :2]
    near = np.hypot(*(states_of(part)[:, :2] - goal).T) <= TOLERANCES.goal_position * 1.05
    far = np.flatnonzero(~near)
    far = far[far >= 1]
    if len(far) == 0:
        return False
    stop = int(rng.choice(far[-10:])) + 1
    for key in COLUMNS:
        part[key] = part[key][:stop]
    return True


def moved_start(column: str) -> Damage:
    """The recorded start moves away from the path's, by anything from 1 nm (or nrad) to 0.1 m (or rad)."""

    def damage(claim: Claim, rng: Rng) -> bool:
        segments(claim, "recorded")[0][column][0] += sign(rng) * 10.0 ** rng.uniform(-9, -1)
        return True

    return damage


kind("start position not exactly the recorded one", "start", alone=True)(moved_start("x"))
kind("start heading not exactly the recorded one", "start", alone=True)(moved_start("theta"))
kind("start hitch angle not exactly the recorded one", "start", alone=True)(moved_start("alpha"))


@kind("whole path moved by a millimetre", "start", alone=True)
def _moved_whole(claim: Claim, rng: Rng) -> bool:
    shift = 1e-3 * direction(rng)
    for part in segments(claim):
        part["x"] += shift[0]
        part["y"] += shift[1]
    return True


def moved_sample(column: str, tolerance: float) -> Damage:
    """One sample is off by more than the tolerance of an interval."""

    def damage(claim: Claim, rng: Rng) -> bool:
        part = some_segment(claim, rng)
        at, by = inner(part, rng), tolerance * min(excess(rng), 10.0)
        if column == "xy":
            shift = direction(rng) * by
            part["x"][at] += shift[0]
            part["y"][at] += shift[1]
        else:
            part[column][at] += sign(rng) * by
        return True

    return damage


kind("one pose off by more than 0.1 mm", "defect", alone=True)(moved_sample("xy", TOLERANCES.defect_position))
kind("one heading off by more than 0.1 mrad", "defect", alone=True)(moved_sample("theta", TOLERANCES.defect_angle))
kind("one hitch angle off by more than 0.1 mrad", "defect", alone=True)(moved_sample("alpha", TOLERANCES.defect_angle))


def zigzag(column: str, tolerance: float) -> Damage:
    """Every other sample is off, each interval within its tolerance, all together just beyond that of the sum."""

    def damage(claim: Claim, rng: Rng) -> bool:
        moved = [(part, np.arange(1, len(part["s"]) - 1, 2)) for part in segments(claim)]
        step = 1.05 * tolerance / (2 * max(1, sum(len(rows) for _, rows in moved)))
        if step > 0.9e-4:
            return False
        turn = direction(rng)
        for part, rows in moved:
            if column == "xy":
                part["x"][rows] += step * turn[0]
                part["y"][rows] += step * turn[1]
            else:
                part[column][rows] += step
        return True

    return damage


kind("poses that zigzag within 0.1 mm", "defect_sum", alone=True)(zigzag("xy", TOLERANCES.sum_position))
kind("headings that zigzag within 0.1 mrad", "defect_sum", alone=True)(zigzag("theta", TOLERANCES.sum_angle))
kind("hitch angles that zigzag within 0.1 mrad", "defect_sum", alone=True)(zigzag("alpha", TOLERANCES.sum_angle))


def lowered(limit: str) -> Damage:
    """The limit is what the path reaches, divided by more than the slack."""

    def damage(claim: Claim, rng: Rng) -> bool:
        parts = segments(claim)
        reached = {
            "max_steer": max(np.abs(part["phi"]).max() for part in parts),
            "max_hitch": max(np.abs(part["alpha"]).max() for part in parts),
            "max_steer_rate": max(np.abs(np.diff(part["phi"]) / np.diff(part["s"])).max() for part in parts),
        }[limit]
        claim["vehicle"][limit] = float(reached / (1.0 + TOLERANCES.limits * 1.05 if rng.random() < 0.5 else 1.05))
        return reached > 0.01

    return damage


kind("steering beyond its limit", "steer", alone=True)(lowered("max_steer"))
kind("hitch angle beyond its limit", "hitch", alone=True)(lowered("max_hitch"))
kind("steering rate beyond its limit", "steer_rate", alone=True)(lowered("max_steer_rate"))


@kind("segments that do not meet", "joints", alone=True)
def _gap(claim: Claim, rng: Rng) -> bool:
    """Where there is no cusp, a segment is divided first; what follows moves by a hair."""
    parts = segments(claim)
    if len(parts) == 1:
        at = inner(parts[0], rng)
        first = {key: parts[0][key][: at + 1].copy() for key in COLUMNS}
        second = {key: parts[0][key][at:].copy() for key in COLUMNS}
        second["s"] -= second["s"][0]
        parts[:] = [{"direction": parts[0]["direction"]} | part for part in (first, second)]
    key, by = str(rng.choice(["x", "y", "theta", "alpha"])), sign(rng) * 10.0 ** rng.uniform(-9, -6)
    for part in parts[int(rng.integers(1, len(parts))) :]:
        part[key] += by
    return True


@kind("arc length that does not start at 0", "spacing", alone=True)
def _shifted_s(claim: Claim, rng: Rng) -> bool:
    some_segment(claim, rng)["s"] += 10.0 ** rng.uniform(-9, 2)
    return True


@kind("samples 5 % too far apart", "spacing", alone=True)
def _sparse(claim: Claim, rng: Rng) -> bool:
    """The last segment driven anew with sparser samples; what it ends at is the recorded goal."""
    part, vehicle = segments(claim)[-1], vehicle_of(claim)
    length = part["s"][-1]
    if length < 0.3:
        return False
    s = np.append(np.arange(0.0, length - 0.12, 1.05 * TOLERANCES.spacing), length)
    phi = np.interp(s, part["s"], part["phi"])
    driven = roll_out_segment(vehicle, states_of(part)[0], part["direction"], s, phi)
    part |= {"s": s, "phi": phi}
    set_states(part, driven.states)
    for key in ("x", "y", "theta", "alpha"):
        segments(claim, "recorded")[-1][key][-1] = part[key][-1]
    return True


@kind("claim of J off by 0.1 %", "objective", alone=True)
def _wrong_j(claim: Claim, rng: Rng) -> bool:
    claim["reported_objective"] *= 1.0 + sign(rng) * 1e-3
    return True


@kind("claim of J off by 2e-6", "objective", alone=True)
def _slightly_wrong_j(claim: Claim, rng: Rng) -> bool:
    claim["reported_objective"] *= 1.0 - 2e-6
    return True


@kind("claim of J with another weight", "objective", alone=True)
def _other_weight(claim: Claim, rng: Rng) -> bool:
    claim["weights"]["length"] *= 1.0 + sign(rng) * 0.01
    return True


@kind("claim of J missing or no number", "objective", alone=True)
def _no_j(claim: Claim, rng: Rng) -> bool:
    claim["reported_objective"] = [None, math.nan, "12.0", True][int(rng.integers(4))]
    return True


@kind("obstacle shaved by a millimetre", "clearance", alone=True)
def _shaved(claim: Claim, rng: Rng) -> bool:
    """A triangle whose tip is 1 mm inside a side of a body."""
    bodies = corners(claim)
    body = bodies[int(rng.integers(len(bodies))), int(rng.integers(2))]
    side = int(rng.integers(4))
    start, stop = body[side], body[(side + 1) % 4]
    along = (stop - start) / np.hypot(*(stop - start))
    outwards = np.array([along[1], -along[0]])
    tip = start + rng.uniform(0.05, 0.95) * (stop - start) - 1e-3 * outwards
    claim["scene"]["polygons"].append(np.array([tip, tip + outwards - along, tip + outwards + along]))
    return True


@kind("post that is hit only between samples", "clearance", alone=True)
def _between(claim: Claim, rng: Rng) -> bool:
    """0.3 mm wide, where a corner passes; more than 0.5 mm away from both bodies at every sample."""
    vehicle, parts = vehicle_of(claim), segments(claim)
    every = shapely.polygons(corners(claim).reshape(-1, 4, 2))
    tree = shapely.STRtree(every)
    for _ in range(60):
        part = parts[int(rng.integers(len(parts)))]
        at = int(rng.integers(len(part["s"]) - 1))
        s = part["s"][at] + (part["s"][at + 1] - part["s"][at]) * np.array([0.0, 0.5])
        states = roll_out(vehicle, states_of(part)[at], s, np.interp(s, part["s"], part["phi"]), part["direction"])
        for point in body_corners(vehicle, states)[1].reshape(-1, 2):
            if len(tree.query(shapely.Point(point), predicate="dwithin", distance=8e-4)) == 0:
                triangle = 3e-4 * np.array([[-0.5, -0.5], [0.5, -0.5], [0.0, 0.5]])
                claim["scene"]["polygons"].append(point + triangle)
                return True
    return False


@kind("obstacle moved into the way", "clearance", alone=True)
def _in_the_way(claim: Claim, rng: Rng) -> bool:
    polygons = claim["scene"]["polygons"]
    if not polygons:
        return False
    row, bodies = int(rng.integers(len(polygons))), corners(claim)
    polygon = np.asarray(polygons[row])
    body = bodies[int(rng.integers(len(bodies))), int(rng.integers(2))]
    polygons[row] = polygon - polygon.mean(axis=0) + body.mean(axis=0)
    return True


@kind("obstacle that is inside a body", "clearance", alone=True)
def _swallowed(claim: Claim, rng: Rng) -> bool:
    bodies = corners(claim)
    middle = bodies[int(rng.integers(len(bodies))), int(rng.integers(2))].mean(axis=0)
    claim["scene"]["polygons"].append(middle + 0.01 * np.array([[0.0, 0.0], [1.0, 0.0], [0.0, 1.0]]))
    return True


@kind("obstacle around the whole vehicle", "clearance", alone=True)
def _swallowing(claim: Claim, rng: Rng) -> bool:
    points = corners(claim).reshape(-1, 2)
    (x0, y0), (x1, y1) = points.min(axis=0) - rng.uniform(1, 9), points.max(axis=0) + rng.uniform(1, 9)
    claim["scene"]["polygons"].append(np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]]))
    return True


@kind("map that ends a millimetre inside the way", "boundary", alone=True)
def _map_ends(claim: Claim, rng: Rng) -> bool:
    points = corners(claim).reshape(-1, 2)
    low, high = points.min(axis=0) - 1.0, points.max(axis=0) + 1.0
    side = int(rng.integers(4))
    (low if side < 2 else high)[side % 2] += 1.001 if side < 2 else -1.001
    outline = np.array([low, [high[0], low[1]], high, [low[0], high[1]]])
    claim["scene"]["boundary"] = outline
    return True


@kind("gear given as true", "structure", alone=True)
def _gear_true(claim: Claim, rng: Rng) -> bool:
    forward = [part for part in segments(claim) if part["direction"] == 1]
    if forward:
        forward[int(rng.integers(len(forward)))]["direction"] = True
    return bool(forward)


@kind("polygon that crosses itself", "structure", alone=True)
def _crossing(claim: Claim, rng: Rng) -> bool:
    """Far from everything: it is refused because nobody can say what it covers."""
    bow = np.array([[0.0, 0.0], [1.0, 1.0], [1.0, 0.0], [0.0, 1.0]])
    claim["scene"]["polygons"].append(corners(claim).reshape(-1, 2).max(axis=0) + rng.uniform(5, 50) + bow)
    return True


@kind("NaN or infinity within the recorded path", "finite", alone=True)
def _hole_in_recorded(claim: Claim, rng: Rng) -> bool:
    part = some_segment(claim, rng, "recorded")
    part[str(rng.choice(COLUMNS[1:]))][inner(part, rng)] = rng.choice([math.nan, math.inf, 1e200])
    return True
