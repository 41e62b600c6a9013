"""Fixtures that more than one file of tests uses, and the profile of the property tests."""

import os
import pathlib
import signal
from collections.abc import Callable, Iterator
from functools import partial

import array_shapes
import logs_maker as make
import pytest
import recording_factory as factory
import run_maker as runs
from hypothesis import settings
from recording_reading import Contents, written

from optim.model.result import Stop
from replay.base.errors import LogError
from replay.base.kernels import drop_stale
from replay.logs.container.log import Log, ReadLimits
from replay.logs.container.scan import scan
from replay.run.case import Case
from replay.run.outcome import Run

if "PYTEST_XDIST_WORKER" not in os.environ:  # a worker must not delete what another one has just compiled
    drop_stale()
settings.register_profile("replay", deadline=None, derandomize=True)  # the same examples on every machine
settings.load_profile("replay")


def pytest_collection_finish() -> None:
    """From here on every array in a field is of the type and shape that the field states."""
    array_shapes.check_from_now_on()


@pytest.fixture(scope="session", autouse=True)
def ctrl_c_is_heard() -> Iterator[None]:
    """What the tests start hears Ctrl-C, even where a shell runs the tests in the background, which ignores it."""
    kept = signal.signal(signal.SIGINT, signal.default_int_handler)
    yield
    signal.signal(signal.SIGINT, kept)


@pytest.fixture(scope="session")
def five() -> Run:
    """Three methods that improve, one whose path is rejected, one that keeps the recorded path; on a grid."""
    steps = factory.towards((8.0, 0.34), 6)
    methods = {
        "shortcut": factory.Prepared(steps[-1], steps[:-1]),
        "cpo": factory.Prepared(steps[-2], steps[:-2], violation=0.4),
        "ddp": factory.Prepared(steps[-3], steps[:3], violation=0.1),
        "nlp": factory.Prepared(factory.manoeuvre(10.0, 0.45)),
        "scp": factory.Prepared(stop=Stop.STALLED, reason="The trust region shrank to nothing."),
    }
    return factory.make_run(methods, with_grid=True)


@pytest.fixture(scope="session")
def one() -> Run:
    """One method that improves the path."""
    return factory.make_run()


@pytest.fixture(scope="session")
def one_file(one: Run, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """The recording of `one`."""
    return written(one, tmp_path_factory.mktemp("one"))


@pytest.fixture(scope="session")
def one_read(one_file: pathlib.Path) -> Contents:
    """What that recording holds."""
    return Contents(one_file)


@pytest.fixture(scope="session")
def five_file(five: Run, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """The recording of `five`."""
    return written(five, tmp_path_factory.mktemp("five"))


@pytest.fixture(scope="session")
def five_read(five_file: pathlib.Path) -> Contents:
    """What that recording holds."""
    return Contents(five_file)


@pytest.fixture
def failed_run(tmp_path: pathlib.Path) -> pathlib.Path:
    """The folder of a regression run in which some results got worse."""
    return runs.regressed(tmp_path / "runs" / "2026-03-14T02-00-00Z_84f303a")


@pytest.fixture
def passed_run(tmp_path: pathlib.Path) -> pathlib.Path:
    """The folder of a regression run, of the night before that, in which nothing changed."""
    found = runs.logs()
    return runs.write_run(tmp_path / "runs" / "2026-03-13T02-00-00Z_84f3039", found, runs.unchanged(found))


@pytest.fixture
def scanned(tmp_path: pathlib.Path) -> Callable[..., Log]:
    """The container with these bytes, every channel wanted."""

    def scan_bytes(data: bytes, limits: ReadLimits | None = None) -> Log:
        file = tmp_path / "log.mcap"
        file.write_bytes(data)
        return scan(file, lambda _: True, limits)

    return scan_bytes


@pytest.fixture
def read(tmp_path: pathlib.Path) -> Callable[..., list[Case]]:
    """The cases of a log that `logs_maker` made."""
    return partial(make.read_log, tmp_path / "yard.mcap")


@pytest.fixture
def refusal(tmp_path: pathlib.Path) -> Callable[..., LogError]:
    """The error that reading such a log ends with."""
    return partial(make.refusal_of, tmp_path / "yard.mcap")
