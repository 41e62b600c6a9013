"""Exit statuses, and words for arguments that cannot be used."""

import difflib
import enum
import inspect
from collections.abc import Callable, Iterable
from typing import TypeVar

Command = TypeVar("Command", bound=Callable[..., int])


class ExitStatus(enum.IntEnum):
    """What a command's exit status says."""

    OK = 0
    """All well."""
    SHORT = 1
    """It ran, and something fell short: a method failed, an audit failed."""
    USAGE = 2
    """Wrong usage, or nothing among the inputs that can be used."""
    PARTIAL = 3
    """Done, but part of an input was lost, or some of several inputs could not be read."""
    INTERRUPTED = 130
    """Stopped by Ctrl-C; what was finished is kept. Stopped by SIGTERM or SIGHUP it is 143 or 129 (`cli.signals`)."""


def unknown(kind: str, word: str, choices: Iterable[str], where: str = "") -> str:
    """One sentence about a word that is not among the choices: where it stands, the nearest of them, all of them."""
    choices = list(choices)
    nearest = difflib.get_close_matches(word, choices, n=1)
    guess = f" Did you mean {nearest[0]!r}?" if nearest else ""
    place = f" {where}" if where else ""
    return f"unknown {kind} {word!r}{place}.{guess} There are: {', '.join(choices)}"


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
    "optimize": "replay optimize recordings/bay_01.mcap --out out",
    "info": "replay info recordings/bay_01.mcap",
    "vehicle": "replay vehicle > truck.toml",
    "audit": "replay audit out/bay_01.results.json",
    "report": "replay report runs/tonight",
    "view": "replay view out",
    "regress": "replay regress recordings",
    "compare": "replay compare before/bay_01.results.json after/bay_01.results.json",
}


def example(command: str) -> str:
    """How a command is called."""
    return _EXAMPLES.get(command, f"replay {command} --help")
