"""What goes wrong with one method or one log stays there: exit statuses, what is kept, what is said."""

import dataclasses
import json
import os
import pathlib
import shutil
import signal
import subprocess
import sys
import threading
import time
from typing import Any

import pytest
from logs_maker import sound_log

from optim.model.objective import Weights
from optim.model.problem import Problem
from optim.model.result import OnIterate, Result, Stop, ignore
from replay.cli.console import Common, Voice
from replay.cli.outputs import Outputs
from replay.cli.session import Session
from replay.cli.settings import RunOptions, Settings
from replay.logs import ReadOptions


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> pathlib.Path:
    return sound_log().write(tmp_path_factory.mktemp("logs") / "yard.mcap")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Keeps:
    """Gives back what it got."""

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        return Result(path=problem.recorded, stop=Stop.STALLED, reason="Nothing to do.", iterations=0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Raises:
    """Does not come to an answer."""

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        raise RuntimeError("lost its way")


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sleeps:
    """Does not come to an answer in time."""

    begun: pathlib.Path
    """A file that says that it has begun."""

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        self.begun.touch()
        time.sleep(60.0)
        raise AssertionError


def session(out: pathlib.Path, methods: dict[str, Any], logs: list[pathlib.Path], **common: bool) -> Session:
    return Session(
        voice=Voice(Common(**common)),
        settings=Settings(
            run=RunOptions(recording=False, jobs=1), methods=methods, read=ReadOptions(), weights=Weights()
        ),
        outputs=Outputs(out, logs),
    )


@pytest.mark.parametrize("verbose", [False, True])
def test_a_method_that_fails_gives_status_1_and_a_traceback_only_if_verbose(tmp_path, log, capsys, verbose):
    methods = {"raises": Raises(), "keeps": Keeps()}
    assert session(tmp_path, methods, [log], verbose=verbose).run([log]) == 1
    said = capsys.readouterr()
    assert "RuntimeError: lost its way" in said.err
    assert ("Traceback" in said.err) is verbose
    assert "nothing better than the recorded path was found" in said.out
    document = json.loads((tmp_path / "yard.results.json").read_text())
    assert [method["status"] for method in document["methods"]] == ["failed", "kept"]


def test_a_method_that_finds_nothing_better_is_no_failure(tmp_path, log):
    assert session(tmp_path, {"keeps": Keeps()}, [log]).run([log]) == 0


def test_ctrl_c_gives_status_130_and_keeps_what_was_finished(tmp_path, log, capsys):
    other = tmp_path / "other.mcap"
    shutil.copy(log, other)
    begun = tmp_path / "begun"
    methods = {"keeps": Keeps(), "sleeps": Sleeps(begun=begun), "never": Keeps()}

    def interrupt() -> None:
        while not begun.exists():
            time.sleep(0.01)
        os.kill(os.getpid(), signal.SIGINT)

    threading.Thread(target=interrupt).start()
    started = time.monotonic()
    assert session(tmp_path / "out", methods, [log, other]).run([log, other]) == 130
    assert time.monotonic() - started < 20.0
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["yard.results.json"]
    document = json.loads((tmp_path / "out" / "yard.results.json").read_text())
    assert [method["name"] for method in document["methods"]] == ["keeps"]
    assert "interrupted" in capsys.readouterr().err


def test_two_runs_of_one_log_in_one_folder_do_not_mix(tmp_path, log, capsys):
    """The process that came first goes on, whatever the numbers: this one's is smaller here."""
    with subprocess.Popen([sys.executable, "-c", "input()"], stdin=subprocess.PIPE) as other:
        mark = tmp_path / f".yard.results.json.{other.pid}.run"
        mark.touch()
        assert session(tmp_path, {"keeps": Keeps()}, [log]).run([log]) == 2
        said = capsys.readouterr().err
        assert f"process {other.pid} is working on it; wait, or use another --out [E_BUSY]" in said
        assert [file.name for file in tmp_path.iterdir()] == [mark.name]
        other.kill()
    assert session(tmp_path, {"keeps": Keeps()}, [log]).run([log]) == 0, "a killed process keeps nobody out"
    assert [file.name for file in tmp_path.iterdir()] == ["yard.results.json"]


def test_a_defect_of_ours_costs_one_log_and_gives_status_1(tmp_path, log, capsys):
    class Defective(dict):
        def items(self):
            raise RuntimeError("a defect")

    assert session(tmp_path, Defective(keeps=Keeps()), [log]).run([log]) == 1
    err = capsys.readouterr().err
    assert "internal error, RuntimeError: a defect" in err
    assert err.count("\n") == 1


def test_a_file_that_cannot_be_written_is_told_in_one_line(tmp_path, log, capsys):
    (tmp_path / "yard.results.json").mkdir()
    assert session(tmp_path, {"keeps": Keeps()}, [log]).run([log]) == 1
    err = capsys.readouterr().err
    assert "yard.results.json: cannot be written" in err
