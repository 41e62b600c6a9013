"""What the page, the trend and the Parquet rows show of a run, and what they leave out."""

import pathlib

import pyarrow.parquet as pq
import run_maker as maker
from page_reading import Page

from replay.report import make_report
from replay.report.charts import drift_chart
from replay.report.history import trend
from replay.report.html import page
from replay.report.run_files import read_run


def text_of(folder: pathlib.Path) -> str:
    run = read_run(folder)
    return Page(page(run, trend(run, folder.parent))).text


def test_a_first_run_gives_the_command_that_makes_it_the_baseline(tmp_path):
    assert f"To make this run the baseline: {maker.COMMANDS['accept']}" in text_of(
        maker.write_run(tmp_path / "run", maker.logs(2))
    )


def test_options_are_shown_one_by_one(tmp_path):
    options = {"seed": 0, "methods": {"cpo": {"d_max": 2.5, "name": None}, "a+b": [["a", {"b": True}]]}}
    text = text_of(maker.write_run(tmp_path / "run", maker.logs(2), options=options))
    assert "methods.cpo.d_max 2.5" in text
    assert "methods.cpo.name none" in text
    assert '[["a", {"b": true}]]' in text


def test_columns_that_say_nothing_are_left_out(tmp_path):
    plain = [entry | {"class": "", "tags": []} for entry in maker.logs(3)]
    text = text_of(maker.write_run(tmp_path / "run", plain, maker.unchanged(plain)))
    assert "Class" not in text
    assert "Tags" not in text
    assert "Tags" in text_of(maker.write_run(tmp_path / "other", maker.logs(3), maker.unchanged(maker.logs(3))))


def test_the_traceback_of_a_crash_is_on_the_page(tmp_path):
    found = maker.logs(2)
    method = found[0]["cases"][0]["methods"][0]
    method |= {"status": "failed", "traceback": 'Traceback:\n  File "x.py", line 7\n\x1b[31mboom'}
    crash = maker.verdict("open_00", method["name"], "status", "crashed", "improved", "failed")
    text = text_of(maker.write_run(tmp_path / "run", found, [crash]))
    assert 'File "x.py", line 7 \\x1b[31mboom' in text


def test_a_method_keeps_its_dashes_whatever_else_ran(tmp_path):
    def dashes(*methods: str) -> str:
        found = [maker.log("open_00", 0, methods)]
        run = read_run(maker.write_run(tmp_path / "-".join(methods), found, methods=list(methods)))
        rule = page(run, []).partition(f"\n.m{methods.index('ddp')} {{")[2]
        return rule.partition("stroke-dasharray: ")[2].partition(";")[0]

    assert dashes("ddp") == dashes("shortcut", "cpo", "ddp") == dashes("mine", "ddp")


def test_the_trend_is_of_one_corpus_and_tells_runs_of_one_day_apart(tmp_path):
    for number, corpus in enumerate(("mine", "another", "mine")):
        folder = tmp_path / f"2026-03-14T0{number}-00-00Z_a"
        about = {"created": f"2026-03-14T0{number}:30:00Z", "corpus": {"path": corpus, "num_logs": 3}}
        maker.write_run(folder, maker.logs(3), **about)
        if number < 2:
            make_report(folder)
    points = trend(read_run(tmp_path / "2026-03-14T02-00-00Z_a"), tmp_path)
    assert [point.created[11:16] for point in points] == ["00:30", "02:30"]
    chart = drift_chart(points)
    assert chart is not None
    assert [label for _, label in chart.x_ticks] == ["00:30", "02:30"]
    assert "2026-03-14" in chart.x_label


def test_rows_name_run_and_what_failed_and_hold_what_is_missing_or_unread(tmp_path):
    bad = maker.log("odd_01", 1, error={"code": "E_NO_MAP", "message": "no map"}, cases=[])
    found = maker.logs(2)
    gone = maker.verdict("gone_01", "", "log", "missing", "there", None, case="")
    worse = maker.verdict("open_00", "ddp", "objective", "worse", 50.0, 60.0)
    folder = maker.write_run(tmp_path / "run", [*found, bad], [gone, worse])
    make_report(folder)
    table = pq.read_table(folder / "rows.parquet")
    rows = table.to_pylist()
    assert {row["run"] for row in rows} == {"run"}
    assert {row["revision"] for row in rows} == {"84f303a"}
    assert [(row["log"], row["status"]) for row in rows[-2:]] == [("odd_01", "unread"), ("gone_01", "missing")]
    (row,) = (row for row in rows if row["failing"] and row["method"])
    assert (row["failing"], row["baseline_objective"]) == (["objective"], 50.0)
    assert rows[-1]["failing"] == ["log"]


def test_a_place_along_the_path_is_in_metres(tmp_path):
    found = maker.logs(1)
    found[0]["cases"][0]["methods"][0]["audit"]["checks"]["defect"]["place"] = {"segment": 0, "s": 3.0}
    make_report(maker.write_run(tmp_path / "run", found))
    schema = pq.read_table(tmp_path / "run" / "rows.parquet").schema
    (name,) = (name for name in schema.names if name.endswith("place.s"))
    assert schema.field(name).metadata == {b"unit": b"m"}
