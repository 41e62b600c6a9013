"""A program that times methods of the version of the project that it is run with; it is started by its path.

Each line of standard input is a request, {"log": path, "method": name}; each line of standard output the answer,
{"seconds": one number for each case} or {"error": one line}. It uses nothing but what every version has.
"""

import json
import os
import sys
import time

for name in ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMEXPR", "NUMBA", "RAYON"):
    os.environ[f"{name}_NUM_THREADS"] = "1"
os.environ["VECLIB_MAXIMUM_THREADS"] = "1"

from optim.methods import METHODS  # noqa: E402 - after the threads have been settled

try:
    from replay.pipeline import read
except ImportError:  # a version from before the pipeline
    from replay.logs import read_cases as read


def main() -> None:
    """Answer until standard input ends."""
    answers = os.fdopen(os.dup(1), "w")
    os.dup2(os.open(os.devnull, os.O_WRONLY), 1)  # what solvers print is no answer
    last, cases = None, []
    for line in sys.stdin:
        request = json.loads(line)
        try:
            if request["log"] != last:
                last, cases = request["log"], read(request["log"])
            answer = {"seconds": [_seconds(_method(request["method"]), case.problem) for case in cases]}
        except Exception as error:  # a border: the other version may fail as it likes
            answer = {"error": f"{type(error).__name__}: {' '.join(str(error).split())}"}
        answers.write(json.dumps(answer) + "\n")
        answers.flush()


def _method(name):
    if name in METHODS:
        return METHODS[name]
    from optim.methods.chain import named

    return named(name, METHODS)


def _seconds(method, problem) -> float:
    started = time.perf_counter()
    method.solve(problem)
    return time.perf_counter() - started


if __name__ == "__main__":
    main()
