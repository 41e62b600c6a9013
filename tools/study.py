"""Run every method over the full corpus and write what came of it: tables, a plot, and the source's claims tested.

In two parts: `methods` runs all methods and chains, and its times mean something on a quiet machine only; `obstacles`
shows methods scarcer descriptions of the obstacles, and counts successes. With a generous time limit, how busy the
machine is does not matter there.

Usage: python tools/study.py [--part methods|obstacles] [--classes A,B] [--only TEXT] [--jobs N] [--time-limit S]
                             [--rows FILE [--budget S]] [--from-rows FILE]

Writes recordings/STUDY.md and recordings/study_profiles.svg, or recordings/STUDY_OBSTACLES.md. `--rows` keeps the
measured rows in a file, log by log, and goes on with those that are missing there, if optim, replay and recordings are
still the same; with `--budget`, no log is begun after so many seconds, and the report is written when none is missing.
`--from-rows` writes the report from such a file without measuring.
"""

import argparse
import json
import math
import os
import pathlib
import platform
import subprocess
import sys
import time
from collections.abc import Sequence
from concurrent.futures import FIRST_COMPLETED, ProcessPoolExecutor, wait
from dataclasses import asdict
from multiprocessing import get_context
from typing import Any

from replay.base.threads import use_one_thread

use_one_thread()

from optim.methods import METHODS  # noqa: E402
from optim.methods.chain import named  # noqa: E402
from optim.methods.cpo.method import Cpo  # noqa: E402
from optim.methods.shortcut import Shortcut  # noqa: E402
from optim.model.method import Method  # noqa: E402
from replay.base.errors import ReplayError  # noqa: E402
from replay.base.files import atomic_write  # noqa: E402
from replay.base.kernels import drop_stale  # noqa: E402
from replay.logs import read_cases  # noqa: E402
from replay.run.judge import run_case  # noqa: E402
from replay.run.limits import Limits  # noqa: E402
from replay.run.worker import Workers  # noqa: E402
from tools.corpus.catalogue import Entry, full_names, read_list, sample_names  # noqa: E402
from tools.script import existing, from_one, method_name, run  # noqa: E402
from tools.study_descriptions import obstacles_report  # noqa: E402
from tools.study_report import report  # noqa: E402
from tools.study_rows import Row  # noqa: E402
from tools.study_scenes import DESCRIPTIONS, Described  # noqa: E402

RECORDINGS = pathlib.Path(__file__).resolve().parent.parent / "recordings"
CHAINS = ("shortcut+scp", "ddp+scp", "ddp+nlp", "shortcut+nlp")
DESCRIBED = ("shortcut", "ddp", "scp")
"""Methods that are also shown scarcer descriptions of the obstacles; `cpo` has its own, and `nlp`, which takes up to a
hundred times as long as `ddp`, solves the problem that `scp` does."""
Document = dict[str, Any]


def variants(part: str, shown_to: Sequence[str] = DESCRIBED) -> dict[str, Method]:
    """What is run on a log: the methods, chains of them and what the claims need beside; or the described ones."""
    if part == "obstacles":
        shown = {
            f"{name} by {description}": Described(method=METHODS[name], description=description)
            for name in shown_to
            for description in DESCRIPTIONS
        }
        return {name: METHODS[name] for name in (*shown_to, "cpo")} | {"cpo points": Cpo(obstacles="points")} | shown
    chained = {name: named(name, METHODS) for name in CHAINS}
    return dict(METHODS) | chained | {"shortcut by trailer length": Shortcut(cost="trailer_length")}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--part", choices=("methods", "obstacles"), default="methods", help="default: %(default)s")
    parser.add_argument(
        "--methods", type=_methods, default=",".join(DESCRIBED), help="of part obstacles (default: %(default)s)"
    )
    parser.add_argument("--classes", type=_words, default="", help="of logs, joined by commas (default: all)")
    parser.add_argument("--jobs", type=from_one, default=2, help="processes (default: %(default)s)")
    parser.add_argument(
        "--time-limit", type=float, default=60.0, help="of a method on a log [s] (default: %(default)s)"
    )
    parser.add_argument("--only", default="", help="logs whose name contains this")
    parser.add_argument("--budget", type=float, default=math.inf, help="begin no log after so many seconds")
    parser.add_argument("--rows", type=pathlib.Path, help="keep the measured rows in this file")
    parser.add_argument("--from-rows", type=existing, help="take the rows from this file")
    options = parser.parse_args()
    if options.from_rows:
        document = json.loads(options.from_rows.read_text())
    else:
        logs = _logs(options.classes, options.only)
        if not logs:
            parser.error("no log is of these classes and has this text in its name")
        drop_stale()
        document = _begun(options)
        missing = measure(document, logs, options)
        if missing:
            print(f"{missing} logs are still to be measured", file=sys.stderr)
            return 0
    if options.part == "obstacles":
        (RECORDINGS / "STUDY_OBSTACLES.md").write_text(obstacles_report(document), encoding="utf-8")
        return 0
    text, figure = report(document)
    (RECORDINGS / "STUDY.md").write_text(text, encoding="utf-8")
    (RECORDINGS / "study_profiles.svg").write_text(figure, encoding="utf-8")
    return 0


def _methods(text: str) -> list[str]:
    return [method_name(word) for word in _words(text)]


def _words(text: str) -> list[str]:
    """The words of an argument that are joined by commas."""
    return [word for word in text.split(",") if word]


def _begun(options: argparse.Namespace) -> Document:
    """What has been measured already, or nothing. Raises SystemExit where that was of other code or options."""
    head = _head(options)
    if not options.rows or not options.rows.exists():
        return {"head": head, "rows": []}
    document = json.loads(options.rows.read_text())
    changed = [key for key in head if key != "commit" and document["head"].get(key) != head[key]]
    if changed:
        raise SystemExit(f"{options.rows} was measured with another {', '.join(changed)}; give another file")
    return document


def measure(document: Document, logs: dict[str, tuple[pathlib.Path, Entry]], options: argparse.Namespace) -> int:
    """Add rows for each log and variant, log by log; how many logs are left when the budget is spent."""
    done = {row["log"] for row in document["rows"]}
    waiting = [name for name in logs if name not in done][::-1]
    asked = variants(options.part, options.methods)
    begun, running = time.monotonic(), {}
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn")) as pool:
        while waiting or running:
            while waiting and len(running) < options.jobs and time.monotonic() - begun < options.budget:
                name = waiting.pop()
                running[pool.submit(_measure, name, logs[name][0], asked, options.time_limit)] = name
            if not running:
                break
            for task in wait(running, return_when=FIRST_COMPLETED).done:
                name = running.pop(task)
                entry = {key: logs[name][1][key] for key in ("class", "map")}
                document["rows"] += [row | entry for row in task.result()]
                print(f"{name} {time.monotonic() - begun:.0f} s, {len(waiting)} wait", file=sys.stderr, flush=True)
                if options.rows:
                    with atomic_write(options.rows) as temporary:
                        temporary.write_text(json.dumps(document))
    return len(waiting)


def _logs(classes: Sequence[str], only: str) -> dict[str, tuple[pathlib.Path, Entry]]:
    """Logs and their entries by name, of all classes if none is asked for; a few of each class before more of any.

    The odd ones are none of them.
    """
    found = {}
    for folder, names in ((RECORDINGS, sample_names()), (RECORDINGS / "full", full_names())):
        listed = read_list(folder)
        for name in names:
            if not name.startswith("odd_") and only in name and (not classes or listed[name]["class"] in classes):
                found[name] = folder / f"{name}.mcap", listed[name]
    return dict(sorted(found.items(), key=lambda item: (item[0].rpartition("_")[2], item[0])))


def _measure(name: str, path: pathlib.Path, methods: dict[str, Method], time_limit: float) -> list[Row]:
    try:
        case = read_cases(path)[0]
    except ReplayError as error:
        return [{"log": name, "method": "recorded", "status": "unreadable", "reason": str(error)}]
    with Workers(Limits(time_s=time_limit, memory_mib=4096)) as workers:
        run = run_case(case, methods, solve=workers)
    recorded = {"log": name, "method": "recorded", "status": "recorded", "feasible": run.recorded_audit.passed}
    rows = [recorded | {"metrics": asdict(run.recorded_metrics)}]
    for each in run.methods:
        row = {"log": name, "method": each.name, "status": each.status, "stop": each.stop, "reason": each.reason}
        rows.append(
            row | {"metrics": asdict(each.metrics), "wall_s": each.wall_s, "rejected": each.rejected is not None}
        )
    return rows


def _head(options: argparse.Namespace) -> dict[str, Any]:
    """Where and with what the figures were measured."""

    def git(*arguments: str) -> str:
        done = subprocess.run(["git", *arguments], capture_output=True, text=True, cwd=RECORDINGS)
        return done.stdout.strip() or "unknown"

    import casadi
    import clarabel
    import cvxpy
    import numba
    import numpy as np
    import scipy

    modules = {module.__name__: module.__version__ for module in (np, scipy, numba, casadi, cvxpy, clarabel)}
    return {
        "commit": git("rev-parse", "--short", "HEAD"),
        "code": [git("rev-parse", f"HEAD:{folder}") for folder in ("optim", "replay", "recordings/full")],
        "machine": f"{os.cpu_count()} cores, {platform.machine()}, Python {platform.python_version()}",
        "versions": modules,
        "part": options.part,
        "methods": ",".join(options.methods),
        "jobs": options.jobs,
        "time_limit": options.time_limit,
    }


if __name__ == "__main__":
    run(main)
