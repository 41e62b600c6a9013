"""Two runs of one request, or two methods of one run, side by side; what cannot be compared is refused."""

import json
import math
import pathlib

import numpy as np
import pytest
from logs_maker import LogMaker, drive, grid, path, sound_log, yard
from recording_reading import Contents
from results_maker import results_data

import replay.cli
from replay.base.documents import plain
from replay.base.errors import ReplayError
from replay.base.style import lighter, styles
from replay.run.results import read_results, to_document
from replay.run.side_by_side import compare, overlay
from replay.run.stored import run_of


def run(*arguments: str | pathlib.Path) -> int:
    return replay.cli.main([str(argument) for argument in arguments])


def optimized(log: pathlib.Path, out: pathlib.Path, *flags: str) -> pathlib.Path:
    assert run("optimize", log, "--no-recording", "--quiet", "--json", *flags, "--out", out) == 0
    return out / f"{log.stem}.results.json"


@pytest.fixture(scope="module")
def folder(tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("compared")
    log = sound_log().write(folder / "yard.mcap")
    both = ["--method", "shortcut", "--method", "ddp"]
    optimized(log, folder / "a", *both, "--shortcut.tries", "20")
    optimized(log, folder / "b", *both, "--method", "cpo", "--shortcut.tries", "60")
    optimized(log, folder / "weights", "--method", "ddp", "--weights.steer", "3")
    return folder


@pytest.fixture
def files(folder) -> tuple[str, str]:
    return str(folder / "a" / "yard.results.json"), str(folder / "b" / "yard.results.json")


def test_a_stored_run_is_the_run_that_was_written(files):
    document = results_data(pathlib.Path(files[0]))
    again = plain(to_document(run_of(read_results(files[0]), files[0])))
    for key in ("log", "vehicle", "scene", "weights", "recorded", "recorded_metrics", "recorded_audit", "read"):
        assert again[key] == document[key], key
    for one, other in zip(again["methods"], document["methods"], strict=True):
        for key in ("name", "status", "stop", "reason", "path", "metrics", "audit", "iterations", "wall_s"):
            assert one[key] == other[key], key


def test_a_file_from_before_a_metric_came_is_drawn_without_it(files, tmp_path):
    document = json.loads(pathlib.Path(files[0]).read_text())
    for figures in (document["recorded_metrics"], *(method["metrics"] for method in document["methods"])):
        del figures["steering_variation"]
    older = tmp_path / "older.results.json"
    older.write_text(json.dumps(document))
    assert run("compare", older, files[1], "--out", tmp_path / "both.rrd") == 0
    summary = Contents(tmp_path / "both.rrd").text("/report/summary")
    (row,) = (line for line in summary.splitlines() if line.startswith("| Steering variation"))
    assert "–" in row


def test_two_files_are_compared_method_by_method(files, folder):
    found = compare(*files)
    assert [pair.name for pair in found.pairs] == ["recorded", "shortcut", "ddp"]
    documents = [results_data(pathlib.Path(file)) for file in files]
    shortcut = found.pairs[1]
    before, after = (document["methods"][0]["metrics"] for document in documents)
    assert shortcut.a.values["objective"] == before["objective"]
    assert shortcut.difference("length") == after["length"] - before["length"]
    assert shortcut.relative("objective") == pytest.approx(after["objective"] / before["objective"] - 1.0)
    assert found.notes == (f"only {files[1]} has cpo",)


def test_two_methods_of_one_file_are_compared(files):
    (pair,) = compare(f"{files[0]}:shortcut", ":ddp").pairs
    assert (pair.name, pair.a.method, pair.b.method) == ("shortcut, ddp", "shortcut", "ddp")
    (pair,) = compare(f"{files[0]}:ddp", files[1]).pairs
    assert (pair.name, pair.relative("objective")) == ("ddp", pytest.approx(0.0, abs=1e-6))
    (pair,) = compare(f"{files[0]}:recorded", ":ddp").pairs
    assert (pair.a.status, math.isnan(pair.a.values["wall_s"])) == ("recorded", True)


def test_under_different_weights_both_are_judged_by_those_of_the_first(files, folder):
    other = str(folder / "weights" / "yard.results.json")
    found = compare(files[0], other)
    recorded = next(pair for pair in found.pairs if pair.name == "recorded")
    assert recorded.difference("objective") == pytest.approx(0.0, abs=1e-9)
    assert "the weights of J differ" in found.notes[0]
    stored = results_data(pathlib.Path(other))["recorded_metrics"]["objective"]
    assert abs(stored - recorded.b.values["objective"]) > 0.01


def test_the_table_fits_and_json_has_the_same_numbers(files, capsys):
    assert run("compare", *files) == 0
    lines = capsys.readouterr().out.splitlines()
    assert max(map(len, lines[2:])) <= 100
    assert sum("steering variation [°]" in line for line in lines) == 3
    assert run("compare", *files, "--json") == 0
    document = json.loads(capsys.readouterr().out)
    assert document["schema"] == "replay.compare/1"
    length = document["pairs"][1]["difference"]["length"]
    (line,) = [line for line in lines[lines.index(next(x for x in lines if "shortcut" in x)) :] if "length" in line][:1]
    assert f"{length:+.2f}" in line


def test_the_recording_overlays_both_in_the_colours_of_their_methods(files, tmp_path):
    assert run("compare", *files, "--out", tmp_path / "both.rrd") == 0
    contents = Contents(tmp_path / "both.rrd")
    labels = [label.partition(":")[0] for label in contents.rows("/scene/legend/paths", "LineStrips2D:labels")[0]]
    assert labels == ["Recorded", "Shortcut A", "Shortcut B", "DDP A", "DDP B"]
    colour = styles(["shortcut"])["shortcut"].colour
    _, looks = overlay(compare(*files))
    assert (looks["shortcut-A"].colour, looks["shortcut-B"].colour) == (colour, lighter(colour))
    for name in ("shortcut-A", "shortcut-B", "ddp-A"):
        assert contents.rows(f"/scene/{name}/path", "LineStrips2D:strips")


def test_two_methods_of_one_file_keep_their_own_looks(files):
    drawn, looks = overlay(compare(f"{files[0]}:shortcut", ":ddp"))
    assert [method.name for method in drawn.methods] == ["shortcut", "ddp"]
    assert looks == styles(["shortcut", "ddp"])


def refused(a: str, b: str) -> str:
    with pytest.raises(ReplayError) as caught:
        compare(a, b)
    return str(caught.value)


def changed(file: str, target: pathlib.Path, change) -> str:
    document = json.loads(pathlib.Path(file).read_text())
    change(document)
    target.write_text(json.dumps(document))
    return str(target)


def test_other_scenes_vehicles_and_requests_are_refused_in_one_line(files, tmp_path):
    a = files[0]
    scene = changed(a, tmp_path / "scene.json", lambda d: d["scene"]["polygons"].pop())
    assert "different scenes (" in refused(a, scene)
    moved = changed(a, tmp_path / "moved.json", lambda d: d["scene"]["polygons"][0][0].__setitem__(0, -9.0))
    assert "different scenes (" in refused(a, moved)
    longer = changed(a, tmp_path / "longer.json", lambda d: d["vehicle"].__setitem__("trailer_rear", 9.5))
    assert "different vehicles (trailer_rear 12 and 9.5)" in refused(a, longer)


def test_another_request_on_the_same_map_is_refused(tmp_path):
    truck, _ = drive()
    maker = LogMaker().vehicle().add("/map", grid(yard()), 1)
    for k in range(2):
        maker.add("/truck", path(truck[: 70 + 20 * k]), 2 + k)
    log = maker.write(tmp_path / "two.mcap")
    optimized_flags = ["--method", "shortcut", "--shortcut.tries", "2"]
    assert run("optimize", log, "--no-recording", "--quiet", "--json", *optimized_flags, "--out", tmp_path) == 0
    said = refused(str(tmp_path / "two-0.results.json"), str(tmp_path / "two-1.results.json"))
    assert "different requests (the goal is at (" in said


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda d: d["vehicle"].pop("wheelbase"), None),
        (lambda d: d["vehicle"].__setitem__("width", 3), "unknown key 'width' in vehicle"),
        (lambda d: d["vehicle"].__setitem__("wheelbase", 10**400), "vehicle.wheelbase is a number of 401 digits"),
        (lambda d: d.pop("recorded_metrics"), "recorded_metrics and recorded_audit are needed"),
        (lambda d: d["methods"][0]["path"]["segments"][0].pop("x"), "not a path: segments[0].x is missing"),
        (lambda d: d["scene"].__setitem__("polygons", 3), "scene.polygons is 3, expected a list"),
        (lambda d: d["scene"]["polygons"][0][0].__setitem__(1, 10**400), "scene.polygons[0][0][1] is a number of 401"),
        (lambda d: d["recorded_audit"]["checks"].__setitem__("steer", 3), "recorded_audit.checks.steer is 3"),
        (
            lambda d: d["methods"][0]["audit"]["checks"]["steer"]["limits"].__setitem__("steer_rad", "x"),
            "methods[0].audit.checks.steer.limits.steer_rad is 'x', expected a number or null",
        ),
        (
            lambda d: d["methods"][0]["audit"]["checks"]["steer"].__setitem__("place", [3]),
            "methods[0].audit.checks.steer.place is a list, expected an object or null",
        ),
        (lambda d: d["recorded_metrics"].pop("length"), "recorded_metrics.length is missing or null"),
        (
            lambda d: d["methods"][0]["metrics"].__setitem__("cusps", None),
            "methods[0].metrics.cusps is missing",
        ),
        (lambda d: d["tool"].__setitem__("options", 3), "tool.options is 3, expected an object"),
    ],
)
def test_a_document_with_a_field_that_is_no_good_is_refused(files, tmp_path, change, words):
    file = changed(files[0], tmp_path / "odd.json", change)
    if words is None:
        assert compare(files[0], file).pairs  # the default vehicle's
    else:
        said = refused(files[0], file)
        assert said.isprintable()
        assert "E_RESULTS" in said
        assert words in said


def test_what_is_not_there_is_named(files, tmp_path, capsys):
    assert "no method 'nlp'; there are recorded, shortcut, ddp" in refused(f"{files[0]}:nlp", ":ddp")
    assert "no method 'shortct' (did you mean 'shortcut'?); there are" in refused(f"{files[0]}:shortct", ":ddp")
    assert run("compare", files[0], tmp_path / "none.json") == 2
    assert "No such file" in capsys.readouterr().err
    assert run("compare", *files, "--out", tmp_path / "both.png") == 2
    assert "expected the name of a recording" in capsys.readouterr().err


def test_lighter_is_lighter():
    assert np.all(np.array(lighter((0, 114, 178))) > (0, 114, 178))
