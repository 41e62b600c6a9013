"""The section on DDP: our descent beside crocoddyl's on the same stages."""

import contextlib
import importlib.util
import io
import json
import math
import pathlib
import statistics
from collections.abc import Callable
from typing import Any

from optim.model.problem import Problem
from replay.base.files import atomic_write
from replay.logs import read_cases
from replay.run.case import Case
from tools.bench.peers import crocoddyl_build, crocoddyl_peer
from tools.bench.peers.common import measure_path, path_at

REPEATS = 1
Row = dict[str, Any]


def run(logs: list[pathlib.Path], folder: pathlib.Path) -> None:
    if importlib.util.find_spec("crocoddyl") is None:
        print("crocoddyl is not installed: its section is left out")
        return
    calls: dict[str, Callable[[Problem], crocoddyl_peer.Outcome]] = {
        "ours": crocoddyl_peer.ours,
        "crocoddyl": crocoddyl_peer.theirs,
    }
    missing = crocoddyl_build.why_not()
    if missing:
        print(f"crocoddyl with a compiled model is left out: {missing} missing")
    else:
        calls["compiled"] = crocoddyl_peer.theirs_compiled
    folder.mkdir(parents=True, exist_ok=True)
    for log in logs:
        file = folder / f"{log.stem}.json"
        if file.exists():
            continue
        case = read_cases(log)[0]
        found: dict[str, list[crocoddyl_peer.Outcome]] = {}
        for turn in range(REPEATS + 1):
            for name, call in calls.items():
                outcome = call(case.problem)
                if turn:  # the first is for the compiler
                    found.setdefault(name, []).append(outcome)
        row = {name: _row(case, outcomes) for name, outcomes in found.items()}
        print(f"{log.stem:<13}" + "".join(f"{name} {r['seconds']:.3f} s  " for name, r in row.items()), flush=True)
        with atomic_write(file) as temporary:
            temporary.write_text(json.dumps(row, indent=1), encoding="utf-8")
    _car_parking(folder)


def _car_parking(folder: pathlib.Path) -> None:
    """What `tools/bench/ddp.py` prints of pycddp, on the problem that it can state."""
    file = folder / "car_parking.txt"
    if file.exists() or importlib.util.find_spec("pycddp") is None:
        return
    from tools.bench.ddp import car_parking

    printed = io.StringIO()
    with contextlib.redirect_stdout(printed):
        car_parking()
    with atomic_write(file) as temporary:
        temporary.write_text(printed.getvalue().strip() + "\n", encoding="utf-8")


def _row(case: Case, outcomes: list[crocoddyl_peer.Outcome]) -> Row:
    best = min(outcomes, key=lambda one: one.seconds)
    path = path_at(case.problem, best.knots)
    status, failures = ("failed", ("no path",)) if path is None else measure_path(case, path)
    return {
        "objective": best.objective,
        "residuals": best.residuals,
        "iterations": best.iterations,
        "seconds": best.seconds,
        "in_model": best.in_model,
        "stages": len(best.knots.phi),
        "status": status,
        "failures": failures,
    }


def report(folder: pathlib.Path) -> str:
    rows = {path.stem: json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))}
    lines = [
        "## One descent of DDP: crocoddyl on the same stages",
        "",
        "crocoddyl has box limits of the controls, but neither other constraints nor bounds that move with the state: "
        "it gets our stages with the same Gauss-Newton derivatives, the augmented Lagrangian as cost, and our outer "
        "iteration (`tools/bench/peers/crocoddyl_peer.py`). The problem is that of our first descent, at the fine "
        "knots: clearance at the knots only. Its model calls our compiled kernels of a stage: once from Python, as "
        "its wheel has it, and once from C++ (`crocoddyl_model.cpp`), where nothing of an iteration is left in "
        "Python. J, iterations, CPU milliseconds; the ratios are those of the times to ours.",
        "",
        "| log | stages | ours | crocoddyl, model in Python | crocoddyl, model in C++ | ratio, Python | ratio, C++ |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    names = ("ours", "crocoddyl", "compiled")
    ratios: dict[str, list[float]] = {name: [] for name in names[1:]}
    for log, row in rows.items():
        cells = [_cell(row.get(name)) for name in names]
        for name in names[1:]:
            ratio = row[name]["seconds"] / row["ours"]["seconds"] if name in row else math.nan
            cells.append(f"{ratio:.1f}" if name in row else "")
            if name in row and not _note(row["ours"]) and not _note(row[name]):
                ratios[name].append(ratio)
        lines.append(f"| {log} | {row['ours']['stages']} | " + " | ".join(cells) + " |")
    lines += ["", *_words(ratios, len(rows))]
    parking = folder / "car_parking.txt"
    if parking.exists():
        lines += [
            "",
            "pycddp's dynamics, constraints and cost are the same at all stages, and it has no gear changes: it ",
        ]
        lines[-1] += "gets Tassa's car-parking problem instead, its cost in Python, wall time:"
        lines += ["", "```", parking.read_text(encoding="utf-8").strip(), "```"]
    return "\n".join(lines)


def _words(ratios: dict[str, list[float]], logs: int) -> list[str]:
    """What the table comes to, on the logs where both keep the constraints."""
    parts = [
        f"{statistics.median(found):.1f} with its model in {where} ({len(found)} of {logs} logs)"
        for found, where in ((ratios["crocoddyl"], "Python"), (ratios["compiled"], "C++"))
        if found
    ]
    if not parts:
        return []
    return [
        f"Median ratio on the logs where both keep the constraints: {', '.join(parts)} (asked for: 3). Where crocoddyl "
        "misses, it has used up its iterations: it has no trust in how far a step may go, and jumps over obstacles."
    ]


def _cell(row: Row | None) -> str:
    if row is None:
        return ""
    return f"{row['objective']:.3f}, {row['iterations']}, {1e3 * row['seconds']:.0f}{_note(row)}"


def _note(row: Row) -> str:
    worst = max(row["residuals"])
    return "" if math.isfinite(worst) and worst <= 1e-3 else f" (misses by {worst:.1e})"
