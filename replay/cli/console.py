"""Output of a command: data on standard output, everything for people on standard error."""

import json
import sys
import traceback
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass
from typing import Annotated, Any

from cyclopts import Parameter
from rich.console import Console, RenderableType

from replay.base.errors import OutputLost, printable

WIDTH = 100
"""Columns of a table that does not go to a terminal."""
LEAST_WIDTH = 80
"""Columns of a table on a terminal, at least: a narrower one wraps it, rather than that digits are lost."""
LONGEST = 4000
"""Characters of a line."""

_Switch = Annotated[bool, Parameter(negative=(), show_default=False)]


@dataclass(frozen=True, kw_only=True)
class Common:
    """Options that every command has."""

    json: _Switch = False
    """Print one JSON document on standard output, and nothing else there."""
    quiet: _Switch = False
    """No progress and no notes: the result, and errors."""
    verbose: _Switch = False
    """More notes, and tracebacks of errors, on standard error."""


@contextmanager
def _writing() -> Iterator[None]:
    """Turn a failure of standard output into OutputLost; a closed reader is not one."""
    try:
        yield
    except BrokenPipeError:
        raise
    except OSError as error:
        raise OutputLost(f"standard output cannot be written: {error.strerror or error}") from error


class _Console(Console):
    """Raises BrokenPipeError when the reader of its output has ended; rich would exit with status 1."""

    def on_broken_pipe(self) -> None:
        raise BrokenPipeError


class Voice:
    """Speaks for one command, as loud as its options say."""

    def __init__(self, common: Common) -> None:
        self.common = common
        self.data = _Console(highlight=False, markup=False, emoji=False)
        self.data.width = max(self.data.width, LEAST_WIDTH) if self.data.is_terminal else WIDTH
        self.people = _Console(stderr=True, highlight=False, markup=False, emoji=False)

    @property
    def wants_progress(self) -> bool:
        """Whether bars may be drawn: on a terminal, unless asked to be quiet."""
        return self.people.is_terminal and not self.common.quiet

    def show(self, *parts: RenderableType) -> None:
        """Data for people, on standard output; nothing in JSON mode."""
        if not self.common.json:
            with _writing():
                for part in parts:
                    is_line = isinstance(part, str)
                    self.data.print(printable(part, LONGEST) if is_line else part, soft_wrap=is_line)

    def document(self, content: dict[str, Any]) -> None:
        """The one JSON document, in JSON mode."""
        if self.common.json:
            # JSON has no infinity (the clearance in an empty scene) and no NaN: null, as in the results file
            content = json.loads(json.dumps(content), parse_constant=lambda _: None)
            with _writing():
                sys.stdout.write(json.dumps(content, indent=1, sort_keys=True) + "\n")
                sys.stdout.flush()

    def note(self, text: str) -> None:
        """A remark, on standard error unless quiet."""
        if not self.common.quiet:
            self._line(text)

    def detail(self, text: str) -> None:
        """A remark for the curious, on standard error if verbose."""
        if self.common.verbose:
            self._line(text)

    def error(self, text: str) -> None:
        """One line, on standard error, always; with the traceback of the present exception if verbose."""
        self._line(text)
        if sys.exc_info()[0] is not None:
            self.trace(traceback.format_exc())

    def trace(self, text: str) -> None:
        """A traceback, on standard error if verbose."""
        if self.common.verbose:
            self.people.print(text.rstrip(), soft_wrap=True)

    def _line(self, text: str) -> None:
        """Print a line, escaped: text from files must not move the cursor or forge a line."""
        self.people.print(f"replay: {printable(text, LONGEST)}", soft_wrap=True)
