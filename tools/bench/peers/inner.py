"""The section on DDP: our descent beside crocoddyl's on the same stages."""

import contextlib
import importlib.util
import io
import json
import math
import pathlib
import statistics
from typing import Any

from replay.case import Case
from replay.files import atomic_write
from replay.logs import read_cases
from tools.bench.peers import crocoddyl_peer
from tools.bench.peers.common import measure_path, path_at

REPEATS = 1
Row = dict[str, Any]


def run(logs: list[pathlib.Path], folder: pathlib.Path) -> None:
    if importlib.util.find_spec("crocoddyl") is None:
        print("crocoddyl is not installed: its section is left out")
        return
    folder.mkdir(parents=True, exist_ok=True)
    for log in logs:
        file = folder / f"{log.stem}.json"
        if file.exists():
            continue
        case = read_cases(log)[0]
        found: dict[str, list[crocoddyl_peer.Outcome]] = {}
        for turn in range(REPEATS + 1):
            for name, call in (("ours", crocoddyl_peer.ours), ("crocoddyl", crocoddyl_peer.theirs)):
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
        "bound": min(one.bound for one in outcomes),
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
        "knots: clearance at the knots only. J, iterations, CPU milliseconds; `in C++` is what it would take at least "
        "with a compiled model: its own iteration on a linear-quadratic problem of the size, and our kernels.",
        "",
        "| log | stages | ours | crocoddyl, model in Python | in C++ | ratio | in C++ |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    whole, bounds = [], []
    for log, row in rows.items():
        ours, theirs = row["ours"], row["crocoddyl"]
        ratios = theirs["seconds"] / ours["seconds"], theirs["bound"] / ours["seconds"]
        if not _note(ours) and not _note(theirs):
            whole.append(ratios[0])
            bounds.append(ratios[1])
        cells = [f"{one['objective']:.3f}, {one['iterations']}, {1e3 * one['seconds']:.0f}" for one in (ours, theirs)]
        tail = f"{1e3 * theirs['bound']:.0f} | {ratios[0]:.1f} | {ratios[1]:.1f}"
        lines.append(f"| {log} | {ours['stages']} | {cells[0]}{_note(ours)} | {cells[1]}{_note(theirs)} | {tail} |")
    if whole:
        lines += [
            "",
            f"On the {len(whole)} of {len(rows)} logs where both keep the constraints: median ratio "
            f"{statistics.median(whole):.1f} with its model in Python, at least {statistics.median(bounds):.1f} with "
            "one in C++ (asked for: 3). With a compiled model both would spend most of their time in the same "
            "derivatives and collision queries, some 2 us a stage and iteration with the roll-outs; its "
            "backward pass alone takes several times as long as ours (`tools/bench/ddp.py`), but that is the "
            "smaller part. Ours also lists anew what is near, which the bound leaves out. Where crocoddyl "
            "misses, it has used up its iterations: it has no trust in how far a step may go, and jumps over "
            "obstacles.",
        ]
    parking = folder / "car_parking.txt"
    if parking.exists():
        lines += [
            "",
            "pycddp's dynamics, constraints and cost are the same at all stages, and it has no gear changes: it ",
        ]
        lines[-1] += "gets Tassa's car-parking problem instead, its cost in Python, wall time:"
        lines += ["", "```", parking.read_text(encoding="utf-8").strip(), "```"]
    return "\n".join(lines)


def _note(row: Row) -> str:
    worst = max(row["residuals"])
    return "" if math.isfinite(worst) and worst <= 1e-3 else f" (misses by {worst:.1e})"
