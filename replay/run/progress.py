"""Progress of a run on a terminal: a line with the case, the method, its iteration and J for each method at work."""

from typing import Self

from rich.console import Console
from rich.progress import Progress as Bars
from rich.progress import SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from optim.model.result import Iterate
from replay.base.errors import printable


class Progress:
    """A context manager around a piece of work; its lines vanish at the end. Does nothing unless enabled."""

    def __init__(self, console: Console, *, enabled: bool, prefix: str = "") -> None:
        columns = [TextColumn(text, markup=False) for text in (prefix, "{task.description}", "{task.fields[state]}")]
        # Standard output is not redirected: it may be a file, and nothing is printed there while they are up.
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
        self._tasks: dict[str, TaskID] = {}

    def __enter__(self) -> Self:
        self._bars.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._bars.stop()

    def show(self, work: str, state: str) -> None:
        """What is being worked on, from now on, and nothing else."""
        for other in list(self._tasks):
            self.end(other)
        self.begin(work, state)

    def begin(self, work: str, state: str) -> None:
        """What is being worked on too, from now on."""
        self._tasks[work] = self._bars.add_task(printable(work), total=None, state=state)

    def iterate(self, work: str, iterate: Iterate) -> None:
        """Some work has come to this iterate; trials that were turned down lead nowhere."""
        if work in self._tasks and iterate.accepted:
            state = f"iteration {iterate.iteration}, J {iterate.objective:.2f}"
            self._bars.update(self._tasks[work], state=state)

    def end(self, work: str) -> None:
        """Some work is done."""
        if work in self._tasks:
            self._bars.remove_task(self._tasks.pop(work))
