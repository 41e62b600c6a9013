"""Reading in a child process: whatever a log does there ends in one line."""

import os
import pathlib
import signal
import time

import numpy as np
import pytest

from replay import pipeline
from replay.base.errors import LogError
from replay.run import reading
from replay.run.reading import guarded

LOG = pathlib.Path(__file__).resolve().parent.parent / "recordings" / "bay_01.mcap"
GIB = 1 << 30


def sleep() -> None:
    time.sleep(600.0)


def eat() -> None:
    np.ones(4 * GIB // 8)


def crash() -> None:
    os.kill(os.getpid(), signal.SIGKILL)


def leave() -> None:
    os._exit(5)


def refuse() -> None:
    raise LogError("E_NO_MAP", LOG, "it holds no map")


@pytest.mark.parametrize(
    ("read", "code", "words"),
    [
        (eat, "E_MEMORY", "needs more than 2048 MiB"),
        (crash, "E_CRASHED", "its process was ended by SIGKILL"),
        (leave, "E_CRASHED", "its process ended with exit status 5"),
        (refuse, "E_NO_MAP", "it holds no map"),
    ],
)
def test_a_log_that_goes_wrong_in_any_way_ends_in_a_line_that_names_it(read, code, words):
    with pytest.raises(LogError, match=words) as caught:
        guarded(LOG, read, memory_mib=2048 if read is eat else None)  # other tests leave data that a child inherits
    assert caught.value.code == code
    assert str(caught.value).startswith(str(LOG))
    assert caught.value.exit_status == 2


def test_a_log_that_hangs_is_ended_when_its_time_is_up(monkeypatch):
    monkeypatch.setattr(reading, "READ_S", 0.5)
    monkeypatch.setattr(reading, "COMPILE_S", 0.0)
    began = time.monotonic()
    with pytest.raises(LogError, match="took more than 1 s") as caught:
        guarded(LOG, sleep, memory_mib=None)
    assert caught.value.code == "E_HUNG"
    assert time.monotonic() - began < 60.0


def test_a_defect_of_the_reader_comes_back_as_the_exception_that_it_is():
    with pytest.raises(ZeroDivisionError):
        guarded(LOG, lambda: 1 // 0, memory_mib=None)


def test_a_case_read_in_a_child_is_the_one_read_here_to_the_last_bit():
    (here,), (there,) = pipeline.read(LOG), pipeline.read(LOG, memory_mib=4096)
    for name in ("x", "y", "theta", "alpha", "phi", "s"):
        mine, other = (getattr(case.problem.recorded.segments[0], name) for case in (here, there))
        assert mine.tobytes() == other.tobytes()
        assert not other.flags.writeable
    assert here.read == there.read
    for mine, other in zip(here.problem.scene.polygons, there.problem.scene.polygons, strict=True):
        assert mine.tobytes() == other.tobytes()
