"""Is this version slower than another? Both are timed in turns, A B B A, on this machine, now.

A stored time says nothing, because the machine is another one every night, if only by what else it does; what is
common to both versions cancels in their ratio. The alarm: the geometric mean of new over old, over all logs, lies above
1.02 with the whole of its 95 % interval (bootstrap over logs).
"""

import contextlib
import json
import math
import os
import pathlib
import select
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Self

import numpy as np

from replay.base.errors import ReplayError

AGAINST_ERROR = "E_AGAINST"
ALARM = 1.02
"""Ratio new over old above which the interval must lie [-]."""
LEAST_PAIRS = 3
"""Logs below which there is no interval, and no alarm."""
ROUNDS = 3
"""A B B A so often at most: six runs of each version."""
ENOUGH_S = 6.0
"""Time after which a pair of log and method gets no further round [s]; it gets one at least."""
MOST_S = 600.0
"""Time for one run, compiling included [s]."""
_SOURCES = pathlib.Path(__file__).resolve().parents[2]
_SAMPLES, _SEED = 4000, 0


@dataclass(frozen=True, kw_only=True)
class Side:
    """How to start a version of the program."""

    name: str
    python: str
    path: str
    """Folder of its sources; empty where they are installed."""


def check_version(name: str) -> None:
    """ReplayError (E_AGAINST) for what is neither an installed environment nor a git revision."""
    if _python(name) is None:
        _git(_SOURCES, name, "rev-parse", "--verify", "--end-of-options", f"{name}^{{commit}}")


def _python(name: str) -> pathlib.Path | None:
    """Of an environment, by its folder or by itself."""
    place = pathlib.Path(name)
    pythons = (place / "bin" / "python", place)
    return next((python for python in pythons if python.is_file() and os.access(python, os.X_OK)), None)


@contextlib.contextmanager
def version(name: str) -> Iterator[Side]:
    """An installed environment (its folder, or its Python), or a git revision, checked out for the time being.

    Raises ReplayError (E_AGAINST) where it is neither.
    """
    python = _python(name)
    if python is not None:
        yield Side(name=name, python=str(python.absolute()), path="")
        return
    sources = _SOURCES
    with tempfile.TemporaryDirectory(prefix="replay-against-") as folder:
        tree = str(pathlib.Path(folder) / "tree")
        _git(sources, name, "worktree", "add", "--detach", "--quiet", tree, f"{name}^{{commit}}")
        try:
            yield Side(name=name, python=sys.executable, path=tree)
        finally:
            _git(sources, name, "worktree", "remove", "--force", tree)


def this_version() -> Side:
    """The program that is running."""
    return Side(name="this version", python=sys.executable, path=str(pathlib.Path(__file__).resolve().parents[2]))


def _git(sources: pathlib.Path, name: str, *arguments: str) -> None:
    environment = {key: value for key, value in os.environ.items() if not key.startswith("GIT_")}
    try:
        done = subprocess.run(
            ["git", *arguments], cwd=sources, capture_output=True, text=True, env=environment, timeout=120
        )
    except (OSError, subprocess.TimeoutExpired) as error:
        raise ReplayError(AGAINST_ERROR, f"--against {name}: git cannot be run: {error}") from error
    if done.returncode != 0:
        words = (done.stderr.strip().splitlines() or ["git failed"])[-1]
        expected = "expected the folder of an environment, its python, or a git revision"
        raise ReplayError(AGAINST_ERROR, f"--against {name}: {expected}: {words}")


class Server:
    """A process that times runs of one version, begun anew where a run takes too long. A context manager."""

    def __init__(self, side: Side) -> None:
        self.side = side
        self._process = self._started()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._end()

    def _started(self) -> subprocess.Popen[str]:
        script = pathlib.Path(__file__).with_name("timing_server.py")
        return subprocess.Popen(
            [self.side.python, "-P", str(script)],
            stdin=subprocess.PIPE,
            stdout=subprocess.PIPE,
            stderr=subprocess.DEVNULL,
            text=True,
            env=os.environ | {"PYTHONPATH": self.side.path},
        )

    def _end(self) -> None:
        self._process.kill()
        self._process.wait()
        for stream in (self._process.stdin, self._process.stdout):
            if stream is not None:
                with contextlib.suppress(OSError):
                    stream.close()

    def seconds(self, log: str, method: str) -> float:
        """Time of a method on all cases of a log [s]; NaN where that version fails, or takes more than `MOST_S`.

        Raises ReplayError (E_AGAINST) if the process has gone.
        """
        assert self._process.stdin is not None
        assert self._process.stdout is not None
        try:
            self._process.stdin.write(json.dumps({"log": log, "method": method}) + "\n")
            self._process.stdin.flush()
            ready, _, _ = select.select([self._process.stdout], [], [], MOST_S)
            if not ready:
                self._end()  # its answer would be taken for that to the next request
                self._process = self._started()
                return math.nan
            answer: Any = json.loads(self._process.stdout.readline())
        except (OSError, ValueError) as error:
            raise ReplayError(AGAINST_ERROR, f"{self.side.name}: its process has ended: {error}") from error
        return math.fsum(answer["seconds"]) if answer.get("seconds") else math.nan


def measure(
    old: Server, new: Server, pairs: Sequence[tuple[str, str, str]], tell: Callable[[int], None] = lambda _: None
) -> dict[str, dict[str, float]]:
    """The ratio new over old of each pair of log and method, by method and log; pairs are (log, file, method).

    Each is run once without looking at the clock, which also compiles; then in rounds A B B A. The least time of each
    side counts. Pairs on which a version fails are left out.
    """
    ratios: dict[str, dict[str, float]] = {}
    for number, (log, file, method) in enumerate(pairs):
        warm = [server.seconds(file, method) for server in (old, new)]
        times: dict[Server, list[float]] = {old: [], new: []}
        for _ in range(ROUNDS if all(map(math.isfinite, warm)) else 0):
            for server in (old, new, new, old):
                times[server].append(server.seconds(file, method))
            if sum(map(sum, times.values())) > ENOUGH_S:
                break
        if times[old] and min(times[old]) > 0.0:
            ratios.setdefault(method, {})[log] = min(times[new]) / min(times[old])
        tell(number + 1)
    return ratios


@dataclass(frozen=True, kw_only=True)
class Comparison:
    """New over old: the geometric mean and its 95 % interval."""

    ratio: float
    low: float | None
    high: float | None
    """None below `LEAST_PAIRS` logs, where resampling says nothing of the spread."""
    pairs: int

    @property
    def alarm(self) -> bool:
        """Whether the new version is slower for certain."""
        return self.low is not None and self.low > ALARM


def compared(ratios: Iterable[float]) -> Comparison:
    """The geometric mean of ratios and its interval by bootstrap, always the same for the same ratios."""
    logarithms = np.log(np.array(list(ratios)))
    mean = float(np.exp(logarithms.mean()))
    if len(logarithms) < LEAST_PAIRS:
        return Comparison(ratio=mean, low=None, high=None, pairs=len(logarithms))
    drawn = np.random.default_rng(_SEED).integers(0, len(logarithms), (_SAMPLES, len(logarithms)))
    low, high = np.quantile(logarithms[drawn].mean(axis=1), (0.025, 0.975))
    return Comparison(ratio=mean, low=float(np.exp(low)), high=float(np.exp(high)), pairs=len(logarithms))


def judged(ratios: Mapping[str, Mapping[str, float]]) -> dict[str, Comparison]:
    """The comparison by method, and over all of them ("all", each log with the mean of its methods)."""
    found = {method: compared(by_log.values()) for method, by_log in ratios.items() if by_log}
    by_log: dict[str, list[float]] = {}
    for logs in ratios.values():
        for log, ratio in logs.items():
            by_log.setdefault(log, []).append(math.log(ratio))
    if by_log:
        found["all"] = compared(math.exp(math.fsum(each) / len(each)) for each in by_log.values())
    return found
