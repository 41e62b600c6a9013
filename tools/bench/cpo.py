"""How fast the points of coordinate points optimisation come to rest, and how low, against plain minimisers.

`python tools/bench/cpo.py [recordings/*.mcap]` takes the longest segment of each log, lays 300 points along it
(`--points`) and lowers the same cost from the same start: by BFGS and L-BFGS in the metric of the sum of squares
(`optim.methods.cpo.bfgs`), and by scipy's BFGS and L-BFGS-B in plain coordinates. All are run to rest: ours to a
promised decrease of 1e-10 of the cost, scipy's to its own tolerances, at most 3000 iterations. CPU seconds, one run
each after a warm-up. Then J of every log by the whole method, beside the shortcut's.
"""

import argparse
import pathlib
import time
from collections.abc import Callable

import numpy as np
from scipy.optimize import minimize

from optim.methods.cpo.bfgs import minimise_bfgs
from optim.methods.cpo.method import Cpo
from optim.methods.cpo.points import AxlePoints, RecordedAxle, spread
from optim.methods.cpo.terms import Terms
from optim.methods.shortcut import Shortcut
from optim.model.objective import objective
from optim.model.problem import Problem
from optim.numerics.arrays import Array
from replay.base.kernels import drop_stale
from replay.logs import read_cases
from tools.script import existing, from_one, run

RECORDINGS = pathlib.Path(__file__).resolve().parents[2] / "recordings"
MOST_ITERATIONS = 3000
Solved = tuple[float, int]  # cost, iterations


def start(problem: Problem, num_points: int) -> tuple[Terms, AxlePoints]:
    """The cost, and the points of the longest segment as recorded."""
    segment = max(problem.recorded.segments, key=lambda one: one.trailer_length)
    axle = RecordedAxle.of(problem.vehicle, segment)
    row = spread(axle, axle.flat[:, :2], axle.share, axle.length / (num_points - 1), np.empty((0, 2)))
    return Cpo().terms(problem, row.spacing), row


def in_metric(terms: Terms, row: AxlePoints, memory: int) -> Solved:
    """By our BFGS (L-BFGS where `memory` is small), in the metric of the sum of squares."""
    free = ~row.anchored
    limits = {"max_iterations": MOST_ITERATIONS, "tolerance": 1e-10, "max_step": 0.5}
    done = minimise_bfgs(terms.evaluate, row.xy, free, memory=memory, **limits)
    return done.value, done.iterations


def plain(terms: Terms, row: AxlePoints, name: str) -> Solved:
    """By scipy's method of this name, in plain coordinates."""
    free = ~row.anchored
    points = row.xy.copy()

    def cost(unknowns: Array) -> tuple[float, Array]:
        points[free] = unknowns.reshape(-1, 2)
        value, slope, _ = terms.evaluate(points, with_metric=False)
        return value, slope[free].ravel()

    most = {"maxiter": MOST_ITERATIONS, "maxfun": 10**6} if name == "L-BFGS-B" else {"maxiter": MOST_ITERATIONS}
    done = minimize(cost, row.xy[free].ravel(), jac=True, method=name, options=most)
    return float(done.fun), int(done.nit)


MINIMISERS: dict[str, Callable[[Terms, AxlePoints], Solved]] = {
    "BFGS, in the metric": lambda terms, row: in_metric(terms, row, MOST_ITERATIONS),
    "L-BFGS, in the metric": lambda terms, row: in_metric(terms, row, 20),
    "scipy BFGS": lambda terms, row: plain(terms, row, "BFGS"),
    "scipy L-BFGS-B": lambda terms, row: plain(terms, row, "L-BFGS-B"),
}


def main() -> None:
    parser = argparse.ArgumentParser(description="Points of CPO against plain minimisers, and J of every log.")
    parser.add_argument("logs", nargs="*", type=existing, metavar="LOG", help="default: the sample logs")
    parser.add_argument("--points", type=from_one, default=300, help="on a segment (default: %(default)s)")
    parser.add_argument("--slow", type=int, default=3, help="logs for which scipy's minimisers are run too")
    arguments = parser.parse_args()
    logs = arguments.logs or sorted(RECORDINGS.glob("*.mcap"))
    drop_stale()
    problems = {case.name: case.problem for log in logs for case in read_cases(log)}
    in_metric(*start(next(iter(problems.values())), 50), 10)
    print(f"{arguments.points} points on the longest segment: cost (iterations) CPU [s]\n")
    print("| log | start |", " | ".join(MINIMISERS), "|")
    print("|---|--:|" + "--:|" * len(MINIMISERS))
    for index, (name, problem) in enumerate(problems.items()):
        terms, row = start(problem, arguments.points)
        cells = [f"{terms.evaluate(row.xy)[0]:.4f}"]
        for label, minimiser in MINIMISERS.items():
            if "scipy" in label and index >= arguments.slow:
                cells.append("")
                continue
            began = time.process_time()
            cost, iterations = minimiser(terms, row)
            cells.append(f"{cost:.6f} ({iterations}) {time.process_time() - began:.2f}")
        print(f"| {name} |", " | ".join(cells), "|", flush=True)
    print("\n| log | J recorded | cpo | shortcut | CPU of cpo [s] |\n|---|--:|--:|--:|--:|")
    for name, problem in problems.items():
        began = time.process_time()
        path = Cpo().solve(problem).path
        seconds = time.process_time() - began
        values = [objective(one, problem.weights) for one in (problem.recorded, path, Shortcut().solve(problem).path)]
        print(f"| {name} |", " | ".join(f"{value:.2f}" for value in values), f"| {seconds:.2f} |")


if __name__ == "__main__":
    run(main)
