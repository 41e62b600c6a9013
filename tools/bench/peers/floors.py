"""The section on where the time goes: a profile of each method on three logs, and what is above its floor.

The floor of a method is the time in its compiled kernels (collision queries, derivatives, backward passes) and in the
solvers that it hands its sub-problems to (Clarabel's factorisations, IPOPT): what would be left if Python cost
nothing. The profiler makes Python look slower than it is, so the ratios are upper bounds.
"""

import cProfile
import json
import pathlib
import pstats
import sys
import time
from typing import Any

import numpy as np
from numba.core.registry import CPUDispatcher

from optim.methods import METHODS
from optim.model.problem import Problem
from replay.base.files import atomic_write
from replay.logs import read_cases

LOGS = ("bay_01", "dock_01", "parallel_02")
SOLVERS = ("DefaultSolver", "_solve_clarabel", "casadi", "solve_banded", "cho_solve", "cholesky", "_lapack", "linalg")
Row = dict[str, Any]


def kernels() -> set[tuple[str, str]]:
    """File and name of every compiled kernel that is loaded."""
    found = set()
    for name, module in list(sys.modules.items()):
        if not name.startswith("optim"):
            continue
        for value in vars(module).values():
            if isinstance(value, CPUDispatcher):
                found.add((value.py_func.__code__.co_filename, value.py_func.__name__))
    return found


def profiled(problem: Problem, name: str) -> Row:
    """CPU seconds, and shares of the profile: kernels, solvers, numpy and scipy, Python; the largest entries."""
    method = METHODS[name]
    method.solve(problem)
    times = []
    for _ in range(2):
        began = time.process_time()
        method.solve(problem)
        times.append(time.process_time() - began)
    profile = cProfile.Profile(time.process_time)
    profile.enable()
    method.solve(problem)
    profile.disable()
    known = kernels()
    shares: dict[str, float] = dict.fromkeys(("kernels", "solvers", "numpy", "Python"), 0.0)
    entries: list[tuple[float, str]] = []
    table: Any = pstats.Stats(profile)  # its entries are not in the stubs
    for (file, _, function), (_, _, own, _, _) in table.stats.items():
        kind = _kind(file, function, known)
        shares[kind] += own
        entries.append((own, f"{pathlib.Path(file).stem}.{function}" if file != "~" else function))
    total = sum(shares.values())
    entries.sort(reverse=True)
    return {
        "seconds": min(times),
        "shares": {kind: value / total for kind, value in shares.items()},
        "largest": [(own / total, words) for own, words in entries[:3]],
    }


def _kind(file: str, function: str, known: set[tuple[str, str]]) -> str:
    if (file, function) in known:
        return "kernels"
    if any(word in function or word in file for word in SOLVERS):
        return "solvers"
    if file == "~" or "numpy" in file or "scipy" in file:
        return "numpy"
    return "Python"


def run(logs: list[pathlib.Path], folder: pathlib.Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for log in logs:
        file = folder / f"{log.stem}.json"
        if file.exists() or log.stem not in LOGS:
            continue
        problem = read_cases(log)[0].problem
        row = {name: profiled(problem, name) for name in METHODS}
        for name, one in row.items():
            print(log.stem, name, one, flush=True)
        with atomic_write(file) as temporary:
            temporary.write_text(json.dumps(row, indent=1), encoding="utf-8")


def report(folder: pathlib.Path) -> str:
    rows = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))}
    lines = [
        "## Where the time goes",
        "",
        f"Profiles on {', '.join(rows)}: mean shares of the time in our compiled kernels, in solvers and "
        "factorisations, in numpy and scipy, and in Python; the ratio of the whole to the floor, which is the first "
        "two; and the largest entries. The profiler makes Python look slower than it is.",
        "",
        "| | CPU [s] | kernels | solvers | numpy, scipy | Python | whole / floor | largest entries |",
        "|---|--:|--:|--:|--:|--:|--:|---|",
    ]
    for name in METHODS:
        mine = [row[name] for row in rows.values()]
        shares = {kind: float(np.mean([one["shares"][kind] for one in mine])) for kind in mine[0]["shares"]}
        seconds = " / ".join(f"{one['seconds']:.3g}" for one in mine)
        largest = ", ".join(f"{_word(words)} {share:.0%}" for share, words in mine[0]["largest"])
        cells = " | ".join(f"{value:.0%}" for value in shares.values())
        ratio = 1.0 / (shares["kernels"] + shares["solvers"])
        lines.append(f"| {name} | {seconds} | {cells} | {ratio:.2f} | {largest} |")
    return "\n".join(lines)


def _word(function: str) -> str:
    return function.replace("{", "").replace("}", "").replace("<", "").replace(">", "").replace("|", "")
