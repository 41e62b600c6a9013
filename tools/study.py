"""Run every method over the full corpus and write what came of it: tables, a plot, and the source's claims tested.

Usage: python tools/study.py [--jobs N] [--time-limit S] [--only TEXT] [--rows FILE] [--from-rows FILE]

Writes recordings/STUDY.md and recordings/study_profiles.svg. `--rows` keeps the measured rows as JSON; `--from-rows`
writes the report from such a file without measuring again.
"""

import argparse
import json
import os
import pathlib
import platform
import subprocess
import sys
import time
from collections.abc import Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

from replay.cli import use_one_thread

use_one_thread()

from optim.methods import METHODS, Method  # noqa: E402 - after the threads have been settled
from optim.methods.chain import named  # noqa: E402
from optim.methods.cpo import Cpo  # noqa: E402
from optim.methods.shortcut import Shortcut  # noqa: E402
from replay.errors import ReplayError  # noqa: E402
from replay.kernels import drop_stale  # noqa: E402
from replay.logs import read_cases  # noqa: E402
from replay.run import run_case  # noqa: E402
from replay.worker import Limits, Worker  # noqa: E402
from tools.corpus.catalogue import FULL, SITES, read_list  # noqa: E402
from tools.study_report import report  # noqa: E402

RECORDINGS = pathlib.Path(__file__).resolve().parent.parent / "recordings"
CHAINS = ("shortcut+scp", "ddp+scp", "ddp+nlp", "shortcut+nlp")
Row = dict[str, Any]


def variants() -> dict[str, Method]:
    """What is run on every log: the methods, chains of them, and what the claims need beside."""
    chained = {name: named(name, METHODS) for name in CHAINS}
    beside = {"cpo points": Cpo(obstacles="points"), "shortcut by trailer length": Shortcut(cost="trailer_length")}
    return dict(METHODS) | chained | beside


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--jobs", type=int, default=2, help="processes (default: %(default)s)")
    parser.add_argument(
        "--time-limit", type=float, default=60.0, help="of a method on a log [s] (default: %(default)s)"
    )
    parser.add_argument("--only", default="", help="logs whose name contains this")
    parser.add_argument("--rows", type=pathlib.Path, help="keep the measured rows in this file")
    parser.add_argument("--from-rows", type=pathlib.Path, help="take the rows from this file")
    options = parser.parse_args()
    if options.from_rows:
        document = json.loads(options.from_rows.read_text())
    else:
        drop_stale()
        document = {"head": _head(options), "rows": list(measure(options))}
        if options.rows:
            options.rows.write_text(json.dumps(document))
    text, figure = report(document)
    (RECORDINGS / "STUDY.md").write_text(text, encoding="utf-8")
    (RECORDINGS / "study_profiles.svg").write_text(figure, encoding="utf-8")
    return 0


def measure(options: argparse.Namespace) -> Iterator[Row]:
    """A row for each log and variant."""
    logs = [(name, RECORDINGS / f"{name}.mcap") for name in SITES]
    logs += [(name, RECORDINGS / "full" / f"{name}.mcap") for name in FULL if not name.startswith("odd_")]
    logs = [pair for pair in logs if options.only in pair[0]]
    listed = read_list(RECORDINGS) | read_list(RECORDINGS / "full")
    begun = time.monotonic()
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        tasks = [pool.submit(_measure, name, path, options.time_limit) for name, path in logs]
        for number, (task, (name, _)) in enumerate(zip(tasks, logs, strict=True), start=1):
            print(f"{number}/{len(logs)} {name} {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)
            entry = listed[name]
            yield from (row | {"class": entry["class"], "map": entry["map"]} for row in task.result())


def _measure(name: str, path: pathlib.Path, time_limit: float) -> list[Row]:
    try:
        case = read_cases(path)[0]
    except ReplayError as error:
        return [{"log": name, "method": "recorded", "status": "unreadable", "reason": str(error)}]
    with Worker(Limits(time_s=time_limit, memory_mib=4096)) as worker:
        run = run_case(case, variants(), solve=worker)
    recorded = {"log": name, "method": "recorded", "status": "recorded", "feasible": run.recorded_audit["passed"]}
    rows = [recorded | {"metrics": run.recorded_metrics}]
    for each in run.methods:
        row = {"log": name, "method": each.name, "status": each.status, "stop": each.stop, "reason": each.reason}
        rows.append(row | {"metrics": each.metrics, "wall_s": each.wall_s, "iterations": each.iterations})
    return rows


def _head(options: argparse.Namespace) -> dict[str, Any]:
    """Where and with what the figures were measured."""
    commit = subprocess.run(["git", "rev-parse", "--short", "HEAD"], capture_output=True, text=True, cwd=RECORDINGS)
    import casadi
    import clarabel
    import cvxpy
    import numba
    import numpy as np
    import scipy

    modules = {module.__name__: module.__version__ for module in (np, scipy, numba, casadi, cvxpy, clarabel)}
    return {
        "commit": commit.stdout.strip() or "unknown",
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}",
        "versions": modules,
        "jobs": options.jobs,
        "time_limit": options.time_limit,
    }


if __name__ == "__main__":
    sys.exit(main())
