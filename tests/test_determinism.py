"""The same log and options on the same machine give the same bits, whatever else differs."""

import json
import os
import pathlib
import re
import subprocess
import sys
from typing import Any

import pytest
from logs_maker import sound_log

from optim.methods import METHODS
from replay.base.threads import VARIABLES
from tools.processes import REPLAY

TIMES = ("wall_s", "compile_s", "solver_s")
"""What may differ: how long things took."""
THREADS = ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "NUMBA_NUM_THREADS", "RAYON_NUM_THREADS")


def without_times(node: Any) -> Any:
    if isinstance(node, dict):
        return {key: without_times(value) for key, value in node.items() if key not in TIMES}
    return [without_times(value) for value in node] if isinstance(node, list) else node


def optimised(log: pathlib.Path, out: pathlib.Path, folder: pathlib.Path, **environment: str) -> Any:
    """The results of all methods in a fresh process, as text; every float has all its digits."""
    arguments = ["optimize", str(log), "--out", str(out), "--quiet", "--seed", "3"]
    subprocess.run(
        [*REPLAY, *arguments, "--no-recording"],
        cwd=folder,
        env=os.environ | environment,
        check=True,
        stdout=subprocess.DEVNULL,
    )
    return json.loads((out / "yard.results.json").read_text())


@pytest.mark.slow
def test_all_methods_give_the_same_bits_in_other_processes_folders_and_environments(tmp_path: pathlib.Path) -> None:
    log = sound_log().write(tmp_path / "yard.mcap")
    other = tmp_path / "other folder"
    other.mkdir()
    first = optimised(log, tmp_path / "a", tmp_path, PYTHONHASHSEED="1", **dict.fromkeys(THREADS, "1"))
    changes = {"PYTHONHASHSEED": "4711", "LC_ALL": "C.UTF-8", "TZ": "Asia/Tokyo", "COLUMNS": "33"}
    second = optimised(log, tmp_path / "b", other, **changes, **dict.fromkeys(THREADS, "4"))
    assert [method["status"] for method in first["methods"]] == ["improved"] * len(METHODS)
    assert json.dumps(without_times(first)) == json.dumps(without_times(second))
    assert json.dumps(first) != json.dumps(second), "times were measured, so something must differ"


def test_the_number_of_threads_is_one_whatever_the_environment_says() -> None:
    script = "import os, replay.base.threads as t; t.use_one_thread(); print(*(os.environ[n] for n in t.VARIABLES))"
    environment = os.environ | dict.fromkeys(VARIABLES, "7")
    said = subprocess.check_output([sys.executable, "-c", script], env=environment, text=True)
    assert set(said.split()) == {"1"}
    assert set(THREADS) <= set(VARIABLES)


def test_libraries_that_are_loaded_already_work_on_one_thread_and_get_theirs_back() -> None:
    script = """
import numpy, threadpoolctl
from replay.base.threads import one_thread
def most(): return max(library["num_threads"] for library in threadpoolctl.threadpool_info())
for _ in range(2):
    with one_thread():
        print(most(), end=" ")
    print(most(), end=" ")
"""
    environment = {name: value for name, value in os.environ.items() if not name.endswith("_THREADS")}
    said = subprocess.check_output([sys.executable, "-c", script], env=environment, text=True).split()
    cores = str(len(os.sched_getaffinity(0)))
    assert said == ["1", cores, "1", cores]


def test_no_command_loads_numpy_before_the_number_of_threads_is_set() -> None:
    script = "import sys, replay.cli; sys.exit('numpy' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", script]).returncode == 0


def test_no_module_draws_from_a_generator_that_all_share() -> None:
    """Seeds are options: every generator is made from one, and nothing reads the clock for one."""
    root = pathlib.Path(__file__).parent.parent
    for file in [*(root / "optim").rglob("*.py"), *(root / "replay").rglob("*.py")]:
        text = file.read_text(encoding="utf-8")
        assert "import random" not in text, file
        for part in text.split("np.random.")[1:]:
            assert re.match(r"default_rng\([\w.]+\)|Generator", part), (file, part[:40])
