"""Progress of a regression run on a terminal: rate, remaining time, and what has failed so far."""

import time
from collections import Counter
from typing import Self

from rich.console import Console
from rich.progress import BarColumn, MofNCompleteColumn, TextColumn, TimeElapsedColumn
from rich.progress import Progress as Bars

from replay.regress.job import Outcome

_FAILURES = ("crashed", "worse", "unread")


class RunProgress:
    """A context manager around a run; the bar vanishes at the end. Does nothing unless enabled."""

    def __init__(self, console: Console, *, enabled: bool, unit: str = "logs") -> None:
        self._unit = unit
        self._bars = Bars(
            BarColumn(),
            MofNCompleteColumn(),
            TimeElapsedColumn(),
            TextColumn("{task.fields[words]}", markup=False),
            console=console,
            transient=True,
            disable=not enabled,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self._task = self._bars.add_task("", total=None, words="starting")
        self._counts: Counter[str] = Counter()
        self._begun, self._done_before = time.monotonic(), 0

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def outcome(self, outcome: Outcome | None, done: int, total: int) -> None:
        """Show that one more log is done; None before the first."""
        if outcome is None:
            self._begun, self._done_before = time.monotonic(), done
        else:
            self._counts[outcome.state] += 1
        self.count(done, total)

    def count(self, done: int, total: int) -> None:
        """Show how many units are done."""
        self._bars.update(self._task, completed=done, total=total, words=self.words(done, total))

    def words(self, done: int, total: int) -> str:
        """Rate, remaining time and failures so far."""
        rate = (done - self._done_before) / max(time.monotonic() - self._begun, 1e-9)
        failed = ", ".join(f"{self._counts[state]} {state}" for state in _FAILURES if self._counts[state])
        parts = (
            [f"{60.0 * rate:.3g} {self._unit}/min, {_duration((total - done) / rate)} left"]
            if rate > 0.0
            else ["starting"]
        )
        return "; ".join([*parts, failed or "no failure"])


def _duration(seconds: float) -> str:
    minutes, rest = divmod(round(seconds), 60)
    hours, minutes = divmod(minutes, 60)
    return f"{hours} h {minutes:02d} min" if hours else (f"{minutes} min {rest:02d} s" if minutes else f"{rest} s")
