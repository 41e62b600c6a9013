"""An output path holds a complete file or what it held before, whatever happens on the way."""

import errno
import os
import pathlib
import random
import signal
import subprocess
import sys
import textwrap
import time

import pytest

from replay.base.errors import ReplayError
from replay.base.files import atomic_write


def left_in(folder: pathlib.Path) -> list[str]:
    return sorted(path.name for path in folder.iterdir())


def in_python(script: str, *arguments: object) -> subprocess.Popen[str]:
    command = [sys.executable, "-c", textwrap.dedent(script), *map(str, arguments)]
    return subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)


def test_the_file_appears_when_the_block_ends_and_not_before(tmp_path: pathlib.Path) -> None:
    target = tmp_path / "bay.results.json"
    with atomic_write(target) as temporary:
        assert temporary.name == f".bay.results.json.{os.getpid()}.tmp"
        temporary.write_bytes(b"all of it")
        assert not target.exists()
    assert target.read_bytes() == b"all of it"
    assert left_in(tmp_path) == [target.name]


def test_an_existing_file_is_replaced_in_one_step(tmp_path: pathlib.Path) -> None:
    target = tmp_path / "bay.rrd"
    target.write_bytes(b"old")
    with target.open("rb") as reader, atomic_write(str(target)) as temporary:
        temporary.write_bytes(b"new")
        assert target.read_bytes() == b"old"
        assert reader.read() == b"old"
    assert target.read_bytes() == b"new"


def test_a_library_may_put_its_own_file_in_place_of_the_temporary_one(tmp_path: pathlib.Path) -> None:
    with atomic_write(tmp_path / "bay.rrd") as temporary:
        temporary.unlink()
        (tmp_path / "other").write_bytes(b"written elsewhere")
        (tmp_path / "other").rename(temporary)
    assert (tmp_path / "bay.rrd").read_bytes() == b"written elsewhere"


@pytest.mark.parametrize("error", [ValueError("bad"), KeyboardInterrupt(), ReplayError("E_LOG", "bad log")])
def test_when_the_block_fails_the_old_file_stays_and_the_error_passes(
    tmp_path: pathlib.Path, error: BaseException
) -> None:
    target = tmp_path / "bay.rrd"
    target.write_bytes(b"old")

    def write() -> None:
        with atomic_write(target) as temporary:
            temporary.write_bytes(b"half")
            raise error

    with pytest.raises(type(error)) as caught:
        write()
    assert caught.value is error
    assert target.read_bytes() == b"old"
    assert left_in(tmp_path) == [target.name]


@pytest.mark.parametrize(
    ("name", "said"),
    [
        ("missing/bay.rrd", "No such file or directory"),
        ("file/bay.rrd", "Not a directory"),
        ("folder", "Is a directory"),
        ("n" * 300, "File name too long"),
        ("bay\0.rrd", "cannot be a file's name"),
        ("folder/..", "cannot be a file's name"),
    ],
)
def test_a_path_that_cannot_be_written_is_one_line(tmp_path: pathlib.Path, name: str, said: str) -> None:
    (tmp_path / "file").touch()
    (tmp_path / "folder").mkdir()
    with pytest.raises(ReplayError, match=said) as caught, atomic_write(tmp_path / name) as temporary:
        temporary.write_bytes(b"content")
    assert caught.value.code == "E_WRITE"
    assert "\n" not in str(caught.value)
    assert left_in(tmp_path) == ["file", "folder"]


@pytest.mark.skipif(os.geteuid() == 0, reason="root may write anywhere")
def test_a_read_only_folder_is_one_line(tmp_path: pathlib.Path) -> None:
    tmp_path.chmod(0o500)
    with pytest.raises(ReplayError, match="Permission denied"), atomic_write(tmp_path / "bay.rrd"):
        pass


def test_a_full_disk_leaves_the_old_file_and_nothing_else(tmp_path: pathlib.Path) -> None:
    """A limit on the size of files fails in the middle of a write, as a full disk does."""
    target = tmp_path / "bay.results.json"
    target.write_bytes(b"old")
    script = """
        import resource, sys
        from replay.base.errors import ReplayError
        from replay.base.files import atomic_write
        resource.setrlimit(resource.RLIMIT_FSIZE, (4096, 4096))
        try:
            with atomic_write(sys.argv[1]) as temporary:
                temporary.write_bytes(bytes(100_000))
        except ReplayError as error:
            print(error)
    """
    out, err = in_python(script, target).communicate(timeout=30)
    assert err == ""
    assert out == f"{target}: cannot be written: File too large [E_WRITE]\n"
    assert target.read_bytes() == b"old"
    assert left_in(tmp_path) == [target.name]


@pytest.mark.parametrize("failing", [1, 2])
def test_a_failing_sync_is_an_error_and_leaves_a_whole_file(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch, failing: int
) -> None:
    """The first sync is the file's: nothing has its name yet. The second is the folder's: the file is complete."""
    calls = 0

    def sync(_: int) -> None:
        nonlocal calls
        calls += 1
        if calls == failing:
            raise OSError(errno.EIO, "Input/output error")

    monkeypatch.setattr(os, "fsync", sync)
    target = tmp_path / "bay.rrd"
    target.write_bytes(b"old")
    with pytest.raises(ReplayError, match="Input/output error"), atomic_write(target) as temporary:
        temporary.write_bytes(b"new")
    assert target.read_bytes() == (b"old" if failing == 1 else b"new")
    assert left_in(tmp_path) == [target.name]


def test_a_file_system_that_cannot_sync_folders_is_no_error(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    def sync(descriptor: int) -> None:
        if os.readlink(f"/proc/self/fd/{descriptor}") == str(tmp_path):  # noqa: PTH115 - of a descriptor
            raise OSError(errno.EINVAL, "Invalid argument")

    monkeypatch.setattr(os, "fsync", sync)
    with atomic_write(tmp_path / "bay.rrd") as temporary:
        temporary.write_bytes(b"new")
    assert (tmp_path / "bay.rrd").read_bytes() == b"new"


def test_a_link_under_the_temporary_name_is_not_followed(tmp_path: pathlib.Path) -> None:
    victim = tmp_path / "victim"
    victim.write_bytes(b"precious")
    (tmp_path / f".bay.rrd.{os.getpid()}.tmp").symlink_to(victim)
    with atomic_write(tmp_path / "bay.rrd") as temporary:
        temporary.write_bytes(b"new")
    assert victim.read_bytes() == b"precious"
    assert not (tmp_path / "bay.rrd").is_symlink()


def test_leftovers_of_dead_writers_of_this_file_go_and_nothing_else(tmp_path: pathlib.Path) -> None:
    dead = in_python("pass")
    dead.communicate(timeout=30)
    ours = tmp_path / f".bay.rrd.{dead.pid}.tmp"
    kept = [
        f".bay.rrd.{os.getppid()}.tmp",
        f".bay2.rrd.{dead.pid}.tmp",
        ".bay.rrd.notes.tmp",
        f"bay.rrd.{dead.pid}.tmp",
    ]
    for name in (ours.name, *kept):
        (tmp_path / name).touch()
    with atomic_write(tmp_path / "bay.rrd"):
        pass
    assert left_in(tmp_path) == sorted([*kept, "bay.rrd"])


def test_a_writer_that_is_killed_at_any_time_leaves_a_whole_file(tmp_path: pathlib.Path) -> None:
    """Ten writers, one after the other, each killed after some milliseconds of writing without pause."""
    script = """
        import itertools, sys
        from replay.base.files import atomic_write
        for i in itertools.count():
            with atomic_write(sys.argv[1]) as temporary:
                with temporary.open("wb") as file:
                    for _ in range(16):
                        file.write(bytes([i % 256]) * 20_000)
            if i == 0:
                print("first", flush=True)
    """
    target, rng = tmp_path / "bay.rrd", random.Random(0)
    for _ in range(10):
        writer = in_python(script, target)
        assert writer.stdout is not None
        assert writer.stdout.readline() == "first\n"
        time.sleep(rng.uniform(0.0, 0.02))
        writer.send_signal(signal.SIGKILL)
        writer.communicate(timeout=30)
        content = target.read_bytes()
        assert len(content) == 320_000
        assert len(set(content)) == 1
        assert len(left_in(tmp_path)) <= 2, "the next writer clears what a killed one left"
    with atomic_write(target):
        pass
    assert left_in(tmp_path) == [target.name]
