"""The baseline: what it holds, what is taken over into it, with what it cannot be compared."""

import subprocess

import pytest
from msgspec.structs import replace
from run_maker import typed
from test_regress_gate import log, method

from replay.base.documents import convert
from replay.base.errors import ReplayError
from replay.base.schemas.baseline import BASELINE_SCHEMA, Baseline
from replay.base.schemas.corpus import Known
from replay.base.schemas.run import RUN_SCHEMA, OptionsDocument, RunHead
from replay.regress.acceptance import Selection, accepted
from replay.regress.baseline import EMPTY, check_baseline, read_baseline, write_baseline
from replay.regress.compare import baseline_entry, compare_log
from replay.regress.options import other_options, uncompared
from replay.regress.program import revision


def baseline(*logs, names=(), **about) -> Baseline:
    """A baseline of some logs, by their names or others."""
    entries = {
        name: baseline_entry(typed(entry)) for name, entry in zip(names or [e["log"] for e in logs], logs, strict=True)
    }
    return Baseline(schema=BASELINE_SCHEMA, logs=entries, **about)


def head(**about) -> RunHead:
    return RunHead(schema=RUN_SCHEMA, **about)


def test_options_other_than_the_baseline_s_are_named_and_objective_is_not_compared_with_other_weights(tmp_path):
    def options(methods, **weights):
        found = {"ddp": {"spacing": 0.4}, "scp": {"rounds": 3}, "shortcut": {"tries": 20}}
        found = {"methods": {m: found[m] for m in methods}, "weights": {"cusp": 5.0, "steer": 0.5} | weights}
        return convert({"seed": 0} | found, OptionsDocument)

    made = head(options=options(("ddp", "scp")), options_fingerprint="x", created="now")
    write_baseline(tmp_path / "b.json", accepted(EMPTY, [typed(log())], made).baseline)
    before = read_baseline(tmp_path / "b.json")
    assert other_options(before, options(("ddp",))) == ""
    assert other_options(before, options(("ddp", "shortcut"))) == ""
    assert not uncompared(before, options(("ddp",)))
    other = replace(options((), cusp=500.0), methods={"ddp": {"spacing": 0.5}})
    words = "ddp.spacing 0.5 (baseline: 0.4), weights.cusp 500.0 (baseline: 5.0); the weights differ"
    assert words in other_options(before, other)
    after = log()
    method(after)["metrics"]["objective"] *= 8.0
    found = compare_log(typed(after), before.logs["bay_01"], without=uncompared(before, other))
    assert {entry.verdict for entry in found} == {"same"}
    unknown = baseline(log(), options_fingerprint="x")
    assert other_options(unknown, other, "y").endswith("it does not say which")
    many = replace(options(("ddp",)), read={f"o{i}": 1 for i in range(9)})
    before = baseline(log(), options=replace(many, read={f"o{i}": 2 for i in range(9)}))
    assert "o0 1 (baseline: 2)" in other_options(before, many)
    assert other_options(before, many).endswith("and 4 more")


def test_accepting_keeps_the_figures_of_what_is_known():
    issue = Known(log="bay_*", method="scp", key="objective")
    after = log()
    for name in ("ddp", "scp"):
        method(after, name)["metrics"]["objective"] *= 1.1
    done = accepted(baseline(log()), [typed(after)], head(created="now", known=(issue,)))
    figures = done.baseline.logs["bay_01"].cases["0"]
    assert figures["scp"].objective == method(log())["metrics"]["objective"]
    assert figures["ddp"].objective == method(after, "ddp")["metrics"]["objective"]
    assert {(change.method, change.verdict) for change in done.changes} == {("ddp", "worse"), ("scp", "known")}


def test_a_run_like_the_baseline_changes_nothing():
    done = accepted(baseline(log()), [typed(log())], head())
    assert (done.changes, done.lost) == ([], [])
    assert done.baseline.logs == baseline(log()).logs


def some_accepted(selection: Selection, **more):
    """Two logs on which both methods changed, and one of the baseline that the run has not got."""
    names = ("bay_01", "bay_02")
    before = baseline(*(log(name) for name in (*names, "gone")), created="then")
    runs = [log(name, **more) for name in names]
    for entry in runs:
        for name in ("ddp", "scp"):
            method(entry, name)["metrics"]["objective"] *= 1.1
    done = accepted(before, map(typed, runs), head(created="now"), selection)
    taken = {
        (name, which)
        for name, entry in done.baseline.logs.items()
        for which, figures in entry.cases["0"].items()
        if figures != before.logs[name].cases["0"][which]
    }
    return done, taken


@pytest.mark.parametrize(
    ("selection", "expected", "kept"),
    [
        (Selection(logs=["*_01"]), {("bay_01", "ddp"), ("bay_01", "scp")}, 4),
        (Selection(methods=["scp"]), {("bay_01", "scp"), ("bay_02", "scp")}, 3),
        (Selection(logs=["bay_01", "x"], methods=["scp"]), {("bay_01", "scp")}, 5),
    ],
)
def test_some_results_are_taken_over_and_the_others_stay(selection, expected, kept):
    done, taken = some_accepted(selection)
    assert (taken, done.kept, done.baseline.created) == (expected, kept, "then")
    assert {(change.log, change.method) for change in done.changes} == expected
    assert "gone" in done.baseline.logs
    everything, taken = some_accepted(Selection())
    assert (len(taken), everything.kept, everything.baseline.created) == (4, 0, "now")
    assert "gone" not in everything.baseline.logs


def test_what_cannot_be_taken_over_is_refused():
    with pytest.raises(ReplayError, match=r"no result for --only x --method scp"):
        some_accepted(Selection(logs=["x"], methods=["scp"]))
    with pytest.raises(ReplayError, match="accept it with all its methods"):
        some_accepted(Selection(methods=["scp"]), sha256="f" * 64)
    assert len(some_accepted(Selection(logs=["bay_01"]), sha256="f" * 64)[1]) == 2
    assert "gone" not in some_accepted(Selection(logs=["gone"]))[0].baseline.logs


# ---- the file


def test_a_baseline_comes_back_as_it_was_written(tmp_path):
    names = ["bay_01", "ö/\ud800\n"]
    about = {"created": "now", "revision": "abc", "options_fingerprint": "x"}
    made = baseline(log(), log(), names=names, **about)
    write_baseline(tmp_path / "b.json", made)
    assert read_baseline(tmp_path / "b.json") == made
    write_baseline(tmp_path / "c.json", replace(made, logs=dict(reversed(made.logs.items()))))
    assert (tmp_path / "b.json").read_text() == (tmp_path / "c.json").read_text()


@pytest.mark.parametrize(
    "text",
    [
        "",
        "[]",
        '{"schema": "replay.baseline/2"}',
        '{"schema": "replay.baseline/1"}',
        '{"schema": "replay.baseline/1", "logs": {"a": 1}}',
        '{"schema": "replay.baseline/1", "logs": {"a": {"cases": {"0": 1}}}}',
        '{"schema": "replay.baseline/1", "logs": {"a": {"sha256": 1, "cases": {}}}}',
        '{"schema": "replay.baseline/1", "logs": {"a": {"cases": {"0": {"ddp": {"objective": "abc"}}}}}}',
        '{"schema": "replay.baseline/1", "logs": {"a": {"cases": {"0": {"ddp": {"cusps": true}}}}}}',
        '{"schema": "replay.baseline/1", "logs": {"a": {"cases": {"0": {"ddp": {"status": 1}}}}}}',
    ],
)
def test_what_is_no_baseline_is_one_line(tmp_path, text):
    (tmp_path / "b.json").write_text(text)
    with pytest.raises(ReplayError, match=r"b\.json"):
        read_baseline(tmp_path / "b.json")


def test_which_schema_was_found_and_what_to_do_is_told(tmp_path):
    (tmp_path / "b.json").write_text('{"schema": "replay.baseline/9"}')
    words = r"schema is 'replay\.baseline/9', expected 'replay\.baseline/1'; .*move the file away, and make it again"
    with pytest.raises(ReplayError, match=words):
        read_baseline(tmp_path / "b.json")


def test_a_baseline_of_quite_another_corpus_is_refused(tmp_path):
    names = ("a", "sub/c")
    file = tmp_path / "b.json"
    write_baseline(file, baseline(log(), log(), names=("x", "y")))
    with pytest.raises(ReplayError, match="none of its 2 logs is in"):
        check_baseline(file, "some", names)
    write_baseline(file, baseline(log(), log(), names=("x", "sub/c")))
    check_baseline(file, "some", names)
    check_baseline(tmp_path / "none.json", "some", names)


def test_two_changed_trees_of_one_commit_have_two_names(tmp_path):
    def git(*words: str) -> None:
        subprocess.run(["git", *words], cwd=tmp_path, check=True, capture_output=True)

    (tmp_path / "optim").mkdir()
    (tmp_path / "optim" / "a.py").write_text("1")
    (tmp_path / "README.md").write_text("1")
    git("init", "-q")
    git("add", ".")
    git("-c", "user.name=a", "-c", "user.email=a@example.org", "commit", "-q", "-m", "first")
    clean = revision(tmp_path)
    assert len(clean) == 12
    names = {clean}
    for text in ("2", "3", "2"):
        (tmp_path / "optim" / "a.py").write_text(text)
        names.add(revision(tmp_path))
    assert len(names) == 3
    assert all(name == clean or name.startswith(f"{clean}-dirty-") for name in names)
    (tmp_path / "optim" / "a.py").write_text("1")
    (tmp_path / "README.md").write_text("2")
    assert revision(tmp_path) == f"{clean}-dirty"
    git("checkout", "-q", "README.md")
    names = {revision(tmp_path)}
    for text in ("1", "2"):
        (tmp_path / "optim" / "new.py").write_text(text)
        names.add(revision(tmp_path))
    assert len(names) == 3, "a file that is not tracked is part of the program"
    (tmp_path / "optim" / "new.py").unlink()
    (tmp_path / "notes.txt").write_text("no part of it")
    assert revision(tmp_path) == clean
