"""Compiled kernels: those that no longer match their sources are dropped, and one process at a time compiles."""

import importlib
import os
import subprocess
import sys
from pathlib import Path

import pytest
from numba.core.errors import TypingError

from replay.base.kernels import any_compiled, drop_stale

INNER = "from numba import njit\n@njit(cache=True)\ndef inner():\n    return {value}\n"
OUTER = "from numba import njit\nfrom inner import inner\n@njit(cache=True)\ndef outer():\n    return inner()\n"


def _answer(folder: Path) -> int:
    """What a fresh process gets from the kernel in `outer`, compiled or from the cache."""
    command = [sys.executable, "-c", "import outer; print(outer.outer())"]
    environment = {key: value for key, value in os.environ.items() if key != "NUMBA_CACHE_DIR"}
    return int(subprocess.run(command, cwd=folder, env=environment, check=True, capture_output=True).stdout)


def test_a_change_in_a_called_kernels_file_takes_effect(tmp_path: Path) -> None:
    (tmp_path / "outer.py").write_text(OUTER)
    (tmp_path / "inner.py").write_text(INNER.format(value=1))
    assert _answer(tmp_path) == 1
    assert drop_stale(tmp_path) == 0
    (tmp_path / "inner.py").write_text(INNER.format(value=2))
    assert drop_stale(tmp_path) == 4  # two kernels, an index and the code of each
    assert _answer(tmp_path) == 2


def test_sources_without_kernels_do_not_count(tmp_path: Path) -> None:
    cache = tmp_path / "__pycache__"
    cache.mkdir()
    (cache / "kernel.nbi").write_bytes(b"")
    (tmp_path / "plain.py").write_text("later = 1\n")
    assert drop_stale(tmp_path) == 0
    assert (cache / "kernel.nbi").exists()


SLOW = """
import pathlib, sys, time
from optim.numerics.kernel import kernel

@kernel
def slow(x):
    y = x
{lines}
    return y

if __name__ == "__main__":
    mine, others = map(pathlib.Path, sys.argv[1:])
    mine.touch()
    while not others.exists():
        time.sleep(0.001)
    slow(1.0)
    print(len(slow.stats.cache_misses), len(slow.stats.cache_hits))
"""


def test_a_kernel_that_two_processes_need_at_once_is_compiled_by_one_of_them(tmp_path):
    script = tmp_path / "slow.py"
    lines = "\n".join(f"    y = y * {number}.5 + x" for number in range(300))
    script.write_text(SLOW.format(lines=lines))
    flags = [(tmp_path / "a", tmp_path / "b"), (tmp_path / "b", tmp_path / "a")]
    command = [sys.executable, str(script)]
    both = [subprocess.Popen([*command, *map(str, pair)], stdout=subprocess.PIPE, text=True) for pair in flags]
    said = sorted(process.communicate(timeout=100)[0].strip() for process in both)
    assert [process.returncode for process in both] == [0, 0]
    assert said == ["0 1", "1 0"], "misses and hits of the cache"


def test_a_kernel_that_cannot_be_compiled_leaves_its_lock_to_the_next_try(tmp_path, monkeypatch):
    (tmp_path / "broken.py").write_text(
        "from optim.numerics.kernel import kernel\n@kernel\ndef plus(x):\n    return x + 1\n", encoding="utf-8"
    )
    monkeypatch.syspath_prepend(tmp_path)
    broken = importlib.import_module("broken")
    with pytest.raises(TypingError):
        broken.plus("a")
    assert broken.plus(1) == 2


def test_whether_anything_was_compiled_before_is_seen(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NUMBA_CACHE_DIR", raising=False)
    (tmp_path / "part" / "__pycache__").mkdir(parents=True)
    assert not any_compiled(tmp_path)
    (tmp_path / "part" / "__pycache__" / "step.nbc").touch()
    assert any_compiled(tmp_path)
