"""The section on scaling: cost against obstacles, knots, gear changes, and cells of a grid; exponents fitted."""

import json
import pathlib
from collections.abc import Callable
from dataclasses import replace
from typing import Any

import numpy as np
import shapely

from optim.geometry.cover import cover_cells
from optim.knots.transcription import knots_of
from optim.methods import METHODS
from optim.methods.ddp.method import Ddp
from optim.methods.scp.method import Scp
from optim.methods.scp.statement import bucket, statement
from optim.model.method import Method
from optim.model.path import Path, Segment, reverse, segment_from_states
from optim.model.problem import Problem
from optim.model.scene import make_scene
from optim.model.vehicle import body_corners
from replay.base.files import atomic_write
from replay.logs import read_cases
from tools.bench.timing import least

LOG = "bay_01"
OBSTACLES = (12, 30, 100, 300, 1000, 2000)
KNOTS = (100, 200, 400, 800, 1200, 2000)
DETOURS = (0, 1, 2, 3)
"""Pairs of gear changes put into the path."""
SIDES = (250, 500, 1000, 2000)
CLEAR = 2.0
"""Added obstacles keep this far from the recorded path and from the best one [m], so that the answer stays."""
Row = dict[str, Any]


def crowded(problem: Problem, total: int, best: Path) -> Problem:
    """The same problem with small obstacles strewn round the path until there are `total`."""
    rng = np.random.default_rng(total)
    states = np.concatenate([problem.recorded.samples.states[::5], best.samples.states[::5]])
    swept = shapely.union_all(shapely.polygons(body_corners(problem.vehicle, states).reshape(-1, 4, 2)))
    free = shapely.buffer(swept, CLEAR)
    shapely.prepare(free)
    low, high = states[:, :2].min(axis=0) - 40.0, states[:, :2].max(axis=0) + 40.0
    polygons = list(problem.scene.polygons)
    while len(polygons) < total:
        turn = np.sort(rng.uniform(0.0, 2.0 * np.pi, 6))
        ring = rng.uniform(low, high) + rng.uniform(0.2, 0.6) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        if not shapely.intersects(free, shapely.Polygon(ring)):
            polygons.append(ring)
    return replace(problem, scene=make_scene(polygons))


def detoured(problem: Problem, pairs: int) -> Problem:
    """The same problem, its first segments driven back and forth again for 4 m at `pairs` places."""
    first, *others = problem.recorded.segments
    cuts = np.searchsorted(first.s, np.linspace(0.3, 0.9, pairs) * first.length).tolist()
    parts: list[Segment] = []
    begin = 0
    for cut in cuts:
        back = int(np.searchsorted(first.s, first.s[cut] - 4.0))
        parts += [_part(first, begin, cut), reverse(Path((_part(first, back, cut),))).segments[0]]
        begin = back
    parts.append(_part(first, begin, first.num_samples - 1))
    return replace(problem, recorded=Path((*parts, *others)))


def _part(segment: Segment, begin: int, end: int) -> Segment:
    """The segment from one sample to another."""
    inside = slice(begin, end + 1)
    s = segment.s[inside]
    return segment_from_states(segment.direction, s - s[0], segment.states[inside], segment.phi[inside])


def solved(method: Method, problem: Problem) -> Row:
    """CPU seconds, iterations, gear changes left."""
    results = []
    spent = least(lambda: results.append(method.solve(problem)), 2)
    return {"seconds": spent, "iterations": results[0].iterations, "cusps": results[0].path.num_cusps}


def measure(problem: Problem) -> Row:
    """All four tables: obstacles, knots, gear changes, cells."""
    scp, ddp = Scp(), Ddp()
    best = ddp.solve(problem).path
    scp.solve(problem)
    out: Row = {"obstacles": [], "knots": [], "cusps": [], "grid": []}
    for total in OBSTACLES:
        crowd = crowded(problem, total, best)
        out["obstacles"].append({"n": total, "ddp": solved(ddp, crowd), "scp": solved(scp, crowd)})
        print(out["obstacles"][-1], flush=True)
    for count in KNOTS:
        spacing = problem.recorded.length / count
        statement(bucket(len(knots_of(problem.vehicle, problem.recorded, spacing).phi)))
        fine = Ddp(spacing=spacing, coarse_spacing=max(0.8, spacing))
        row = {"n": count, "ddp": solved(fine, problem)}
        row["scp"] = solved(Scp(spacing=spacing, removals=0), problem)
        out["knots"].append(row)
        print(row, flush=True)
    for pairs in DETOURS:
        more = detoured(problem, pairs)
        row = {"n": more.recorded.num_cusps, "knots": int(more.recorded.length / 0.35)}
        out["cusps"].append(row | {name: solved(METHODS[name], more) for name in ("ddp", "scp")})
        print(out["cusps"][-1], flush=True)
    for side in SIDES:
        cells = yard_cells(side)
        polygons = cover_cells(cells, 0.05)
        covered = least(lambda cells=cells: cover_cells(cells, 0.05), 2)
        packed = least(lambda polygons=polygons: make_scene(polygons).packed, 2)
        out["grid"].append({"n": side, "occupied": int(cells.sum()), "polygons": len(polygons), "seconds": covered})
        out["grid"][-1]["seconds"] += packed
        print(out["grid"][-1], flush=True)
    return out


def yard_cells(side: int) -> np.ndarray:
    """A square map: parked boxes in all directions, walls, and speckles; about a tenth occupied."""
    rng = np.random.default_rng(side)
    y, x = np.mgrid[0:side, 0:side].astype(np.float32) / side
    cells = np.zeros((side, side), dtype=bool)
    for _ in range(40):
        (cx, cy), angle = rng.uniform(0.0, 1.0, 2), rng.uniform(0.0, np.pi)
        c, s = np.cos(angle), np.sin(angle)
        along, across = c * (x - cx) + s * (y - cy), c * (y - cy) - s * (x - cx)
        cells |= (np.abs(along) < 0.06) & (np.abs(across) < 0.013)
    cells[:3], cells[-3:], cells[:, :3], cells[:, -3:] = True, True, True, True
    cells.ravel()[rng.choice(side * side, side // 2, replace=False)] = True
    return cells


def run(logs: list[pathlib.Path], folder: pathlib.Path) -> None:
    file = folder / f"{LOG}.json"
    chosen = [log for log in logs if log.stem == LOG]
    if file.exists() or not chosen:
        return
    folder.mkdir(parents=True, exist_ok=True)
    row = measure(read_cases(chosen[0])[0].problem)
    with atomic_write(file) as temporary:
        temporary.write_text(json.dumps(row, indent=1), encoding="utf-8")


def exponent(rows: list[Row], of: Callable[[Row], float]) -> float:
    """The slope of log(cost) over log(n), least squares."""
    pairs = [(np.log(row["n"]), np.log(of(row))) for row in rows if row["n"] > 0]
    x, y = np.array(pairs).T
    return float(np.polyfit(x, y, 1)[0])


def report(folder: pathlib.Path) -> str:
    row = json.loads((folder / f"{LOG}.json").read_text(encoding="utf-8"))
    lines = [
        "## Scaling",
        "",
        f"{LOG}, CPU seconds (iterations); the statement of scp's sub-problem compiled before.",
        "",
    ]
    titles = {
        "obstacles": "Obstacles strewn round the path, none nearer than 2 m to where it leads",
        "knots": "Knots (a finer spacing; scp without trying to leave segments out)",
        "cusps": "Gear changes (detours of 4 m put into the path; those left at the end after the arrow)",
    }
    for part, title in titles.items():
        rows = row[part]
        lines += [f"| {title} | " + " | ".join(str(one["n"]) for one in rows) + " | exponent | each iteration |"]
        lines += ["|---|" + "--:|" * (len(rows) + 2)]
        for name in ("ddp", "scp"):
            cells = [f"{one[name]['seconds']:.3g} ({one[name]['iterations']})" for one in rows]
            if part == "cusps":
                cells = [f"{cell} → {one[name]['cusps']}" for cell, one in zip(cells, rows, strict=True)]
            whole = exponent(rows, lambda one, name=name: one[name]["seconds"])
            each = exponent(rows, lambda one, name=name: one[name]["seconds"] / one[name]["iterations"])
            lines.append(f"| {name} | {' | '.join(cells)} | {whole:.2f} | {each:.2f} |")
        lines.append("")
    rows = {one["n"]: one for one in row["obstacles"]}
    ratios = [f"{name} {rows[1000][name]['seconds'] / rows[12][name]['seconds']:.2f}" for name in ("ddp", "scp")]
    lines += [
        f"1,000 obstacles cost {' and '.join(ratios)} times as much as the log's own 12 (asked for: 2 at most).",
        "",
    ]
    lines += ["| grid, cells | occupied | polygons | covered and packed, CPU [s] |", "|---|--:|--:|--:|"]
    for one in row["grid"]:
        lines.append(f"| {one['n']} × {one['n']} | {one['occupied']} | {one['polygons']} | {one['seconds']:.2f} |")
    lines += ["", "Asked for: 2000 × 2000 in 1.5 s."]
    return "\n".join(lines)
