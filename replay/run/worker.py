"""Running methods in child processes, so that a crash, a hang or a shortage of memory costs one method and no more.

A child is forked once, and again after it had to be ended or has died; it stays warm between methods. It gets a
problem and a method, and sends iterates and the outcome back. Ctrl-C is the parent's business: the child ignores it
and is killed. When the parent dies, the child is ended by the system (Linux), or ends with its next message.
"""

import contextlib
import ctypes
import io
import math
import multiprocessing
import os
import pickle
import signal
import sys
import time
import warnings
from collections.abc import Callable, Generator, Iterator, Mapping
from functools import partial
from multiprocessing.connection import Connection, wait
from types import MappingProxyType
from typing import Any, Self

import numpy as np

from optim.model.method import Method
from optim.model.problem import Problem
from optim.model.result import OnIterate, ignore
from replay.run.limits import GRACE_S, NO_LIMITS, Limits
from replay.run.solving import OnNamedIterate, OnStart, Solved, solve

_MIB = 1 << 20
_PR_SET_PDEATHSIG = 1  # of <sys/prctl.h>
_ENDING = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP} if hasattr(signal, "SIGHUP") else set[signal.Signals]()
"""Signals that ask a process to end; only systems that have SIGHUP can isolate."""


def can_isolate() -> bool:
    """Whether this system can run methods in processes of their own (by fork)."""
    return "fork" in multiprocessing.get_all_start_methods()


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


class Worker:
    """A child process that runs methods, one at a time; see `Workers`."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._process: Any = None
        self._pipe: Any = None  # a Connection; with fork never a PipeConnection, which type checkers see
        self._clock = _Clock(math.inf)
        self._on_iterate: OnIterate = ignore

    def begin(self, problem: Problem, method: Method, on_iterate: OnIterate) -> None:
        """Give a method to the child, which has none; `step` returns what comes of it."""
        pipe = self._ready()
        self._clock, self._on_iterate = _Clock(self.limits.watch_s), on_iterate
        with contextlib.suppress(BrokenPipeError):  # it has died: the pipe's end says so in `step`
            _send(pipe, (problem, method, self.limits.time_s, self.limits.by_processor))

    @property
    def pipe(self) -> Any:
        """Connection to the child; `wait` takes it."""
        return self._pipe

    def left(self) -> float | None:
        """Time until the method's process is ended [s]; None for no end."""
        return self._clock.left()

    def step(self) -> Solved | None:
        """Handle one message from the child; return the outcome once it arrives or time runs out."""
        if not self._pipe.poll(0.0):
            if self.left() != 0.0:
                return None
            self.end()
            return self._lost(out_of_time=True)
        try:
            kind, body = pickle.loads(self._pipe.recv_bytes())
        except (EOFError, OSError):
            return self._lost(error=self._cause_of_death())
        if kind == "solved":
            return body
        if kind == "iterate":
            self._on_iterate(body)
        else:
            self._clock.pause(body)
        return None

    def _lost(self, *, out_of_time: bool = False, error: str = "") -> Solved:
        spent, paused = self._clock.spent(), self._clock.paused
        return Solved(result=None, out_of_time=out_of_time, error=error, wall_s=spent, compile_s=paused)

    def _ready(self) -> Any:
        """The pipe to the child, which is started if there is none."""
        if self._pipe is not None and self._process.is_alive():
            return self._pipe
        self.end()
        context = multiprocessing.get_context("fork")
        ours, theirs = context.Pipe()
        self._process = context.Process(
            target=_serve, args=(theirs, ours, self.limits.memory_mib, os.getpid()), daemon=True
        )
        with warnings.catch_warnings(), _signals_later():
            # threads of other libraries may run in this process by now; the child uses nothing that they hold
            warnings.simplefilter("ignore", DeprecationWarning)
            self._process.start()
        theirs.close()
        self._pipe = ours
        return ours

    def _cause_of_death(self) -> str:
        """Why the child ended."""
        self._process.join(GRACE_S)
        code = self._process.exitcode
        self.end()
        if code is not None and code < 0:
            with contextlib.suppress(ValueError):
                return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with exit status {code}"

    def end(self) -> None:
        """End the child, whatever it does."""
        if self._pipe is not None:
            self._pipe.close()
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process.close()
        self._process, self._pipe = None, None


class Workers:
    """Runs several methods at the same time, each in a child process; `solving.SolveEach`. A context manager."""

    def __init__(self, limits: Limits = NO_LIMITS, jobs: int = 1, meanwhile: Callable[[], None] = lambda: None) -> None:
        """`jobs` children at most; `meanwhile` is called once all of them have work, each time methods are run."""
        self.limits = limits
        self._workers = tuple(Worker(limits) for _ in range(jobs))
        self._meanwhile = meanwhile

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        for worker in self._workers:
            worker.end()

    def __call__(
        self, problem: Problem, methods: Mapping[str, Method], on_start: OnStart, on_iterate: OnNamedIterate
    ) -> Generator[tuple[str, Solved]]:
        """Give out methods in their order; outcomes come as they come. What ends this ends the children too."""
        waiting, busy = list(methods)[::-1], dict[str, Worker]()
        free = list(self._workers[::-1])

        def give_out() -> None:
            while waiting and free:
                name, worker = waiting.pop(), free.pop()
                on_start(name)
                worker.begin(problem, methods[name], partial(on_iterate, name))
                busy[name] = worker

        try:
            give_out()
            self._meanwhile()
            while busy:
                solved = _step(busy)
                free += [busy.pop(name) for name in solved]
                yield from solved.items()  # first, so that no interruption loses them
                give_out()
        except BaseException:
            for worker in self._workers:
                worker.end()
            raise


def _step(busy: Mapping[str, Worker]) -> dict[str, Solved]:
    """Wait until a child sends a message or has used up its time; outcomes by the method's name."""
    lefts = [left for worker in busy.values() if (left := worker.left()) is not None]
    wait([worker.pipe for worker in busy.values()], min(lefts, default=None))
    stepped = {name: worker.step() for name, worker in busy.items()}
    return {name: solved for name, solved in stepped.items() if solved is not None}


class _Clock:
    """Counts down, except while paused."""

    def __init__(self, limit: float) -> None:
        self._limit, self._started = limit, time.monotonic()
        self.paused, self._since = 0.0, math.nan

    def pause(self, on: bool) -> None:
        """Stop, or go on after a stop."""
        if on:
            self._since = time.monotonic()
        else:
            self.paused += time.monotonic() - self._since
            self._since = math.nan

    def spent(self) -> float:
        return time.monotonic() - self._started - self.paused

    def left(self) -> float | None:
        """Seconds; None for no end."""
        if math.isinf(self._limit) or not math.isnan(self._since):
            return None
        return max(0.0, self._limit - self.spent())


def _serve(pipe: Connection, parents: Connection, memory_mib: int | None, parent: int) -> None:
    """The child: solve what comes until the pipe closes."""
    end_with_parent(parent)
    parents.close()  # else the pipe would never end
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in _ENDING - {signal.SIGINT}:
        signal.signal(number, signal.SIG_DFL)  # what the parent does on these is not for the child
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)
    limit_memory(memory_mib)

    def say(kind: str, body: object) -> None:
        _send(pipe, (kind, body))

    with contextlib.suppress(EOFError, OSError):
        while True:
            problem, method, limit, by_processor = pickle.loads(pipe.recv_bytes())
            solved = solve(
                problem,
                method,
                partial(say, "iterate"),
                time_limit=limit,
                by_processor=by_processor,
                on_compiling=partial(say, "compiling"),
            )
            say("solved", solved)


@contextlib.contextmanager
def _signals_later() -> Iterator[None]:
    """Signals that end a process wait while the block runs: a child that is being made is neither lost nor confused."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def end_with_parent(parent: int) -> None:
    """Have the system end this process when the thread that started it ends, where it can (Linux).

    Without it a child of a killed process would work on, until its next message.
    """
    if sys.platform != "linux":
        return
    ctypes.CDLL(None).prctl(_PR_SET_PDEATHSIG, signal.SIGKILL)
    if os.getppid() != parent:  # it has gone in the meantime
        os._exit(1)


def limit_memory(memory_mib: int | None) -> None:
    """Limit the data that this process may hold, where the system can [MiB]."""
    if memory_mib is None:
        return
    import resource  # not on every system

    _, most = resource.getrlimit(resource.RLIMIT_DATA)
    wanted = memory_mib * _MIB
    resource.setrlimit(resource.RLIMIT_DATA, (wanted if most < 0 else min(wanted, most), most))


class _Pickler(pickle.Pickler):
    """Keeps read-only arrays read-only: kernels are compiled for those, and would be compiled again for others."""

    def reducer_override(self, obj: Any) -> Any:
        if isinstance(obj, np.ndarray) and not obj.flags.writeable:
            return _read_only, (obj.copy(),)
        if isinstance(obj, MappingProxyType):
            return _proxy, (dict(obj),)
        return NotImplemented


def _proxy(values: dict[Any, Any]) -> Any:
    return MappingProxyType(values)  # the type itself has no name that pickle finds


def _read_only(array: Any) -> Any:
    array.setflags(write=False)
    return array


def _send(pipe: Any, message: object) -> None:
    buffer = io.BytesIO()
    _Pickler(buffer, pickle.HIGHEST_PROTOCOL).dump(message)
    pipe.send_bytes(buffer.getbuffer())
