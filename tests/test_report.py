"""What a regression run amounts to, and its page; nothing in its files can make it say something else."""

import json
import math
import xml.etree.ElementTree as ET

import pyarrow.parquet as pq
import pytest
import run_maker as maker
from page_reading import Page

from replay.base.style import styles
from replay.report import make_report
from replay.report.facts import cost_ratio, figures, headline, profiles, state
from replay.report.groups import gravest, groups
from replay.report.html import page
from replay.report.run_files import read_run

HOSTILE = "<img src=x onerror=alert(1)>\"'\x1b[2J\u202e|`[x](javascript:alert(1)) @all ]]>\ud800"


# ---- the verdict


def test_a_run_fails_by_what_is_worse_crashed_or_missing_and_by_nothing_else(tmp_path):
    for i, (verdict, expected) in enumerate(
        {
            "worse": "failed",
            "changed": "failed",
            "crashed": "failed",
            "missing": "failed",
            "known": "passed",
            "better": "passed",
        }.items()
    ):
        run = maker.write_run(tmp_path / str(i), maker.logs(1), [maker.verdict("open_00", "scp", "objective", verdict)])
        assert state(read_run(run)) == expected


def test_without_a_baseline_unfinished_and_empty_are_told_apart(tmp_path):
    new = [maker.verdict("open_00", "scp", "objective", "new", None, 1.0)]
    assert state(read_run(maker.write_run(tmp_path / "a", maker.logs(1), new))) == "unjudged"
    assert state(read_run(maker.write_run(tmp_path / "b", []))) == "empty"
    unfinished = read_run(maker.write_run(tmp_path / "c", maker.logs(3), corpus={"num_logs": 70}, complete=False))
    assert state(unfinished) == "unfinished"
    assert headline(unfinished) == "Unfinished: 3 of 70 logs done; no regression so far"


def test_what_got_worse_is_put_together_by_class_and_told_with_its_size(failed_run):
    run = read_run(failed_run)
    assert headline(run) == "Regression: 1 result crashed, 2 results worse; 3 of 8 logs affected"
    found = {(g.verdict, g.method, g.kind): g for g in groups(run)}
    worse = found["worse", "scp", "narrow"]
    assert len(worse.changes) == 2
    assert worse.median == pytest.approx(0.005)
    assert "scp: objective worse on 2 cases of class narrow, by +0.50 % at the median" in worse.sentence


def test_logs_whose_file_changed_are_reported_one_by_one_in_every_report(tmp_path):
    found = maker.logs(8)
    notes = [
        f"{name}: the log file changed since the baseline; 5 results not compared"
        for name in ("narrow_01", "narrow_05")
    ]
    verdicts = maker.unchanged(found[2:])
    for name, note in zip(("narrow_01", "narrow_05"), notes, strict=True):
        verdicts.append(maker.verdict(name, "", "sha256", "changed", "0a", "0b", case="", note=note))
    run = maker.write_run(tmp_path / "run", found, verdicts)
    made = make_report(run)
    assert made.summary.headline == "Regression: 2 logs changed; 2 of 8 logs affected"
    assert [group.sentence for group in gravest(groups(made.run))] == notes
    junit = ET.parse(run / "junit.xml").getroot()
    assert [failure.get("message") for failure in junit.iter("failure")] == notes
    summary = (run / "summary.json").read_text()
    for note, escaped in zip(notes, [note.replace("_", "\\_") for note in notes], strict=True):
        assert note in Page((run / "report.html").read_text()).text
        assert f"**{escaped}**" in (run / "report.md").read_text()
        assert note in summary


def test_other_options_than_the_baseline_s_stand_in_every_report(tmp_path):
    found = maker.logs(1)
    words = "the baseline was made with other options: weights.cusp 1 (baseline: 5)"
    run = maker.write_run(tmp_path / "run", found, maker.unchanged(found), other_options=words, partial="methods scp")
    make_report(run)
    for name in ("report.html", "report.md", "junit.xml", "summary.json"):
        assert words in (run / name).read_text()


def test_a_run_that_is_slower_for_certain_fails_in_every_report(tmp_path):
    found = maker.logs(3)
    run = maker.write_run(tmp_path / "run", found, maker.unchanged(found))
    compared = {
        "scp": {"ratio": 1.2, "low": 1.1, "high": 1.3, "pairs": 3, "alarm": True},
        "all": {"ratio": 1.2, "low": None, "high": None, "pairs": 2, "alarm": False},
    }
    document = {"schema": "replay.timing/1", "against": "v1.2", "ratios": {}, "compared": compared}
    (run / "timing.json").write_text(json.dumps(document))
    made = make_report(run)
    assert made.summary.state == "failed"
    assert made.summary.headline == "Regression: slower than v1.2: scp"
    assert [each.slower for each in made.summary.timing] == [True, False]
    root = ET.parse(run / "junit.xml").getroot()
    assert (root.get("failures"), len(root.findall("testsuite[@name='timing']/testcase"))) == ("1", 2)
    for name in ("report.html", "report.md"):
        text = (run / name).read_text()
        for words in ("slower than v1.2", "1.100 to 1.300", "✗ slower", "too few logs"):
            assert words in text
        assert maker.COMMANDS["accept"] not in text  # times are in no baseline


def test_figures_follow_from_the_rows(passed_run):
    run = read_run(passed_run)
    rows = [row for row in run.rows if row.method == "scp"]
    found = figures(rows)
    product = 1.0
    for row in rows:
        product *= cost_ratio(row) or math.nan
    assert found.ratio == pytest.approx(product ** (1 / 8))
    assert (found.results, found.improved, found.kept, found.failed) == (8, 8, 0, 0)
    assert min(ratios[0] for ratios in profiles(run).values()) == 1.0
    assert all(len(ratios) == 8 for ratios in profiles(run).values())


# ---- the page


def test_the_page_is_well_formed_and_says_what_got_worse_before_all_else(failed_run):
    made = make_report(failed_run)
    read = Page((failed_run / "report.html").read_text())
    text = read.text
    assert text.index(made.summary.headline) < text.index("What changed") < text.index("Methods")
    assert maker.COMMANDS["accept"] in text
    assert maker.COMMANDS["view"] in text
    run = read_run(failed_run)
    worst = next(c for c in run.changes if c.verdict == "worse")
    assert f"{worst.before:.8g}" in text
    assert f"{worst.after:.8g}" in text
    assert {a["href"] for a in read.attributes("a")} == {"./recordings/narrow_01.rrd", "./recordings/narrow_05.rrd"}


def test_the_page_fetches_nothing_and_its_policy_forbids_it(failed_run):
    make_report(failed_run)
    text = (failed_run / "report.html").read_text()
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


def test_curves_have_the_colours_of_the_recordings(passed_run):
    make_report(passed_run)
    text = (passed_run / "report.html").read_text()
    for style in styles(maker.METHODS).values():
        assert f"rgb({style.colour[0]} {style.colour[1]} {style.colour[2]})" in text


@pytest.mark.parametrize("recording", ["javascript:alert(1).rrd", "../../secret.rrd"])
def test_hostile_names_stay_text_in_every_report(tmp_path, recording):
    entry = maker.log(HOSTILE, 1, [HOSTILE, "scp"], tags=[HOSTILE])
    entry["class"] = HOSTILE
    entry["cases"][0]["recording"] = recording
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
