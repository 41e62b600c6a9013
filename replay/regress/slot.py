"""The parent's end of a process that works on logs: starts it, watches it, ends it, and says what it died of."""

import contextlib
import os
import pickle
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from multiprocessing.connection import Connection
from typing import IO, Any, Self

from replay.regress.work import Job, Outcome, publish_error
from replay.run.limits import BUSY

START_S = 120.0
"""Time for a process to start and import what it needs [s]."""
READ_S = 60.0
"""Time for reading a log, for measuring a recorded path, and for writing a recording, each [s]."""
COMPILE_S = 300.0
"""Time for a method beside its own limit, and for every stage of a process's first job [s]: kernels may have to be
compiled."""
MOST_JOBS = 200
"""Jobs after which a process is replaced, lest it grow."""
MOST_TRIES = 2
"""Processes that one log may cost."""
_WAIT_S = 0.1


class Stopped(Exception):
    """The work was called off."""


class Slot:
    """One process at a time, and one job at a time in it. A context manager: the process ends with it."""

    def __init__(self, stop: threading.Event | None = None) -> None:
        self._stop = stop or threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None
        self._lifeline = -1
        self._words: IO[bytes] | None = None
        self._limits: tuple[float, int] = (0.0, 0)
        self._jobs = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def run(self, job: Job) -> Outcome:
        """Have a log worked on; one that kills its process twice, or hangs, costs its own row. Raises Stopped.

        Twice, because somebody else may have killed the process, as the system does that runs out of memory.
        """
        words = ""
        try:
            for _ in range(MOST_TRIES):
                try:
                    return self._run(job)
                except (EOFError, OSError):
                    words = self._last_words()
            return publish_error(job, "E_CRASHED", words)
        except _Late as late:
            return publish_error(job, "E_HUNG", str(late))
        except BaseException:
            self.end()
            raise

    def _run(self, job: Job) -> Outcome:
        pipe = self._ready(job)
        usual = READ_S if self._jobs else READ_S + COMPILE_S
        self._jobs += 1
        pipe.send_bytes(pickle.dumps(job, pickle.HIGHEST_PROTOCOL))
        stage, limit = "reading", usual
        while True:
            kind, body = self._next(pipe, stage, limit)
            if kind == "done":
                return body
            is_method = body.startswith("method ")
            stage, limit = body, BUSY * job.settings.time_limit + COMPILE_S if is_method else usual

    def _next(self, pipe: Connection, stage: str, limit: float) -> tuple[str, Any]:
        """The next message. Raises _Late, Stopped, EOFError where the process has died."""
        deadline = time.monotonic() + limit
        while not pipe.poll(_WAIT_S):
            if self._stop.is_set():
                raise Stopped
            if time.monotonic() > deadline:
                self.end()
                raise _Late(f"{stage}: no end after {limit:.0f} s")
        return pickle.loads(pipe.recv_bytes())

    def _ready(self, job: Job) -> Connection:
        """The socket to the process, which is started if there is none, or if it has served long enough."""
        limits = (job.settings.time_limit, job.settings.memory_limit)
        if self._pipe is not None and limits == self._limits and self._jobs < MOST_JOBS:
            return self._pipe
        self.end()
        self._limits, self._jobs = limits, 0
        pipe = self._pipe = self._start()
        pipe.send_bytes(pickle.dumps((sys.path, *limits)))
        self._next(pipe, "starting", START_S)
        return pipe

    def _start(self) -> Connection:
        ours, theirs = socket.socketpair()
        end, self._lifeline = os.pipe()
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        command = [sys.executable, "-P", "-m", "replay.regress.child", str(theirs.fileno()), str(end)]
        try:
            self._process = subprocess.Popen(
                command,
                stdin=subprocess.DEVNULL,
                stdout=subprocess.DEVNULL,
                stderr=self._words,
                pass_fds=(theirs.fileno(), end),
                process_group=0,
            )
        finally:
            theirs.close()
            os.close(end)
        return Connection(ours.detach())

    def _last_words(self) -> str:
        """Why the process has gone, and the last line that it wrote."""
        process, line = self._process, ""
        if process is None:
            return "its process could not be started"
        with contextlib.suppress(subprocess.TimeoutExpired):
            process.wait(5.0)
        if self._words is not None:
            size = self._words.seek(0, os.SEEK_END)
            self._words.seek(max(0, size - 2000))
            lines = self._words.read().decode("utf-8", "replace").split("\n")
            line = next((text.strip() for text in reversed(lines) if text.strip()), "")
        code = process.returncode
        self.end()
        if code is not None and code < 0:
            with contextlib.suppress(ValueError):
                return f"its process was ended by {signal.Signals(-code).name}"
        return f"its process ended with exit status {code}" + (f": {line[:200]}" if line else "")

    def end(self) -> None:
        """End the process with everything below it."""
        if self._process is not None:
            with contextlib.suppress(ProcessLookupError, PermissionError):
                os.killpg(self._process.pid, signal.SIGKILL)
            self._process.wait()
        if self._pipe is not None:
            self._pipe.close()
        if self._lifeline >= 0:
            os.close(self._lifeline)
        if self._words is not None:
            self._words.close()
        self._process, self._pipe, self._lifeline, self._words = None, None, -1, None


class _Late(Exception):
    """A stage took too long; `str()` says which."""
