"""The trend over the last runs, read from the folder in which runs are kept."""

import hashlib
import os
import pathlib
from collections.abc import Iterable

from replay.base.documents import DocumentError, read_json
from replay.base.errors import ReplayError
from replay.base.run_folder import HEAD, SUMMARY_FILE
from replay.base.schemas.summary import LARGEST_SUMMARY, Summary, TrendPoint
from replay.report.facts import by_method, state
from replay.report.run_data import RunData
from replay.report.run_files import read_run
from replay.report.safe import safe

MOST_RUNS = 30
"""Maximum number of runs in the trend; a month of nights."""


def point(run: RunData) -> TrendPoint:
    """One run as a point of the trend."""
    found = by_method(run)
    return TrendPoint(
        name=run.name,
        created=run.head.created,
        revision=run.head.revision,
        state=state(run),
        logs=len(run.logs),
        comparable=fingerprint(run),
        ratio={name: f.ratio for name, f in found.items() if f.ratio is not None},
        wall_s={name: f.wall_s for name, f in found.items() if f.wall_s is not None},
    )


def fingerprint(run: RunData) -> str:
    """Digest that is equal for runs that worked on the same logs."""
    logs = sorted({(row.log, row.sha256) for row in run.rows} | {(error.log, "") for error in run.errors})
    return hashlib.sha256(repr(logs).encode("utf-8", "backslashreplace")).hexdigest()[:16]


def trend(run: RunData, history: pathlib.Path) -> list[TrendPoint]:
    """Latest finished runs over the whole of this corpus, oldest first, and this run as the last."""
    here = point(run)
    names = sorted(name for name in _folders(history) if name < run.name)
    before: list[TrendPoint] = []
    for name in reversed(names):
        found = _past(history / name, run.head.corpus.path)
        if found is not None:
            before.append(found)
        if len(before) == MOST_RUNS - 1:
            break
    return [*reversed(before), here]


def _folders(history: pathlib.Path) -> Iterable[str]:
    """Names of the runs' folders: they begin with the time, so that they sort by time."""
    try:
        return [name for name in os.listdir(history) if (history / name / HEAD).is_file()]  # noqa: PTH208
    except OSError:
        return []


def _past(folder: pathlib.Path, corpus: str) -> TrendPoint | None:
    """An earlier run from its summary, or from its results where the summary is missing or not final.

    None unless it is of the whole of this corpus.
    """
    try:
        summary = read_json(folder / SUMMARY_FILE, Summary, LARGEST_SUMMARY)
    except DocumentError:
        summary = None
    if summary is not None and (summary.partial or summary.corpus != corpus):
        return None
    if summary is not None and summary.complete:
        return safe(summary.trend)
    try:
        run = read_run(folder)
    except ReplayError:
        return None
    whole = run.head.complete and not run.head.partial
    return point(run) if whole and run.head.corpus.path == corpus else None
