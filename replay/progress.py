"""Progress of a run on a terminal: one line with the case, the method, its iteration and its objective."""

from typing import Self

from rich.console import Console
from rich.progress import Progress as Bars
from rich.progress import SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from optim.result import Iterate
from replay.errors import printable


class Progress:
    """A context manager around a piece of work; its line vanishes at the end. Does nothing unless enabled."""

    def __init__(self, console: Console, *, enabled: bool, prefix: str = "") -> None:
        columns = [TextColumn(text, markup=False) for text in (prefix, "{task.description}", "{task.fields[state]}")]
        # Standard output is not redirected: it may be a file, and nothing is printed there while the line is up.
        self._bars = Bars(
            SpinnerColumn(),
            *columns,
            TimeElapsedColumn(),
            console=console,
            transient=True,
            disable=not enabled,
            redirect_stdout=False,
            redirect_stderr=False,
        )
        self._task: TaskID | None = None

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def show(self, work: str, state: str) -> None:
        """What is being worked on, from now on."""
        if self._task is not None:
            self._bars.remove_task(self._task)
        self._task = self._bars.add_task(printable(work), total=None, state=state)

    def iterate(self, iterate: Iterate) -> None:
        """The present work has come to this iterate; trials that were turned down lead nowhere."""
        if self._task is not None and iterate.accepted:
            self._bars.update(self._task, state=f"iteration {iterate.iteration}, J {iterate.objective:.2f}")
