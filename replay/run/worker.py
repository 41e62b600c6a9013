"""Methods in child processes, so that a crash, a hang or a shortage of memory costs one method and no more.

A child stays warm between methods; it gets a problem and a method, and sends iterates and the outcome back.
"""

import math
import os
import pickle
import sys
import time
from collections.abc import Callable, Generator, Mapping
from functools import partial
from multiprocessing.connection import Connection, wait
from typing import Any, Self

from optim.model.method import Method
from optim.model.problem import Problem
from optim.model.result import OnIterate, ignore
from replay.run.child import Child, Died, send
from replay.run.limits import NO_LIMITS, Limits
from replay.run.solving import OnNamedIterate, OnStart, Solved, solve


def usable_cores() -> int:
    """Cores that this process may use."""
    return len(os.sched_getaffinity(0)) if sys.platform == "linux" else os.cpu_count() or 1


class Worker:
    """A child process that runs methods, one at a time; see `Workers`."""

    def __init__(self, limits: Limits) -> None:
        self.limits = limits
        self._child: Child | None = None
        self._clock = _Clock(math.inf)
        self._on_iterate: OnIterate = ignore

    def begin(self, problem: Problem, method: Method, on_iterate: OnIterate) -> None:
        """Give a method to the child, which has none; `step` returns what comes of it."""
        if self._child is None or not self._child.is_alive:
            self.end()
            self._child = Child.forked(_serve, memory_mib=self.limits.memory_mib)
        self._clock, self._on_iterate = _Clock(self.limits.watch_s), on_iterate
        self._child.send((problem, method, self.limits.time_s, self.limits.by_processor))

    @property
    def pipe(self) -> Any:
        """Connection to the child; `wait` takes it."""
        assert self._child is not None
        return self._child.pipe

    def left(self) -> float | None:
        """Time until the method's process is ended [s]; None for no end."""
        return self._clock.left()

    def step(self) -> Solved | None:
        """Handle one message from the child; return the outcome once it arrives or time runs out."""
        assert self._child is not None
        try:
            message = self._child.receive(0.0)
        except Died as died:
            self._child = None
            return self._lost(error=str(died))
        if message is None:
            if self.left() != 0.0:
                return None
            self.end()
            return self._lost(out_of_time=True)
        kind, body = message
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

    def end(self) -> None:
        """End the child, whatever it does."""
        if self._child is not None:
            self._child.end()
        self._child = None


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


def _serve(pipe: Connection) -> None:
    """The child: solve what comes until the pipe closes."""

    def say(kind: str, body: object) -> None:
        send(pipe, (kind, body))

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
