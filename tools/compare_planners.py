"""Compare the planners of optim/planning on sites of every class, and put the table into recordings/README.md.

Usage: python tools/compare_planners.py [--sites N] [--seeds N] [--time-limit S] [--jobs N] [--print]

The sites are those of tools/corpus/families.py, each in the first variant whose start and goal are free, whether or
not any planner finds a path there. A path counts as found when it passes the audit.
"""

import argparse
import itertools
import math
import os
import pathlib
import sys
import time
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from dataclasses import asdict
from multiprocessing import get_context
from typing import Any

import numpy as np

from replay.base.threads import use_one_thread

use_one_thread()

from optim.audit.checks import audit_recorded  # noqa: E402 - after the threads have been settled
from optim.model.metrics import metrics  # noqa: E402
from optim.model.objective import Weights  # noqa: E402
from optim.planning.closed_loop import ClosedLoopRrt  # noqa: E402
from optim.planning.hybrid import HybridAStar  # noqa: E402
from optim.planning.protocol import GiveUp, Planner, PlanningProblem  # noqa: E402
from optim.planning.rrt import Rrt  # noqa: E402
from replay.base.kernels import drop_stale  # noqa: E402
from replay.run.plain import path_to_document, scene_to_document  # noqa: E402
from tools.corpus.build import problem_of  # noqa: E402
from tools.corpus.families import CLASSES, draw_site  # noqa: E402
from tools.corpus.grid import draw_grid  # noqa: E402
from tools.corpus.site import Site  # noqa: E402
from tools.corpus.tables import kept_table  # noqa: E402
from tools.script import from_one, run  # noqa: E402

README = pathlib.Path(__file__).resolve().parent.parent / "recordings" / "README.md"
BEGIN, END = "<!-- planners: begin -->", "<!-- planners: end -->"
NO_BOUND = 10**6  # the time limit ends every search
PLANNERS: tuple[Planner, ...] = (
    Rrt(max_iterations=20_000),
    ClosedLoopRrt(max_iterations=NO_BOUND, table=kept_table),
    HybridAStar(max_nodes=1_000_000, table=kept_table),
)
Row = dict[str, Any]


def main(arguments: Sequence[str] | None = None) -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sites", type=from_one, default=4, help="sites of each class (default: %(default)s)")
    parser.add_argument("--seeds", type=from_one, default=3, help="seeds on each site (default: %(default)s)")
    parser.add_argument("--time-limit", type=float, default=10.0, help="of a search [s] (default: %(default)s)")
    parser.add_argument("--jobs", type=from_one, default=2, help="processes (default: %(default)s)")
    parser.add_argument("--print", action="store_true", help="print the table; leave the README as it is")
    options = parser.parse_args(arguments)
    drop_stale()
    rows = measure(options)
    text = table(rows, options)
    if options.print:
        print(text)
    else:
        README.write_text(with_table(README.read_text(encoding="utf-8"), text), encoding="utf-8")
    return 0


def measure(options: argparse.Namespace) -> list[Row]:
    """A row for each class, site, seed and planner."""
    chosen = [(kind, number) for kind in CLASSES for number in range(1, options.sites + 1)]
    for vehicle in {problem.vehicle for problem in map(_problem, chosen)}:
        kept_table(vehicle)  # so that no search is charged for it
    begun, rows = time.monotonic(), []
    with ProcessPoolExecutor(options.jobs, mp_context=get_context("spawn"), initializer=_warm_up) as pool:
        tasks = [pool.submit(_measure, kind, number, options.seeds, options.time_limit) for kind, number in chosen]
        for (kind, number), task in zip(chosen, tasks, strict=True):
            rows += task.result()
            print(f"{kind}_{number:02d} {time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)
    return rows


def _warm_up() -> None:
    """Load the compiled code before anything is timed."""
    problem = _problem(("open", 1))
    for planner in PLANNERS:
        planner.plan(problem, 0, after(10.0))


def first_free(kind: str, number: int) -> Site:
    """The first variant of a site whose start and goal are free."""
    return next(site for variant in itertools.count() if (site := draw_site(kind, number, variant)) is not None)


def after(time_limit: float) -> GiveUp:
    """Whether so many seconds have passed since now."""
    end = time.monotonic() + time_limit
    return lambda: time.monotonic() > end


def _problem(key: tuple[str, int]) -> PlanningProblem:
    site = first_free(*key)
    return problem_of(site, draw_grid(site))


def _measure(kind: str, number: int, seeds: int, time_limit: float) -> list[Row]:
    problem, rows = _problem((kind, number)), []
    kept_table(problem.vehicle)
    for seed, planner in itertools.product(range(seeds), PLANNERS):
        row = {"class": kind, "site": f"{kind}_{number:02d}", "seed": seed, "planner": planner.name}
        begun = time.perf_counter()
        plan = planner.plan(problem, seed, after(time_limit))
        row |= {"seconds": time.perf_counter() - begun, "found": False, "audit": True}
        if plan is not None:
            scene, path = scene_to_document(problem.scene), path_to_document(plan.path)
            row["audit"] = row["found"] = audit_recorded(asdict(problem.vehicle), scene, path).passed
            row |= asdict(metrics(problem.vehicle, problem.scene, plan.path, Weights()))
        rows.append(row)
    return rows


def table(rows: Sequence[Row], options: argparse.Namespace) -> str:
    """The comparison as text for the README."""
    lines = [
        "| class | planner | found | time [s] | J | length [m] | gear changes |",
        "|---|---|--:|--:|--:|--:|--:|",
    ]
    for kind in (*CLASSES, "all"):
        mine = [row for row in rows if kind in ("all", row["class"])]
        lines += [_line(kind, planner.name, mine) for planner in PLANNERS]
    unsound = sum(not row["audit"] for row in rows)
    return f"""\
{options.sites} sites of each class, {options.seeds} seeds on each, at most {options.time_limit:g} s for a search,
{options.jobs} at a time on {os.cpu_count()} cores; {unsound} paths were found and failed the audit. Found: share of
searches. Time: median of all searches, one that finds nothing counts with the limit. J, length, gear changes: means
over the searches of the class in which all three planners found a path (their number in brackets).

{chr(10).join(lines)}"""


def _line(kind: str, name: str, rows: Sequence[Row]) -> str:
    keys = {(row["site"], row["seed"]) for row in rows}
    by = {(row["site"], row["seed"], row["planner"]): row for row in rows}
    common = [key for key in keys if all(by[*key, planner.name]["found"] for planner in PLANNERS)]
    mine = [row for row in rows if row["planner"] == name]
    found = sum(row["found"] for row in mine)
    seconds = [row["seconds"] if row["found"] else math.inf for row in mine]
    median = float(np.median(seconds))
    figures = [f"{100.0 * found / len(mine):.0f} %", f"{median:.2f}" if math.isfinite(median) else "at the limit"]
    for key in ("objective", "length", "cusps"):
        values = [by[*each, name][key] for each in common]
        figures.append(f"{np.mean(values):.1f}" if values else "–")
    figures[2] += f" ({len(common)})"
    return f"| `{kind}` | {name} | " + " | ".join(figures) + " |"


def with_table(readme: str, text: str) -> str:
    """The README with the text between the markers. Raises ValueError where they are missing."""
    before, begin, rest = readme.partition(BEGIN)
    _, end, after = rest.partition(END)
    if not begin or not end:
        raise ValueError(f"the README has no {BEGIN} ... {END}")
    return f"{before}{BEGIN}\n{text}\n{END}{after}"


if __name__ == "__main__":
    run(main)
