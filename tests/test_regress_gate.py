"""What counts as worse, which logs a corpus has, what a run keeps in files."""

import errno
import io
import json
import os
import pathlib

import pytest
import run_maker as maker
from rich.console import Console

from replay.errors import ReplayError
from replay.regress.bar import Bar
from replay.regress.compare import baseline_entry, compare_log, gone
from replay.regress.corpus import Known, find_corpus
from replay.regress.gate import Metric, metrics_of
from replay.regress.selection import select
from replay.regress.store import Store, file_stem
from replay.regress.work import Outcome


def log(name: str = "bay_01", **more):
    entry = maker.log(name, 1, ["ddp", "scp"], **more)
    for method in [m for case in entry["cases"] for m in case["methods"]]:
        method["audit"] = {"passed": True, "checks": {}}
    return entry


def method(entry, which: str = "scp"):
    return next(m for m in entry["cases"][0]["methods"] if m["name"] == which)


def found(entry, before, *verdicts: str, known=(), **more):
    entries = compare_log(entry, baseline_entry(before) if before else None, known, **more)
    return [(e["method"], e["key"], e["verdict"]) for e in entries if e["verdict"] in verdicts]


FAILING = ("worse", "crashed", "missing")


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
    metric = Metric(key="k", value=after, unit="-", direction=direction, rel_tol=0.001)
    assert metric.verdict(before) == expected


def test_statuses_are_ordered_and_a_passed_audit_is_better_than_none():
    def status(value):
        return Metric(key="status", value=value, unit="-", direction="higher")

    def audit(value):
        return Metric(key="audit", value=value, unit="-", direction="higher")

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
    entry = method(after)
    place = entry["work"] if key in entry["work"] else (entry if key == "wall_s" else entry["metrics"])
    place[key] *= value
    told = found(after, before, "worse", "better")
    assert told == ([] if expected == "same" else [("scp", key, expected)])


def test_clearance_beyond_what_is_enough_is_not_compared():
    before, after = log(), log()
    method(before)["metrics"]["min_clearance"] = None  # nothing is near
    method(after)["metrics"]["min_clearance"] = 0.7
    assert found(after, before, *FAILING, "better") == []


def test_every_metric_of_a_sound_result_has_a_value():
    assert {m.key for m in metrics_of(method(log())) if m.value is None} == {"defect", "defect_sum"}


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


def test_a_log_with_other_content_is_compared_with_nothing_and_is_told_once():
    after = log(sha256="f" * 64)
    method(after)["metrics"]["objective"] *= 2.0
    (entry,) = compare_log(after, baseline_entry(log()))
    assert (entry["verdict"], entry["after"]) == ("changed", "f" * 12)
    assert entry["note"] == "bay_01 is another log than the baseline's: 2 results not compared"
    method(after)["status"] = "failed"
    assert found(after, log(), *FAILING) == [("scp", "status", "crashed")]


# ---- known issues


def test_a_known_issue_does_not_fail_and_is_told_when_it_has_gone():
    issue = Known(log="bay_*", method="scp", key="objective", note="slow start")
    after = log()
    method(after)["metrics"]["objective"] *= 1.1
    before = baseline_entry(log())
    entries = compare_log(after, before, [issue])
    assert [(e["verdict"], e["note"]) for e in entries if e["verdict"] == "known"] == [("known", "slow start")]
    assert not [e for e in entries if e["verdict"] in FAILING]
    assert gone([issue], entries) == []
    (passing,) = gone([issue], compare_log(log(), before, [issue]))
    assert passing["verdict"] == "better"
    assert "passes" in passing["note"]
    assert gone([issue], compare_log(log("dock_01"), baseline_entry(log("dock_01")), [issue])) == []


def test_a_known_issue_has_not_gone_where_its_method_did_not_run_to_its_end():
    issue = Known(log="bay_01", method="scp", key="objective")
    before = baseline_entry(log())
    without, failed, other, same = log(), log(), log(sha256="f" * 64), log()
    without["cases"][0]["methods"].pop()
    method(failed)["status"] = "failed"
    unread = log(error={"code": "E_NOT_FOUND", "message": "none"}, cases=[])
    for entry in (without, failed, other, unread):
        assert gone([issue], compare_log(entry, before, [issue], whole=False)) == []
    assert gone([issue], compare_log(same, before, [issue]), partial=True)
    pattern = Known(log="bay_*", method="scp", key="objective")
    assert gone([pattern], compare_log(same, before, [pattern]), partial=True) == []


# ---- files


def test_names_of_logs_become_names_of_files_that_never_meet_and_are_never_hidden(tmp_path):
    names = ["a/b", "a%2Fb", ".a", "..", "a" * 300, "a" * 299 + "b", "\ud800", "\n", "ä" * 90]
    stems = [file_stem(name) for name in names]
    assert len(set(stems)) == len(names)
    assert all("/" not in stem and not stem.startswith(".") and len(stem) <= 200 for stem in stems)
    store = Store(tmp_path)
    store.make()
    for name in names:
        assert store.publish({"log": name, "schema": "replay.run.log/1"})
        assert not store.publish({"log": name, "schema": "replay.run.log/1"})
    assert len(store.done()) == len(names)
    assert not [path for path in store.logs.iterdir() if path.suffix == ".tmp"]


# ---- corpora


@pytest.fixture
def corpus(tmp_path) -> pathlib.Path:
    for name in ("a.mcap", "b.mcap", "sub/c.mcap", "sub/deep/d.mcap", ".hidden/e.mcap", "notes.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "corpus.toml").write_text(
        '[logs.a]\nclass = "bay"\nexpect = "kept"\ntags = ["grid"]\nmethods = ["ddp"]\nseed = 7\n[logs.gone]\n'
    )
    (tmp_path / "sub" / "corpus.toml").write_text('methods = ["scp"]\n[[known]]\nlog = "c"\nnote = "why"\n')
    return tmp_path


def test_a_folder_is_a_corpus_with_all_below_it_and_what_its_lists_say(corpus):
    made = find_corpus(str(corpus))
    assert [log.name for log in made.logs] == ["a", "b", "gone", "sub/c", "sub/deep/d"]
    a, _, lost, c, d = made.logs
    assert (a.kind, a.expect, a.tags, a.methods) == ("bay", "kept", ("grid",), ("ddp",))
    assert lost.path == str(corpus / "gone.mcap")
    assert (c.methods, d.methods) == (("scp",), ())
    (issue,) = made.known
    assert issue.covers("sub/c", "scp", "objective")
    assert not issue.covers("c", "scp", "objective")


def test_a_glob_a_list_and_a_single_log_are_corpora_too(corpus):
    assert [log.name for log in find_corpus(str(corpus / "**" / "*.mcap")).logs] == ["a", "b", "sub/c", "sub/deep/d"]
    (corpus / "list.txt").write_text("# some\n\nsub/c.mcap\na.mcap\n")
    listed = find_corpus(str(corpus / "list.txt"))
    assert [(log.name, log.kind) for log in listed.logs] == [("a", "bay"), ("sub/c", "")]
    assert [log.name for log in find_corpus(str(corpus / "a.mcap")).logs] == ["a"]
    (corpus / "list.txt").write_text("hi\n")
    with pytest.raises(ReplayError, match=r"none of its lines \(1\) is the path of a file"):
        find_corpus(str(corpus / "list.txt"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[logs.a]\nclass = 3", "logs.a.class is a int"),
        ("[logs]\na = 3", "logs.a is a int"),
        ("methods = [3]", "methods holds what is no text"),
        ("[[known]]\nnote = 'x'", "has no log"),
        ("[[known]]\nlog = 'x'\nmethods = 'x'", "known.methods"),
        ("schema = 'other/1'", "schema is"),
        ("[logs", "not TOML"),
    ],
)
def test_a_list_that_is_wrong_is_one_line_that_says_where(corpus, text, words):
    (corpus / "corpus.toml").write_text(text)
    with pytest.raises(ReplayError, match=r"corpus\.toml") as caught:
        find_corpus(str(corpus))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_corpus_is_one_line_that_names_the_choices(tmp_path):
    for where in ("nowhere", str(tmp_path), str(tmp_path / "*.mcap")):
        with pytest.raises(ReplayError):
            find_corpus(where)


def test_logs_are_selected_by_method_tag_class_and_name(corpus):
    made = find_corpus(str(corpus))

    def names(**more):
        logs, words = select(made, **({"methods": (), "tags": (), "patterns": ()} | more))
        return [log.name for log in logs], words

    assert names() == (["a", "b", "gone", "sub/c", "sub/deep/d"], "")
    assert names(methods=["ddp"]) == (["a", "b", "gone", "sub/deep/d"], "methods ddp")
    assert names(tags=["grid"])[0] == names(tags=["bay"])[0] == ["a"]
    assert names(patterns=["sub/*"]) == (["sub/c", "sub/deep/d"], "logs sub/*")
    with pytest.raises(ReplayError, match="there are: bay, grid"):
        names(tags=["nonsense"])
    (corpus / "corpus.toml").unlink()
    with pytest.raises(ReplayError, match=r"none, corpus\.toml gives them"):
        select(find_corpus(str(corpus)), (), ("nonsense",), ())


def test_results_are_plain_json(tmp_path):
    store = Store(tmp_path)
    store.make()
    store.publish({"log": "a", "schema": "replay.run.log/1", "x": float("inf"), "y": (1, 2)})
    assert json.loads(store.file("a").read_text()) == {"log": "a", "schema": "replay.run.log/1", "x": None, "y": [1, 2]}


def test_a_folder_that_cannot_keep_a_name_is_told_and_one_that_never_does_so_is_no_error(tmp_path, monkeypatch):
    store = Store(tmp_path)
    store.make()

    def failing(number: int):
        def sync(descriptor: int) -> None:
            if os.readlink(f"/proc/self/fd/{descriptor}") == str(store.logs):  # noqa: PTH115 - of a descriptor
                raise OSError(number, os.strerror(number))

        return sync

    monkeypatch.setattr(os, "fsync", failing(errno.ENOTSUP))
    assert store.publish({"log": "a", "schema": "replay.run.log/1"})
    monkeypatch.setattr(os, "fsync", failing(errno.EIO))
    with pytest.raises(ReplayError, match="Input/output error"):
        store.publish({"log": "b", "schema": "replay.run.log/1"})


# ---- progress


def test_progress_says_rate_remaining_time_and_what_has_failed(monkeypatch):
    now = [0.0]
    monkeypatch.setattr("time.monotonic", lambda: now[0])
    bar = Bar(Console(file=io.StringIO()), enabled=False)
    bar.outcome(None, 40, 100)  # resumed: what was done before says nothing of the rate
    assert bar.words(40, 100) == "starting; no failure"
    now[0] = 30.0
    for state in ("same", "crashed", "worse", "worse", "skipped"):
        bar.outcome(Outcome(name="a", state=state), 45, 100)
    assert bar.words(50, 100) == "20 logs/min, 2 min 30 s left; 1 crashed, 2 worse"
    now[0] = 36000.0
    assert bar.words(41, 100) == "0.00167 logs/min, 590 h 00 min left; 1 crashed, 2 worse"
