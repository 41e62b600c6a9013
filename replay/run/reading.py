"""Reading logs in a child process, so that a log that hangs, crashes or eats memory ends in one line.

Forking costs a hundredth of a second; a program of its own would cost a second of imports.
"""

import os
import pathlib
from collections.abc import Callable
from multiprocessing.connection import Connection
from typing import Any, Final, TypeVar

from replay.base.errors import LogError
from replay.base.kernels import any_compiled
from replay.run.child import Child, Died, can_fork, send

READ_S: Final = 60.0
"""Time for reading a log [s], and for each other step between its methods; beside it `BYTES_PER_S`."""
COMPILE_S: Final = 300.0
"""Time more where kernels may have to be compiled [s]."""
BYTES_PER_S: Final = 10_000_000
"""A log may take a second more for so many bytes [B/s]; reading was measured at 300 MB/s."""
_T = TypeVar("_T")


def guarded(log: str | os.PathLike[str], read: Callable[..., _T], *arguments: object, memory_mib: int | None) -> _T:
    """Call what reads a log, in a child process where the system can fork; its result.

    Raises what it raises, and LogError: E_HUNG after `READ_S`, E_MEMORY beyond `memory_mib`, E_CRASHED.
    """
    if not can_fork():
        return read(*arguments)
    limit = READ_S + _size(pathlib.Path(log)) / BYTES_PER_S + (0.0 if any_compiled() else COMPILE_S)
    child = Child.forked(_answer, read, arguments, memory_mib=memory_mib)
    try:
        answer = child.receive(limit)
    except Died as died:
        raise LogError("E_CRASHED", log, f"reading it failed: {died}") from died
    finally:
        child.end()
    if answer is None:
        raise LogError("E_HUNG", log, f"reading it took more than {limit:.0f} s")
    error, result = answer
    if isinstance(error, MemoryError):
        raise LogError("E_MEMORY", log, f"reading it needs more than {memory_mib} MiB: `--memory-limit` allows more")
    if error is not None:
        raise error
    return result


def _answer(pipe: Connection, read: Callable[..., Any], arguments: tuple[object, ...]) -> None:
    """The child: send an error or a result."""
    try:
        send(pipe, (None, read(*arguments)))
    except Exception as error:  # a border: raised again in the parent
        send(pipe, (error, None))


def _size(path: pathlib.Path) -> int:
    """Bytes of a file, or of the files of a folder."""
    files = path.iterdir() if path.is_dir() else (path,)
    return sum(file.stat().st_size for file in files if file.is_file())
