"""A program that times methods of the version of the project that it is run with; it is started by its path.

Its argument is the file descriptor of a socket, on which requests come, (path of a log, name of a method), and answers
go: the seconds of each case, none where that version fails. It uses nothing but what every version has.
"""

import contextlib
import os
import sys
import time
from multiprocessing.connection import Connection

for name in ("OMP", "OPENBLAS", "MKL", "BLIS", "NUMEXPR", "NUMBA", "RAYON"):
    os.environ[f"{name}_NUM_THREADS"] = "1"
os.environ["VECLIB_MAXIMUM_THREADS"] = "1"

from optim.methods import METHODS  # noqa: E402 - after the threads have been settled

try:
    from replay.pipeline import read
except ImportError:  # a version from before the pipeline
    from replay.logs import read_cases as read


def main() -> None:
    """Answer until the socket closes."""
    pipe = Connection(int(sys.argv[1]))
    last, cases = None, []
    with contextlib.suppress(EOFError, OSError):
        while True:
            log, name = pipe.recv()
            try:
                if log != last:
                    last, cases = log, read(log)
                answer = [_seconds(_method(name), case.problem) for case in cases]
            except Exception:  # a border: the other version may fail as it likes
                answer = []
            pipe.send(answer)


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
