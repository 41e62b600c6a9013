"""The audit accepts a sound path and rejects every kind of damage, by the check that is meant for it."""

import ast
import json
import math
import pathlib
import subprocess
import sys
import time

import numpy as np
import pytest
from audit_cases import (
    ALONE,
    DAMAGES,
    SOUND,
    VEHICLE,
    Case,
    add,
    audited,
    case_of,
    obstacle_moved_into_path,
    pose_moved,
    restated,
    segment,
    sound,
)
from paths import random_path
from scenes import blocks_beside

import optim.audit.checks
from optim.audit.checks import audit_recorded
from optim.model.vehicle import Vehicle
from replay.base.documents import to_bytes
from replay.run.results import audit_document


def test_a_sound_path_with_a_cusp_passes_every_check() -> None:
    report = audited(SOUND)
    assert report.failures == ()
    assert report.passed
    assert set(report.checks) == {
        *("structure", "finite", "spacing", "joints", "start", "goal", "defect", "defect_sum"),
        *("steer", "hitch", "steer_rate", "clearance", "boundary", "objective"),
    }


@pytest.mark.parametrize("seed", range(6))
def test_sound_paths_with_other_gears_and_vehicles_pass(seed: int) -> None:
    offset = (0.0, 0.0, -0.4, 0.7, 0.0, 0.3)[seed]
    vehicle = Vehicle(hitch_to_axle=5.0 + seed, trailer_rear=6.0 + seed, hitch_offset=offset)
    path = random_path(vehicle, (9.0, 7.0, 5.0), first_direction=(-1) ** seed, seed=seed, spacing=0.1)
    report = audited(case_of(path, blocks_beside(vehicle, path, 4, seed), vehicle))
    assert report.failures == ()


def test_the_heading_at_the_goal_may_differ_by_full_turns() -> None:
    case = sound()
    for k in range(2):
        add(segment(case, k, "recorded")["theta"], 0.0 if k == 0 else math.tau)
    assert audited(case).failures == ()


def test_numerical_noise_of_a_twentieth_of_a_millimetre_is_accepted() -> None:
    case, rng = sound(), np.random.default_rng(0)
    for key in ("x", "y"):
        add(segment(case)[key], rng.uniform(-5e-5, 5e-5, 30), 100, 130)
    assert audited(case).failures == ()


def test_a_scene_without_obstacles_or_boundary_is_free() -> None:
    case = sound()
    case["scene"] = {"polygons": []}
    report = audited(case)
    assert report.passed
    assert "boundary" not in report.checks
    assert report.clearance.values == {"truck_m": math.inf, "trailer_m": math.inf}


def test_the_recorded_path_is_audited_without_start_goal_and_objective() -> None:
    report = audit_recorded(SOUND["vehicle"], SOUND["scene"], SOUND["recorded"])
    assert report.passed
    assert not {"start", "goal", "objective"} & set(report.checks)
    case = sound()
    add(segment(case)["x"], 0.002, 100, 101)
    assert audit_recorded(case["vehicle"], case["scene"], case["path"]).failed == ("defect",)


def test_a_report_is_plain_json() -> None:
    for damage, _ in DAMAGES.values():
        document = json.loads(to_bytes(audit_document(audited(damage(sound())))))
        assert set(document) == {"passed", "complete", "checks"}


@pytest.mark.parametrize("name", DAMAGES)
def test_damage_is_rejected_by_the_check_meant_for_it(name: str) -> None:
    damage, check = DAMAGES[name]
    report = audited(damage(sound()))
    assert not report.passed
    assert check in report.failed, report.failures
    assert all("\n" not in line for line in report.failures)


@pytest.mark.parametrize("name", ALONE)
def test_no_other_check_would_have_noticed(name: str) -> None:
    damage, check = ALONE[name]
    assert audited(restated_unless(damage(sound()), check)).failed == (check,)


def restated_unless(case: Case, check: str) -> Case:
    return case if check == "objective" else restated(case)


def test_every_check_of_motion_and_claims_is_the_only_one_for_some_damage() -> None:
    assert {check for _, check in DAMAGES.values()} == set(audited(SOUND).checks)
    assert set(audited(SOUND).checks) - {check for _, check in ALONE.values()} == {"structure", "finite", "spacing"}


def test_the_place_of_the_worst_value_is_named() -> None:
    place = audited(obstacle_moved_into_path(sound())).checks["clearance"].place
    assert place is not None
    assert place.polygon == 0
    place = audited(pose_moved(sound())).checks["defect"].place
    assert place is not None
    assert (place.segment, place.s) == (0, pytest.approx(5.0, abs=0.06))


def test_a_check_is_found_by_its_name_and_has_the_value_that_decides() -> None:
    report = audited(obstacle_moved_into_path(sound()))
    assert report.clearance is report.checks["clearance"]
    assert report.clearance.value == min(report.clearance.values.values()) < 0.0
    assert report.steer.value == report.steer.values["steer_rad"]
    assert math.isnan(report.structure.value)
    with pytest.raises(AttributeError, match="no check 'clearence' was made; there are structure, "):
        _ = report.clearence


MODULES = ("checks", "data", "motion", "report")


def test_the_audit_imports_nothing_that_a_method_uses() -> None:
    """In its sources, and in what a fresh interpreter has loaded after importing it."""
    allowed = {"numpy", "shapely", *(f"optim.audit.{name}" for name in MODULES)}
    folder = pathlib.Path(optim.audit.checks.__file__).parent
    for name in MODULES:
        for node in ast.walk(ast.parse((folder / f"{name}.py").read_text(encoding="utf-8"))):
            names = [alias.name for alias in node.names] if isinstance(node, ast.Import) else []
            names += [node.module or "."] if isinstance(node, ast.ImportFrom) else []
            for imported in names:
                root = imported.partition(".")[0]
                assert imported in allowed or root in allowed or root in sys.stdlib_module_names, imported
    script = "import sys, optim.audit.checks; print(*sorted(m for m in sys.modules if m[:5] in ('optim', 'numba')))"
    loaded = subprocess.run([sys.executable, "-c", script], capture_output=True, text=True, check=True).stdout.split()
    assert set(loaded) == {"optim", "optim.audit", *(f"optim.audit.{name}" for name in MODULES)}


def test_a_path_of_a_hundred_metres_takes_well_below_a_second() -> None:
    path = random_path(VEHICLE, (40.0, 30.0, 30.0), seed=3)
    case = case_of(path, blocks_beside(VEHICLE, path, 30, seed=2))
    started = time.process_time()
    assert audited(case).passed
    assert time.process_time() - started < 1.0
