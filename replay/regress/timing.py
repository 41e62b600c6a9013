"""Is this version slower than another? Both are timed in turns, A B B A, on this machine, now.

A stored time says nothing, because the load of the machine differs every night; what is common to both versions cancels
in their ratio. The alarm: the whole 95 % interval (bootstrap over logs) of the geometric mean of new over old lies
above 1.02.
"""

import contextlib
import json
import math
import os
import pathlib
import subprocess
import sys
import tempfile
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from dataclasses import dataclass
from typing import Self

import numpy as np

from replay.base.documents import plain
from replay.base.errors import ReplayError
from replay.base.run_folder import TIMING_FILE
from replay.base.schemas.timing import TIMING_SCHEMA, TimeRatio, TimingDocument
from replay.regress.folder import RunFolder, write_document
from replay.regress.plan import Plan
from replay.regress.program import SOURCES
from replay.regress.sources import STORES, local_file
from replay.run.child import Child, Died

AGAINST_ERROR = "E_AGAINST"
ALARM = 1.02
"""Ratio new over old above which the interval must lie [-]."""
LEAST_PAIRS = 3
"""Number of logs below which there is no interval, and no alarm."""
ROUNDS = 3
"""Maximum number of rounds A B B A: six runs of each version."""
ENOUGH_S = 6.0
"""Time after which a pair of log and method gets no further round [s]; it gets at least one."""
MOST_S = 600.0
"""Time limit of one run, compiling included [s]."""
_SAMPLES, _SEED = 4000, 0


@dataclass(frozen=True, kw_only=True)
class Version:
    """How to start a version of the program."""

    name: str
    python: str
    path: str
    """Folder of its sources; empty where they are installed."""


def check_version(name: str) -> None:
    """Check that a name is an installed environment or a git revision. Raises ReplayError (E_AGAINST)."""
    if _python(name) is None:
        _git(SOURCES, name, "rev-parse", "--verify", "--end-of-options", f"{name}^{{commit}}")


def _python(name: str) -> pathlib.Path | None:
    """The Python of an environment, by the path of either."""
    place = pathlib.Path(name)
    pythons = (place / "bin" / "python", place)
    return next((python for python in pythons if python.is_file() and os.access(python, os.X_OK)), None)


@contextlib.contextmanager
def version(name: str) -> Iterator[Version]:
    """An installed environment (its folder, or its Python), or a git revision, which is checked out meanwhile.

    Raises ReplayError (E_AGAINST) where it is neither.
    """
    python = _python(name)
    if python is not None:
        yield Version(name=name, python=str(python.absolute()), path="")
        return
    sources = SOURCES
    with tempfile.TemporaryDirectory(prefix="replay-against-") as folder:
        tree = str(pathlib.Path(folder) / "tree")
        _git(sources, name, "worktree", "add", "--detach", "--quiet", tree, f"{name}^{{commit}}")
        try:
            yield Version(name=name, python=sys.executable, path=tree)
        finally:
            _git(sources, name, "worktree", "remove", "--force", tree)


def this_version() -> Version:
    """The program that is running."""
    return Version(name="this version", python=sys.executable, path=str(SOURCES))


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


class TimingServer:
    """A process that times runs of one version, started again where a run takes too long. A context manager."""

    def __init__(self, version: Version) -> None:
        self.version = version
        self._child = self._started()

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self._child.end()

    def _started(self) -> Child:
        script = pathlib.Path(__file__).with_name("timing_server.py")
        return Child.started([self.version.python, "-P", str(script)], os.environ | {"PYTHONPATH": self.version.path})

    def seconds(self, log: str, method: str) -> float:
        """Time a method on all cases of a log [s]; NaN where that version fails, or takes more than `MOST_S`.

        Raises ReplayError (E_AGAINST) if the process has ended.
        """
        self._child.send((log, method))
        try:
            seconds = self._child.receive(MOST_S)
        except Died as died:
            raise ReplayError(AGAINST_ERROR, f"{self.version.name}: {died}") from died
        if seconds is None:
            self._child.end()  # its answer would be taken for the next one
            self._child = self._started()
        return math.fsum(seconds) if seconds else math.nan


def measure(
    old: TimingServer,
    new: TimingServer,
    pairs: Sequence[tuple[str, str, str]],
    on_pair: Callable[[int, int], None] = lambda *_: None,
) -> dict[str, dict[str, float]]:
    """Measure new over old for pairs (log, file, method); ratios by method and log [-].

    Each pair is run once untimed, which also compiles; then in rounds A B B A. The least time of each version counts.
    Pairs on which a version fails are left out. `on_pair` gets the number of pairs done, and of all pairs.
    """
    ratios: dict[str, dict[str, float]] = {}
    for number, (log, file, method) in enumerate(pairs):
        warm = [server.seconds(file, method) for server in (old, new)]
        times: dict[TimingServer, list[float]] = {old: [], new: []}
        for _ in range(ROUNDS if all(map(math.isfinite, warm)) else 0):
            for server in (old, new, new, old):
                times[server].append(server.seconds(file, method))
            if sum(map(sum, times.values())) > ENOUGH_S:
                break
        if times[old] and min(times[old]) > 0.0:
            ratios.setdefault(method, {})[log] = min(times[new]) / min(times[old])
        on_pair(number + 1, len(pairs))
    return ratios


def compared(ratios: Iterable[float]) -> TimeRatio:
    """Geometric mean of ratios and its interval by bootstrap, always the same for the same ratios."""
    logarithms = np.log(np.array(list(ratios)))
    mean, pairs = float(np.exp(logarithms.mean())), len(logarithms)
    if pairs < LEAST_PAIRS:
        return TimeRatio(ratio=mean, low=None, high=None, pairs=pairs, alarm=False)
    drawn = np.random.default_rng(_SEED).integers(0, pairs, (_SAMPLES, pairs))
    low, high = (float(np.exp(each)) for each in np.quantile(logarithms[drawn].mean(axis=1), (0.025, 0.975)))
    return TimeRatio(ratio=mean, low=low, high=high, pairs=pairs, alarm=low > ALARM)


def judged(ratios: Mapping[str, Mapping[str, float]]) -> dict[str, TimeRatio]:
    """The mean ratio by method, and over all methods ("all", each log with the mean of its methods)."""
    found = {method: compared(by_log.values()) for method, by_log in ratios.items() if by_log}
    by_log: dict[str, list[float]] = {}
    for logs in ratios.values():
        for log, ratio in logs.items():
            by_log.setdefault(log, []).append(math.log(ratio))
    if by_log:
        found["all"] = compared(math.exp(math.fsum(each) / len(each)) for each in by_log.values())
    return found


def time_against(
    plan: Plan, folder: RunFolder, name: str, on_pair: Callable[[int, int], None] = lambda *_: None
) -> TimingDocument:
    """Time this version and another one in turns on the logs of a run, and write timing.json into its folder.

    Methods are timed with their default options, which both versions have. Raises ReplayError (E_AGAINST).
    """
    read = {document.log for document in folder.documents() if document.error is None}
    pairs = [
        (log.name, str(local_file(log.path).absolute()), method)
        for log in plan.logs
        if log.name in read or log.path.startswith(STORES)
        for method in plan.methods_of(log)
    ]
    with version(name) as other, TimingServer(other) as old, TimingServer(this_version()) as new:
        ratios = measure(old, new, pairs, on_pair)
    document = TimingDocument(schema=TIMING_SCHEMA, against=name, ratios=ratios, compared=judged(ratios))
    write_document(folder.path / TIMING_FILE, json.dumps(plain(document), indent=1, sort_keys=True))
    return document
