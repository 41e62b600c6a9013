"""A results file is audited from its own content alone, and what it claims is found or not."""

import copy
import dataclasses
from typing import Any

import numpy as np
import pytest
from paths import straight
from results_maker import RECORDED, Answer, Document, make_run, results_data, written

from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle
from replay.base.documents import plain
from replay.run.confirm import Confirmation, audit_results
from replay.run.judge import run_case
from replay.run.plain import path_to_document
from replay.run.results import results_of, to_document

RUN = make_run()


@pytest.fixture(scope="module")
def stored(tmp_path_factory: pytest.TempPathFactory) -> Document:
    return results_data(written(tmp_path_factory.mktemp("stored"), to_document(RUN)))


def audited(document: Document) -> list[Confirmation]:
    return audit_results(results_of(document, "document"))


def test_an_honest_file_is_confirmed(stored: Document) -> None:
    verdicts = audited(stored)
    assert [verdict.name for verdict in verdicts] == ["recorded", "better", "same", "wrong", "broken"]
    assert all(verdict.report.passed for verdict in verdicts)
    assert [verdict.differences for verdict in verdicts] == [()] * 5


def test_a_file_without_the_recorded_metrics_can_be_audited(stored: Document) -> None:
    document = {key: value for key, value in stored.items() if not key.startswith("recorded_")}
    assert all(verdict.report.passed and verdict.confirmed for verdict in audited(document))


def test_a_path_that_is_not_sound_and_not_called_so_is_confirmed(stored: Document) -> None:
    """The recorded path may break a limit; a file that says so is honest."""
    problem = dataclasses.replace(RUN.case.problem, vehicle=Vehicle(truck_front=4.0, truck_width=6.5))
    run = run_case(dataclasses.replace(RUN.case, problem=problem), {"same": Answer(path=RECORDED)})
    verdicts = audit_results(to_document(run))
    assert [verdict.report.failed for verdict in verdicts] == [("clearance",)] * 2
    assert all(verdict.confirmed for verdict in verdicts)


def test_a_file_that_asks_for_more_clearance_than_its_paths_keep_is_not_confirmed() -> None:
    block = np.array([[16.3, -1.0], [20.0, -1.0], [20.0, 1.0], [16.3, 1.0]])  # 0.3 m ahead of the truck at 11 m
    problem = dataclasses.replace(RUN.case.problem, scene=make_scene([block]))
    run = run_case(dataclasses.replace(RUN.case, problem=problem), {"far": Answer(path=straight(11.0, -1.0))})
    document = plain(to_document(run))
    assert all(verdict.confirmed for verdict in audited(document))
    document["scene"]["margin"] = 0.9
    recorded, far = audited(document)
    assert recorded.confirmed
    assert far.differences == ("the status is 'improved', but the path's clearance is 0.3000 m, required 0.9000 m",)


def tampered(stored: Document, *keys: Any, value: Any) -> Document:
    document = copy.deepcopy(stored)
    node = document
    for key in keys[:-1]:
        node = node[key]
    node[keys[-1]] = value
    return document


@pytest.mark.parametrize(
    ("keys", "value", "name", "said"),
    [
        (("methods", 0, "audit", "passed"), False, "better", "stored audit does not say passed"),
        (("methods", 0, "audit", "checks", "goal", "passed"), False, "better", "check 'goal' is not confirmed"),
        (("methods", 0, "audit", "checks", "magic"), {"passed": True}, "better", "check 'magic' is not confirmed"),
        (("methods", 0, "audit"), {}, "better", "stored audit does not say passed"),
        (("methods", 0, "metrics", "objective"), 1.0, "better", "repeated: objective"),
        (("methods", 0, "metrics"), {}, "better", "repeated: objective"),
        (("methods", 0, "path", "segments", 0, "x", 50), 9.0, "better", "repeated: defect"),
        (("methods", 0, "path"), path_to_document(RECORDED), "better", "is 'improved', but J is"),
        (("methods", 1, "status"), "improved", "same", "is 'improved', but J is"),
        (("methods", 1, "path"), path_to_document(straight(10.0)), "same", "the path is not the recorded one"),
        (("vehicle", "truck_width"), 6.5, "better", "repeated: clearance"),
        (("vehicle", "wheelbase"), "3.6", "better", "repeated: structure"),
        (("methods", 0, "metrics", "length"), 7.0, "better", "stored metric length is 7, recomputed 10"),
        (("methods", 0, "metrics", "cusps"), 1, "better", "stored metric cusps is 1, recomputed 0"),
        (("methods", 0, "metrics", "min_clearance"), None, "better", "stored metric min_clearance is null"),
        (("methods", 0, "audit", "checks", "steer", "values", "steer_rad"), 0.1, "better", "'steer': steer_rad is 0.1"),
        (("methods", 0, "audit", "checks", "steer", "limits", "steer_rad"), 9.0, "better", "limit of steer_rad is 9"),
        (("vehicle", "trailer_width"), 2.6, "better", "check 'clearance': trailer_m is"),
        (("recorded_metrics", "length"), 1.0, "recorded", "stored metric length is 1"),
        (("recorded_metrics", "objective"), 1.0, "recorded", "repeated: objective"),
        (("recorded_audit", "passed"), False, "recorded", "stored audit does not say passed"),
    ],
)
def test_a_claim_that_does_not_hold_is_found(
    stored: Document, keys: tuple[Any, ...], value: Any, name: str, said: str
) -> None:
    verdicts = {verdict.name: verdict for verdict in audited(tampered(stored, *keys, value=value))}
    assert any(said in line for line in verdicts[name].differences), verdicts[name].differences
    assert not verdicts[name].confirmed
