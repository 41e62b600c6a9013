"""Compiled inner loops: Numba, kept on disk, compiled by one process at a time.

Numba's files of a kernel are not safe where processes of a fresh machine compile it at once: a process reads the index,
adds a signature of its own, and writes both back, so the index can end up naming code of another signature, which is
then called with arguments of the wrong types. Here whoever compiles holds a lock; the others wait and load.

Numba does not see a change in the file of a kernel that another one calls: whoever runs kernels after such a change
must remove what is kept of the callers first.
"""

import contextlib
import pathlib
from collections.abc import Callable, Iterator
from typing import Any, TypeVar, overload

from numba import njit
from numba.core import event

try:
    import fcntl
except ImportError:  # such systems run methods in one process
    fcntl = None

_F = TypeVar("_F", bound=Callable[..., Any])


@overload
def kernel(function: _F, /) -> _F: ...
@overload
def kernel(**options: Any) -> Callable[[_F], _F]: ...
def kernel(function: Any = None, /, **options: Any) -> Any:
    """Compile a function at its first call with each kind of arguments; `options` are those of `numba.njit`."""
    if function is None:
        return lambda decorated: kernel(decorated, **options)
    dispatcher: Any = njit(cache=True, **options)(function)
    if hasattr(dispatcher, "compile"):  # else Numba is switched off
        _lock_while_compiling(dispatcher, f"{function.__name__}-{function.__code__.co_firstlineno}.lock")
    return dispatcher


def _lock_while_compiling(dispatcher: Any, name: str) -> None:
    """Have `dispatcher.compile`, which loads what is on disk, or compiles and saves, hold the lock of this name."""
    compile_alone, depth = dispatcher.compile, 0

    def locked(signature: Any) -> Any:
        nonlocal depth
        with _lock(pathlib.Path(dispatcher.stats.cache_path) / name) if depth == 0 else contextlib.nullcontext():
            depth += 1
            try:
                return compile_alone(signature)
            finally:
                depth -= 1

    dispatcher.compile = locked


@contextlib.contextmanager
def _lock(path: pathlib.Path) -> Iterator[None]:
    """Hold a lock among processes; not where the folder cannot be written. Waiting counts as compiling."""
    with contextlib.ExitStack() as stack:
        with contextlib.suppress(OSError):
            if fcntl is not None:
                path.parent.mkdir(parents=True, exist_ok=True)
                file = stack.enter_context(path.open("w"))
                try:
                    fcntl.flock(file, fcntl.LOCK_EX | fcntl.LOCK_NB)
                except BlockingIOError:
                    with event.trigger_event("numba:compile"):
                        fcntl.flock(file, fcntl.LOCK_EX)
        yield
