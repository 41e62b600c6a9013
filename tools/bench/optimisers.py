"""J, gear changes and time of the methods at knots on logs, in one run: nlp, scp, ddp, and scp after shortcut.

Usage: python tools/bench/optimisers.py LOG...

Each method solves every log once after a first solution that is not counted (compilation, loading). Times are CPU
seconds, with building and solving; of ddp, which is short, the least of three. The last columns compare scp with
nlp, and ddp with the better of both; its times are those of the other over its own.
"""

import argparse
import time
from typing import Any
from unittest.mock import patch

import numpy as np

from optim.methods import METHODS as KNOWN
from optim.methods.chain import named
from optim.methods.scp import method as scp
from optim.methods.scp.subproblem import SubproblemSolution
from optim.model.method import Method
from optim.model.objective import objective
from optim.model.problem import Problem
from optim.model.result import Result
from replay.base.kernels import drop_stale
from replay.base.threads import use_one_thread
from replay.logs import ReadOptions, read_cases
from replay.run.case import Case
from replay.run.judge import run_case
from tools.bench.peers.common import Given
from tools.script import existing, run

METHODS = ("nlp", "scp", "ddp", "shortcut+scp")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="+", type=existing, metavar="LOG")
    logs = parser.parse_args().logs
    use_one_thread()  # IPOPT's linear algebra, loaded later, else spends twice the CPU time for the same solution
    drop_stale()
    cases = [(log.stem, read_cases(log, ReadOptions())[0]) for log in logs]
    methods = {name: named(name, KNOWN) for name in METHODS}
    for method in methods.values():
        method.solve(cases[0][1].problem)
    heads = (
        f"{'log':<13}{'recorded':>13}" + "".join(f"{name:>25}" for name in METHODS) + f"{'scp/nlp [%]':>13}{'time':>8}"
    )
    print(heads + f"{'ddp/best [%]':>14}{'time':>16}")
    ratios, differences, ddp_ratios, ddp_differences = [], [], [], []
    for name, case in cases:
        rows = [_measure(case, key, method) for key, method in methods.items()]
        (nlp_j, nlp_s), (scp_j, scp_s), (ddp_j, ddp_s) = ((row[0], row[2]) for row in rows[:3])
        differences.append(100.0 * (scp_j / nlp_j - 1.0))
        ratios.append(nlp_s / scp_s)
        ddp_differences.append(100.0 * (ddp_j / min(nlp_j, scp_j) - 1.0))
        ddp_ratios.append((nlp_s / ddp_s, scp_s / ddp_s))
        before = f"{objective(case.problem.recorded, case.problem.weights):.2f} / {case.problem.recorded.num_cusps}"
        cells = "".join(f"{f'{j:.3f} / {cusps} {seconds:6.2f} s {word}':>25}" for j, cusps, seconds, word in rows)
        print(
            f"{name:<13}{before:>13}{cells}{differences[-1]:>13.3f}{ratios[-1]:>7.1f}x"
            f"{ddp_differences[-1]:>14.3f}{ddp_ratios[-1][0]:>8.1f}x{ddp_ratios[-1][1]:>6.1f}x",
            flush=True,
        )
    within = sum(difference <= 0.1 for difference in differences)
    print(f"scp within 0.1 % of nlp or better on {within} of {len(cases)}; median time ratio {np.median(ratios):.1f}")
    close = sum(difference <= 0.5 for difference in ddp_differences)
    to_nlp, to_scp = np.median(ddp_ratios, axis=0)
    print(f"ddp within 0.5 % of the better of both on {close} of {len(cases)}; ", end="")
    print(f"median time ratio {to_nlp:.0f} to nlp, {to_scp:.1f} to scp")
    for name, case in cases:
        print(f"{name:<13}{_sub_problems(case.problem)}")
    return 0


def _measure(case: Case, name: str, method: Method) -> tuple[float, int, float, str]:
    """J, gear changes, CPU seconds of solving alone, and the first letter of the audited status."""
    result, seconds = _timed(method, case.problem)
    for _ in range(2 if name == "ddp" else 0):
        seconds = min(seconds, _timed(method, case.problem)[1])
    judged = run_case(case, {name: Given(result)}).methods[0]
    return objective(judged.path, case.problem.weights), judged.path.num_cusps, seconds, judged.status[0]


def _timed(method: Method, problem: Problem) -> tuple[Result, float]:
    started = time.process_time()
    result = method.solve(problem)
    return result, time.process_time() - started


def _sub_problems(problem: Problem) -> str:
    """Where scp's time goes: in Clarabel (setup and solution), around it in a sub-problem, and outside of those."""
    import clarabel

    solver: Any = clarabel  # compiled: type checkers cannot see into it
    clock = {"solver": 0.0, "sub-problem": 0.0}
    count = 0
    real, solve = solver.DefaultSolver, scp.solve_subproblem

    class Timed:
        def __init__(self, *args: Any) -> None:
            started = time.perf_counter()
            self.inner = real(*args)
            clock["solver"] += time.perf_counter() - started

        def solve(self) -> Any:
            started = time.perf_counter()
            solution = self.inner.solve()
            clock["solver"] += time.perf_counter() - started
            return solution

    def timed(*args: Any) -> SubproblemSolution:
        nonlocal count
        started = time.perf_counter()
        step = solve(*args)
        clock["sub-problem"] += time.perf_counter() - started
        count += 1
        return step

    with patch.object(solver, "DefaultSolver", Timed), patch.object(scp, "solve_subproblem", timed):
        started = time.perf_counter()
        KNOWN["scp"].solve(problem)
        whole = time.perf_counter() - started
    inside, each = clock["solver"] / clock["sub-problem"], clock["sub-problem"] / count
    rest = 1.0 - clock["sub-problem"] / whole
    each_of = f"{count:>4} sub-problems, {each * 1e3:.1f} ms each, {1.0 - inside:.0%} of it outside Clarabel"
    return f"{each_of}; {rest:.0%} of scp's time outside of sub-problems"


if __name__ == "__main__":
    run(main)
