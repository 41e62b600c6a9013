import os
import subprocess
import sys
from pathlib import Path

from replay.kernels import drop_stale

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
