"""No content of a document raises, and what changes nothing about a path changes no verdict."""

import copy
import json
import math
from typing import Any

import numpy as np
import pytest
from audit_cases import ALONE, SHORT, SOUND, SOUND_PATH, Case, add, audited, plain, put, sound
from hypothesis import example, given, settings
from hypothesis import strategies as st

from optim.audit.data import COLUMNS
from optim.model.path import reverse
from replay.base.documents import to_bytes
from replay.run.results import audit_document


def moved_points(points: Any, angle: float, shift: np.ndarray) -> np.ndarray:
    c, s = math.cos(angle), math.sin(angle)
    return np.asarray(points) @ np.array([[c, s], [-s, c]]) + shift


def moved_case(case: Case, angle: float, shift: np.ndarray) -> Case:
    case = copy.deepcopy(case)
    for part in case["path"]["segments"] + case["recorded"]["segments"]:
        xy = moved_points(np.stack([part["x"], part["y"]], axis=1), angle, shift)
        part["x"], part["y"] = xy[:, 0].tolist(), xy[:, 1].tolist()
        add(part["theta"], angle)
    scene = case["scene"]
    scene["polygons"] = [moved_points(polygon, angle, shift).tolist() for polygon in scene["polygons"]]
    if scene["boundary"] is not None:
        scene["boundary"] = moved_points(scene["boundary"], angle, shift).tolist()
    return case


def mirrored_case(case: Case) -> Case:
    case = copy.deepcopy(case)
    for part in case["path"]["segments"] + case["recorded"]["segments"]:
        for key in ("y", "theta", "alpha", "phi"):
            part[key] = [-value for value in part[key]]
    flip = np.array([1.0, -1.0])
    case["scene"]["polygons"] = [(flip * polygon).tolist() for polygon in case["scene"]["polygons"]]
    if case["scene"]["boundary"] is not None:
        case["scene"]["boundary"] = (flip * case["scene"]["boundary"]).tolist()
    return case


def reversed_case(case: Case) -> Case:
    case = copy.deepcopy(case)
    for key in ("path", "recorded"):
        for part in case[key]["segments"]:
            part["direction"] *= -1
            for column in COLUMNS:
                part[column].reverse()
            part["s"] = [part["s"][0] - s for s in part["s"]]
        case[key]["segments"].reverse()
    return case


ORDINARY = [name for name, (_, check) in ALONE.items() if check not in ("start", "goal", "joints")]
"""Damage that is the same damage when start and goal change places."""
motions = st.tuples(st.floats(-4, 4), st.floats(-500, 500), st.floats(-500, 500))


@settings(max_examples=25, deadline=None)
@given(name=st.sampled_from(["none", *ALONE]), motion=motions)
def test_moving_the_whole_scene_changes_no_verdict(name: str, motion: tuple[float, float, float]) -> None:
    case = ALONE[name][0](sound()) if name in ALONE else sound()
    assert audited(moved_case(case, motion[0], np.array(motion[1:]))).failed == audited(case).failed


@pytest.mark.parametrize("name", ["none", *ALONE])
def test_mirroring_everything_changes_no_verdict(name: str) -> None:
    case = ALONE[name][0](sound()) if name in ALONE else sound()
    assert audited(mirrored_case(case)).failed == audited(case).failed


@pytest.mark.parametrize("name", ["none", *ORDINARY])
def test_driving_the_path_backwards_changes_no_verdict(name: str) -> None:
    case = ALONE[name][0](sound()) if name in ALONE else sound()
    assert audited(reversed_case(case)).failed == audited(case).failed


def test_time_reversal_here_is_that_of_the_path() -> None:
    assert reversed_case(SOUND)["path"] == plain(reverse(SOUND_PATH))


@settings(max_examples=25, deadline=None)
@given(
    name=st.sampled_from(["none", *ALONE]),
    middle=st.tuples(st.floats(-30, 30), st.floats(-30, 30)),
    size=st.floats(0.05, 5.0),
)
def test_one_more_obstacle_never_helps(name: str, middle: tuple[float, float], size: float) -> None:
    case = ALONE[name][0](sound()) if name in ALONE else sound()
    before = audited(case)
    case["scene"]["polygons"].append((np.array(middle) + size * np.array([[0, 0], [1, 0], [0, 1]])).tolist())
    after = audited(case)
    assert set(before.failed) <= set(after.failed)
    for body, value in after.checks["clearance"].values.items():
        assert value <= before.checks["clearance"].values[body]


# Anything at all may be in a document.

scalars = st.none() | st.booleans() | st.integers() | st.floats() | st.text(max_size=5) | st.just(10**400)
anything = st.recursive(
    scalars, lambda inner: st.lists(inner, max_size=4) | st.dictionaries(st.text(max_size=3), inner)
)


def places(node: Any, prefix: tuple[Any, ...] = ()) -> list[tuple[Any, ...]]:
    """The keys of every entry of a document; of long lists the first three and the last."""
    entries = list(node.items() if isinstance(node, dict) else enumerate(node) if isinstance(node, list) else [])
    found = [prefix] if prefix else []
    for key, value in entries if len(entries) < 12 else entries[:3] + entries[-1:]:
        found += places(value, (*prefix, key))
    return found


@settings(max_examples=150, deadline=None)
@given(place=st.sampled_from(places(SHORT)), value=anything)
@example(place=("path", "segments", 0, "x"), value=[[[[]]]])
@example(place=("scene", "polygons"), value="ab")
@example(place=("scene", "polygons", 0), value=[[0, 0], [1e-200, 0], [0, 1e-200]])
@example(place=("vehicle", "hitch_to_axle"), value=0.002)
@example(place=("path", "segments", 0, "phi", 1), value=math.pi / 2)
@example(place=("path", "segments", 0, "phi", 1), value=1e7)
@example(place=("path", "segments", 0, "s", 1), value=5e-324)
def test_no_content_of_a_document_raises(place: tuple[Any, ...], value: Any) -> None:
    report = audited(put(value, *place)(copy.deepcopy(SHORT)))
    json.loads(to_bytes(audit_document(report)))
