"""Files in the folder of a regression run, which `replay.regress` writes and `replay.report` reads."""

import os
import pathlib
from typing import Final

from replay.base.documents import DocumentError, read_json
from replay.base.errors import ReplayError
from replay.base.schemas.run import LARGEST_HEAD, RunHead

HEAD: Final = "run.json"
LOGS: Final = "logs"
RECORDINGS: Final = "recordings"
VERDICTS_FILE: Final = "verdicts.json"
TIMING_FILE: Final = "timing.json"
SUMMARY_FILE: Final = "summary.json"
RUN_ERROR: Final = "E_RUN"
"""The folder holds no run, or its head cannot be read."""


def read_head(folder: pathlib.Path) -> RunHead:
    """Read the head of the run in a folder. Raises ReplayError (E_RUN), one line, where there is none."""
    if not folder.is_dir():
        raise ReplayError(RUN_ERROR, f"{folder}: no such folder, expected one written by `replay regress`")
    path = folder / HEAD
    try:
        return read_json(path, RunHead, LARGEST_HEAD)
    except DocumentError as error:
        raise ReplayError(RUN_ERROR, f"{path}: {error}; expected the folder of a run of `replay regress`") from None


def log_files(folder: pathlib.Path) -> list[pathlib.Path]:
    """List the documents of the logs in the order of their names. Raises ReplayError (E_RUN)."""
    logs = folder / LOGS
    try:
        names = sorted(os.listdir(logs))  # noqa: PTH208 - there may be tens of thousands
    except FileNotFoundError:
        return []
    except OSError as error:
        raise ReplayError(RUN_ERROR, f"{logs}: {error.strerror}") from error
    return [logs / name for name in names if name.endswith(".json") and not name.startswith(".")]
