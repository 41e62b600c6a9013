"""What the reports of a regression run say, and that nothing in a run's files can make them say something else."""

import json
import pathlib
import xml.etree.ElementTree as ET
from html.parser import HTMLParser

import pyarrow.parquet as pq
import pytest
import run_maker as maker

import replay.cli
from replay.errors import ReplayError
from replay.regress.reports import FILES, make_report
from replay.regress.reports.facts import figures, headline, profiles, state
from replay.regress.reports.groups import groups
from replay.regress.reports.html import page
from replay.regress.reports.junit import junit
from replay.regress.reports.markdown import markdown
from replay.regress.reports.reading import read_run
from replay.style import styles

HOSTILE = "<img src=x onerror=alert(1)>\"'\x1b[2J\u202e|`[x](javascript:alert(1)) @all ]]>\ud800"
VOID = {"meta", "br", "input", "img", "link"}


class Page(HTMLParser):
    """A page read back: its elements must be closed in order."""

    def __init__(self, text: str) -> None:
        super().__init__()
        self.open: list[str] = []
        self.seen: list[tuple[str, dict[str, str | None]]] = []
        self.texts: list[str] = []
        self.feed(text)
        self.close()
        assert not self.open

    def handle_starttag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        assert len({name for name, _ in attrs}) == len(attrs), f"an attribute of {tag} is there twice"
        self.seen.append((tag, dict(attrs)))
        if tag not in VOID:
            self.open.append(tag)

    def handle_startendtag(self, tag: str, attrs: list[tuple[str, str | None]]) -> None:
        self.seen.append((tag, dict(attrs)))

    def handle_endtag(self, tag: str) -> None:
        assert self.open, f"</{tag}> closes nothing"
        assert self.open.pop() == tag

    def handle_data(self, data: str) -> None:
        if self.open and self.open[-1] not in ("style", "script"):
            self.texts.append(data)

    def attributes(self, tag: str) -> list[dict[str, str | None]]:
        return [found for name, found in self.seen if name == tag]

    @property
    def text(self) -> str:
        return " ".join(" ".join(self.texts).split())


def logs(count: int = 8) -> list[dict]:
    return [maker.log(f"{maker.CLASSES[i % 4]}_{i:02d}", i) for i in range(count)]


def regressed(folder: pathlib.Path) -> pathlib.Path:
    """A run in which scp is 0.5 % worse on both narrow logs, one method crashed, and one issue is known."""
    found = logs()
    verdicts = maker.unchanged(found)
    for entry in (found[1], found[5]):
        (scp,) = (m for m in entry["cases"][0]["methods"] if m["name"] == "scp")
        before = scp["metrics"]["objective"]
        scp["metrics"]["objective"] = 1.005 * before
        scp["recording"] = f"recordings/{entry['log']}.rrd"
        verdicts.append(maker.verdict(entry["log"], "scp", "objective", "worse", before, 1.005 * before))
    crash = maker.verdict(found[4]["log"], "nlp", "status", "crashed", "improved", "failed", rel_tol=None, abs_tol=None)
    verdicts.append(crash)
    verdicts.append(maker.verdict(found[3]["log"], "cpo", "cusps", "known", 1.0, 2.0, note="being looked at"))
    run = maker.write_run(folder, found, verdicts)
    for entry in (found[1], found[5]):
        (run / "recordings" / f"{entry['log']}.rrd").write_bytes(b"made by the test")
    return run


@pytest.fixture
def failed(tmp_path: pathlib.Path) -> pathlib.Path:
    return regressed(tmp_path / "runs" / "2026-03-14T02-00-00Z_84f303a")


@pytest.fixture
def passed(tmp_path: pathlib.Path) -> pathlib.Path:
    found = logs()
    return maker.write_run(tmp_path / "runs" / "2026-03-13T02-00-00Z_84f3039", found, maker.unchanged(found))


# ---- the verdict


def test_a_run_fails_by_what_is_worse_crashed_or_missing_and_by_nothing_else(tmp_path):
    for i, (verdict, expected) in enumerate(
        {"worse": "failed", "crashed": "failed", "missing": "failed", "known": "passed", "better": "passed"}.items()
    ):
        run = maker.write_run(tmp_path / str(i), logs(1), [maker.verdict("open_00", "scp", "objective", verdict)])
        assert state(read_run(run)) == expected


def test_without_a_baseline_unfinished_and_empty_are_told_apart(tmp_path):
    new = [maker.verdict("open_00", "scp", "objective", "new", None, 1.0)]
    assert state(read_run(maker.write_run(tmp_path / "a", logs(1), new))) == "unjudged"
    assert state(read_run(maker.write_run(tmp_path / "b", []))) == "empty"
    unfinished = read_run(maker.write_run(tmp_path / "c", logs(3), corpus={"num_logs": 70}, complete=False))
    assert state(unfinished) == "unfinished"
    assert headline(unfinished) == "Unfinished: 3 of 70 logs done; no regression so far"


def test_what_got_worse_is_put_together_by_class_and_told_with_its_size(failed):
    run = read_run(failed)
    assert headline(run) == "Regression: 1 result crashed, 2 results worse; 3 of 8 logs affected"
    found = {(g.verdict, g.method, g.kind): g for g in groups(run)}
    worse = found["worse", "scp", "narrow"]
    assert len(worse.changes) == 2
    assert worse.median == pytest.approx(0.005)
    assert "scp: objective worse on 2 cases of class narrow, by +0.50 % at the median" in worse.sentence


def test_figures_follow_from_the_rows(passed):
    run = read_run(passed)
    rows = [row for row in run.rows if row.method == "scp"]
    found = figures(rows)
    product = 1.0
    for row in rows:
        product *= row.metrics["objective"] / row.recorded["objective"]
    assert found.ratio == pytest.approx(product ** (1 / 8))
    assert (found.results, found.improved, found.kept, found.failed) == (8, 8, 0, 0)
    assert min(ratios[0] for ratios in profiles(run).values()) == 1.0
    assert all(len(ratios) == 8 for ratios in profiles(run).values())


# ---- the page


def test_the_page_is_well_formed_and_says_what_got_worse_before_all_else(failed):
    made = make_report(failed, accept="replay regress accept RUN")
    read = Page((failed / "report.html").read_text())
    text = read.text
    assert text.index(str(made.summary["headline"])) < text.index("What changed") < text.index("Methods")
    assert "replay regress accept RUN" in text
    run = read_run(failed)
    worst = next(c for c in run.changes if c.verdict == "worse")
    assert f"{worst.before:.8g}" in text
    assert f"{worst.after:.8g}" in text
    assert {a["href"] for a in read.attributes("a")} == {"./recordings/narrow_01.rrd", "./recordings/narrow_05.rrd"}


def test_the_page_fetches_nothing_and_its_policy_forbids_it(failed):
    make_report(failed)
    text = (failed / "report.html").read_text()
    read = Page(text)
    policy = next(m["content"] for m in read.attributes("meta") if m.get("http-equiv") == "Content-Security-Policy")
    assert policy is not None
    assert "default-src 'none'" in policy
    assert "unsafe" not in policy
    assert policy.count("sha256-") == 2
    assert not [name for name, _ in read.seen if name in ("link", "img", "iframe", "object", "base", "form")]
    assert not [found for _, found in read.seen if {"src", "style", "action"} & set(found)]
    assert not [key for _, found in read.seen for key in found if key.startswith("on")]
    assert "http://" not in text
    assert "https://" not in text


def test_curves_have_the_colours_of_the_recordings(passed):
    make_report(passed)
    text = (passed / "report.html").read_text()
    for style in styles(maker.METHODS).values():
        assert f"rgb({style.colour[0]} {style.colour[1]} {style.colour[2]})" in text


def test_hostile_names_stay_text_in_every_report(tmp_path):
    entry = maker.log(HOSTILE, 1, [HOSTILE, "scp"], tags=[HOSTILE])
    entry["class"] = HOSTILE
    entry["cases"][0]["methods"][0]["recording"] = "javascript:alert(1).rrd"
    entry["cases"][0]["methods"][1]["recording"] = "../../secret.rrd"
    verdicts = [maker.verdict(HOSTILE, HOSTILE, HOSTILE, "worse", 1.0, 2.0, note=HOSTILE, unit=HOSTILE)]
    run = maker.write_run(tmp_path / "run", [entry], verdicts, revision=HOSTILE, corpus={"path": HOSTILE})
    make_report(run)
    read = Page((run / "report.html").read_text())
    assert not read.attributes("img")
    assert not read.attributes("a")
    assert "<img src=x onerror=alert(1)>" in read.text
    for name in ("report.html", "report.md", "junit.xml", "summary.json"):
        text = (run / name).read_text()
        assert not [c for c in text if not c.isprintable() and c not in "\n\u200b"]
    ET.parse(run / "junit.xml")
    text = (run / "report.md").read_text()
    assert "<img" not in text
    assert "@all" not in text
    assert "\\[x\\]" in text
    assert all(line.count("|") - line.count("\\|") == 11 for line in text.splitlines() if line.startswith("| ▼"))
    assert pq.read_table(run / "rows.parquet").num_rows == 2


def test_a_page_of_thousands_of_cases_stays_small_and_says_what_it_leaves_out(tmp_path):
    found = [maker.log(f"log_{i:04d}", i, ["scp"]) for i in range(1500)]
    verdicts = [maker.verdict(entry["log"], "scp", "objective", "worse", 1.0, 1.1) for entry in found]
    run = read_run(maker.write_run(tmp_path / "run", found, verdicts))
    text = page(run, [])
    assert len(text) < 2_000_000
    read = Page(text)
    assert "The first 500; 1000 more are in verdicts.json" in read.text
    assert "The first 1000 of 1500 cases" in read.text


# ---- the other formats


def test_junit_has_one_case_for_each_result_and_failures_name_what_decided(failed):
    root = ET.fromstring(junit(read_run(failed)))
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
    bad = maker.log("odd_01", 1, error="odd_01.mcap: no map [E_NO_MAP]", cases=[])
    refused = maker.log("odd_02", 2, error="odd_02.mcap: cut [E_CUT]", expect="refused", cases=[])
    gone = maker.verdict("open_99", "scp", "", "missing", None, None)
    run = read_run(maker.write_run(tmp_path / "run", [bad, refused], [gone]))
    root = ET.fromstring(junit(run))
    assert root.get("tests") == "3"
    assert (root.get("failures"), root.get("errors")) == ("1", "1")
    assert [e.get("message") for e in root.iter("error")] == ["odd_01.mcap: no map [E_NO_MAP]"]


def test_markdown_is_short_and_has_the_facts(failed):
    text = markdown(read_run(failed), accept="replay regress accept RUN")
    lines = text.splitlines()
    assert lines[0] == "### ✗ Regression: 1 result crashed, 2 results worse; 3 of 8 logs affected"
    assert "`replay regress accept RUN`" in lines[-1]
    assert any(line.startswith("| ▼ worse | scp | objective | narrow | 2 | +0.50 % |") for line in lines)
    assert any(line.startswith("| ✗ crashed | nlp | status | open | 1 |  | open\\_04/0 |") for line in lines)
    assert len(lines) < 40


def test_parquet_has_typed_columns_with_units(failed):
    make_report(failed)
    table = pq.read_table(failed / "rows.parquet")
    run = read_run(failed)
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
    assert rows[0]["objective"] == run.rows[0].metrics["objective"]
    assert rows[0]["work.iterations"] == 12


def test_a_clearance_without_obstacles_is_null_not_a_number(tmp_path):
    entry = maker.log("open_00", 0, ["scp"])
    entry["cases"][0]["methods"][0]["metrics"]["min_clearance"] = None
    run = maker.write_run(tmp_path / "run", [entry])
    make_report(run)
    assert pq.read_table(run / "rows.parquet").to_pylist()[0]["min_clearance"] is None
    Page((run / "report.html").read_text())


# ---- files that are damaged or missing


def test_damaged_files_are_left_out_and_named(passed):
    (passed / "logs" / "00003.json").write_bytes(b'{"schema": "replay.run.log/1", "log": ')
    (passed / "logs" / "00004.json").write_text(json.dumps({"schema": "replay.run.log/9"}))
    (passed / "logs" / "00005.json").write_text(
        json.dumps({"schema": "replay.run.log/1", "log": "x", "cases": [{"case": "x/0", "recorded": [], "methods": 3}]})
    )
    run = read_run(passed)
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
    from replay.regress.reports.charts import drift_chart
    from replay.regress.reports.history import trend

    runs = tmp_path / "runs"
    for day, count, head in ((1, 8, {}), (2, 8, {"complete": False}), (3, 8, {"partial": "class narrow"}), (4, 6, {})):
        maker.write_run(runs / f"2026-03-0{day}T02-00-00Z_a", logs(count), **head)
    make_report(runs / "2026-03-01T02-00-00Z_a")
    here = maker.write_run(runs / "2026-03-05T02-00-00Z_a", logs(6))
    later = maker.write_run(runs / "2026-03-06T02-00-00Z_a", logs(6))
    points = trend(read_run(here), runs)
    assert [point.name[:10] for point in points] == ["2026-03-01", "2026-03-04", "2026-03-05"]
    assert len(trend(read_run(later), runs)) == 4
    chart = drift_chart(points)
    assert chart is not None
    assert len(chart.breaks) == 1
    assert all(len(line.pieces) == 2 for line in chart.lines)


def test_the_trend_is_the_same_from_summaries_and_from_results(tmp_path):
    from replay.regress.reports.history import trend

    runs = tmp_path / "runs"
    past = maker.write_run(runs / "2026-03-01T02-00-00Z_a", logs())
    here = maker.write_run(runs / "2026-03-02T02-00-00Z_a", logs())
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


def test_the_command_writes_every_report_and_its_status_is_the_runs(call, failed, passed):
    status, out, err = call("report", failed)
    assert status == 1
    assert "Regression: 1 result crashed" in out
    assert not err
    assert all((failed / name).is_file() for name in FILES)
    assert not [path for path in failed.iterdir() if path.name.startswith(".")]
    assert call("report", passed)[0] == 0


def test_an_unfinished_run_is_reported_and_called_so(call, tmp_path):
    run = maker.write_run(tmp_path / "run", logs(3), corpus={"path": "recordings", "num_logs": 9}, complete=False)
    status, out, err = call("report", run)
    assert status == 3
    assert "Unfinished: 3 of 9 logs done" in out
    assert "unfinished" in err
    assert "has not come to its end" in Page((run / "report.html").read_text()).text
    assert "**Unfinished:**" in (run / "report.md").read_text()


def test_the_command_gives_the_summary_as_json(call, failed):
    status, out, _ = call("report", failed, "--json")
    document = json.loads(out)
    assert document["exit_status"] == status == 1
    assert document["summary"] == json.loads((failed / "summary.json").read_text())
    assert document["summary"]["verdicts"] == {"crashed": 1, "worse": 2, "known": 1, "same": 40}


def test_a_log_that_could_not_be_read_unexpectedly_is_another_status(call, tmp_path):
    bad = maker.log("odd_01", 1, error="odd_01.mcap: no map [E_NO_MAP]", cases=[])
    found = logs(1)
    run = maker.write_run(tmp_path / "a", [*found, bad], maker.unchanged(found))
    assert call("report", run)[0] == 3
    expected = maker.write_run(tmp_path / "b", [*found, bad | {"expect": "refused"}], maker.unchanged(found))
    assert call("report", expected)[0] == 0


def test_no_run_is_one_line_and_status_2(call, tmp_path):
    for place in (tmp_path, tmp_path / "absent", __file__):
        status, out, err = call("report", place)
        assert status == 2
        assert not out
        assert err.count("\n") == 1


def test_reports_that_cannot_be_written_are_one_line(call, passed):
    (passed / "report.html").mkdir()
    status, _, err = call("report", passed)
    assert status == 1
    assert "report.html" in err
    assert err.count("\n") == 1
