"""Regression runs with real processes: what is planted is found and named, what is unchanged passes."""

import os
import pathlib
import signal
from collections.abc import Iterator

import planted
import pytest
import regress_help as help

from optim.methods import METHODS
from replay.base.errors import ReplayError
from replay.base.schemas.run import Commands
from replay.cli import main
from replay.regress.finish import finish
from replay.regress.plan import Execute, carry_out, remaining, resumed, start
from replay.regress.supervisor import Supervisor

BAY = tuple(help.LENGTHS.values())
DOCK = (118.65,)
DDP = METHODS["ddp"]


@pytest.fixture(scope="module")
def warm() -> Iterator[Execute]:
    """One process for the logs of all runs that need none of their own."""
    with Supervisor() as supervisor:
        yield help.through(supervisor)


@pytest.fixture(scope="module")
def corpus(tmp_path_factory, warm) -> str:
    """Three logs of two classes, with the baseline of the unchanged method under the name that faults go by."""
    folder = help.make_corpus(tmp_path_factory.mktemp("corpora") / "some")
    runs = tmp_path_factory.mktemp("runs")
    run, found = help.run(help.make_plan(folder, {"ddp": DDP}), runs, warm)
    assert found.state == "unjudged"
    assert main(["regress", "accept", str(run.path), "--quiet"]) == 0
    return folder


@pytest.fixture
def runs(tmp_path) -> pathlib.Path:
    return tmp_path / "runs"


# ---- what is planted is found


def test_a_method_that_is_half_a_percent_worse_on_one_class_is_found_and_named(corpus, runs, warm):
    run, found = help.run(help.make_plan(corpus, {"ddp": planted.Worse(lengths=BAY, factor=2.7)}), runs, warm)
    assert found.state == "failed"
    worse = [entry for entry in help.verdicts(run, "worse") if entry.key == "objective"]
    assert {entry.log for entry in worse} == {"bay_01", "bay_02"}
    ratios = [float(entry.after or 0.0) / float(entry.before or 0.0) for entry in worse]
    assert all(0.003 < ratio - 1.0 < 0.007 for ratio in ratios)
    assert any("ddp: objective worse on 2 cases of class bay" in line for line in found.failing)
    assert not [entry for entry in help.verdicts(run, "worse", "crashed") if entry.log == "dock_01"]


def test_a_loosened_margin_is_found_although_the_audit_still_passes(corpus, runs, warm):
    run, found = help.run(help.make_plan(corpus, {"ddp": planted.Loose(by=0.02)}, recordings="changed"), runs, warm)
    assert found.state == "failed"
    worse = [entry for entry in help.verdicts(run, "worse") if entry.key == "status"]
    assert {entry.log for entry in worse} == {"bay_01", "bay_02", "dock_01"}
    assert {(entry.before, entry.after) for entry in worse} == {("improved", "kept")}
    written = {path.stem for path in (run.path / "recordings").iterdir()}
    assert written == {"bay_01%2F0", "bay_02%2F0", "dock_01%2F0"}
    assert "recordings/bay_01%252F0.rrd" in (run.path / "report.html").read_text()


def test_a_method_that_kills_its_process_on_one_log_costs_that_result_alone(corpus, runs, warm):
    run, found = help.run(help.make_plan(corpus, {"scp": DDP, "ddp": planted.Crashes(lengths=DOCK)}), runs, warm)
    assert found.state == "failed"
    (crash,) = help.verdicts(run, "crashed")
    assert (crash.log, crash.method, crash.note) == ("dock_01", "ddp", "its process was ended by SIGSEGV")
    assert any("ddp on dock_01/0 crashed" in line for line in found.failing)
    assert not help.verdicts(run, "worse", "missing")
    assert {entry.method for entry in help.verdicts(run, "new")} == {"scp"}


@pytest.mark.slow
def test_a_log_that_kills_its_process_costs_its_own_row(runs, tmp_path, warm):
    folder = help.make_corpus(tmp_path / "corpus", more='[logs.dock_02]\nmethods = ["poison"]\n')
    (tmp_path / "corpus" / "dock_02.mcap").write_bytes(b"never read")
    list_file = tmp_path / "corpus" / "corpus.toml"
    list_file.write_text(list_file.read_text().replace('expect = "improved"', 'methods = ["ddp"]'))
    run, found = help.run(help.make_plan(folder, {"ddp": DDP, "poison": planted.Poison()}), runs, warm)
    (crash,) = help.verdicts(run, "crashed")
    assert (crash.log, crash.after) == ("dock_02", "E_CRASHED")
    assert "SIGKILL" in crash.note
    assert sum(len(case.methods) for log in run.documents() for case in log.cases) == 3
    assert found.state == "failed"


@pytest.mark.slow
def test_the_unchanged_program_passes_every_time_in_any_order_and_gives_the_same(corpus, runs, warm):
    first = None
    for number in range(5):
        plan = help.make_plan(corpus, {"ddp": DDP}, shuffle=number)
        run, found = help.run(plan, runs, help.here(2) if number == 1 else warm)
        assert found.state == "passed"
        assert not help.verdicts(run, "worse", "better", "crashed", "missing", "new", "known")
        documents = help.results(run)
        first = first or documents
        assert documents == first
    assert len(list(runs.iterdir())) == 5


# ---- killed, interrupted, resumed


def test_a_run_that_was_broken_off_is_resumed_with_exactly_the_rest(corpus, runs, warm):
    plan = help.make_plan(corpus, {"ddp": DDP})
    run = start(plan, runs)
    carry_out(plan, run, warm, lambda *_: None)
    done = run.done()
    assert len(done) == 3
    run.file("bay_02").unlink()
    (run.logs / ".left.tmp").touch()
    assert [log.name for log in remaining(plan, run)] == ["bay_02"]
    run.file("bay_01").write_text("{torn")
    assert [log.name for log in remaining(plan, run)] == ["bay_02", "bay_01"]
    rest = resumed(plan, runs)
    assert rest.path == run.path
    carry_out(plan, rest, warm, lambda *_: None)
    assert rest.done() == done
    assert not (run.logs / ".left.tmp").exists()
    assert help.attempts(rest).count("dock_01") == 1
    assert finish(rest.path, runs, Commands()).state == "passed"
    with pytest.raises(ReplayError, match="no unfinished run"):
        resumed(plan, runs)


@pytest.mark.slow
def test_killing_the_process_of_the_logs_costs_none_of_them(corpus, runs):
    plan = help.make_plan(corpus, {"ddp": DDP})
    run = start(plan, runs)
    killed: list[int] = []

    def kill_once(outcome, *_: object) -> None:
        if outcome is not None and not killed:
            killed.append(help.below(os.getpid())[0])
            os.kill(killed[0], signal.SIGKILL)

    with Supervisor() as supervisor:
        carry_out(plan, run, help.through(supervisor), kill_once)
    assert killed
    documents = list(run.documents())
    assert len(documents) == 3
    assert not [document for document in documents if document.error]


def test_results_that_cannot_be_written_end_the_run_with_one_line(corpus, runs, warm):
    plan = help.make_plan(corpus, {"ddp": DDP})
    run = start(plan, runs)
    run.logs.rmdir()
    run.logs.write_text("no folder")
    with pytest.raises(ReplayError, match="logs"):
        carry_out(plan, run, warm, lambda *_: None)
