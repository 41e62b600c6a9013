"""Exit statuses, and words for arguments that cannot be used."""

import enum
import inspect
import os
import sys
from collections.abc import Callable, Sequence
from typing import TypeVar

from replay.cli.invoked import to_paste

Command = TypeVar("Command", bound=Callable[..., int])


class ExitStatus(enum.IntEnum):
    """Meaning of a command's exit status."""

    OK = 0
    """All well."""
    SHORT = 1
    """The command ran, but a method or an audit failed."""
    USAGE = 2
    """Wrong usage, or nothing among the inputs that can be used."""
    PARTIAL = 3
    """Done, but part of an input was lost, or some of several inputs could not be read."""
    INTERRUPTED = 130
    """Stopped by Ctrl-C; what was finished is kept. Stopped by SIGTERM or SIGHUP: 143 or 129 (`interrupts`)."""


def drop_output() -> None:
    """Discard what is still to be written on standard output, also when Python ends."""
    os.dup2(os.open(os.devnull, os.O_WRONLY), sys.stdout.fileno())


def reflowed(command: Command) -> Command:
    """The same command, the paragraphs of its docstring in one line each: its help is wrapped to the terminal alone."""
    lines = [""]
    for line in inspect.cleandoc(command.__doc__ or "").splitlines():
        if line.strip() and 0 < _indent(line) == _indent(lines[-1]):
            lines[-1] += " " + line.strip()
        else:
            lines.append(line)
    command.__doc__ = "\n".join(lines[1:])
    return command


def _indent(line: str) -> int:
    return len(line) - len(line.lstrip())


_EXAMPLES = {
    "optimize": "optimize recordings/bay_01.mcap --out out",
    "info": "info recordings/bay_01.mcap",
    "vehicle": "vehicle > truck.toml",
    "audit": "audit out/bay_01.results.json",
    "report": "report runs/RUN",
    "regress": "regress recordings",
    "regress accept": "regress accept runs/RUN",
    "compare": "compare before/bay_01.results.json after/bay_01.results.json",
}


def example(command: str) -> str:
    """Example call of a command, such as `regress accept`."""
    return to_paste(*_EXAMPLES.get(command, f"{command} --help").split())


def command_of(tokens: Sequence[str]) -> Sequence[str]:
    """The words at the beginning of a command line that name its command."""
    return tokens[: 2 if " ".join(tokens[:2]) in _EXAMPLES else 1]
