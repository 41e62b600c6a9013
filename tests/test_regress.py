"""Regression runs with real processes: what is planted is found and named, what is unchanged passes."""

import os
import pathlib
import shlex
import shutil
import signal
import subprocess
import sys
import time
from collections.abc import Iterator

import planted
import pytest
import regress_help as help

from optim.methods import METHODS
from replay.base.errors import ReplayError
from replay.base.schemas.baseline import BASELINE_SCHEMA, Baseline, LogFigures
from replay.base.schemas.run import Commands
from replay.cli import main
from replay.regress.baseline import read_baseline, write_baseline
from replay.regress.finish import finish
from replay.regress.plan import Execute, carry_out, remaining, resumed, start
from replay.regress.supervisor import Supervisor
from tools.processes import is_running

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
    assert all(0.003 < float(entry.after or 0.0) / float(entry.before or 0.0) - 1.0 < 0.007 for entry in worse)
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


# ---- the command


def test_a_failing_run_ends_with_the_command_that_accepts_and_accepting_makes_it_pass(tmp_path):
    folder = help.make_corpus(tmp_path / "corpus", ["bay_01"])
    arguments = ["regress", folder, "--method", "ddp", "--out", str(tmp_path / "runs")]
    listed = tmp_path / "corpus" / "corpus.toml"
    listed.write_text('methods = ["ddp"]\n' + listed.read_text())
    whole = [word for word in arguments if word not in ("--method", "ddp")]
    done = help.command(*whole)
    assert done.returncode == 0, done.stderr
    assert "no baseline" in done.stdout
    accept = done.stderr.strip().splitlines()[-1].partition("replay regress accept ")[2]
    accepted = help.command("regress", "accept", accept)
    assert accepted.returncode == 0
    assert "new: 1 result, in 9 figures of 1 log\n" in accepted.stdout
    assert "1 log; 9 changes, 0 logs out" in accepted.stdout
    assert help.command(*whole).returncode == 0
    changed = help.command(*whole, "--margin", "0.05")
    assert changed.returncode == 1
    assert "min_clearance" in changed.stdout
    last = changed.stderr.strip().splitlines()[-1]
    run = last.partition("replay regress accept ")[2]
    assert pathlib.Path(run, "report.html").is_file()
    again = help.command("regress", "accept", run)
    assert any(line.split()[:4] == ["worse", "bay_01/0", "ddp", "min_clearance"] for line in again.stdout.splitlines())
    assert help.command(*whole, "--margin", "0.05").returncode == 0
    before = read_baseline(tmp_path / "corpus" / "baseline.json")
    options = ["--margin", "0.02", "--json", "--weights.cusp=5", "--ddp.spacing", "0.4"]
    partial = help.command(*arguments, "--only=bay*", *options)
    assert partial.returncode == 1
    assert "cannot become the baseline" in (told := partial.stderr.strip().splitlines()[-1])
    assert shlex.split(told.partition("the whole: ")[2]) == ["replay", *whole, *options]
    newest = sorted((tmp_path / "runs").iterdir())[-1]
    assert help.command("regress", "accept", str(newest)).returncode == 2
    assert read_baseline(tmp_path / "corpus" / "baseline.json") == before


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["nowhere"], "no such corpus"),
        (["recordings", "--method", "spc"], "scp"),
        (["recordings", "--jobs", "0"], "--jobs"),
        (["recordings", "--baseline", "nowhere"], "no such file"),
        (["recordings", "--against", "no-such-version"], "expected the folder of an environment"),
        (["recordings", "--resume", "--out", "nowhere"], "no unfinished run"),
        (["recordings", "--tag", "nonsense"], "no log is left"),
        (["accept", "nowhere"], "no such folder"),
    ],
)
def test_wrong_usage_is_one_line_and_status_2(arguments, words, capsys, monkeypatch):
    monkeypatch.chdir(help.ROOT)
    assert main(["regress", *arguments]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["accept"], "expected RUN, as in `replay regress accept runs/RUN` (see `replay regress accept --help`)"),
        (["accept", "runs/RUN", "--onyl"], "(see `replay regress accept --help`)"),
        (["recordings", "--jobs", "0"], "(see `replay regress --help`)"),
    ],
)
def test_wrong_usage_of_a_command_below_a_command_names_that_one(arguments, words, capsys):
    assert main(["regress", *arguments]) == 2
    assert words in capsys.readouterr().err


def test_where_the_files_are_wrong_no_help_is_recommended(tmp_path, capsys):
    (tmp_path / "corpus.toml").write_text("")
    assert main(["regress", str(tmp_path)]) == 2
    error = capsys.readouterr().err
    assert "holds no log" in error
    assert "--help" not in error


def test_what_is_given_to_paste_names_the_program_as_it_was_called(tmp_path):
    for name in ("bay_01", "bay_02"):
        shutil.copy(help.RECORDINGS / f"{name}.mcap", tmp_path)
    script = pathlib.Path(sys.executable).with_name("replay")
    called = os.path.relpath(script, tmp_path)
    environment = os.environ | {"PATH": "/usr/bin:/bin"}
    quick = ["--method", "shortcut", "--shortcut.tries", "3"]
    toml = 'methods = ["shortcut"]'
    (tmp_path / "corpus.toml").write_text(toml)

    def call(*words: str) -> subprocess.CompletedProcess[str]:
        done = [called, *words]
        return subprocess.run(done, cwd=tmp_path, env=environment, capture_output=True, text=True, timeout=120)

    done = call("regress", "*_0[12].mcap", *quick[2:])
    assert done.returncode == 0, done.stderr
    (run,) = (tmp_path / "runs").iterdir()
    accept = f"{called} regress accept runs/{run.name} --baseline baseline.json"
    assert done.stderr.strip().splitlines()[-1].endswith(f": {accept}")
    page = (run / "report.html").read_text()
    assert accept in page
    viewer = os.path.relpath(script.with_name("rerun"), tmp_path)
    assert f"{viewer} runs/{run.name}/recordings/*.rrd" in page
    assert f"the whole: {called} regress" in call("regress", "bay_01.mcap", *quick).stderr
    assert f"(see `{called} regress --help`)" in call("regress", "bay_01.mcap", "--jobs", "0").stderr


@pytest.mark.parametrize("more", [[], ["--method", "shortcut"], ["--only", "bay_01"]])
def test_a_baseline_that_cannot_be_the_corpus_s_is_refused_before_anything_is_made(more, tmp_path, capsys):
    folder = help.make_corpus(tmp_path / "corpus", ["bay_01"])
    arguments = ["regress", folder, "--out", str(tmp_path / "runs"), *more]
    other = tmp_path / "other.json"
    write_baseline(other, Baseline(schema=BASELINE_SCHEMA, logs={"elsewhere": LogFigures(cases={})}))
    assert main([*arguments, "--baseline", str(other)]) == 2
    (tmp_path / "corpus" / "baseline.json").write_text("{}")
    assert main(arguments) == 2
    error = capsys.readouterr().err
    assert "is in" in error.splitlines()[0]
    assert "schema is missing" in error.splitlines()[1]
    assert not (tmp_path / "runs").exists()


def test_a_regression_is_told_by_the_status_also_to_who_reads_the_first_line_alone(tmp_path):
    folder = help.make_corpus(tmp_path / "corpus", ["bay_01"])
    listed = tmp_path / "corpus" / "corpus.toml"
    listed.write_text('methods = ["ddp"]\n' + listed.read_text().replace("improved", "E_NO_MAP"))
    process = subprocess.Popen(
        help.call("regress", folder, "--out", str(tmp_path / "runs"), "--quiet"),
        stdout=subprocess.PIPE,
        stderr=subprocess.PIPE,
        text=True,
    )
    assert process.stdout is not None
    process.stdout.close()
    _, error = process.communicate(timeout=120)
    assert (process.returncode, error) == (1, "")


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


def _long_run(folder: str, runs: pathlib.Path) -> list[str]:
    """Arguments of a run that is still at work when it is ended."""
    return ["regress", folder, "--method", "shortcut", "--shortcut.tries", "100000", "--out", str(runs)]


def test_ctrl_c_stops_within_two_seconds_leaves_no_process_and_the_rest_can_be_done(tmp_path):
    folder = help.make_corpus(tmp_path / "corpus", ["bay_01", "bay_02", "dock_01", "dock_02", "angled_02"])
    arguments = _long_run(folder, tmp_path / "runs")
    process = subprocess.Popen(
        help.call(*arguments), stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True, start_new_session=True
    )
    try:
        deadline = time.monotonic() + 60.0
        while not list((tmp_path / "runs").glob("*/attempts")) and time.monotonic() < deadline:
            time.sleep(0.05)
        time.sleep(1.0)
        children = help.below(process.pid)
        assert len(children) >= 2
        process.send_signal(signal.SIGINT)
        asked = time.monotonic()
        _, error = process.communicate(timeout=20)
        took = time.monotonic() - asked
    finally:
        process.kill()
    assert process.returncode == 130
    assert took < 2.0
    assert not [pid for pid in children if is_running(pid)]
    assert "--resume" in error.strip().splitlines()[-1]
    assert "Traceback" not in error


def test_killing_the_command_leaves_no_process_that_works_on(tmp_path):
    folder = help.make_corpus(tmp_path / "corpus", ["bay_01", "bay_02"])
    arguments = _long_run(folder, tmp_path / "runs")
    process = subprocess.Popen(help.call(*arguments), stderr=subprocess.DEVNULL)
    deadline = time.monotonic() + 60.0
    children: list[int] = []
    while len(children) < 3 and time.monotonic() < deadline:  # two processes of logs, and one of methods at least
        time.sleep(0.1)
        children = help.below(process.pid)
    process.kill()
    process.wait()
    deadline = time.monotonic() + 5.0
    while [pid for pid in children if is_running(pid)] and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not [pid for pid in children if is_running(pid)]


def test_results_that_cannot_be_written_end_the_run_with_one_line(corpus, runs, warm):
    plan = help.make_plan(corpus, {"ddp": DDP})
    run = start(plan, runs)
    run.logs.rmdir()
    run.logs.write_text("no folder")
    with pytest.raises(ReplayError, match="logs"):
        carry_out(plan, run, warm, lambda *_: None)
