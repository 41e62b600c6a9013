"""Progress of a run: a line with the case, the method, its iteration and J for each method that is running."""

import time
from typing import Any, Protocol, Self

from rich.console import Console
from rich.progress import Progress as Bars
from rich.progress import SpinnerColumn, TaskID, TextColumn, TimeElapsedColumn

from optim.model.result import Iterate
from replay.base.errors import printable


class _Lines(Protocol):
    """Lines of work that come and go."""

    def start(self) -> None: ...
    def stop(self) -> None: ...
    def add(self, work: str, state: str) -> None: ...
    def change(self, work: str, state: str) -> None: ...
    def remove(self, work: str) -> None: ...


class Progress:
    """A context manager around a piece of work; its lines vanish at the end. Does nothing unless enabled."""

    def __init__(self, console: Console | None = None, *, enabled: bool | None = None, prefix: str = "") -> None:
        """By default enabled on a terminal and in a notebook; `prefix` begins each line."""
        console = console or Console(stderr=True)
        wanted = console.is_terminal or console.is_jupyter if enabled is None else enabled
        is_notebook = wanted and console.is_jupyter
        self._lines: _Lines = _NotebookLines(prefix) if is_notebook else _TerminalLines(console, prefix, wanted)
        self._works: set[str] = set()
        self._depth = 0

    def __enter__(self) -> Self:
        self._depth += 1
        if self._depth == 1:
            self._lines.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._depth -= 1
        if self._depth == 0:
            self._lines.stop()

    def show(self, work: str, state: str) -> None:
        """Show this work alone."""
        for other in list(self._works):
            self.end(other)
        self.begin(work, state)

    def begin(self, work: str, state: str) -> None:
        """Show a further task."""
        self.end(work)
        self._works.add(work)
        self._lines.add(work, state)

    def iterate(self, work: str, iterate: Iterate) -> None:
        """Show the iterate that some work has come to, unless it is a rejected trial."""
        if work in self._works and iterate.accepted:
            self._lines.change(work, f"iteration {iterate.iteration}, J {iterate.objective:.2f}")

    def end(self, work: str) -> None:
        """Remove the line of some work."""
        if work in self._works:
            self._works.remove(work)
            self._lines.remove(work)


class _TerminalLines:
    """Lines of rich, on a terminal."""

    def __init__(self, console: Console, prefix: str, enabled: bool) -> None:
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

    def start(self) -> None:
        self._bars.start()

    def stop(self) -> None:
        self._bars.stop()

    def add(self, work: str, state: str) -> None:
        self._tasks[work] = self._bars.add_task(printable(work), total=None, state=state)

    def change(self, work: str, state: str) -> None:
        self._bars.update(self._tasks[work], state=state)

    def remove(self, work: str) -> None:
        self._bars.remove_task(self._tasks.pop(work))


class _NotebookLines:
    """Plain text in the output of a notebook's cell: rich would need ipywidgets there."""

    _PAUSE_S = 0.2
    """Time between updates [s]."""

    def __init__(self, prefix: str) -> None:
        self._prefix = prefix
        self._states: dict[str, tuple[str, float]] = {}
        self._output: Any = None
        self._shown = 0.0

    def start(self) -> None:
        from IPython.display import display

        self._output = display({"text/plain": ""}, raw=True, display_id=True)

    def stop(self) -> None:
        self._states.clear()
        self._draw()

    def add(self, work: str, state: str) -> None:
        self._states[work] = (state, time.monotonic())
        self._draw()

    def change(self, work: str, state: str) -> None:
        self._states[work] = (state, self._states[work][1])
        if time.monotonic() - self._shown > self._PAUSE_S:
            self._draw()

    def remove(self, work: str) -> None:
        del self._states[work]

    def _draw(self) -> None:
        now = self._shown = time.monotonic()
        lines = (f"{self._prefix} {work} {state} {now - began:.0f} s" for work, (state, began) in self._states.items())
        self._output.update({"text/plain": "\n".join(printable(line).strip() for line in lines)}, raw=True)
