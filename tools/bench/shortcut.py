"""What the shortcut's variants gain, and how long they take.

`python tools/bench/shortcut.py recordings/*.mcap` prints for each log J and gear changes of the recorded path and of
each variant's result, and the CPU seconds of the default variant (median of five runs after compilation); then the
geometric mean of J's ratios.
"""

import argparse
import math
import statistics
import time

from optim.methods.shortcut import Shortcut
from optim.model.objective import objective
from optim.model.problem import Problem
from replay.base.kernels import drop_stale
from replay.logs import read_cases
from tools.script import existing, run

VARIANTS = {
    "random": Shortcut(),
    "random, trailer length": Shortcut(cost="trailer_length"),
    "deterministic": Shortcut(variant="deterministic"),
    "deterministic, trailer length": Shortcut(variant="deterministic", cost="trailer_length"),
}
RUNS = 5


def cpu_seconds(method: Shortcut, problem: Problem) -> float:
    """Median CPU time of one call, compiled before."""
    seconds = []
    for _ in range(RUNS):
        start = time.process_time()
        method.solve(problem)
        seconds.append(time.process_time() - start)
    return statistics.median(seconds)


def main() -> None:
    parser = argparse.ArgumentParser(description="What the shortcut's variants gain, and how long they take.")
    parser.add_argument("logs", nargs="+", type=existing, metavar="LOG")
    arguments = parser.parse_args()
    drop_stale()
    print(f"J / gear changes. CPU seconds: {VARIANTS['random'].tries} tries of 'random'.\n")
    print("| log | recorded |", " | ".join(VARIANTS), "| CPU [s] |")
    print("|---|--:|" + "--:|" * (len(VARIANTS) + 1))
    logarithms = []
    for log in arguments.logs:
        for case in read_cases(log):
            problem = case.problem
            paths = [problem.recorded, *(method.solve(problem).path for method in VARIANTS.values())]
            values = [objective(path, problem.weights) for path in paths]
            logarithms.append([math.log(value / values[0]) for value in values])
            cells = [f"{value:.1f} / {path.num_cusps}" for value, path in zip(values, paths, strict=True)]
            print(f"| {case.name} |", " | ".join(cells), f"| {cpu_seconds(VARIANTS['random'], problem):.2f} |")
    means = [math.exp(statistics.fmean(column)) for column in zip(*logarithms, strict=True)]
    print("| geometric mean of J / recorded J |", " | ".join(f"{mean:.3f}" for mean in means), "| |")


if __name__ == "__main__":
    run(main)
