"""What may not change the audit's verdict, or change it in one direction only."""

import dataclasses
from typing import Any

import numpy as np
import pytest
from audit_cases import ALONE, SOUND_PATH, VEHICLE, Case, audited, case_of, sound
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import random_path
from scenes import blocks_beside

from optim.audit.data import COLUMNS
from optim.model.kinematics import roll_out
from optim.model.vehicle import Vehicle

names = st.sampled_from(["none", *ALONE])
SHRINKING = ("truck_front", "truck_rear", "truck_width", "trailer_front", "trailer_rear", "trailer_width")


def damaged(name: str) -> Case:
    return ALONE[name][0](sound()) if name in ALONE else sound()


def refined(case: Case, share: float, choice: np.random.Generator | None = None) -> Case:
    """A sample more in each interval (or in some), at a share of it, where the motion from its start is by then."""
    vehicle = Vehicle(**case["vehicle"])
    for part in case["path"]["segments"]:
        old = np.array([part[key] for key in COLUMNS])
        rows = [old[:, :1]]
        for left, right in zip(old.T[:-1], old.T[1:], strict=True):
            if choice is None or choice.random() < 0.5:
                s = left[0] + share * (right[0] - left[0])
                phi = left[5] + share * (right[5] - left[5])
                state = roll_out(
                    vehicle, left[1:5], np.array([0.0, s - left[0]]), np.array([left[5], phi]), part["direction"]
                )
                rows.append(np.array([[s, *state[-1], phi]]).T)
            rows.append(right[:, None])
        part |= dict(zip(COLUMNS, np.concatenate(rows, axis=1).tolist(), strict=True))
    return case


@pytest.mark.parametrize("name", ["none", *ALONE])
def test_more_samples_of_the_same_motion_change_no_verdict(name: str) -> None:
    assert audited(refined(damaged(name), 0.5)).failed == audited(damaged(name)).failed


@settings(max_examples=12)
@given(name=names, share=st.floats(0.05, 0.95), seed=st.integers(0, 9))
def test_a_few_more_samples_anywhere_change_no_verdict(name: str, share: float, seed: int) -> None:
    case = refined(damaged(name), share, np.random.default_rng(seed))
    assert audited(case).failed == audited(damaged(name)).failed


def test_a_collision_is_found_however_coarse_or_fine_the_samples() -> None:
    post = np.array([[0.0, 0.0], [0.02, 0.0], [0.0, 0.02]])
    for k in (0, 130, 260):
        x, y = SOUND_PATH.samples.states[k, :2]
        case = sound()
        case["scene"]["polygons"].append((post + [x, y]).tolist())
        for share in (None, 0.3, 0.8):
            assert not audited(case if share is None else refined(case, share)).checks["clearance"].passed


def crowded(seed: int) -> Case:
    """Random blocks, half of them kept clear of the path by the audit's bound and half of them anywhere."""
    path = random_path(VEHICLE, (8.0, 6.0), (-1) ** seed, seed=seed, spacing=0.1)
    rng = np.random.default_rng(seed)
    polygons: list[Any] = [*blocks_beside(VEHICLE, path, 4, seed, room=0.05)]
    low, high = path.samples.states[:, :2].min(axis=0) - 9, path.samples.states[:, :2].max(axis=0) + 9
    polygons += [rng.uniform(low, high) + rng.uniform(0.1, 1.5) * np.array([[0, 0], [1, 0], [0, 1]]) for _ in range(4)]
    return case_of(path, polygons)


@settings(max_examples=40)
@given(seed=st.integers(0, 30), kept=st.sets(st.integers(0, 7)))
def test_removing_obstacles_never_turns_a_pass_into_a_rejection(seed: int, kept: set[int]) -> None:
    case = crowded(seed)
    before = audited(case)
    case["scene"]["polygons"] = [p for row, p in enumerate(case["scene"]["polygons"]) if row in kept]
    after = audited(case)
    assert set(after.failed) <= set(before.failed)
    for body, value in after.checks["clearance"].values.items():
        assert value >= before.checks["clearance"].values[body]


def test_the_scenes_are_of_both_kinds() -> None:
    verdicts = [audited(crowded(seed)).passed for seed in range(31)]
    assert 5 < sum(verdicts) < 26


@settings(max_examples=40)
@given(seed=st.integers(0, 30), name=st.sampled_from(SHRINKING), factor=st.floats(0.3, 1.0))
def test_a_smaller_vehicle_never_turns_a_pass_into_a_rejection(seed: int, name: str, factor: float) -> None:
    case = crowded(seed)
    before = audited(case)
    case["vehicle"] = dataclasses.asdict(VEHICLE) | {name: factor * getattr(VEHICLE, name)}
    after = audited(case)
    assert set(after.failed) <= set(before.failed)


@settings(max_examples=20)
@given(seed=st.integers(0, 30), order=st.randoms(use_true_random=False))
def test_the_order_of_obstacles_and_of_their_corners_changes_nothing(seed: int, order: Any) -> None:
    case = crowded(seed)
    before = audited(case).checks["clearance"].values
    turned = [polygon[k:] + polygon[:k] for polygon in case["scene"]["polygons"] for k in [order.randrange(3)]]
    order.shuffle(turned)
    case["scene"]["polygons"] = [polygon[::-1] if order.random() < 0.5 else polygon for polygon in turned]
    after = audited(case).checks["clearance"].values
    assert after == pytest.approx(before, abs=1e-9)
