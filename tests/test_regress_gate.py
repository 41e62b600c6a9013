"""What counts as worse, what a baseline keeps, what is said on the way."""

import io
import pathlib

import pytest
import run_maker as maker
from rich.console import Console

from replay.base.documents import plain
from replay.base.schemas.corpus import Known
from replay.cli.regress_progress import RunProgress
from replay.regress.baseline import read_baseline
from replay.regress.compare import baseline_entry, compare_log, gone
from replay.regress.gate import Figure, figures_of
from replay.regress.job import Outcome


def log(name: str = "bay_01", **more):
    return maker.log(name, 1, ["ddp", "scp"], **more)


def method(entry, which: str = "scp"):
    return next(m for m in entry["cases"][0]["methods"] if m["name"] == which)


def found(entry, before, *verdicts: str, known=(), **more):
    compared = compare(entry, before, known, **more)
    return [(each.method, each.key, each.verdict) for each in compared if each.verdict in verdicts]


def compare(entry, before, known=(), **more):
    figures = baseline_entry(maker.typed(before)) if before else None
    return compare_log(maker.typed(entry), figures, known, **more)


FAILING = ("worse", "crashed", "missing")
RECORDINGS = pathlib.Path(__file__).parent.parent / "recordings"


# ---- single metrics


@pytest.mark.parametrize(
    ("direction", "before", "after", "expected"),
    [
        ("lower", 100.0, 100.1, "same"),
        ("lower", 100.0, 100.11, "worse"),
        ("lower", 100.0, 99.8, "better"),
        ("higher", 100.0, 99.8, "worse"),
        ("higher", 100.0, 100.2, "better"),
        ("exact", 100.0, 99.8, "worse"),
        ("exact", 100.0, 100.05, "same"),
        ("lower", None, 1.0, "new"),
        ("lower", 1.0, None, "worse"),
    ],
)
def test_a_metric_is_judged_by_its_direction_within_its_tolerance(direction, before, after, expected):
    figure = Figure(key="k", value=after, unit="-", direction=direction, rel_tol=0.001)
    assert figure.verdict(before) == expected


def test_statuses_are_ordered_and_a_passed_audit_is_better_than_none():
    def status(value):
        return Figure(key="status", value=value, unit="-", direction="higher")

    def audit(value):
        return Figure(key="audit", value=value, unit="-", direction="higher")

    assert status("kept").verdict("improved") == "worse"
    assert status("improved").verdict("kept") == "better"
    assert audit(False).verdict(True) == "worse"
    assert audit(True).verdict(False) == "better"


@pytest.mark.parametrize(
    ("key", "value", "expected"),
    [
        ("objective", 1.0009, "same"),
        ("objective", 1.005, "worse"),
        ("min_clearance", 0.98, "worse"),
        ("cusps", 2.0, "worse"),
        ("iterations", 1.005, "same"),
        ("iterations", 1.02, "worse"),
        ("wall_s", 10.0, "same"),
    ],
)
def test_correctness_is_tight_quality_loose_work_to_a_hundredth_and_time_free(key, value, expected):
    before, after = log(), log()
    for entry in (before, after):
        method(entry)["work"]["iterations"] = 1000
    entry = method(after)
    place = entry["work"] if key in entry["work"] else (entry if key == "wall_s" else entry["metrics"])
    place[key] = type(place[key])(place[key] * value)
    told = found(after, before, "worse", "better")
    assert told == ([] if expected == "same" else [("scp", key, expected)])


def test_clearance_beyond_what_is_enough_is_not_compared():
    before, after = log(), log()
    method(before)["metrics"]["min_clearance"] = None  # nothing is near
    method(after)["metrics"]["min_clearance"] = 0.7
    assert found(after, before, *FAILING, "better") == []


def test_every_metric_of_a_sound_result_has_a_value():
    result = maker.typed(log()).cases[0].methods[1]
    assert [figure.key for figure in figures_of(result) if figure.value is None] == []
    figures = plain(read_baseline(RECORDINGS / "baseline.json").logs["bay_01"].cases["0"]["scp"])
    assert figures.keys() == {figure.key for figure in figures_of(result)}
    assert [key for key, value in figures.items() if value is None] == []


# ---- logs


def test_a_method_that_fails_has_crashed_and_nothing_else_is_said_of_it():
    after = log()
    method(after).update(status="failed", reason="lost its way")
    assert found(after, log(), *FAILING) == [("scp", "status", "crashed")]
    assert found(after, None, *FAILING) == [("scp", "status", "crashed")]
    assert found(after, after, *FAILING) == []


def test_a_method_or_a_case_that_is_gone_is_missing_unless_it_was_not_asked_for():
    after = log()
    after["cases"][0]["methods"].pop()
    assert found(after, log(), *FAILING) == [("scp", "result", "missing")]
    assert found(after, log(), *FAILING, whole=False) == []
    nothing = log(cases=[], expect="")
    assert found(nothing, log(), *FAILING) == [("", "case", "missing")]


def test_a_log_that_cannot_be_read_is_judged_by_what_is_declared_and_by_what_was():
    broken = log(error={"code": "E_NO_MAP", "message": "no map"}, cases=[], expect="E_NO_MAP")
    assert found(broken, log(expect="")) == []
    assert found(broken | {"expect": ""}, log(), *FAILING) == [("", "error", "worse")]
    assert found(broken | {"expect": ""}, broken, *FAILING) == []
    assert found(broken | {"expect": ""}, None, *FAILING) == []
    assert found(broken | {"expect": "improved"}, None, *FAILING) == [("", "error", "worse")]
    crashed = broken | {"error": {"code": "E_CRASHED", "message": "SIGSEGV"}}
    assert found(crashed, None, *FAILING) == [("", "error", "crashed")]
    assert found(log(expect="E_NO_MAP"), None, *FAILING) == [("", "expect", "worse")]


def test_what_a_corpus_expects_is_held_without_a_baseline():
    kept = log()
    for entry in kept["cases"][0]["methods"]:
        entry["status"] = "kept"
    assert found(kept, None, *FAILING) == [("", "expect", "worse")]
    assert found(kept, None, *FAILING, whole=False) == []


def test_a_log_with_other_content_is_not_compared_and_is_reported_once():
    after = log(sha256="f" * 64)
    method(after)["metrics"]["objective"] *= 2.0
    (entry,) = compare(after, log())
    assert (entry.verdict, entry.after) == ("changed", "f" * 12)
    assert entry.note == "bay_01: the log file changed since the baseline; 2 results not compared"
    method(after)["status"] = "failed"
    assert found(after, log(), *FAILING) == [("scp", "status", "crashed")]


# ---- known issues


def test_a_known_issue_does_not_fail_and_is_reported_when_it_no_longer_shows():
    issue = Known(log="bay_*", method="scp", key="objective", note="slow start")
    after = log()
    method(after)["metrics"]["objective"] *= 1.1
    entries = compare(after, log(), [issue])
    assert [(e.verdict, e.note) for e in entries if e.verdict == "known"] == [("known", "slow start")]
    assert not [e for e in entries if e.verdict in FAILING]
    assert gone([issue], entries) == []
    (passing,) = gone([issue], compare(log(), log(), [issue]))
    assert passing.verdict == "better"
    assert "no longer shows" in passing.note
    assert gone([issue], compare(log("dock_01"), log("dock_01"), [issue])) == []


def test_a_known_issue_has_not_gone_where_its_method_did_not_run_to_its_end():
    issue = Known(log="bay_01", method="scp", key="objective")
    without, failed, other, same = log(), log(), log(sha256="f" * 64), log()
    without["cases"][0]["methods"].pop()
    method(failed)["status"] = "failed"
    unread = log(error={"code": "E_NOT_FOUND", "message": "none"}, cases=[])
    for entry in (without, failed, other, unread):
        assert gone([issue], compare(entry, log(), [issue], whole=False)) == []
    assert gone([issue], compare(same, log(), [issue]), partial=True)
    pattern = Known(log="bay_*", method="scp", key="objective")
    assert gone([pattern], compare(same, log(), [pattern]), partial=True) == []


# ---- progress


def test_progress_says_rate_remaining_time_and_what_has_failed(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    progress = RunProgress(Console(file=io.StringIO()), enabled=False)
    progress.outcome(None, 40, 100)  # resumed: what was done before says nothing of the rate
    assert progress.words(40, 100) == "starting; no failure"
    now[0] = 30.0
    for state in ("same", "crashed", "worse", "worse", "skipped"):
        progress.outcome(Outcome(name="a", state=state), 45, 100)
    assert progress.words(50, 100) == "20 logs/min, 2 min 30 s left; 1 crashed, 2 worse"
    now[0] = 36000.0
    assert progress.words(41, 100) == "0.00167 logs/min, 590 h 00 min left; 1 crashed, 2 worse"
