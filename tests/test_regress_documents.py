"""Documents of regression runs that are damaged or hostile: one line that names the field, never a traceback."""

import json
import pathlib

import pytest
import run_maker as maker

from replay.cli import main
from replay.report import make_report
from replay.report.history import trend
from replay.report.run_files import read_run

HUGE = "1" + "0" * 400


def write(path: pathlib.Path, content: object, number: str) -> None:
    """Write JSON in which the text "HERE" is that number."""
    path.write_text(json.dumps(content).replace('"HERE"', number))


def line_of(capsys: pytest.CaptureFixture[str], *arguments: object) -> str:
    """The one line with which a command ends with status 2."""
    assert main([str(argument) for argument in arguments]) == 2
    error = capsys.readouterr().err
    assert error.count("\n") == 1
    return error


@pytest.mark.parametrize(
    ("head", "words"),
    [
        ('"options": {"seed": HERE}', "options.seed is a number of 401 digits"),
        ('"options": {"weights": {"cusp": HERE}}', "options.weights.cusp"),
        (
            '"options": {"methods": {"ddp": {"spacing": HERE}}}',
            "options.methods.ddp.spacing",
        ),
        (
            '"options": {"methods": {"a+b": [["a", {"x": HERE}]]}}',
            "options.methods.a+b[0][1].x",
        ),
        ('"corpus": {"num_logs": HERE}', "corpus.num_logs"),
        ('"created": 1e400', "1e400 is beyond the range"),
        ('"created": "a", "created": "b"', "the key 'created' appears twice"),
        ('"known": [{"method": "ddp"}]', "known[0].log is missing"),
    ],
)
def test_a_head_that_is_wrong_is_one_line_that_names_the_field(tmp_path, capsys, head, words):
    text = f'{{"schema": "replay.run/1", {head}}}'
    (tmp_path / "run.json").write_text(text.replace("HERE", HUGE))
    for command in (["report"], ["regress", "accept"]):
        assert words in line_of(capsys, *command, tmp_path)


def test_a_head_of_another_schema_or_of_none_is_refused(tmp_path, capsys):
    (tmp_path / "run.json").write_text('{"schema": "replay.run/9"}')
    assert "schema is 'replay.run/9', expected 'replay.run/1'" in line_of(capsys, "report", tmp_path)
    (tmp_path / "run.json").write_text("{}")
    assert "schema is missing" in line_of(capsys, "report", tmp_path)


@pytest.mark.parametrize("key", ["objective", "iterations", "defect"])
def test_a_baseline_with_a_number_of_four_hundred_digits_names_the_field(tmp_path, capsys, key):
    corpus = tmp_path / "corpus"
    corpus.mkdir()
    (corpus / "bay_01.mcap").write_bytes(b"never read")
    logs = {"bay_01": {"cases": {"0": {"ddp": {key: "HERE"}}}}}
    write(corpus / "baseline.json", {"schema": "replay.baseline/1", "logs": logs}, HUGE)
    error = line_of(capsys, "regress", corpus, "--out", tmp_path / "runs")
    assert f"logs.bay_01.cases.0.ddp.{key} is a number of 401 digits" in error
    assert not (tmp_path / "runs").exists()


@pytest.mark.parametrize(
    ("text", "words"),
    [
        (f"[logs.bay_01]\nexpect = {HUGE}\n", "logs.bay_01.expect is a number of 401 digits, expected a text"),
        ("[logs.bay_01]\ntags = [1e400]\n", "logs.bay_01.tags[0]"),
        ("methods = []\nmethods = []\n", "not TOML"),
        ("a = " + "[" * 5000, "corpus.toml: "),
        ("a = " + "9" * 5000, "corpus.toml: "),
    ],
)
def test_a_list_that_is_wrong_is_one_line_that_names_the_field(tmp_path, capsys, text, words):
    (tmp_path / "bay_01.mcap").write_bytes(b"never read")
    (tmp_path / "corpus.toml").write_text(text)
    assert words in line_of(capsys, "regress", tmp_path)


def test_numbers_among_the_notes_of_a_list_may_be_anything(tmp_path, capsys):
    (tmp_path / "bay_01.mcap").write_bytes(b"never read")
    (tmp_path / "corpus.toml").write_text(f"[logs.bay_01]\nlength_m = {HUGE}\n")
    assert "--tag" not in line_of(capsys, "regress", tmp_path, "--tag", "nonsense")


@pytest.mark.parametrize("number", [HUGE, "1e400", "NaN"])
def test_results_verdicts_and_times_that_are_wrong_are_left_out_and_named(tmp_path, number):
    run = maker.write_run(tmp_path / "run", maker.logs(3))
    entry = maker.log("open_00", 0)
    entry["cases"][0]["methods"][1]["audit"]["checks"]["defect"]["values"]["position_m"] = "HERE"
    write(run / "logs" / "00000.json", entry, number)
    verdict = maker.verdict("open_00", "scp", "objective", "worse", "HERE")
    write(run / "verdicts.json", {"schema": "replay.verdicts/1", "verdicts": [verdict]}, number)
    ratio = {"ratio": "HERE", "pairs": 3, "alarm": False}
    write(run / "timing.json", {"schema": "replay.timing/1", "against": "a", "compared": {"scp": ratio}}, number)
    made = make_report(run)
    assert [line.partition(":")[0] for line in made.run.damaged] == [
        "logs/00000.json",
        "run/verdicts.json",
        "run/timing.json",
    ]
    assert all("\n" not in line and len(line) < 300 for line in made.run.damaged)
    assert {row.log for row in made.run.rows} == {"narrow_01", "cusps_02"}


def test_a_summary_that_is_wrong_is_made_up_for_by_the_results(tmp_path):
    past = maker.write_run(tmp_path / "2026-03-01", maker.logs(3))
    here = maker.write_run(tmp_path / "2026-03-02", maker.logs(3))
    make_report(past)
    expected = trend(read_run(here), tmp_path)
    summary = json.loads((past / "summary.json").read_text())
    summary["trend"]["ratio"]["scp"] = "HERE"
    write(past / "summary.json", summary, HUGE)
    assert trend(read_run(here), tmp_path) == expected
