"""The reports for programs, the trend over earlier runs, damaged runs, and the command."""

import json
import xml.etree.ElementTree as ET
from typing import Any

import pyarrow.parquet as pq
import pytest
import run_maker as maker
from page_reading import Page

import replay.cli
from replay.base.errors import ReplayError
from replay.base.schemas.run import Commands
from replay.regress.finish import judge_and_report
from replay.report import FILES, make_report
from replay.report.charts import drift_chart
from replay.report.history import trend
from replay.report.html import page
from replay.report.junit import junit
from replay.report.markdown import markdown
from replay.report.run_files import read_run

# ---- the other formats


def test_junit_has_one_case_for_each_result_and_failures_name_what_decided(failed_run):
    root = ET.fromstring(junit(read_run(failed_run)))
    assert root.tag == "testsuites"
    cases = root.findall("testsuite/testcase")
    assert len(cases) == 8 * len(maker.METHODS)
    for suite in root:
        assert suite.tag == "testsuite"
        assert {"name", "tests", "failures", "errors", "skipped", "time"} <= set(suite.attrib)
        tests = suite.findall("testcase")
        assert int(suite.attrib["tests"]) == len(tests)
        for tag, key in (("failure", "failures"), ("error", "errors"), ("skipped", "skipped")):
            assert int(suite.attrib[key]) == len(suite.findall(f"testcase/{tag}"))
    for case in cases:
        assert {"classname", "name", "time"} <= set(case.attrib)
        assert len(case) <= 1
    assert len({(case.get("classname"), case.get("name")) for case in cases}) == len(cases)
    (failure, _) = root.findall("testsuite[@name='scp']/testcase/failure")
    assert failure.text is not None
    before = 0.661 * 1.06 * 87.3  # as run_maker makes it
    figures_told = f"before {before:.9g}, after {1.005 * before:.9g}"
    for word in ("objective", figures_told, "tolerance 0.1 %", "recordings/narrow_01.rrd"):
        assert word in failure.text
    assert root.get("failures") == "2"
    assert root.get("errors") == "1"
    assert root.get("skipped") == "1"


def test_junit_counts_results_that_are_missing_and_logs_that_cannot_be_read(tmp_path):
    bad = maker.log("odd_01", 1, error={"code": "E_NO_MAP", "message": "odd_01.mcap: no map"}, cases=[])
    refused = maker.log("odd_02", 2, error={"code": "E_CUT", "message": "odd_02.mcap: cut"}, expect="E_CUT", cases=[])
    gone = maker.verdict("open_99", "scp", "", "missing", None, None)
    run = read_run(maker.write_run(tmp_path / "run", [bad, refused], [gone]))
    root = ET.fromstring(junit(run))
    assert root.get("tests") == "3"
    assert (root.get("failures"), root.get("errors")) == ("1", "1")
    assert [e.get("message") for e in root.iter("error")] == ["odd_01.mcap: no map [E_NO_MAP]"]


def test_a_log_that_the_baseline_could_not_read_either_is_known_and_of_another_the_cure_is_told(tmp_path):
    error = {"code": "E_NO_MAP", "message": "no map"}
    found = [maker.log(name, 1, error=error, cases=[], path=f"site/{name}.mcap") for name in ("old", "new.1", "was")]
    verdicts = [
        maker.verdict(entry["log"], "", "error", verdict, case="")
        for entry, verdict in zip(found, ("same", "new", "worse"), strict=True)
    ]
    run = maker.write_run(tmp_path / "run", found, verdicts)
    made = make_report(run)
    cure = 'if this is expected, add to site/corpus.toml: [logs."new.1"] expect = "E_NO_MAP"'
    told = {error.log: (error.expected, error.cure) for error in made.run.errors}
    assert told == {"old": (True, ""), "new.1": (False, cure), "was": (False, "")}
    assert cure in Page((run / "report.html").read_text()).text
    assert replay.cli.main(["report", str(maker.write_run(tmp_path / "other", found[:1], verdicts[:1]))]) == 0


def test_recordings_that_could_not_be_written_are_told(tmp_path):
    (entry,) = maker.logs(1)
    entry["cases"][0] |= {"recording": None, "recording_error": "the disk is full"}
    run = maker.write_run(tmp_path / "run", [entry], [maker.verdict("open_00", "scp", "cusps", "worse", 1.0, 2.0)])
    make_report(run)
    assert "**1 recording could not be written:** the disk is full" in (run / "report.md").read_text()
    assert "could not be written: the disk is full" in (run / "junit.xml").read_text()
    assert "not written" in Page((run / "report.html").read_text()).text
    assert judge_and_report(run, tmp_path, Commands()).unwritten == "1 recording could not be written: the disk is full"


def test_logs_of_one_content_are_told_once(tmp_path):
    found = [maker.log(name, 1) for name in ("a", "b")] + [maker.log("c", 2)]
    run = maker.write_run(tmp_path / "run", found, maker.unchanged(found))
    assert judge_and_report(run, tmp_path, Commands()).equal == "logs with the same content: a = b"


def test_markdown_is_short_and_has_the_facts(failed_run):
    text = markdown(read_run(failed_run))
    lines = text.splitlines()
    assert lines[0] == "### ✗ Regression: 1 result crashed, 2 results worse; 3 of 8 logs affected"
    assert f"`{maker.COMMANDS['accept']}`" in lines[-1]
    assert any(line.startswith("| ▼ worse | scp | objective | narrow | 2 | +0.50 % |") for line in lines)
    assert any(line.startswith("| ✗ crashed | nlp | status | open | 1 |  | open\\_04/0 |") for line in lines)
    assert len(lines) < 40


def test_where_there_is_no_baseline_nothing_is_listed_as_changed(tmp_path):
    new = [maker.verdict("open_00", "scp", "objective", "new", None, 1.0)]
    run = read_run(maker.write_run(tmp_path / "first", maker.logs(1), new))
    assert "no baseline" in markdown(run)
    assert "new" not in markdown(run)
    assert "What changed" not in page(run, [])


def test_parquet_has_typed_columns_with_units(failed_run):
    make_report(failed_run)
    table = pq.read_table(failed_run / "rows.parquet")
    run = read_run(failed_run)
    assert table.num_rows == len(run.rows) == 40
    schema = table.schema
    assert schema.field("length").metadata == {b"unit": b"m"}
    assert schema.field("wall_s").metadata == {b"unit": b"s"}
    assert str(schema.field("cusps").type) == "int64"
    assert str(schema.field("objective").type) == "double"
    assert schema.metadata[b"revision"] == b"84f303a"
    rows = table.to_pylist()
    worse = [row for row in rows if row["regressed"]]
    assert {(row["log"], row["method"]) for row in worse} == {
        ("narrow_01", "scp"),
        ("narrow_05", "scp"),
        ("open_04", "nlp"),
    }
    assert rows[0]["objective"] == run.rows[0].result.metrics.objective
    assert rows[0]["work.iterations"] == 12


def test_a_clearance_without_obstacles_is_null_not_a_number(tmp_path):
    entry = maker.log("open_00", 0, ["scp"])
    entry["cases"][0]["methods"][0]["metrics"]["min_clearance"] = None
    run = maker.write_run(tmp_path / "run", [entry])
    make_report(run)
    assert pq.read_table(run / "rows.parquet").to_pylist()[0]["min_clearance"] is None
    Page((run / "report.html").read_text())


@pytest.mark.parametrize("key", ["cusps", "objective"])
def test_a_number_that_no_column_can_hold_is_named_as_damage(tmp_path, key):
    entry = maker.log("open_00", 0, ["scp"])
    entry["cases"][0]["methods"][0]["metrics"][key] = 10**400
    made = make_report(maker.write_run(tmp_path / "run", [entry, *maker.logs(2)]))
    (line,) = made.run.damaged
    assert line.startswith(f"logs/00000.json: cases[0].methods[0].metrics.{key} is a number of 401 digits")
    assert len(made.run.rows) == 10


# ---- files that are damaged or missing


def test_damaged_files_are_left_out_and_named(passed_run):
    (passed_run / "logs" / "00003.json").write_bytes(b'{"schema": "replay.run.log/1", "log": ')
    (passed_run / "logs" / "00004.json").write_text(json.dumps({"schema": "replay.run.log/9"}))
    (passed_run / "logs" / "00005.json").write_text(
        json.dumps({"schema": "replay.run.log/1", "log": "x", "cases": [{"case": "x/0", "recorded": [], "methods": 3}]})
    )
    run = read_run(passed_run)
    assert [line.split(":")[0] for line in run.damaged] == [f"logs/0000{i}.json" for i in (3, 4, 5)]
    assert len(run.logs) == 5
    assert "3 files of this run cannot be read" in Page(page(run, [])).text


@pytest.mark.parametrize(
    "content", [None, "", "[]", '{"schema": "other/1"}', '{"schema": "replay.run/1", "created": 3}']
)
def test_a_folder_without_a_run_is_refused_in_one_line(tmp_path, content):
    if content is not None:
        (tmp_path / "run.json").write_text(content)
    with pytest.raises(ReplayError, match=r"run\.json: .*\[E_RUN\]") as refused:
        read_run(tmp_path)
    assert "\n" not in str(refused.value)


# ---- the trend


def test_the_trend_holds_whole_runs_up_to_this_one_and_marks_other_logs(tmp_path):
    runs = tmp_path / "runs"
    heads: list[tuple[int, int, dict[str, Any]]] = [
        (1, 8, {}),
        (2, 8, {"complete": False}),
        (3, 8, {"partial": "class narrow"}),
        (4, 6, {}),
    ]
    for day, count, head in heads:
        maker.write_run(runs / f"2026-03-0{day}T02-00-00Z_a", maker.logs(count), **head)
    for day in (1, 3):  # the others have no summary
        make_report(runs / f"2026-03-0{day}T02-00-00Z_a")
    here = maker.write_run(runs / "2026-03-05T02-00-00Z_a", maker.logs(6))
    later = maker.write_run(runs / "2026-03-06T02-00-00Z_a", maker.logs(6))
    points = trend(read_run(here), runs)
    assert [point.name[:10] for point in points] == ["2026-03-01", "2026-03-04", "2026-03-05"]
    assert len(trend(read_run(later), runs)) == 4
    chart = drift_chart(points)
    assert chart is not None
    assert len(chart.breaks) == 1
    assert all(len(line.pieces) == 2 for line in chart.lines)


def test_the_trend_is_the_same_from_summaries_and_from_results(tmp_path):
    runs = tmp_path / "runs"
    past = maker.write_run(runs / "2026-03-01T02-00-00Z_a", maker.logs())
    here = maker.write_run(runs / "2026-03-02T02-00-00Z_a", maker.logs())
    without = trend(read_run(here), runs)
    make_report(past)
    assert trend(read_run(here), runs) == without


# ---- the command


@pytest.fixture
def call(capsys):
    def run(*arguments: object) -> tuple[int, str, str]:
        capsys.readouterr()
        status = replay.cli.main([str(argument) for argument in arguments])
        said = capsys.readouterr()
        return status, said.out, said.err

    return run


def test_the_command_writes_every_report_and_its_status_is_the_runs(call, failed_run, passed_run):
    status, out, err = call("report", failed_run)
    assert status == 1
    assert "Regression: 1 result crashed" in out
    assert not err
    assert all((failed_run / name).is_file() for name in FILES)
    assert not [path for path in failed_run.iterdir() if path.name.startswith(".")]
    assert call("report", passed_run)[0] == 0


def test_reports_made_again_are_the_same_with_the_command_that_accepts(call, failed_run):
    make_report(failed_run)
    before = {name: (failed_run / name).read_bytes() for name in FILES}
    call("report", failed_run)
    assert {name: (failed_run / name).read_bytes() for name in FILES} == before
    assert maker.COMMANDS["accept"] in (failed_run / "report.md").read_text()


def test_an_unfinished_run_is_reported_and_called_so(call, tmp_path):
    run = maker.write_run(tmp_path / "run", maker.logs(3), corpus={"path": "recordings", "num_logs": 9}, complete=False)
    status, out, err = call("report", run)
    assert status == 3
    assert "Unfinished: 3 of 9 logs done" in out
    assert "unfinished" in err
    assert "has not come to its end" in Page((run / "report.html").read_text()).text
    assert "**Unfinished:**" in (run / "report.md").read_text()


def test_the_command_gives_the_summary_as_json(call, failed_run):
    status, out, _ = call("report", failed_run, "--json")
    document = json.loads(out)
    assert document["exit_status"] == status == 1
    assert document["summary"] == json.loads((failed_run / "summary.json").read_text())
    assert document["summary"]["verdicts"] == {"crashed": 1, "worse": 2, "known": 1, "same": 40}


def test_a_log_that_could_not_be_read_unexpectedly_is_another_status(call, tmp_path):
    bad = maker.log("odd_01", 1, error={"code": "E_NO_MAP", "message": "odd_01.mcap: no map"}, cases=[])
    found = maker.logs(1)
    run = maker.write_run(tmp_path / "a", [*found, bad], maker.unchanged(found))
    assert call("report", run)[0] == 3
    expected = maker.write_run(tmp_path / "b", [*found, bad | {"expect": "E_NO_MAP"}], maker.unchanged(found))
    assert call("report", expected)[0] == 0
    another = maker.write_run(tmp_path / "c", [*found, bad | {"expect": "E_CUT"}], maker.unchanged(found))
    assert call("report", another)[0] == 3


def test_no_run_is_one_line_and_status_2(call, tmp_path):
    for place in (tmp_path, tmp_path / "absent", __file__):
        status, out, err = call("report", place)
        assert status == 2
        assert not out
        assert err.count("\n") == 1


def test_reports_that_cannot_be_written_are_one_line(call, passed_run):
    (passed_run / "report.html").mkdir()
    status, _, err = call("report", passed_run)
    assert status == 1
    assert "report.html" in err
    assert err.count("\n") == 1
