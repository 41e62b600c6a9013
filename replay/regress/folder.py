"""The folder of a run: one document for each log, and these files are the state of the run.

A log's document takes its name in one step and only if there is none yet (`os.link`), so that however often a log is
worked on, killed and worked on again, there is exactly one whole document of it. `attempts` has a line for each time
that work on a log began.
"""

import contextlib
import errno
import hashlib
import json
import os
import pathlib
import re
import secrets
import urllib.parse
from collections.abc import Iterator

from replay.base import run_folder
from replay.base.documents import DocumentError, plain, read_json
from replay.base.errors import ReplayError
from replay.base.files import WRITE_ERROR, atomic_write, sync_directory
from replay.base.run_folder import HEAD, LOGS, RECORDINGS
from replay.base.schemas.log import LARGEST_LOG, LogResults
from replay.base.schemas.run import RunHead

ATTEMPTS = "attempts"
_LONGEST = 200
"""Characters of a file's name without its suffix."""
_TEMPORARY = re.compile(r"\..*\.tmp")


class RunFolder:
    """The files of one run."""

    def __init__(self, path: str | os.PathLike[str]) -> None:
        self.path = pathlib.Path(path)
        self.logs = self.path / LOGS

    def make(self) -> None:
        """Make the folders for documents and recordings. Raises ReplayError (E_WRITE)."""
        try:
            for folder in (self.logs, self.path / RECORDINGS):
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ReplayError(WRITE_ERROR, f"{self.path}: {error.strerror}") from error

    def write_head(self, head: RunHead) -> None:
        """Write the head. Raises ReplayError (E_WRITE)."""
        write_document(self.path / HEAD, json.dumps(plain(head), indent=1, sort_keys=True))

    def head(self) -> RunHead:
        """Read the head. Raises ReplayError (E_RUN) where there is none."""
        return run_folder.read_head(self.path)

    def file(self, name: str) -> pathlib.Path:
        """Path of a log's document, by the log's name."""
        return self.logs / (file_stem(name) + ".json")

    def done(self) -> set[str]:
        """Names of the documents that are there, as files."""
        return {path.name for path in run_folder.log_files(self.path)}

    def documents(self) -> Iterator[LogResults]:
        """Read the documents one after the other; damaged ones are left out, `replay report` names them."""
        for path in run_folder.log_files(self.path):
            with contextlib.suppress(DocumentError):
                yield read_json(path, LogResults, LARGEST_LOG)

    def publish(self, document: LogResults) -> bool:
        """Give a log's document its name; False where there is one already. Raises ReplayError (E_WRITE)."""
        text = json.dumps(plain(document), sort_keys=True, allow_nan=False, separators=(",", ":"))
        final = self.file(document.log)
        temporary = self.logs / f".{secrets.token_hex(8)}.tmp"
        try:
            with temporary.open("xb") as file:
                file.write(text.encode("utf-8", "backslashreplace") + b"\n")
                file.flush()
                os.fsync(file.fileno())
            _link(temporary, final)
            sync_directory(self.logs)
        except FileExistsError:
            return False
        except OSError as error:
            raise ReplayError(WRITE_ERROR, f"{final}: cannot be written: {error.strerror}") from error
        finally:
            with contextlib.suppress(OSError):
                temporary.unlink(missing_ok=True)
        return True

    def note_attempt(self, name: str) -> None:
        """Add a line to `attempts`."""
        descriptor = os.open(self.path / ATTEMPTS, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            os.write(descriptor, f"{file_stem(name)}\n".encode())
        finally:
            os.close(descriptor)

    def sweep(self) -> None:
        """Remove temporary files of killed processes. Only while no other process works on the run."""
        for name in os.listdir(self.logs):  # noqa: PTH208 - there may be tens of thousands
            if _TEMPORARY.fullmatch(name):
                (self.logs / name).unlink(missing_ok=True)


def write_document(path: pathlib.Path, text: str) -> None:
    """Write a JSON text as a file, whole or not at all. Raises ReplayError (E_WRITE)."""
    with atomic_write(path) as temporary:
        temporary.write_bytes(text.encode("utf-8", "backslashreplace") + b"\n")


def _link(temporary: pathlib.Path, final: pathlib.Path) -> None:
    """Give a file its final name. Raises FileExistsError where the name is taken."""
    try:
        os.link(temporary, final)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS):
            raise
        if final.exists():  # no hard links here: as near as such a file system allows
            raise FileExistsError from error
        temporary.replace(final)


def file_stem(name: str) -> str:
    """A log's name as a file's: reversible where it is short, never hidden, never in another folder."""
    stem = urllib.parse.quote(name.encode("utf-8", "surrogatepass"), safe=" ()+,=@")
    if stem.startswith("."):
        stem = "%2E" + stem[1:]
    if len(stem) > _LONGEST:
        digest = hashlib.sha256(stem.encode()).hexdigest()[:16]
        stem = f"{stem[: _LONGEST - 17]}~{digest}"
    return stem
