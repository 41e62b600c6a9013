"""Child processes that are given requests and answer with messages: a crash or a hang there costs one answer.

A child is forked, and has then what this process has loaded, or it is another program, which leads a process group of
its own. Both are ended by `end`, whatever they do; a forked one also by the system when the parent dies (Linux), else
with its next message. Ctrl-C is the parent's business. Requests and messages are any objects that can be pickled.
"""

import contextlib
import ctypes
import io
import multiprocessing
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import warnings
from collections.abc import Callable, Iterator, Mapping, Sequence
from multiprocessing.connection import Connection
from types import MappingProxyType
from typing import Any, Self

import numpy as np

_LINGER_S = 2.0  # time for the system to take note of a death
_MIB = 1 << 20
_PR_SET_PDEATHSIG = 1  # of <sys/prctl.h>
_ENDING = {signal.SIGINT, signal.SIGTERM, signal.SIGHUP} if hasattr(signal, "SIGHUP") else set[signal.Signals]()
"""Signals that ask a process to end; only systems that have SIGHUP can fork."""
Serve = Callable[..., None]
"""What a forked child does: called with its connection, and with what else it needs."""


class Died(Exception):
    """A child has died; `str()` says why."""


class Child:
    """A child process and the connection to it; see `forked` and `started`."""

    def __init__(self, process: Any, pipe: Any, words: Any = None) -> None:
        self._process, self._words = process, words
        self.pipe = pipe
        """For `multiprocessing.connection.wait`."""

    @classmethod
    def forked(cls, serve: Serve, *arguments: object, memory_mib: int | None = None) -> Self:
        """Fork a child that runs `serve`, with at most so much memory for data [MiB]."""
        context = multiprocessing.get_context("fork")
        ours, theirs = context.Pipe()
        entry = (theirs, ours, memory_mib, os.getpid(), serve, arguments)
        process = context.Process(target=_enter, args=entry, daemon=True)
        with warnings.catch_warnings(), _signals_later():
            # threads of other libraries may run in this process by now; the child uses nothing that they hold
            warnings.simplefilter("ignore", DeprecationWarning)
            process.start()
        theirs.close()
        return cls(process, ours)

    @classmethod
    def started(cls, command: Sequence[str], environment: Mapping[str, str] | None = None) -> Self:
        """Start a program; its last argument will be the file descriptor of its connection. Raises OSError."""
        ours, theirs = socket.socketpair()
        words = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        with theirs:
            process = subprocess.Popen(
                [*command, str(theirs.fileno())],
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=words,
                pass_fds=(theirs.fileno(),),
                process_group=0,
                env=environment,
            )
        return cls(process, Connection(ours.detach()), words)

    @property
    def is_alive(self) -> bool:
        """Whether it runs."""
        return _exit_code(self._process, 0.0) is None

    def send(self, request: object) -> None:
        """Send a request; to a child that has died, nothing: `receive` reports that."""
        with contextlib.suppress(OSError):
            send(self.pipe, request)

    def receive(self, timeout: float | None) -> Any:
        """The next message, or None after so many seconds without one. Raises Died, and the child has been ended."""
        try:
            if not self.pipe.poll(timeout):
                return None
            return pickle.loads(self.pipe.recv_bytes())
        except (EOFError, OSError):
            raise Died(self._cause_of_death()) from None

    def _cause_of_death(self) -> str:
        """Its signal, or its exit status and the last line that it wrote."""
        code, line = _exit_code(self._process, _LINGER_S), self._last_line()
        self.end()
        if code is not None and code < 0:
            with contextlib.suppress(ValueError):
                return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with exit status {code}" + (f": {line[:200]}" if line else "")

    def _last_line(self) -> str:
        if self._words is None:
            return ""
        size = self._words.seek(0, os.SEEK_END)
        self._words.seek(max(0, size - 2000))
        lines = self._words.read().decode("utf-8", "replace").split("\n")
        return next((text.strip() for text in reversed(lines) if text.strip()), "")

    def end(self) -> None:
        """End it, whatever it does, and all processes of its group."""
        self.pipe.close()
        if self._words is None:
            self._process.kill()
            self._process.join()
            return
        with contextlib.suppress(ProcessLookupError, PermissionError):
            os.killpg(self._process.pid, signal.SIGKILL)
        self._process.wait()
        self._words.close()


def _exit_code(process: Any, timeout: float) -> int | None:
    """The exit status, the negative number of a signal, or None while the process runs."""
    if isinstance(process, subprocess.Popen):
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(timeout)
        return process.returncode
    process.join(timeout)
    return process.exitcode


def can_fork() -> bool:
    """Whether this system can fork."""
    return "fork" in multiprocessing.get_all_start_methods()


# ---- in the child


def _enter(
    pipe: Connection,
    parents: Connection,
    memory_mib: int | None,
    parent: int,
    serve: Serve,
    arguments: Sequence[object],
) -> None:
    _end_with_parent(parent)
    parents.close()  # else the pipe would never end
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    for number in _ENDING - {signal.SIGINT}:
        signal.signal(number, signal.SIG_DFL)  # what the parent does on these is not for the child
    signal.pthread_sigmask(signal.SIG_UNBLOCK, _ENDING)
    limit_memory(memory_mib)
    with contextlib.suppress(EOFError, OSError):
        serve(pipe, *arguments)


@contextlib.contextmanager
def _signals_later() -> Iterator[None]:
    """Signals that end a process wait while the block runs: a child that is being made is neither lost nor confused."""
    before = signal.pthread_sigmask(signal.SIG_BLOCK, _ENDING)
    try:
        yield
    finally:
        signal.pthread_sigmask(signal.SIG_SETMASK, before)


def _end_with_parent(parent: int) -> None:
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


# ---- on the way


def send(pipe: Any, message: object) -> None:
    """Send an object. Raises OSError where nobody receives it any more."""
    buffer = io.BytesIO()
    _Pickler(buffer, pickle.HIGHEST_PROTOCOL).dump(message)
    pipe.send_bytes(buffer.getbuffer())


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
