"""Supervisors of workers on this machine: each starts a worker, watches it, ends it, and says why it died."""

import queue
import sys
import threading
import time
from collections.abc import Generator, Iterable, Iterator
from typing import Any, Self

from replay.regress.job import Job, Outcome, publish_error
from replay.run.child import Child, Died
from replay.run.limits import BUSY, NO_LIMITS, Limits
from replay.run.reading import COMPILE_S, READ_S

START_S = 120.0
"""Time for a worker to start and import what it needs [s]."""
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
        self._worker: Child | None = None
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
                except Died as died:
                    self._worker, words = None, str(died)
            return publish_error(job, "E_CRASHED", words)
        except _Late as late:
            return publish_error(job, "E_HUNG", str(late))
        except BaseException:
            self.end()
            raise

    def _run(self, job: Job) -> Outcome:
        worker = self._ready(job)
        usual = READ_S if self._jobs else READ_S + COMPILE_S
        self._jobs += 1
        worker.send(job)
        stage, limit = "reading", usual
        while True:
            kind, body = self._next(worker, stage, limit)
            if kind == "done":
                return body
            is_method = body.startswith("method ")
            stage, limit = body, BUSY * job.options.limits.time_s + COMPILE_S if is_method else usual

    def _next(self, worker: Child, stage: str, limit: float) -> tuple[str, Any]:
        """The next message. Raises _Late, Stopped, Died."""
        deadline = time.monotonic() + limit
        while (message := worker.receive(_POLL_S)) is None:
            if self._stop.is_set():
                raise Stopped
            if time.monotonic() > deadline:
                self.end()
                raise _Late(f"{stage}: no end after {limit:.0f} s")
        return message

    def _ready(self, job: Job) -> Child:
        """The worker, which is started if there is none, or if it has served long enough. Raises Died."""
        limits = job.options.limits
        if self._worker is not None and limits == self._limits and self._jobs < MOST_JOBS:
            return self._worker
        self.end()
        self._limits, self._jobs = limits, 0
        try:
            self._worker = Child.started([sys.executable, "-P", "-m", "replay.regress.worker"])
        except OSError as error:
            raise Died(f"its process could not be started: {error}") from error
        self._worker.send((sys.path, limits))
        self._next(self._worker, "starting", START_S)
        return self._worker

    def end(self) -> None:
        """End the worker and all processes below it."""
        if self._worker is not None:
            self._worker.end()
        self._worker = None


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
