"""`replay regress` as a command: what it says, what it gives to paste, and that nothing is left when it is ended."""

import os
import pathlib
import shlex
import shutil
import signal
import subprocess
import sys
import time

import pytest
import regress_help as help

from replay.base.schemas.baseline import BASELINE_SCHEMA, Baseline, LogFigures
from replay.cli import main
from replay.regress.baseline import read_baseline, write_baseline
from tools.processes import is_running


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


# ---- killed, interrupted


def _long_run(folder: str, runs: pathlib.Path) -> list[str]:
    """Arguments of a run that is still at work when it is ended."""
    return ["regress", folder, "--method", "shortcut", "--shortcut.tries", "100000", "--out", str(runs)]


@pytest.mark.slow
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


@pytest.mark.slow
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
