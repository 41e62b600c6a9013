"""Writing files so that an output path either does not exist or holds a complete file.

Whatever is written goes to `.NAME.PID.tmp` in the same directory first, is synced, and takes its name in one step
(`os.replace`); then the directory is synced, so that the name survives a power failure too. A process that is
killed leaves at most its temporary file, which the next writer of the same name removes.
"""

import contextlib
import errno
import os
import pathlib
import re
from collections.abc import Iterator

from replay.base.errors import ReplayError

WRITE_ERROR = "E_WRITE"
BUSY_ERROR = "E_BUSY"
_TEMPORARY, _RUN = "tmp", "run"


@contextlib.contextmanager
def atomic_write(path: str | os.PathLike[str]) -> Iterator[pathlib.Path]:
    """Give the path of an empty temporary file; when the block succeeds, it becomes `path`, else it is removed.

    The block may write by path or replace the file, and should verify what it wrote. An OSError (no permission, no
    such folder, disk full), in the block too, becomes a `ReplayError` (E_WRITE) of one line; other exceptions pass.
    """
    target = pathlib.Path(path)
    if target.name in ("", "..") or "\0" in str(target):
        raise ReplayError(WRITE_ERROR, f"{target} cannot be a file's name")
    temporary = _beside(target, os.getpid(), _TEMPORARY)
    try:
        with _removed_on_failure(temporary):
            _remove_leftovers(target)
            _create(temporary)
            yield temporary
            _sync(temporary)
            temporary.replace(target)
        sync_directory(target.parent)
    except OSError as error:
        raise _unwritable(target, error) from error


@contextlib.contextmanager
def _removed_on_failure(temporary: pathlib.Path) -> Iterator[None]:
    try:
        yield
    except BaseException:  # Ctrl-C included
        with contextlib.suppress(OSError):  # the first failure is the one to report
            temporary.unlink()
        raise


@contextlib.contextmanager
def reserved(path: str | os.PathLike[str]) -> Iterator[None]:
    """Keep other processes from working on `path` while the block runs; a killed process keeps nobody out.

    An empty file `.NAME.PID.run` beside it marks who works on it; of several the oldest counts. Raises ReplayError
    (E_BUSY) where another process works on it, E_WRITE where the folder cannot be written to.
    """
    target = pathlib.Path(path)
    mark = _beside(target, os.getpid(), _RUN)
    with _removed_on_failure(mark):
        try:
            _remove_leftovers(target)
            _create(mark)
            first = _oldest_mark(target)
        except OSError as error:
            raise _unwritable(target, error) from error
        if first != os.getpid():
            raise ReplayError(BUSY_ERROR, f"{target}: process {first} is working on it; wait, or use another --out")
        yield
    with contextlib.suppress(OSError):
        mark.unlink(missing_ok=True)


def _oldest_mark(target: pathlib.Path) -> int:
    """The process whose mark is the oldest; of two of one age, the smaller number."""
    age: dict[int, int] = {}
    for pid in _writers(target, _RUN):
        with contextlib.suppress(FileNotFoundError):  # done in the meantime
            age[pid] = _beside(target, pid, _RUN).stat().st_mtime_ns
    return min(age, key=lambda pid: (age[pid], pid))


def _unwritable(target: pathlib.Path, error: OSError) -> ReplayError:
    reason = error.strerror or str(error) or type(error).__name__
    return ReplayError(WRITE_ERROR, f"{target}: cannot be written: {reason}")


def _beside(target: pathlib.Path, pid: int, suffix: str) -> pathlib.Path:
    """The file of a process beside `target`."""
    return target.with_name(f".{target.name}.{pid}.{suffix}")


def _writers(target: pathlib.Path, suffix: str) -> list[int]:
    """Processes that have such a file beside `target`, running or not."""
    pattern = re.compile(re.escape(f".{target.name}.") + r"(\d{1,10})\." + suffix)
    names = os.listdir(target.parent)  # noqa: PTH208 - a folder of results may hold tens of thousands
    return [int(match[1]) for match in map(pattern.fullmatch, names) if match]


def _create(temporary: pathlib.Path) -> None:
    """A new empty file, never what somebody else put there: the name can be guessed, and could be a link."""
    temporary.unlink(missing_ok=True)
    os.close(os.open(temporary, os.O_CREAT | os.O_EXCL | os.O_WRONLY, 0o666))


def _remove_leftovers(target: pathlib.Path) -> None:
    """Remove temporary files of this name whose process has ended."""
    for suffix in (_TEMPORARY, _RUN):
        for pid in _writers(target, suffix):
            if not _is_running(pid):
                _beside(target, pid, suffix).unlink(missing_ok=True)


def _is_running(pid: int) -> bool:
    try:
        os.kill(pid, 0)
    except (ProcessLookupError, OverflowError):
        return False
    except PermissionError:
        pass  # running, as somebody else's
    return True


def _sync(path: pathlib.Path) -> None:
    with path.open("rb") as file:
        os.fsync(file.fileno())


def sync_directory(path: pathlib.Path) -> None:
    """Have the names in a folder survive a power failure, where its file system can do that. Raises OSError."""
    descriptor = os.open(path, os.O_RDONLY | os.O_DIRECTORY)
    try:
        os.fsync(descriptor)
    except OSError as error:
        if error.errno not in (
            errno.EINVAL,
            errno.ENOTSUP,
        ):  # a file system that does not sync directories; the file itself is safe
            raise
    finally:
        os.close(descriptor)
