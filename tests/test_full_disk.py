"""A file system that runs full: no half file gets its name, nothing else is left, and the exit status says so."""

import pathlib
import shutil
import subprocess
from collections.abc import Iterator

import pytest
from logs_maker import sound_log

from replay.run.confirm import audit_results
from replay.run.results import read_results
from tools.processes import REPLAY


@pytest.fixture
def disk(tmp_path: pathlib.Path) -> Iterator[pathlib.Path]:
    """An empty file system of 1 MiB."""
    folder = tmp_path / "disk"
    folder.mkdir()
    mount = ["mount", "-t", "tmpfs", "-o", "size=1m", "tmpfs", str(folder)]
    if not shutil.which("mount") or subprocess.run(mount, capture_output=True).returncode != 0:
        pytest.skip("only root may mount a file system")
    try:
        yield folder
    finally:
        subprocess.run(["umount", str(folder)], check=True)


@pytest.mark.parametrize("free_kib", [20, 300])
def test_nothing_half_written_is_left_on_a_full_disk(tmp_path: pathlib.Path, disk: pathlib.Path, free_kib: int) -> None:
    """With room for nothing, and with room for the results but not for the recording beside them."""
    log = sound_log().write(tmp_path / "yard.mcap")
    (disk / "others").write_bytes(bytes(((1 << 20) - free_kib * 1024) // 4096 * 4096))
    command = [*REPLAY, "optimize", str(log), "--method", "ddp", "--out", str(disk), "--quiet"]
    ended = subprocess.run(command, capture_output=True, text=True)
    assert ended.returncode == 1
    (line,) = ended.stderr.splitlines()
    assert line.endswith("cannot be written: No space left on device [E_WRITE]")
    left = {file.name for file in disk.iterdir()} - {"others"}
    assert left == (set() if free_kib == 20 else {"yard.results.json"})
    for name in left:
        assert all(verdict.report.passed for verdict in audit_results(read_results(disk / name)))
    if free_kib == 20:
        return
    (disk / "others").unlink()
    assert subprocess.run(command, capture_output=True).returncode == 0, "with room again, the same run works"
    assert {file.name for file in disk.iterdir()} == {"yard.results.json", "yard.rrd"}
