"""The files of a run: one for each log, whole or not there, under names that never meet."""

import errno
import json
import os

import pytest

from replay.base.errors import ReplayError
from replay.base.schemas.log import LOG_SCHEMA, CaseResult, LogResults, Recorded
from replay.base.schemas.results import MetricsDocument
from replay.regress.folder import RunFolder, file_stem


def log(name: str, **more) -> LogResults:
    return LogResults(schema=LOG_SCHEMA, log=name, **more)


def test_names_of_logs_become_names_of_files_that_never_meet_and_are_never_hidden(tmp_path):
    names = ["a/b", "a%2Fb", ".a", "..", "a" * 300, "a" * 299 + "b", "\ud800", "\n", "ä" * 90]
    stems = [file_stem(name) for name in names]
    assert len(set(stems)) == len(names)
    assert all("/" not in stem and not stem.startswith(".") and len(stem) <= 200 for stem in stems)
    run = RunFolder(tmp_path)
    run.make()
    for name in names:
        assert run.publish(log(name))
        assert not run.publish(log(name))
    assert len(run.done()) == len(names)
    assert not [path for path in run.logs.iterdir() if path.suffix == ".tmp"]


def test_results_are_plain_json(tmp_path):
    run = RunFolder(tmp_path)
    run.make()
    metrics = MetricsDocument(length=1.5, min_clearance=float("inf"))
    run.publish(
        log("a", tags=("x", "y"), cases=(CaseResult(case="a/0", recorded=Recorded(metrics=metrics), methods=()),))
    )
    found = json.loads(run.file("a").read_text())
    assert (found["schema"], found["log"], found["tags"]) == ("replay.run.log/1", "a", ["x", "y"])
    assert found["cases"][0]["recorded"]["metrics"] == {"length": 1.5, "min_clearance": None}


def test_a_folder_that_cannot_keep_a_name_is_told_and_one_that_never_does_so_is_no_error(tmp_path, monkeypatch):
    run = RunFolder(tmp_path)
    run.make()

    def failing(number: int):
        def sync(descriptor: int) -> None:
            if os.readlink(f"/proc/self/fd/{descriptor}") == str(run.logs):  # noqa: PTH115 - of a descriptor
                raise OSError(number, os.strerror(number))

        return sync

    monkeypatch.setattr(os, "fsync", failing(errno.ENOTSUP))
    assert run.publish(log("a"))
    monkeypatch.setattr(os, "fsync", failing(errno.EIO))
    with pytest.raises(ReplayError, match="Input/output error"):
        run.publish(log("b"))
