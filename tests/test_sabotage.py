"""Sound claims, spoiled in many ways: the audit rejects each by the check meant for it, and needs every check."""

import dataclasses
import json

import pytest
from audit_cases import SOUND_PATH, VEHICLE
from paths import random_path
from scenes import blocks_beside

from optim.audit.checks import ALL
from optim.model.objective import Weights
from optim.model.scene import make_scene
from tools.attacks.saboteur.claims import KINDS, Claim, Kind, as_json, claim_of
from tools.attacks.saboteur.trial import passes_without, report_of, spoiled, trial

SEEDS = 2
"""Results spoiled in each way; `tools/attacks/sabotage.py` spoils results of real logs with a hundred."""


@pytest.fixture(scope="module")
def sound() -> list[Claim]:
    """Sound claims about three paths, one of them without a gear change and with another vehicle."""
    other = dataclasses.replace(VEHICLE, hitch_to_axle=6.5, trailer_rear=9.0)
    driven = [
        (VEHICLE, SOUND_PATH),
        (VEHICLE, random_path(VEHICLE, (9.0, 8.0, 6.0), -1, seed=3, spacing=0.1, turning=0.3)),
        (other, random_path(other, (14.0,), seed=8, spacing=0.1, turning=0.3)),
    ]
    claims = []
    for seed, (vehicle, path) in enumerate(driven):
        scene = make_scene(blocks_beside(vehicle, path, 4, seed))
        claims.append(claim_of(vehicle, scene, path, path, Weights()))
    return claims


def test_the_claims_are_sound_before_they_are_spoiled(sound: list[Claim]) -> None:
    assert [report_of(as_json(claim), ALL).failures for claim in sound] == [(), (), ()]


@pytest.mark.parametrize("kind", KINDS, ids=lambda kind: kind.name)
def test_spoiled_claims_are_rejected_by_the_check_that_is_meant_to_notice(sound: list[Claim], kind: Kind) -> None:
    for seed in range(SEEDS):
        outcome = trial(kind, sound, seed)
        assert outcome.rejected
        assert outcome.by_name, outcome.failed
        assert outcome.passes_without in ((True,) if kind.alone else (None,)), outcome.failed


def test_every_check_is_the_only_one_to_notice_some_kind() -> None:
    assert {kind.check for kind in KINDS if kind.alone} == {*ALL, "structure", "finite"}
    assert len(KINDS) >= 60
    assert len({kind.name for kind in KINDS}) == len(KINDS)


def test_without_another_check_a_spoiled_claim_is_still_rejected(sound: list[Claim]) -> None:
    """Switching off takes one check away, not all."""
    for kind in KINDS:
        if kind.alone:
            claim = spoiled(kind, sound, seed=0)
            other = "steer" if kind.check != "steer" else "joints"
            assert not passes_without(claim, other)


def test_the_reading_refuses_again_after_it_was_switched_off(sound: list[Claim]) -> None:
    (kind,) = (kind for kind in KINDS if kind.check == "finite" and kind.alone)
    claim = spoiled(kind, sound, seed=1)
    assert passes_without(claim, "finite")
    assert report_of(claim, ALL).failed == ("finite",)


def test_spoiling_leaves_the_sound_claim_as_it_was(sound: list[Claim]) -> None:
    before = [json.dumps(as_json(claim), sort_keys=True) for claim in sound]
    for kind in KINDS:
        spoiled(kind, sound, seed=0)
    assert [json.dumps(as_json(claim), sort_keys=True) for claim in sound] == before
