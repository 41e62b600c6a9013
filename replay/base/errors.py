"""Errors that a user meets: one line each, with a stable code and an exit status.

Everything a log, a file name or a results file contributes to such a line passes through `printable`,
so that no file can move the cursor, hide text or forge another line on a terminal.
"""

import difflib
import os
from collections.abc import Iterable
from typing import Final

ERROR_LENGTH = 1200  # characters; nobody reads a longer line


def printable(text: object, limit: int = 200) -> str:
    """`text` with every control, bidirectional or otherwise invisible character escaped, cut at `limit` characters."""
    raw = str(text)
    shown = raw if len(raw) <= limit else raw[: limit - 1] + "…"
    if shown.isprintable():
        return shown
    return "".join(c if c.isprintable() else c.encode("unicode_escape").decode("ascii") for c in shown)


class ReplayError(Exception):
    """An error that a user can understand and correct: `str()` is one line, `code` never changes its meaning.

    Args:
        code: stable identifier such as ``E_NO_MAP``, for programs and for searching.
        message: what was found, where, what was expected, and which choices there are.
    """

    exit_status: int = 2

    def __init__(self, code: str, message: str) -> None:
        self.code = code
        self.message = printable(message, ERROR_LENGTH)
        super().__init__(self.message)

    def __str__(self) -> str:
        return f"{self.message} [{self.code}]"

    def __reduce__(self) -> tuple[object, ...]:
        # exceptions travel between processes; the default would call __init__ with the finished line only
        return type(self), (self.code, self.message)


USAGE_ERROR: Final = "E_USAGE"
"""Code of errors in what was asked for, to which the help has the answer."""


class UsageError(ReplayError):
    """Arguments that are unknown or cannot be used together, or a value out of its range."""

    def __init__(self, message: str) -> None:
        super().__init__(USAGE_ERROR, message)

    def __reduce__(self) -> tuple[object, ...]:
        return UsageError, (self.message,)


def unknown(kind: str, word: str, choices: Iterable[str], where: str = "") -> str:
    """One sentence about a word that is not among the choices: where it stands, the nearest of them, all of them."""
    choices = list(choices)
    nearest = difflib.get_close_matches(word, choices, n=1)
    guess = f" Did you mean {nearest[0]!r}?" if nearest else ""
    place = f" {where}" if where else ""
    return f"unknown {kind} {word!r}{place}.{guess} There are: {', '.join(choices)}"


class OutputLost(Exception):
    """Standard output cannot be written to, as on a full disk; `str()` is one line."""


class LogError(ReplayError):
    """A log that cannot be used. The line begins with the file's name."""

    def __init__(self, code: str, path: str | os.PathLike[str], message: str) -> None:
        self.path = os.fspath(path)
        super().__init__(code, f"{printable(self.path)}: {message}")

    def __reduce__(self) -> tuple[object, ...]:
        return _restore, (type(self), self.code, self.path, self.message)


def _restore(kind: type[LogError], code: str, path: str, message: str) -> LogError:
    error = kind.__new__(kind)
    ReplayError.__init__(error, code, message)
    error.path = path
    return error
