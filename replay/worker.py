"""Running methods in a child process, so that a crash, a hang or a hunger for memory costs one method and no more.

The child is forked once, and again after it had to be ended or has died; it stays warm between methods. It gets a
problem and a method, and sends iterates and the outcome back. Ctrl-C is the parent's business: the child ignores it
and is killed. When the parent dies, the child is ended by the system (Linux), or ends with its next word.
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
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from multiprocessing.connection import Connection
from types import MappingProxyType, TracebackType
from typing import Any, Self

import numpy as np

from optim.methods import Method
from optim.problem import Problem
from optim.result import OnIterate
from replay.solving import Solved, solve

GRACE_S = 2.0
"""Time that a method has to tell its next iterate after its time is up [s]; then its process is ended."""
_MIB = 1 << 20
_PR_SET_PDEATHSIG = 1  # of <sys/prctl.h>
_ENDING = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP} if hasattr(signal, "SIGHUP") else set[signal.Signals]()
"""Signals that ask a process to end; only systems that have SIGHUP can isolate."""


def can_isolate() -> bool:
    """Whether this system can run methods in processes of their own (by fork)."""
    return "fork" in multiprocessing.get_all_start_methods()


@dataclass(frozen=True, kw_only=True)
class Limits:
    """Of one method."""

    time_s: float = math.inf
    """Of solving, compiling not counted [s]."""
    memory_mib: int | None = None
    """Of data that the process may hold [MiB]; only systems with RLIMIT_DATA keep it."""


NO_LIMITS = Limits()


class Worker:
    """Runs methods in a child process; `solving.Solve`. A context manager: the child ends with it."""

    def __init__(self, limits: Limits = NO_LIMITS) -> None:
        self.limits = limits
        self._process: Any = None
        self._pipe: Any = None  # a Connection; with fork never a PipeConnection, which type checkers see

    def __enter__(self) -> Self:
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def __call__(self, problem: Problem, method: Method, on_iterate: OnIterate) -> Solved:
        """Run a method in the child; an exception of `on_iterate`, or Ctrl-C, ends the child and flies on."""
        try:
            return self._solve(problem, method, on_iterate)
        except BaseException:
            self._end()
            raise

    def _solve(self, problem: Problem, method: Method, on_iterate: OnIterate) -> Solved:
        pipe = self._ready()
        clock = _Clock(self.limits.time_s + GRACE_S)
        with contextlib.suppress(BrokenPipeError):  # it has died: the pipe's end says so below
            _send(pipe, (problem, method, self.limits.time_s))
        while True:
            if not pipe.poll(clock.left()):
                self._end()
                return Solved(result=None, out_of_time=True, wall_s=clock.spent(), compile_s=clock.paused)
            try:
                kind, body = pickle.loads(pipe.recv_bytes())
            except (EOFError, OSError):
                return Solved(result=None, error=self._last_words(), wall_s=clock.spent(), compile_s=clock.paused)
            if kind == "iterate":
                on_iterate(body)
            elif kind == "compiling":
                clock.pause(body)
            else:
                return body

    def _ready(self) -> Any:
        """The pipe to the child, which is started if there is none."""
        if self._pipe is not None and self._process.is_alive():
            return self._pipe
        self._end()
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

    def _last_words(self) -> str:
        """Why the child has gone."""
        self._process.join(GRACE_S)
        code = self._process.exitcode
        self._end()
        if code is not None and code < 0:
            with contextlib.suppress(ValueError):
                return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with exit status {code}"

    def _end(self) -> None:
        if self._pipe is not None:
            self._pipe.close()
        if self._process is not None:
            self._process.kill()
            self._process.join()
            self._process.close()
        self._process, self._pipe = None, None


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
    with contextlib.suppress(EOFError, OSError):
        while True:
            problem, method, time_limit = pickle.loads(pipe.recv_bytes())
            tell: Callable[[Any], None] = lambda iterate: _send(pipe, ("iterate", iterate))  # noqa: E731
            told: Callable[[bool], None] = lambda on: _send(pipe, ("compiling", on))  # noqa: E731
            _send(pipe, ("solved", solve(problem, method, tell, time_limit=time_limit, on_compiling=told)))


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

    Without it a child of a killed process would work on, until it has its next word to say.
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
    """Keeps read-only arrays read-only: kernels are compiled for those, and would be compiled anew for others."""

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
