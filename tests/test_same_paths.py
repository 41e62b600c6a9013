"""The comparison of two folders of results files: what counts as a difference, and what does not."""

import copy
import json
import math
import pathlib

import pytest
import results_maker as make

from replay.base.documents import to_bytes
from replay.run.results import to_document
from tools.same_paths import main

Document = make.Document


@pytest.fixture(scope="module")
def document() -> Document:
    return json.loads(to_bytes(to_document(make.make_run())))


def compared(tmp_path: pathlib.Path, first: Document, second: Document, *words: str) -> int:
    for name, document in (("a", first), ("b", second)):
        (tmp_path / name).mkdir()
        (tmp_path / name / "bay_01.results.json").write_text(json.dumps(document))
    return main([str(tmp_path / "a"), str(tmp_path / "b"), *words])


def changed(document: Document, index: int = 0) -> tuple[Document, Document]:
    """A copy of a document, and the method of it that is to be changed."""
    copied = copy.deepcopy(document)
    return copied, copied["methods"][index]


def test_times_sentences_options_and_versions_may_differ(tmp_path, document, capsys):
    other, method = changed(document)
    method |= {"wall_s": 99.0, "reason": "Other words."}
    method["audit"]["checks"]["clearance"]["sentence"] = "Other words."
    method["history"][0]["solver_s"] = 3.0
    other["tool"] |= {"version": "2.0", "options": {}}
    assert compared(tmp_path, document, other, "--history") == 0
    assert capsys.readouterr().out == "1 cases, 4 methods compared: 0 differences\n"


def test_the_last_bit_of_one_number_of_a_path_is_a_difference(tmp_path, document, capsys):
    other, method = changed(document)
    column = method["path"]["segments"][0]["x"]
    column[3] = math.nextafter(column[3], math.inf)
    assert compared(tmp_path, document, other) == 1
    lines = capsys.readouterr().out.splitlines()
    assert lines[0].startswith("bay_01 better: path.segments[0].x[3] is ")
    assert "by up to " in lines[0]
    assert lines[-1] == "1 cases, 4 methods compared: 1 differences"


def test_a_zero_with_another_sign_is_another_number(tmp_path, document, capsys):
    other, method = changed(document)
    assert method["path"]["segments"][0]["phi"][0] == 0.0
    method["path"]["segments"][0]["phi"][0] = -0.0
    assert compared(tmp_path, document, other) == 1
    assert "phi[0] is 0.0 and -0.0" in capsys.readouterr().out


@pytest.mark.parametrize(
    ("change", "said"),
    [
        ({"status": "kept"}, "status is 'improved' and 'kept'"),
        ({"stop": "stalled"}, "stop is 'converged' and 'stalled'"),
        ({"iterations": 2}, "iterations is 1 and 2"),
        ({"metrics": {}}, "metrics.cusps is "),
        ({"audit": None}, "audit.checks."),
    ],
)
def test_status_iterations_metrics_and_audit_count(tmp_path, document, capsys, change, said):
    other, method = changed(document)
    method |= change
    assert compared(tmp_path, document, other) == 1
    assert f"bay_01 better: {said}" in capsys.readouterr().out


def test_a_path_with_fewer_samples_is_told_by_what_is_missing(tmp_path, document, capsys):
    other, method = changed(document, 1)
    for column in method["path"]["segments"][0].values():
        if isinstance(column, list):
            column.pop()
    assert compared(tmp_path, document, other) == 1
    assert "missing; 6 of " in capsys.readouterr().out


def test_iterates_count_where_they_are_asked_for(tmp_path, document, capsys):
    other, method = changed(document)
    method["history"][0]["objective"] += 1.0
    assert compared(tmp_path, document, other) == 0
    assert main([str(tmp_path / "a"), str(tmp_path / "b"), "--history"]) == 1
    assert "history[0].objective is 30.0 and 31.0, by up to 1" in capsys.readouterr().out


def test_a_method_or_a_case_that_one_folder_lacks_is_a_difference(tmp_path, document, capsys):
    other, _ = changed(document)
    del other["methods"][2]
    assert compared(tmp_path, document, other) == 1
    assert "bay_01 wrong: only in A" in capsys.readouterr().out
    (tmp_path / "b" / "bay_01.results.json").rename(tmp_path / "b" / "bay_02.results.json")
    assert main([str(tmp_path / "a"), str(tmp_path / "b")]) == 1
    found = capsys.readouterr().out
    assert f"bay_01: only in {tmp_path / 'a'}" in found
    assert f"bay_02: only in {tmp_path / 'b'}" in found
    assert "nothing was compared" in found


def test_the_recorded_path_counts_too(tmp_path, document, capsys):
    other = copy.deepcopy(document)
    other["recorded"]["segments"][0]["direction"] = -1
    assert compared(tmp_path, document, other) == 1
    assert "bay_01 recorded: recorded.segments[0].direction is 1 and -1" in capsys.readouterr().out
