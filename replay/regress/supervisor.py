"""Supervisors of workers on this machine: each starts a worker, watches it, ends it, and says why it died."""

import contextlib
import os
import pickle
import queue
import signal
import socket
import subprocess
import sys
import tempfile
import threading
import time
from collections.abc import Generator, Iterable, Iterator
from multiprocessing.connection import Connection
from typing import IO, Any, Self

from replay.regress.job import Job, Outcome, publish_error
from replay.run.limits import BUSY, NO_LIMITS, Limits

START_S = 120.0
"""Time for a worker to start and import what it needs [s]."""
READ_S = 60.0
"""Time for reading a log, for measuring a recorded path, and for writing a recording, each [s]."""
COMPILE_S = 300.0
"""Time for a method beside its own limit, and for every stage of a worker's first job [s]: kernels may have to be
compiled."""
MOST_JOBS = 200
"""Jobs after which a worker is replaced, to bound memory growth."""
MOST_TRIES = 2
"""Workers that one log may cost."""
_POLL_S, _QUEUE_S = 0.1, 0.2


class Stopped(Exception):
    """The run was stopped while a job was being done."""


class Supervisor:
    """Keeps one worker, which does one job at a time. A context manager: the worker ends with it."""

    def __init__(self, stop: threading.Event | None = None) -> None:
        self._stop = stop or threading.Event()
        self._process: subprocess.Popen[bytes] | None = None
        self._pipe: Connection | None = None
        self._lifeline = -1
        self._words: IO[bytes] | None = None
        self._limits: Limits = NO_LIMITS
        self._jobs = 0

    def __enter__(self) -> Self:
        return self

    def __exit__(self, *_: object) -> None:
        self.end()

    def run(self, job: Job) -> Outcome:
        """Have a job done; a log that kills its worker twice, or hangs, becomes an error of its own. Raises Stopped.

        Twice, because the worker may have been killed by somebody else, as by a system that runs out of memory.
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
            stage, limit = body, BUSY * job.options.limits.time_s + COMPILE_S if is_method else usual

    def _next(self, pipe: Connection, stage: str, limit: float) -> tuple[str, Any]:
        """The next message. Raises _Late, Stopped, EOFError where the worker has died."""
        deadline = time.monotonic() + limit
        while not pipe.poll(_POLL_S):
            if self._stop.is_set():
                raise Stopped
            if time.monotonic() > deadline:
                self.end()
                raise _Late(f"{stage}: no end after {limit:.0f} s")
        return pickle.loads(pipe.recv_bytes())

    def _ready(self, job: Job) -> Connection:
        """The socket to the worker, which is started if there is none, or if it has served long enough."""
        limits = job.options.limits
        if self._pipe is not None and limits == self._limits and self._jobs < MOST_JOBS:
            return self._pipe
        self.end()
        self._limits, self._jobs = limits, 0
        pipe = self._pipe = self._start()
        pipe.send_bytes(pickle.dumps((sys.path, limits)))
        self._next(pipe, "starting", START_S)
        return pipe

    def _start(self) -> Connection:
        ours, theirs = socket.socketpair()
        end, self._lifeline = os.pipe()
        self._words = tempfile.TemporaryFile()  # noqa: SIM115 - lives as long as the process
        command = [sys.executable, "-P", "-m", "replay.regress.worker", str(theirs.fileno()), str(end)]
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
        """Why the worker has died, and the last line that it wrote."""
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
        """End the worker and all processes below it."""
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


def run_here(jobs: Iterable[Job], num_workers: int) -> Generator[Outcome]:
    """Do jobs in workers of this machine; outcomes come in the order in which jobs end.

    Jobs are taken when a worker is free, so that their number does not matter for memory. Closing the iterator, or an
    exception in whoever reads it, ends all workers. Raises what a job's bookkeeping raises (OSError where results
    cannot be written).
    """
    stop = threading.Event()
    done: _Done = queue.SimpleQueue()
    shared = (iter(jobs), threading.Lock(), stop, done)
    threads = [threading.Thread(target=_serve, args=shared, daemon=True) for _ in range(num_workers)]
    for thread in threads:
        thread.start()
    try:
        yield from _outcomes(done, num_workers)
    finally:
        stop.set()
        for thread in threads:
            thread.join()


_Done = queue.SimpleQueue[Outcome | BaseException | None]
"""What the threads have to say: an outcome, an error that ends the run, or None at a thread's end."""


def _serve(waiting: Iterator[Job], taking: threading.Lock, stop: threading.Event, done: _Done) -> None:
    """A thread: take jobs and have them done in one worker, until there are none left."""
    try:
        with Supervisor(stop) as supervisor:
            while not stop.is_set():
                with taking:
                    job = next(waiting, None)
                if job is None:
                    break
                done.put(supervisor.run(job))
    except Stopped:
        pass
    except BaseException as error:
        done.put(error)
    done.put(None)


def _outcomes(done: _Done, num_busy: int) -> Generator[Outcome]:
    """Outcomes until every thread has ended. Raises what a thread raised."""
    while num_busy:
        try:
            outcome = done.get(timeout=_QUEUE_S)  # with a timeout, so that Ctrl-C is noticed
        except queue.Empty:
            continue
        if isinstance(outcome, BaseException):
            raise outcome
        if outcome is None:
            num_busy -= 1
        else:
            yield outcome
