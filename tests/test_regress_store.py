"""The files of a run: one for each log, whole or not there, under names that never meet."""

import errno
import json
import os

import pytest

from replay.base.errors import ReplayError
from replay.regress.store import Store, file_stem


def test_names_of_logs_become_names_of_files_that_never_meet_and_are_never_hidden(tmp_path):
    names = ["a/b", "a%2Fb", ".a", "..", "a" * 300, "a" * 299 + "b", "\ud800", "\n", "ä" * 90]
    stems = [file_stem(name) for name in names]
    assert len(set(stems)) == len(names)
    assert all("/" not in stem and not stem.startswith(".") and len(stem) <= 200 for stem in stems)
    store = Store(tmp_path)
    store.make()
    for name in names:
        assert store.publish({"log": name, "schema": "replay.run.log/1"})
        assert not store.publish({"log": name, "schema": "replay.run.log/1"})
    assert len(store.done()) == len(names)
    assert not [path for path in store.logs.iterdir() if path.suffix == ".tmp"]


def test_results_are_plain_json(tmp_path):
    store = Store(tmp_path)
    store.make()
    store.publish({"log": "a", "schema": "replay.run.log/1", "x": float("inf"), "y": (1, 2)})
    assert json.loads(store.file("a").read_text()) == {"log": "a", "schema": "replay.run.log/1", "x": None, "y": [1, 2]}


def test_a_folder_that_cannot_keep_a_name_is_told_and_one_that_never_does_so_is_no_error(tmp_path, monkeypatch):
    store = Store(tmp_path)
    store.make()

    def failing(number: int):
        def sync(descriptor: int) -> None:
            if os.readlink(f"/proc/self/fd/{descriptor}") == str(store.logs):  # noqa: PTH115 - of a descriptor
                raise OSError(number, os.strerror(number))

        return sync

    monkeypatch.setattr(os, "fsync", failing(errno.ENOTSUP))
    assert store.publish({"log": "a", "schema": "replay.run.log/1"})
    monkeypatch.setattr(os, "fsync", failing(errno.EIO))
    with pytest.raises(ReplayError, match="Input/output error"):
        store.publish({"log": "b", "schema": "replay.run.log/1"})
