"""The folder of a run: one file for each log, and these files are the state of the run.

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
from collections.abc import Iterator, Mapping
from typing import Any

from replay.base.documents import plain
from replay.base.errors import ReplayError
from replay.base.files import WRITE_ERROR, atomic_write, sync_directory
from replay.base.strict_json import JsonError, read_json
from replay.report.reading import LARGEST_LOG, LOG_SCHEMA, RUN_SCHEMA, log_files

ATTEMPTS = "attempts"
_LONGEST = 200
"""Characters of a file's name, its suffix apart."""
_TEMPORARY = re.compile(r"\..*\.tmp")


class Store:
    """The files of one run."""

    def __init__(self, folder: str | os.PathLike[str]) -> None:
        self.folder = pathlib.Path(folder)
        self.logs = self.folder / "logs"

    def make(self) -> None:
        """Its folders. ReplayError (E_WRITE) where they cannot be made."""
        try:
            for folder in (self.logs, self.folder / "recordings"):
                folder.mkdir(parents=True, exist_ok=True)
        except OSError as error:
            raise ReplayError(WRITE_ERROR, f"{self.folder}: {error.strerror}") from error

    def write_head(self, head: Mapping[str, Any]) -> None:
        """run.json."""
        text = json.dumps(plain({"schema": RUN_SCHEMA, **head}), indent=1, sort_keys=True)
        with atomic_write(self.folder / "run.json") as temporary:
            temporary.write_bytes(text.encode("utf-8", "backslashreplace") + b"\n")

    def head(self) -> dict[str, Any]:
        """The content of run.json. ReplayError (E_RUN) where there is none."""
        path = self.folder / "run.json"
        try:
            head = read_json(path, LARGEST_LOG)
        except JsonError as error:
            raise ReplayError("E_RUN", f"{path}: {error}; expected the folder of a run of `replay regress`") from None
        if not isinstance(head, dict) or head.get("schema") != RUN_SCHEMA:
            raise ReplayError("E_RUN", f"{path}: no {RUN_SCHEMA} document")
        return head

    def file(self, name: str) -> pathlib.Path:
        """Where the document of a log is, or will be."""
        return self.logs / (file_stem(name) + ".json")

    def done(self) -> set[str]:
        """Names of the files that are there."""
        return {path.name for path in log_files(self.folder)}

    def documents(self) -> Iterator[dict[str, Any]]:
        """The documents one after the other; what is damaged is left out, `replay report` names it."""
        for path in log_files(self.folder):
            with contextlib.suppress(JsonError):
                document = read_json(path, LARGEST_LOG)
                if isinstance(document, dict) and document.get("schema") == LOG_SCHEMA:
                    yield document

    def publish(self, document: Mapping[str, Any]) -> bool:
        """Give a log's document its name; False where there is one already. ReplayError (E_WRITE) where it cannot."""
        text = json.dumps(plain(document), sort_keys=True, allow_nan=False, separators=(",", ":"))
        final = self.file(document["log"])
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
        """A line in `attempts`."""
        descriptor = os.open(self.folder / ATTEMPTS, os.O_WRONLY | os.O_APPEND | os.O_CREAT, 0o666)
        try:
            os.write(descriptor, f"{file_stem(name)}\n".encode())
        finally:
            os.close(descriptor)

    def sweep(self) -> None:
        """Remove what killed processes have left. Only where no other process works on the run."""
        for name in os.listdir(self.logs):  # noqa: PTH208 - there may be tens of thousands
            if _TEMPORARY.fullmatch(name):
                (self.logs / name).unlink(missing_ok=True)


def _link(temporary: pathlib.Path, final: pathlib.Path) -> None:
    """Give a file its final name unless it is taken: FileExistsError."""
    try:
        os.link(temporary, final)
    except OSError as error:
        if error.errno not in (errno.EPERM, errno.ENOTSUP, errno.ENOSYS):
            raise
        if final.exists():  # no hard links here: as near as such a file system allows
            raise FileExistsError from error
        temporary.replace(final)


def file_stem(name: str) -> str:
    """A log's name as a file's: reversible where it is short, never hidden, never of another folder."""
    stem = urllib.parse.quote(name.encode("utf-8", "surrogatepass"), safe=" ()+,=@")
    if stem.startswith("."):
        stem = "%2E" + stem[1:]
    if len(stem) > _LONGEST:
        digest = hashlib.sha256(stem.encode()).hexdigest()[:16]
        stem = f"{stem[: _LONGEST - 17]}~{digest}"
    return stem
