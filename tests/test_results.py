"""Results files hold a run exactly, and are read with suspicion."""

import contextlib
import copy
import dataclasses
import json
import os
import pathlib
from collections.abc import Callable
from typing import Any

import msgspec
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import random_path
from results_maker import VEHICLE, Document, make_run, results_data, written

import replay.run.results
from replay.base.documents import to_bytes
from replay.base.errors import ReplayError
from replay.run.confirm import audit_results
from replay.run.plain import path_from_document, path_to_document, scene_to_document
from replay.run.results import read_results, results_of, to_document, write_results
from replay.run.stored import run_of

RUN = make_run()


@pytest.fixture(scope="module")
def stored_file(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    return written(tmp_path_factory.mktemp("stored"), to_document(RUN))


@pytest.fixture(scope="module")
def stored(stored_file: pathlib.Path) -> Document:
    return results_data(stored_file)


@pytest.fixture(scope="module")
def stored_bytes(stored_file: pathlib.Path) -> bytes:
    return stored_file.read_bytes()


# Writing, and reading back.


def test_a_document_has_the_fields_of_the_schema(stored: Document) -> None:
    schema = {"schema", "log", "tool", "vehicle", "scene", "recorded", "read", "methods"}
    assert set(stored) - schema == {"weights", "recorded_metrics", "recorded_audit"}, "these are additive"
    assert schema <= set(stored)
    assert stored["schema"] == "replay.results/1"
    assert stored["log"] == {"path": "bay_01.mcap", "sha256": "ab" * 32, "case": "bay_01/0"}
    assert stored["tool"]["seed"] == 7
    assert stored["tool"]["options"] == {"better": {"window": 3.0, "kind": ["a", "b"]}}
    assert stored["tool"]["packages"]["numpy"] == np.__version__
    assert stored["vehicle"] == dataclasses.asdict(VEHICLE)
    assert stored["scene"]["margin"] == 0.1
    assert stored["scene"]["frame"] == "map"
    assert stored["read"]["notes"] == ["odd"]
    assert [method["status"] for method in stored["methods"]] == ["improved", "kept", "kept", "failed"]
    fields = {"name", "status", "stop", "reason", "path", "metrics", "audit", "iterations", "wall_s", "history"}
    assert set(stored["methods"][0]) - fields == {"rejected"}
    assert fields <= set(stored["methods"][0])


def test_paths_come_back_bit_for_bit(tmp_path: pathlib.Path) -> None:
    path = random_path(VEHICLE, (5.0, 4.0), seed=9)
    document = msgspec.structs.replace(to_document(RUN), recorded=path_to_document(path))
    again = path_from_document(read_results(written(tmp_path, document)).recorded)
    assert len(again.segments) == len(path.segments)
    for one, other in zip(path.segments, again.segments, strict=True):
        assert one.direction == other.direction
        for key in ("s", "x", "y", "theta", "alpha", "phi"):
            np.testing.assert_array_equal(getattr(one, key), getattr(other, key), strict=True)


def test_the_same_document_makes_the_same_bytes_with_sorted_keys(tmp_path: pathlib.Path, stored: Document) -> None:
    first = written(tmp_path, stored).read_bytes()
    shuffled = dict(reversed(stored.items()))
    assert written(tmp_path, shuffled).read_bytes() == first
    keys = list(json.loads(first))
    assert keys == sorted(keys)
    assert first.endswith(b"}\n")


def test_what_is_not_finite_becomes_null(stored: Document) -> None:
    row = stored["methods"][0]["history"][0]
    assert row["step"] is None
    assert row["trust_region"] is None
    assert row["solver_s"] is None


def test_a_history_says_what_decided_convergence(stored: Document) -> None:
    row = stored["methods"][0]["history"][0]
    assert row["residuals"] == {"defect": 12.5, "step": None}
    assert row["accepted"] is True


def test_text_of_any_language_and_file_names_that_are_no_text_survive(tmp_path: pathlib.Path) -> None:
    name = os.fsdecode("Höfe_倉庫_\udcff.mcap".encode("utf-8", "surrogateescape"))
    document = to_document(dataclasses.replace(RUN, case=dataclasses.replace(RUN.case, log=pathlib.Path(name))))
    path = written(tmp_path, document)
    path.read_bytes().decode("utf-8")
    assert read_results(path).log.path == name


def test_the_boundary_is_stored_where_there_is_one(stored: Document) -> None:
    assert stored["scene"]["boundary"] is None
    outline = [[-30.0, -30.0], [30.0, -30.0], [30.0, 30.0], [-30.0, 30.0]]
    run = make_run(boundary=outline)
    assert sorted(scene_to_document(run.case.problem.scene)["boundary"]) == sorted(outline)
    assert [verdict.confirmed for verdict in audit_results(to_document(run))] == [True] * 5


def test_a_folder_that_is_missing_is_one_line(tmp_path: pathlib.Path) -> None:
    with pytest.raises(ReplayError, match="cannot be written: No such file"):
        write_results(tmp_path / "missing" / "bay.json", to_document(RUN))


def test_a_run_comes_back_with_its_audits_metrics_and_history(stored_file: pathlib.Path) -> None:
    again = run_of(read_results(stored_file), "stored")
    assert [method.metrics for method in again.methods] == [method.metrics for method in RUN.methods]
    for one, other in zip(again.methods, RUN.methods, strict=True):
        assert one.audit == other.audit
        assert one.rejected == other.rejected
        assert repr(one.history) == repr(other.history).replace("inf", "nan"), "null stands for both"
    assert again.best is not None
    assert again.best.audit.clearance.value == RUN.methods[0].audit.clearance.value


# Reading what may be anything.


def without(key: str) -> Callable[[Document], Document]:
    return lambda document: {name: value for name, value in document.items() if name != key}


def with_method(key: str, value: Any) -> Callable[[Document], Document]:
    def change(document: Document) -> Document:
        document = copy.deepcopy(document)
        document["methods"][1][key] = value
        return document

    return change


@pytest.mark.parametrize(
    ("change", "said"),
    [
        (lambda document: [document], "the document is a list, expected an object"),
        (
            lambda document: document | {"schema": "replay.results/2"},
            "schema is 'replay.results/2', expected 'replay.results/1'",
        ),
        (without("schema"), "schema is missing"),
        (without("vehicle"), "vehicle is missing"),
        (without("weights"), "weights is missing"),
        (lambda document: document | {"recorded": []}, "recorded is a list, expected an object"),
        (lambda document: document | {"methods": {}}, "methods is an object, expected a list"),
        (lambda document: document | {"methods": [1]}, r"methods\[0\] is 1, expected an object"),
        (with_method("name", 3), r"methods\[1\].name is 3, expected a text"),
        (with_method("name", "better"), "two methods have one name"),
        (
            with_method("status", "splendid"),
            r"methods\[1\].status is 'splendid', expected 'improved' or 'kept' or 'failed'",
        ),
        (with_method("metrics", {"length": "7"}), r"methods\[1\].metrics.length is '7', expected a number or null"),
        (with_method("metrics", {"cusps": 10**400}), r"methods\[1\].metrics.cusps is a number of 401 digits"),
        (with_method("wall_s", 10**400), r"methods\[1\].wall_s is a number of 401 digits, expected a number"),
        (with_method("audit", {"checks": {"steer": {"limits": {"steer_rad": "x"}}}}), "steer.limits.steer_rad is 'x'"),
        (with_method("path", None), r"methods\[1\].path is null, expected an object"),
    ],
)
def test_what_is_no_results_document_is_said_in_one_line(
    tmp_path: pathlib.Path, stored: Document, change: Callable[[Document], Any], said: str
) -> None:
    path = tmp_path / "bad.json"
    path.write_text(json.dumps(change(stored)), encoding="utf-8")
    with pytest.raises(ReplayError, match=said) as caught:
        read_results(path)
    assert caught.value.code == "E_RESULTS"
    assert str(path) in str(caught.value)
    assert "\n" not in str(caught.value)
    with pytest.raises(ReplayError, match=said):
        results_of(change(stored), "document")


@pytest.mark.parametrize(
    ("content", "said"), [(b"hello", "not JSON"), (b'{"a": NaN}', "NaN is not JSON"), (b"[" * 200_000, "too deeply")]
)
def test_what_is_no_json_is_a_results_error(tmp_path: pathlib.Path, content: bytes, said: str) -> None:
    path = tmp_path / "bad.json"
    path.write_bytes(content)
    with pytest.raises(ReplayError, match=said) as caught:
        read_results(path)
    assert caught.value.code == "E_RESULTS"
    assert str(caught.value).startswith(f"{path}: ")


def test_a_file_that_is_too_large_is_not_read(tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch) -> None:
    path = written(tmp_path, to_document(RUN))
    monkeypatch.setattr(replay.run.results, "LARGEST_FILE", path.stat().st_size - 1)
    with pytest.raises(ReplayError, match="larger than"):
        read_results(path)


def test_no_part_of_a_file_is_taken_for_the_whole(tmp_path: pathlib.Path) -> None:
    content = written(tmp_path, to_document(RUN)).read_bytes().rstrip()
    path = tmp_path / "part.json"
    for length in np.random.default_rng(0).integers(0, len(content), 40):
        path.write_bytes(content[:length])
        with pytest.raises(ReplayError):
            read_results(path)


@settings(max_examples=60, deadline=None)
@given(place=st.floats(0.0, 1.0, exclude_max=True), bit=st.integers(0, 7))
def test_a_flipped_bit_is_an_error_or_a_document_that_can_be_audited(
    tmp_path_factory: pytest.TempPathFactory, stored_bytes: bytes, place: float, bit: int
) -> None:
    content = bytearray(stored_bytes)
    content[int(place * len(content))] ^= 1 << bit
    path = tmp_path_factory.getbasetemp() / "flipped.json"
    path.write_bytes(content)
    with contextlib.suppress(ReplayError):
        audit_results(read_results(path))


ODD = [None, True, "x", "\ud800", 10**400, -1, 1.5, 1e308, [], {}, [None], {"a": 1}, {"\ud800": 1}, [[1, 2]]]


def places(tree: Any, limit: int = 3) -> list[tuple[Any, ...]]:
    """Where something may be put: every key, and the first items of lists."""
    items = list(tree.items()) if isinstance(tree, dict) else list(enumerate(tree))[:limit]
    deeper = [(key, *rest) for key, value in items if isinstance(value, (dict, list)) for rest in places(value, limit)]
    return [(key,) for key, _ in items] + deeper


STORED = to_bytes(to_document(RUN))
PLACES = places(json.loads(STORED))


@settings(max_examples=300, deadline=None)
@given(number=st.integers(0, 10_000), value=st.sampled_from(ODD))
def test_any_value_anywhere_is_one_line_or_a_document_that_can_be_audited_and_rebuilt(number: int, value: Any) -> None:
    *keys, last = PLACES[number % len(PLACES)]
    node = document = json.loads(STORED)
    for key in keys:
        node = node[key]
    node[last] = value
    for use in (audit_results, lambda each: run_of(each, "changed")):
        with contextlib.suppress(ReplayError):
            use(results_of(document, "changed"))


@pytest.mark.parametrize(
    "document",
    [{}, {"segments": 3}, {"segments": [{}]}, {"segments": []}, {"segments": [{"direction": 1, "s": "ab"}]}, []],
)
def test_what_is_no_path_is_said_in_one_line(document: Any) -> None:
    with pytest.raises(ReplayError, match="not a path"):
        path_from_document(document)
