"""The way from a log to a result: read, optimize, record, save, load, export.

The command line, the nightly run and notebooks go this way, and get the same bits: every library computes on one
thread, compiled kernels that no longer match their sources are dropped, and each method runs in a process of its own
where the system has such (by fork). `import replay` offers these functions without loading anything.
"""

import dataclasses
import functools
import os
import pathlib
from collections.abc import Callable, Mapping, Sequence
from contextlib import nullcontext
from typing import Any, Final

from optim.methods import METHODS
from optim.methods.chain import JOINT, Chain, named
from optim.model.method import Method
from optim.model.objective import Weights
from optim.model.result import Iterate
from replay.base.errors import UsageError, unknown
from replay.base.kernels import drop_stale
from replay.base.threads import one_thread, use_one_thread
from replay.logs import ReadOptions, read_cases
from replay.run.case import Case
from replay.run.child import can_fork
from replay.run.judge import run_case
from replay.run.limits import LIMITS, Limits
from replay.run.outcome import MethodRun, Run
from replay.run.progress import Progress
from replay.run.reading import guarded
from replay.run.results import read_results, to_document, write_results
from replay.run.solving import InTurn
from replay.run.stored import run_of
from replay.run.vehicle_file import read_vehicle
from replay.run.worker import Workers, usable_cores

JOBS: Final = 2
"""Methods of a case that run at the same time by default."""
File = str | os.PathLike[str]
MethodLike = str | Method | Mapping[str, Method]
Solver = Workers | InTurn
"""Runner of methods, which may be kept open over several cases; see `open_workers`."""
GEARS: Final = {"forward": 1, "reverse": -1}


@functools.cache
def _prepared() -> None:
    """Settle what the process needs before its first computation."""
    use_one_thread()
    drop_stale()


def read(log: File, options: ReadOptions | None = None, *, memory_mib: int | None = None, **changes: Any) -> list[Case]:
    """Read the parking requests of a log: an MCAP file, or a folder that rosbag2 recorded.

    `changes` are fields of `ReadOptions`, as on the command line, such as margin=0.2 or unknown="free"; `vehicle` may
    be a `Vehicle` or the path of its TOML file, `start_direction` "forward" or "reverse". With `memory_mib`, the log
    is read in a process of its own, with limits of memory and time. Raises UsageError for an option that is unknown or
    out of range, LogError for a log that cannot be used.
    """
    _prepared()
    chosen = read_options(options or ReadOptions(), changes)
    with one_thread():
        if memory_mib is None:
            cases = read_cases(log, chosen)
        else:
            cases = guarded(log, read_cases, log, chosen, memory_mib=memory_mib)
    return [dataclasses.replace(case, reading=dataclasses.asdict(chosen)) for case in cases]


def read_options(options: ReadOptions, changes: Mapping[str, Any]) -> ReadOptions:
    """The options with some of them changed. Raises UsageError."""
    names = [field.name for field in dataclasses.fields(ReadOptions)]
    for name in changes:
        if name not in names:
            raise UsageError(unknown("option", name, names, "of read"))
    values = dict(changes)
    if isinstance(values.get("vehicle"), (str, os.PathLike)):
        values["vehicle"] = read_vehicle(values["vehicle"])
    if values.get("start_direction") in GEARS:
        values["start_direction"] = GEARS[values["start_direction"]]
    try:
        return dataclasses.replace(options, **values)
    except (TypeError, ValueError) as error:
        raise UsageError(f"reading: {error}") from error


def optimize(
    case: Case,
    *methods: MethodLike,
    weights: Weights | None = None,
    limits: Limits = LIMITS,
    jobs: int = JOBS,
    seed: int = 0,
    on_iterate: Callable[[str, Iterate], None] | None = None,
    on_start: Callable[[str], None] = lambda _: None,
    on_end: Callable[[MethodRun], None] = lambda _: None,
    progress: Progress | bool | None = None,
    workers: Solver | None = None,
) -> Run:
    """Run methods on a case, and judge what each gives; one that fails does not stop the others.

    Parameters
    ----------
    case
        One of those that `read` gives.
    methods
        Names, such as "ddp" or the chain "shortcut+scp"; objects, such as Ddp(spacing=0.2), called by their class; or
        one mapping from names of your own to objects. All methods where none is given.
    weights
        Of the objective J; by default those of the case.
    limits
        Limits of each method's time and memory.
    jobs
        Methods that run at the same time; of more than this computer has cores, as many as it has.
    seed
        Seed of those methods that are given by name and have one; an object keeps its own.
    on_iterate, on_start, on_end
        Called in this process with a method's name and each iterate, with its name when it begins, and with what came
        of it.
    progress
        Whether to show progress, or what shows it; by default on a terminal and in a notebook.
    workers
        Open workers (`open_workers`) to use again for the next case; `jobs` and `limits` are theirs then.

    Raises UsageError for an unknown method, Interrupted (a KeyboardInterrupt with what was finished) on Ctrl-C.
    """
    if not isinstance(case, Case):
        raise UsageError(f"expected one case, as in read(log)[0], and it is a {type(case).__name__}")
    chosen = chosen_methods(methods, seed)
    if weights is not None:
        case = with_weights(case, weights)
    _prepared()
    shown = progress if isinstance(progress, Progress) else Progress(enabled=progress)
    watched = _Watch(case.name, shown, on_iterate, on_start, on_end)
    with one_thread(), nullcontext(workers) if workers else open_workers(limits, jobs) as solver, shown:
        shown.show(case.name, "measuring the recorded path")
        return run_case(
            case,
            chosen,
            watched.iterate,
            on_start=watched.start,
            on_end=watched.end,
            seed=seed,
            limits=solver.limits,
            solve=solver,
        )


def with_weights(case: Case, weights: Weights) -> Case:
    """The case with other weights of the objective."""
    return dataclasses.replace(case, problem=dataclasses.replace(case.problem, weights=weights))


class _Watch:
    """Passes on what happens to the methods of a case, and shows it as progress."""

    def __init__(
        self,
        case: str,
        progress: Progress,
        on_iterate: Callable[[str, Iterate], None] | None,
        on_start: Callable[[str], None],
        on_end: Callable[[MethodRun], None],
    ) -> None:
        self._case, self._progress = case, progress
        self._on_iterate, self._on_start, self._on_end = on_iterate, on_start, on_end

    def start(self, name: str) -> None:
        self._progress.end(self._case)
        self._progress.begin(f"{self._case} {name}", "starting")
        self._on_start(name)

    def iterate(self, name: str, iterate: Iterate) -> None:
        self._progress.iterate(f"{self._case} {name}", iterate)
        if self._on_iterate is not None:
            self._on_iterate(name, iterate)

    def end(self, method: MethodRun) -> None:
        self._progress.end(f"{self._case} {method.name}")
        self._on_end(method)


def open_workers(limits: Limits = LIMITS, jobs: int = JOBS, meanwhile: Callable[[], None] = lambda: None) -> Solver:
    """Open processes for methods, to be kept over several cases: a context manager, the `workers` of `optimize`.

    `meanwhile` is called each time that all of them have work. Where the system has no fork, methods run in this
    process, one after the other.
    """
    if not can_fork():
        return InTurn(limits)
    return Workers(limits, max(1, min(jobs, usable_cores())), meanwhile)


def chosen_methods(given: Sequence[MethodLike], seed: int = 0) -> dict[str, Method]:
    """Methods by name, in the order given; all where none is given. Raises UsageError."""
    if not given:
        given = tuple(METHODS)
    seeded = {name: with_seed(method, seed) for name, method in METHODS.items()}
    found: dict[str, Method] = {}
    for each in given:
        for name, method in _by_name(each, seeded).items():
            if name in found and not isinstance(each, str):
                raise UsageError(f"two methods are called {name!r}: give them names of their own, as {{{name!r}: ...}}")
            found[name] = method
    return found


def _by_name(given: MethodLike, methods: Mapping[str, Method]) -> Mapping[str, Method]:
    if isinstance(given, str):
        return {given.lower(): method_named(given.lower(), methods)}
    if isinstance(given, Mapping):
        return given
    if isinstance(given, Chain):
        return {JOINT.join(name for name, _ in given.parts): given}
    if not hasattr(given, "solve") or isinstance(given, type):
        raise UsageError(f"expected the name of a method or a method, as in 'ddp' or Ddp(), not {given!r}")
    kind = type(given)
    return {next((name for name, known in methods.items() if type(known) is kind), kind.__name__.lower()): given}


def method_named(name: str, methods: Mapping[str, Method]) -> Method:
    """The method of that name, or the chain of those whose names it joins. Raises UsageError."""
    try:
        return named(name, methods)
    except KeyError as error:
        part = error.args[0]
        raise UsageError(unknown("method", part, methods, "" if part == name else f"in {name!r}")) from error


def with_seed(method: Method, seed: int) -> Method:
    """The method with a seed, where it has one."""
    if not dataclasses.is_dataclass(method) or isinstance(method, type):
        return method
    has_seed = any(field.name == "seed" for field in dataclasses.fields(method))
    return dataclasses.replace(method, seed=seed) if has_seed else method  # pyright: ignore[reportReturnType]


def record(run: Run, path: File) -> None:
    """Write the run as a Rerun recording, STEM.rrd. Raises ReplayError where that is not possible."""
    from replay.recording import write_recording  # Rerun takes a second to load

    write_recording(run, pathlib.Path(path))


def save(run: Run, path: File) -> None:
    """Write the run as a results file, STEM.results.json, as the command line does. Raises ReplayError."""
    write_results(path, to_document(run))


def load(path: File) -> Run:
    """Read a results file; maps and iterates are not stored in it. Raises ReplayError, one line, for what is none."""
    return run_of(read_results(path), os.fspath(path))


def export(runs: Run | Sequence[Run], path: File) -> None:
    """Write the paths of one log's runs into a copy of that log. Raises ReplayError."""
    from replay.logs.export import write_export

    write_export([runs] if isinstance(runs, Run) else runs, path)
