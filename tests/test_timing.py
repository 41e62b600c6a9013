"""Timing two versions in turns: what the statistics say, and what is found between two real versions."""

import math
import os
import pathlib
import shutil
import subprocess
import sys

import numpy as np
import pytest
import regress_help as help

from replay.base.errors import ReplayError
from replay.regress import timing
from replay.regress.timing import TimingServer, Version, check_version, compared, judged, measure, this_version, version


def ratios(true: float, noise: float, count: int = 40, seed: int = 1) -> list[float]:
    return list(true * np.exp(np.random.default_rng(seed).normal(0.0, noise, count)))


def test_a_slowdown_is_found_and_noise_is_not():
    assert compared(ratios(1.10, 0.03)).alarm
    assert compared(ratios(1.05, 0.03)).alarm
    assert not any(compared(ratios(1.0, 0.03, seed=seed)).alarm for seed in range(40))
    assert not compared(ratios(1.10, 0.6)).alarm  # too noisy to be certain
    assert not compared(ratios(0.8, 0.03)).alarm
    assert compared(ratios(1.05, 0.03)) == compared(ratios(1.05, 0.03))


def test_the_interval_holds_the_mean_and_methods_are_told_apart():
    found = judged({"ddp": {str(i): r for i, r in enumerate(ratios(1.2, 0.02))}, "scp": {"0": 1.5, "1": 1.5}})
    assert found["ddp"].alarm
    assert (found["scp"].low, found["scp"].high) == (None, None)  # two logs say nothing for certain
    assert not found["scp"].alarm
    assert found["ddp"].low is not None
    assert found["ddp"].high is not None
    assert found["ddp"].low < found["ddp"].ratio < found["ddp"].high
    assert (found["all"].pairs, found["scp"].pairs) == (40, 2)
    assert judged({}) == {}


def test_what_is_no_version_is_one_line_that_says_what_would_be():
    with pytest.raises(ReplayError, match="a git revision"):
        check_version("no-such-thing")
    with pytest.raises(ReplayError, match="a git revision") as caught, version("no-such-thing"):
        pass
    assert "\n" not in str(caught.value)


def test_an_environment_is_known_by_its_python():
    with version(str(pathlib.Path(sys.executable).parent.parent)) as other:
        assert other.python == sys.executable
        assert other.path == ""


@pytest.mark.skipif(not (help.ROOT / ".git").exists(), reason="no git checkout")
def test_a_revision_is_checked_out_for_the_time_being():
    with version("HEAD") as other:
        assert (pathlib.Path(other.path) / "optim" / "methods" / "__init__.py").is_file()
    assert not pathlib.Path(other.path).exists()
    listed = subprocess.run(["git", "worktree", "list"], cwd=help.ROOT, capture_output=True, text=True, check=True)
    assert other.path not in listed.stdout


def slower(folder: pathlib.Path) -> Version:
    """This version with a method that takes its time, and another that fails."""
    for name in ("optim", "replay"):
        shutil.copytree(help.ROOT / name, folder / name, copy_function=os.link)
    file = folder / "optim" / "methods" / "__init__.py"
    text = file.read_text()
    file.unlink()  # a link to the one that is tested
    file.write_text(
        text
        + "\nimport time\nfrom optim.model.result import ignore\nclass Slow(Ddp):\n"
        + "    def solve(self, problem, on_iterate=ignore):\n"
        + "        time.sleep(0.3)\n        return super().solve(problem, on_iterate)\n"
        + "METHODS = {**METHODS, 'ddp': Slow(), 'cpo': None}\n"
    )
    return Version(name="slower", python=this_version().python, path=str(folder))


def test_an_answer_that_comes_too_late_is_not_taken_for_the_next_one(tmp_path, monkeypatch):
    python = tmp_path / "python"
    python.write_text(
        f"#!{sys.executable}\n"
        "import sys, time\n"
        "from multiprocessing.connection import Connection\n"
        "pipe = Connection(int(sys.argv[-1]))\n"
        "while True:\n"
        "    is_slow = pipe.recv()[1] == 'slow'\n"
        "    time.sleep(3.5 if is_slow else 0.0)\n"
        "    pipe.send([1.0 if is_slow else 2.0])\n"
    )
    python.chmod(0o755)
    monkeypatch.setattr(timing, "MOST_S", 2.5)
    with TimingServer(Version(name="late", python=str(python), path="")) as server:
        assert math.isnan(server.seconds("log", "slow"))
        assert server.seconds("log", "fast") == 2.0


@pytest.mark.slow
def test_a_version_that_sleeps_is_slower_and_pairs_that_one_side_cannot_do_are_left_out(tmp_path):
    logs = ["bay_01", "bay_02", "dock_02"]
    pairs = [(name, str(help.RECORDINGS / f"{name}.mcap"), method) for name in logs for method in ("ddp", "cpo")]
    with TimingServer(this_version()) as old, TimingServer(slower(tmp_path)) as new:
        found = measure(old, new, pairs)
    assert set(found) == {"ddp"}
    assert set(found["ddp"]) == set(logs)
    assert judged(found)["ddp"].alarm
