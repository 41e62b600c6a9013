"""The section on first impressions: imports, the first run with its compilation, time to the first recording."""

import json
import os
import pathlib
import resource
import subprocess
import sys
import tempfile
import time
from typing import Any

from replay.base.files import atomic_write

LOG = "bay_01"
IMPORTS = ("numpy", "numba", "optim.methods", "replay.run.judge", "casadi", "cvxpy", "rerun")
Row = dict[str, Any]


def timed(command: list[str], runs: int, cache: str | None = None) -> Row:
    """Least wall and CPU seconds of a command, children included; `cache` is where compiled kernels are kept."""
    environment = os.environ | ({"NUMBA_CACHE_DIR": cache} if cache else {})
    walls, spent = [], []
    for _ in range(runs):
        before, began = _children(), time.perf_counter()
        subprocess.run(command, env=environment, check=True, capture_output=True)
        walls.append(time.perf_counter() - began)
        spent.append(_children() - before)
    return {"wall": min(walls), "cpu": min(spent)}


def _children() -> float:
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    return used.ru_utime + used.ru_stime


def run(logs: list[pathlib.Path], folder: pathlib.Path) -> None:
    file = folder / "start.json"
    chosen = [log for log in logs if log.stem == LOG]
    if file.exists() or not chosen:
        return
    folder.mkdir(parents=True, exist_ok=True)
    replay = str(pathlib.Path(sys.executable).parent / "replay")
    row: Row = {"help": timed([replay, "--help"], 9), "imports": {}}
    for name in IMPORTS:
        row["imports"][name] = timed([sys.executable, "-c", f"import {name}"], 3)
    row["bare"] = timed([sys.executable, "-c", ""], 5)
    with tempfile.TemporaryDirectory() as out:
        optimize = [replay, "optimize", str(chosen[0]), "--out", out]
        timed(optimize, 1)
        row["warm"] = timed(optimize, 2)
        row["without"] = timed([*optimize, "--no-recording"], 1)
        for name in ("shortcut", "cpo", "ddp", "nlp", "scp"):
            row[name] = timed([*optimize, "--no-recording", "--method", name], 1)
        with tempfile.TemporaryDirectory() as cache:
            row["cold"] = timed(optimize, 1, cache)
        with tempfile.TemporaryDirectory() as cache:
            row["cold ddp"] = timed([*optimize, "--method", "ddp"], 1, cache)
    print(json.dumps(row), flush=True)
    with atomic_write(file) as temporary:
        temporary.write_text(json.dumps(row, indent=1), encoding="utf-8")


def report(folder: pathlib.Path) -> str:
    row = json.loads((folder / "start.json").read_text(encoding="utf-8"))

    def cells(one: Row) -> str:
        return f"{one['wall']:.2f} | {one['cpu']:.2f}"

    lines = [
        "## First impressions",
        "",
        f"Least of a few runs of whole processes; `replay optimize` on {LOG}. Cold: no kernel compiled before.",
        "",
        "| | wall [s] | CPU [s] | asked for, wall [s] |",
        "|---|--:|--:|--:|",
    ]
    wanted = {
        "help": ("`replay --help`", "0.3"),
        "warm": ("all methods and the recording", "6"),
        "without": ("all methods, no recording", ""),
        **{name: (f"{name} alone, no recording", "") for name in ("shortcut", "cpo", "ddp", "nlp", "scp")},
        "cold": ("cold, all methods and the recording", "40"),
        "cold ddp": ("cold, ddp and the recording", ""),
    }
    lines += [f"| {words} | {cells(row[key])} | {limit} |" for key, (words, limit) in wanted.items() if key in row]
    lines += [f"| `import {name}` | {cells(one)} | |" for name, one in row["imports"].items()]
    lines += [f"| Python alone | {cells(row['bare'])} | |"]
    lines += ["", "CPU time is that of all processes together; on a busy machine wall times are far above it."]
    return "\n".join(lines)
