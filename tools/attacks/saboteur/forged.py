"""Sabotage that several checks may see; one is meant to."""

import math
from typing import Any

import numpy as np

from optim.audit.data import COLUMNS
from tools.attacks.saboteur.claims import (
    Claim,
    Damage,
    Rng,
    inner,
    kind,
    segments,
    set_states,
    some_segment,
    states_of,
)


@kind("gears flipped", "defect")
def _gears_flipped(claim: Claim, rng: Rng) -> bool:
    for part in segments(claim):
        part["direction"] = -part["direction"]
    return True


@kind("steering flipped", "defect")
def _steering_flipped(claim: Claim, rng: Rng) -> bool:
    for part in segments(claim):
        part["phi"] = -part["phi"]
    return max(np.abs(part["phi"]).max() for part in segments(claim)) > 0.05


@kind("path of a vehicle with another wheelbase", "defect")
def _other_wheelbase(claim: Claim, rng: Rng) -> bool:
    claim["vehicle"]["wheelbase"] *= rng.choice([0.9, 1.1])
    return True


@kind("path of a vehicle with another trailer", "defect")
def _other_trailer(claim: Claim, rng: Rng) -> bool:
    claim["vehicle"]["hitch_to_axle"] *= rng.choice([0.8, 1.25])
    return True


@kind("path mirrored about its first heading", "defect")
def _mirrored(claim: Claim, rng: Rng) -> bool:
    """Positions and headings, but neither steering nor hitch angle."""
    x, y, theta, _ = states_of(segments(claim)[0])[0]
    c, s = math.cos(2 * theta), math.sin(2 * theta)
    for part in segments(claim):
        states = states_of(part)
        dx, dy = states[:, 0] - x, states[:, 1] - y
        states[:, 0], states[:, 1] = x + c * dx + s * dy, y + s * dx - c * dy
        states[:, 2] = 2 * theta - states[:, 2]
        set_states(part, states)
    return True


@kind("path driven from its end to its start", "start")
def _backwards(claim: Claim, rng: Rng) -> bool:
    """Properly, with all gears changed."""
    for part in segments(claim):
        part["direction"] = -part["direction"]
        length = part["s"][-1]
        for key in COLUMNS:
            part[key] = part[key][::-1].copy()
        part["s"] = length - part["s"]
    segments(claim).reverse()
    return True


@kind("heading that jumps by a full turn", "defect")
def _full_turn(claim: Claim, rng: Rng) -> bool:
    part = some_segment(claim, rng)
    part["theta"][inner(part, rng) :] += math.tau
    return True


@kind("two neighbouring samples swapped", "spacing")
def _swapped(claim: Claim, rng: Rng) -> bool:
    part = some_segment(claim, rng)
    at = inner(part, rng)
    for key in COLUMNS:
        part[key][[at - 1, at]] = part[key][[at, at - 1]]
    return True


@kind("two neighbouring samples swapped, arc lengths kept", "defect")
def _swapped_states(claim: Claim, rng: Rng) -> bool:
    part = some_segment(claim, rng)
    if len(part["s"]) < 4:
        return False
    at = int(rng.integers(2, len(part["s"]) - 1))
    for key in COLUMNS[1:]:
        part[key][[at - 1, at]] = part[key][[at, at - 1]]
    return True


@kind("sample repeated", "spacing")
def _repeated(claim: Claim, rng: Rng) -> bool:
    part = some_segment(claim, rng)
    at = inner(part, rng)
    for key in COLUMNS:
        part[key] = np.insert(part[key], at, part[key][at])
    return True


@kind("stretch left out", "defect")
def _left_out(claim: Claim, rng: Rng) -> bool:
    """And the arc length closed up."""
    part = some_segment(claim, rng)
    if len(part["s"]) < 12:
        return False
    start = int(rng.integers(1, len(part["s"]) - 9))
    rows = np.r_[0:start, start + 8 : len(part["s"])]
    shift = part["s"][start + 8] - part["s"][start - 1] - 0.05
    for key in COLUMNS:
        part[key] = part[key][rows]
    part["s"][start:] -= shift
    return True


@kind("stretch driven twice", "defect")
def _pasted(claim: Claim, rng: Rng) -> bool:
    part = some_segment(claim, rng)
    if len(part["s"]) < 12:
        return False
    start = int(rng.integers(1, len(part["s"]) - 10))
    rows = np.r_[0 : start + 8, start : len(part["s"])]
    step = part["s"][start + 8] - part["s"][start]
    for key in COLUMNS:
        part[key] = part[key][rows]
    part["s"][start + 8 :] += step
    return True


@kind("segment driven twice", "joints")
def _segment_twice(claim: Claim, rng: Rng) -> bool:
    part = some_segment(claim, rng)
    segments(claim).append({key: value.copy() if key != "direction" else value for key, value in part.items()})
    return True


@kind("segments in another order", "joints")
def _other_order(claim: Claim, rng: Rng) -> bool:
    segments(claim).reverse()
    return len(segments(claim)) > 1


@kind("first segment left out", "start")
def _no_first(claim: Claim, rng: Rng) -> bool:
    del segments(claim)[0]
    return len(segments(claim)) > 0


@kind("jump of the steering", "steer_rate")
def _steering_jump(claim: Claim, rng: Rng) -> bool:
    part = some_segment(claim, rng)
    part["phi"][inner(part, rng) :] += rng.choice([-1, 1]) * 0.08
    return True


@kind("jackknifed sample", "hitch")
def _jackknifed(claim: Claim, rng: Rng) -> bool:
    part = some_segment(claim, rng)
    part["alpha"][inner(part, rng)] = claim["vehicle"]["max_hitch"] * rng.uniform(1.01, 1.5)
    return True


# ---- documents that cannot be read


def absurd(value: Any) -> Damage:
    """One value of a column is replaced by what is no coordinate."""

    def damage(claim: Claim, rng: Rng) -> bool:
        part = some_segment(claim, rng)
        key = str(rng.choice(COLUMNS))
        values = part[key].tolist()
        values[int(rng.integers(len(values)))] = value
        part[key] = values
        return True

    return damage


kind("NaN in the path", "finite")(absurd(math.nan))
kind("infinity in the path", "finite")(absurd(-math.inf))
kind("null in the path", "finite")(absurd(None))
kind("absurdly large number in the path", "finite")(absurd(1e150))
kind("text in the path", "structure")(absurd("1.0"))
kind("list in the path", "structure")(absurd([1.0]))
kind("integer beyond a float in the path", "structure")(absurd(10**400))


@kind("array that is cut off", "structure")
def _cut_off(claim: Claim, rng: Rng) -> bool:
    part = some_segment(claim, rng)
    key = str(rng.choice(COLUMNS))
    part[key] = part[key][: int(rng.integers(len(part[key])))]
    return True


@kind("array that is missing", "structure")
def _missing(claim: Claim, rng: Rng) -> bool:
    del some_segment(claim, rng)[str(rng.choice([*COLUMNS, "direction"]))]
    return True


@kind("gear that is neither 1 nor -1", "structure")
def _no_gear(claim: Claim, rng: Rng) -> bool:
    some_segment(claim, rng)["direction"] = [0, 2, "forward", None, 1.0][int(rng.integers(5))]
    return True


@kind("dimension or limit of the vehicle missing", "structure")
def _no_dimension(claim: Claim, rng: Rng) -> bool:
    del claim["vehicle"][str(rng.choice(list(claim["vehicle"])))]
    return True


@kind("dimension or limit of the vehicle no number", "finite")
def _nan_dimension(claim: Claim, rng: Rng) -> bool:
    claim["vehicle"][str(rng.choice(list(claim["vehicle"])))] = math.nan
    return True


@kind("corner of an obstacle no number", "finite")
def _nan_corner(claim: Claim, rng: Rng) -> bool:
    polygons = claim["scene"]["polygons"]
    if not polygons:
        return False
    row = int(rng.integers(len(polygons)))
    polygon = np.array(polygons[row], dtype=float)
    polygon[int(rng.integers(len(polygon))), int(rng.integers(2))] = math.nan
    polygons[row] = polygon
    return True


@kind("obstacles missing", "structure")
def _no_obstacles(claim: Claim, rng: Rng) -> bool:
    del claim["scene"]["polygons"]
    return True


@kind("path without segments", "structure")
def _no_segments(claim: Claim, rng: Rng) -> bool:
    claim["path"]["segments"] = []
    return True
