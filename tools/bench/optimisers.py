"""J, gear changes and time of the methods at knots on logs, in one run: nlp, scp, and scp after shortcut.

Usage: python tools/bench/optimisers.py LOG...

Each method solves every log once after a first solution that is not counted (compilation, loading). Times are CPU
seconds, with building and solving. The last columns compare scp with nlp.
"""

import argparse
import pathlib
import sys
import time

import numpy as np

from optim.methods import METHODS as KNOWN
from optim.methods import Method
from optim.methods.chain import named
from optim.objective import objective
from optim.problem import Problem
from optim.result import Iterate, OnIterate, Result, ignore
from replay.case import Case
from replay.kernels import drop_stale
from replay.logs import ReadOptions, read_cases
from replay.run import run_case

METHODS = ("nlp", "scp", "shortcut+scp")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=pathlib.Path)
    logs = parser.parse_args().logs
    drop_stale()
    cases = [(log.stem, read_cases(log, ReadOptions())[0]) for log in logs]
    methods = {name: named(name, KNOWN) for name in METHODS}
    for method in methods.values():
        method.solve(cases[0][1].problem)
    print(f"{'log':<13}{'recorded':>13}" + "".join(f"{name:>25}" for name in METHODS) + f"{'dJ [%]':>9}{'time':>8}")
    ratios, differences = [], []
    for name, case in cases:
        rows = [_measure(case, key, method) for key, method in methods.items()]
        (nlp_j, nlp_s), (scp_j, scp_s) = ((row[0], row[2]) for row in rows[:2])
        differences.append(100.0 * (scp_j / nlp_j - 1.0))
        ratios.append(nlp_s / scp_s)
        before = f"{objective(case.problem.recorded, case.problem.weights):.2f} / {case.problem.recorded.num_cusps}"
        cells = "".join(f"{f'{j:.3f} / {cusps} {seconds:6.2f} s {word}':>25}" for j, cusps, seconds, word in rows)
        print(f"{name:<13}{before:>13}{cells}{differences[-1]:>9.3f}{ratios[-1]:>7.1f}x", flush=True)
    within = sum(difference <= 0.1 for difference in differences)
    print(f"scp within 0.1 % of nlp or better on {within} of {len(cases)}; median time ratio {np.median(ratios):.1f}")
    _sub_problems(cases[0][1].problem)
    return 0


def _measure(case: Case, name: str, method: Method) -> tuple[float, int, float, str]:
    """J, gear changes, CPU seconds of solving alone, and the first letter of the audited status."""
    started = time.process_time()
    result = method.solve(case.problem)
    seconds = time.process_time() - started
    run = run_case(case, {name: _Given(result)}).methods[0]
    return objective(run.path, case.problem.weights), run.path.num_cusps, seconds, run.status[0]


class _Given:
    """A method that gives back a result that is there already, so that it is audited without solving again."""

    def __init__(self, result: Result) -> None:
        self.result = result

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        del problem, on_iterate
        return self.result


def _sub_problems(problem: Problem) -> None:
    """How much of scp's time is spent outside the solver."""
    solver: list[float] = []

    def tell(iterate: Iterate) -> None:
        if np.isfinite(iterate.solver_s):
            solver.append(iterate.solver_s)

    started = time.perf_counter()
    KNOWN["scp"].solve(problem, tell)
    whole = time.perf_counter() - started
    print(
        f"{len(solver)} sub-problems, {whole / len(solver) * 1e3:.1f} ms each, {sum(solver) / whole:.0%} in the solver"
    )


if __name__ == "__main__":
    sys.exit(main())
