"""A sound result, and every kind of damage to it with the check that must notice."""

import copy
import dataclasses
import math
from collections.abc import Callable
from typing import Any

import numpy as np
from paths import random_path
from scenes import blocks_beside

from optim.audit.checks import AuditReport, audit_path
from optim.audit.data import COLUMNS
from optim.model.objective import Weights, objective
from optim.model.path import Path, Segment, roll_out_segment
from optim.model.vehicle import Vehicle

VEHICLE = Vehicle()
Case = dict[str, Any]
"""The arguments of `audit_path` by name."""


def plain(path: Path) -> Case:
    """The path as a document has it."""
    return {
        "segments": [
            {"direction": segment.direction} | {key: getattr(segment, key).tolist() for key in COLUMNS}
            for segment in path.segments
        ]
    }


def case_of(path: Path, polygons: list[Any], vehicle: Vehicle = VEHICLE, boundary: Any = None) -> Case:
    """The claim that a path improves itself, with its right J."""
    return {
        "vehicle": dataclasses.asdict(vehicle),
        "scene": {"polygons": [np.asarray(p).tolist() for p in polygons], "boundary": boundary},
        "recorded": plain(path),
        "path": plain(path),
        "weights": dataclasses.asdict(Weights()),
        "reported_objective": objective(path, Weights()),
    }


SOUND_PATH = random_path(VEHICLE, (14.0, 12.0), seed=5, spacing=0.05)
SQUARE = [[-80.0, -80.0], [80.0, -80.0], [80.0, 80.0], [-80.0, 80.0]]
SOUND = case_of(SOUND_PATH, blocks_beside(VEHICLE, SOUND_PATH, 3, seed=1), boundary=SQUARE)
SHORT_PATH = random_path(VEHICLE, (1.5, 1.0), seed=2, spacing=0.1)
SHORT = case_of(SHORT_PATH, blocks_beside(VEHICLE, SHORT_PATH, 2, seed=1), boundary=SQUARE)


def audited(case: Case) -> AuditReport:
    return audit_path(**case)


def sound() -> Case:
    return copy.deepcopy(SOUND)


def segment(case: Case, index: int = 0, key: str = "path") -> Case:
    return case[key]["segments"][index]


def add(values: list[float], offset: Any, start: int = 0, stop: int | None = None) -> None:
    """Add to some of the values, in place."""
    values[start:stop] = (np.array(values[start:stop]) + offset).tolist()


def pose_moved(case: Case) -> Case:
    add(segment(case)["x"], 0.002, 100, 101)
    return case


def heading_off(case: Case) -> Case:
    add(segment(case)["theta"], math.radians(0.1), 100, 101)
    return case


def drift(key: str, step: float) -> Callable[[Case], Case]:
    """Each interval is off by `step`, within its tolerance; back and forth, so that the ends are right."""

    def damage(case: Case) -> Case:
        values = segment(case)[key]
        count = len(values)
        add(values, step * np.minimum(np.arange(count), np.arange(count)[::-1]))
        return case

    return damage


def put(value: Any, *keys: Any) -> Callable[[Case], Case]:
    """Replace the entry that the keys lead to."""

    def damage(case: Case) -> Case:
        node = case
        for key in keys[:-1]:
            node = node[key]
        node[keys[-1]] = value
        return case

    return damage


def drop(*keys: Any) -> Callable[[Case], Case]:
    def damage(case: Case) -> Case:
        node = case
        for key in keys[:-1]:
            node = node[key]
        del node[keys[-1]]
        return case

    return damage


def path_with(change: Callable[[np.ndarray], None]) -> Callable[[Case], Case]:
    """Roll out other steering: a path that is sound but for the limits it breaks."""

    def damage(case: Case) -> Case:
        segments: list[Segment] = []
        for old in SOUND_PATH.segments:
            phi = old.phi.copy()
            change(phi)
            start = segments[-1].states[-1] if segments else old.states[0]
            segments.append(roll_out_segment(VEHICLE, start, old.direction, old.s, phi))
        return case_of(Path(tuple(segments)), [])

    return damage


def steering_jumps(phi: np.ndarray) -> None:
    phi[60:] += 0.05


def steering_beyond_limit(phi: np.ndarray) -> None:
    excess = 0.56 - phi[90]
    phi += np.interp(np.arange(len(phi)), [50, 90, 92, 132], [0.0, excess, excess, 0.0])


def limit_lowered(name: str, factor: float) -> Callable[[Case], Case]:
    """The limit is the largest value met, divided by the factor."""

    def damage(case: Case) -> Case:
        checks = {"max_steer": "steer", "max_hitch": "hitch", "max_steer_rate": "steer_rate"}
        (value,) = audited(case).checks[checks[name]].values.values()
        case["vehicle"][name] = value / factor
        return case

    return damage


def cut_short(case: Case) -> Case:
    for key in COLUMNS:
        del segment(case, 1)[key][-5:]
    return restated(case)


def restated(case: Case) -> Case:
    """The same with the objective reported rightly, so that no other check steps in."""
    case["reported_objective"] = audited(case).checks["objective"].values["recomputed"]
    return case


def repeated_sample(case: Case) -> Case:
    for key in COLUMNS:
        segment(case)[key].insert(100, segment(case)[key][100])
    return case


def backward_interval(case: Case) -> Case:
    s = segment(case)["s"]
    s[100], s[101] = s[101], s[100]
    return case


def shifted_arc_length(case: Case) -> Case:
    add(segment(case)["s"], 1.0)
    return case


def mirrored(case: Case) -> Case:
    for part in case["path"]["segments"]:
        for key in ("y", "theta", "alpha", "phi"):
            part[key] = [-value for value in part[key]]
    return case


def pasted_stretch(case: Case) -> Case:
    part = segment(case)
    for key in COLUMNS:
        part[key][120:120] = part[key][100:120]
    add(part["s"], part["s"][20], 120)
    return case


def pasted_segment(case: Case) -> Case:
    case["path"]["segments"].append(copy.deepcopy(segment(case, 1)))
    return case


def swapped_segments(case: Case) -> Case:
    case["path"]["segments"].reverse()
    return case


def second_segment_shifted(case: Case) -> Case:
    add(segment(case, 1)["x"], 1e-5)
    return case


def thinned(case: Case) -> Case:
    for part in case["path"]["segments"]:
        for key in COLUMNS:
            part[key] = part[key][::4]
    return case


def wrapped_heading(case: Case) -> Case:
    """The heading jumps by a full turn between two samples."""
    add(segment(case)["theta"], -math.tau, 100)
    add(segment(case, 1)["theta"], -math.tau)
    return case


def obstacle_moved_into_path(case: Case) -> Case:
    x, y = segment(case)["x"][50], segment(case)["y"][50]
    polygon = np.array(case["scene"]["polygons"][0])
    case["scene"]["polygons"][0] = (polygon - polygon.mean(axis=0) + [x, y]).tolist()
    return case


def boundary_through_path(case: Case) -> Case:
    x = np.concatenate([segment(case, k)["x"] for k in range(2)])
    case["scene"]["boundary"] = [[-80.0, -80.0], [x.mean(), -80.0], [x.mean(), 80.0], [-80.0, 80.0]]
    return case


def steering_cut_off(case: Case) -> Case:
    segment(case)["phi"] = segment(case)["phi"][:-1]
    return case


Damage = tuple[Callable[[Case], Case], str]

ALONE: dict[str, Damage] = {
    "a pose moved by 2 mm": (pose_moved, "defect"),
    "a heading off by 0.1 degrees": (heading_off, "defect"),
    "a hitch angle that drifts": (drift("alpha", 4e-5), "defect_sum"),
    "a position that drifts": (drift("y", 6e-5), "defect_sum"),
    "steering beyond the limit": (limit_lowered("max_steer", 1.002), "steer"),
    "a hitch angle beyond the limit": (limit_lowered("max_hitch", 1.002), "hitch"),
    "steering faster than the limit": (limit_lowered("max_steer_rate", 1.002), "steer_rate"),
    "a jump of the steering within a segment": (path_with(steering_jumps), "steer_rate"),
    "steering held beyond the limit": (path_with(steering_beyond_limit), "steer"),
    "a path cut short": (cut_short, "goal"),
    "a start shifted by 10 micrometres": (lambda c: add(segment(c)["x"], 1e-5, 0, 1) or c, "start"),
    "a goal 2 cm away": (lambda c: add(segment(c, 1, "recorded")["x"], 0.02) or c, "goal"),
    "a goal turned by 0.2 degrees": (lambda c: add(segment(c, 1, "recorded")["theta"], 0.0035) or c, "goal"),
    "a goal folded by 0.2 degrees": (lambda c: add(segment(c, 1, "recorded")["alpha"], 0.0035) or c, "goal"),
    "a goal folded by a full turn": (lambda c: add(segment(c, 1, "recorded")["alpha"], math.tau) or c, "goal"),
    "an objective one per cent too small": (
        put(0.99 * SOUND["reported_objective"], "reported_objective"),
        "objective",
    ),
    "an objective that is missing": (put(None, "reported_objective"), "objective"),
    "an objective that is not a number": (put(math.nan, "reported_objective"), "objective"),
    "an objective with other weights": (put(4.0, "weights", "rate"), "objective"),
    "segments that do not meet": (second_segment_shifted, "joints"),
    "an obstacle in the way": (obstacle_moved_into_path, "clearance"),
    "a map that ends on the way": (boundary_through_path, "boundary"),
}
"""Damage that one check sees and no other: without that check it would pass."""

DAMAGES: dict[str, Damage] = ALONE | {
    "a flipped gear": (put(-1, "path", "segments", 0, "direction"), "defect"),
    "a wheelbase that is not the path's": (put(3.8, "vehicle", "wheelbase"), "defect"),
    "a heading that jumps by a full turn": (wrapped_heading, "defect"),
    "a mirrored path": (mirrored, "start"),
    "a pasted stretch": (pasted_stretch, "defect"),
    "a pasted segment": (pasted_segment, "joints"),
    "segments in the wrong order": (swapped_segments, "joints"),
    "one sample of steering": (put(0.3, "path", "segments", 0, "phi", 100), "steer_rate"),
    "a folded sample": (put(1.2, "path", "segments", 0, "alpha", 100), "hitch"),
    "samples 0.2 m apart": (thinned, "spacing"),
    "an interval of length zero": (repeated_sample, "spacing"),
    "an interval of negative length": (backward_interval, "spacing"),
    "arc length that starts at 1 m": (shifted_arc_length, "spacing"),
    "NaN": (put(math.nan, "path", "segments", 0, "alpha", 100), "finite"),
    "infinity": (put(math.inf, "path", "segments", 1, "x", 3), "finite"),
    "null for a number": (put(None, "path", "segments", 0, "y", 7), "finite"),
    "an absurd coordinate": (put(1e200, "path", "segments", 0, "y", 7), "finite"),
    "NaN in the recorded path": (put(math.nan, "recorded", "segments", 1, "x", -1), "finite"),
    "NaN in a polygon": (put([math.nan, 0.0], "scene", "polygons", 1, 0), "finite"),
    "NaN in the vehicle": (put(math.nan, "vehicle", "max_steer"), "finite"),
    "NaN in the weights": (put(math.nan, "weights", "rate"), "finite"),
    "gear zero": (put(0, "path", "segments", 0, "direction"), "structure"),
    "a gear that is true": (put(True, "path", "segments", 0, "direction"), "structure"),
    "a gear in words": (put("forward", "path", "segments", 0, "direction"), "structure"),
    "a missing array": (drop("path", "segments", 0, "phi"), "structure"),
    "a missing gear": (drop("path", "segments", 0, "direction"), "structure"),
    "missing segments": (drop("path", "segments"), "structure"),
    "missing polygons": (drop("scene", "polygons"), "structure"),
    "a missing dimension": (drop("vehicle", "trailer_rear"), "structure"),
    "a missing weight": (drop("weights", "jump"), "structure"),
    "a missing recorded path": (drop("recorded", "segments"), "structure"),
    "an array that is too short": (steering_cut_off, "structure"),
    "numbers as text": (put(["0.0", "0.1"], "path", "segments", 0, "s"), "structure"),
    "an array of arrays": (put([[0.0], [0.1]], "path", "segments", 0, "s"), "structure"),
    "an integer beyond float64": (put(10**400, "path", "segments", 0, "x", 5), "structure"),
    "a negative wheelbase": (put(-3.6, "vehicle", "wheelbase"), "structure"),
    "a dimension in text": (put("3.6", "vehicle", "wheelbase"), "structure"),
    "a path that is empty": (put([], "path", "segments"), "structure"),
    "a path that is null": (put(None, "path"), "structure"),
    "a scene that is a list": (put([], "scene"), "structure"),
    "a polygon of two points": (put([[0.0, 0.0], [1.0, 0.0]], "scene", "polygons", 0), "structure"),
    "a polygon that crosses itself": (
        put([[90.0, 90.0], [91.0, 91.0], [91.0, 90.0], [90.0, 91.0]], "scene", "polygons", 0),
        "structure",
    ),
}
