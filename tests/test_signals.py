"""A command that a signal ends tidies up, says so, and leaves no process behind."""

import os
import pathlib
import signal
import subprocess
import sys
import textwrap
import time

import pytest
from logs_maker import sound_log

import replay.cli
from replay.cli.interrupts import like_ctrl_c
from replay.cli.usage import ExitStatus
from tools.processes import REPLAY, is_running

TESTS = pathlib.Path(__file__).parent
RUN = """
    import pathlib, sys
    sys.path.insert(0, sys.argv[1])
    from test_session import Sleeps, session
    from replay.cli import interrupts

    log, out = pathlib.Path(sys.argv[2]), pathlib.Path(sys.argv[3])
    with interrupts.like_ctrl_c() as ending:
        status = session(out, {"sleeps": Sleeps(begun=out.parent / "begun")}, [log]).run([log])
    sys.exit(ending.status(status))
"""


@pytest.fixture
def sleeper(tmp_path: pathlib.Path):
    """A run whose method sleeps in its own process, in a process group of its own; and that process's number."""
    log = sound_log().write(tmp_path / "yard.mcap")
    command = [sys.executable, "-c", textwrap.dedent(RUN), str(TESTS), str(log), str(tmp_path / "out")]
    process = subprocess.Popen(command, stderr=subprocess.PIPE, text=True, start_new_session=True)
    try:
        while not (tmp_path / "begun").exists():
            assert process.poll() is None, process.communicate()[1]
            time.sleep(0.01)
        (child,) = pathlib.Path(f"/proc/{process.pid}/task/{process.pid}/children").read_text().split()
        yield process, int(child)
    finally:
        process.kill()
        process.communicate()


def gone(pid: int) -> bool:
    deadline = time.monotonic() + 10.0
    while is_running(pid) and time.monotonic() < deadline:
        time.sleep(0.01)
    return not is_running(pid)


@pytest.mark.parametrize(
    ("number", "status", "whole_group"),
    [
        (signal.SIGTERM, 143, False),
        (signal.SIGHUP, 129, True),
    ],
)
def test_a_signal_ends_a_run_with_its_status_and_nothing_is_left(sleeper, tmp_path, number, status, whole_group):
    process, child = sleeper
    (os.killpg if whole_group else os.kill)(process.pid, number)
    _, said = process.communicate(timeout=20.0)
    assert process.returncode == status
    assert said == "replay: interrupted; what was finished has been kept\n"
    assert list((tmp_path / "out").iterdir()) == []
    assert gone(child)


def test_the_methods_process_ends_with_a_run_that_is_killed_even_if_it_says_nothing_any_more(sleeper):
    process, child = sleeper
    assert is_running(child)
    process.kill()
    assert gone(child)


def test_the_whole_command_answers_sigterm(tmp_path):
    log = sound_log().write(tmp_path / "yard.mcap")
    out = tmp_path / "out"
    command = [*REPLAY, "optimize", str(log), "--out", str(out), "--method", "nlp"]
    with subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.PIPE, text=True) as process:
        while not (out.is_dir() and any(out.iterdir())):
            assert process.poll() is None
            time.sleep(0.01)
        process.terminate()
        _, said = process.communicate(timeout=20.0)
    assert process.returncode == 143
    assert "Traceback" not in said
    assert not [file for file in out.iterdir() if file.suffix in (".tmp", ".run")]


def test_signals_are_as_before_after_a_command(capsys):
    before = [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)]
    assert replay.cli.main(["methods"]) == 0
    assert [signal.getsignal(number) for number in (signal.SIGTERM, signal.SIGHUP, signal.SIGINT)] == before
    assert capsys.readouterr().out


def test_a_signal_that_is_ignored_stays_ignored():
    kept = signal.signal(signal.SIGHUP, signal.SIG_IGN)
    try:
        with like_ctrl_c() as ending:
            os.kill(os.getpid(), signal.SIGHUP)
    finally:
        signal.signal(signal.SIGHUP, kept)
    assert ending.signal is None


def test_a_command_that_ended_before_the_signal_took_effect_keeps_its_status():
    with pytest.raises(KeyboardInterrupt), like_ctrl_c() as ending:
        os.kill(os.getpid(), signal.SIGTERM)
    assert ending.status(ExitStatus.INTERRUPTED) == 143
    assert ending.status(ExitStatus.OK) == 0
