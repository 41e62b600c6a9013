"""The trend over the last runs, read from the folder in which runs are kept."""

import contextlib
import hashlib
import os
import pathlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from replay.base.errors import ReplayError
from replay.base.strict_json import JsonError, read_json
from replay.report import fields
from replay.report.facts import by_method, state
from replay.report.fields import Malformed
from replay.report.model import RunData
from replay.report.reading import read_run

SUMMARY = "summary.json"
SUMMARY_SCHEMA = "replay.summary/1"
MOST_RUNS = 30
"""Runs in the trend; a month of nights."""
_LARGEST_SUMMARY = 8 * 2**20  # [bytes]


@dataclass(frozen=True, kw_only=True)
class Point:
    """One run in the trend."""

    name: str
    created: str
    revision: str
    state: str
    logs: int
    comparable: str
    """Figures may be compared where this is the same: the logs that were worked on."""
    ratio: Mapping[str, float]
    """Geometric mean of J over the recorded J, by method [-]."""
    wall_s: Mapping[str, float]
    """Median wall time by method [s]."""


def point(run: RunData) -> Point:
    """A run as one point of the trend."""
    found = by_method(run)
    return Point(
        name=run.name,
        created=run.created,
        revision=run.revision,
        state=state(run),
        logs=len(run.logs),
        comparable=fingerprint(run),
        ratio={name: f.ratio for name, f in found.items() if f.ratio is not None},
        wall_s={name: f.wall_s for name, f in found.items() if f.wall_s is not None},
    )


def fingerprint(run: RunData) -> str:
    """The same for runs that worked on the same logs."""
    logs = sorted({(row.log, row.sha256) for row in run.rows} | {(error.log, "") for error in run.errors})
    return hashlib.sha256(repr(logs).encode("utf-8", "backslashreplace")).hexdigest()[:16]


def trend(run: RunData, history: pathlib.Path) -> list[Point]:
    """The last runs over the whole of this corpus that came to their end, oldest first, and this one as the last."""
    here = point(run)
    names = sorted(name for name in _folders(history) if name < run.name)
    before: list[Point] = []
    for name in reversed(names):
        found = _past(history / name, run.corpus)
        if found is not None:
            before.append(found)
        if len(before) == MOST_RUNS - 1:
            break
    return [*reversed(before), here]


def _folders(history: pathlib.Path) -> Iterable[str]:
    """Names of the runs' folders: they begin with the time, so that their order is that of time."""
    try:
        return [name for name in os.listdir(history) if (history / name / "run.json").is_file()]  # noqa: PTH208
    except OSError:
        return []


def _past(folder: pathlib.Path, corpus: str) -> Point | None:
    """An earlier run from its summary, or from its results where that is missing or not final.

    None unless it is of the whole of this corpus.
    """
    with contextlib.suppress(JsonError, Malformed):
        return _stored(read_json(folder / SUMMARY, _LARGEST_SUMMARY), corpus)
    try:
        run = read_run(folder)
    except ReplayError:
        return None
    return point(run) if run.complete and not run.partial and run.corpus == corpus else None


def _stored(document: Any, corpus: str) -> Point | None:
    """A point from a summary; None for that of a partial run or of another corpus.

    Raises Malformed for what is none of a finished one.
    """
    if not isinstance(document, Mapping) or document.get("schema") != SUMMARY_SCHEMA:
        raise Malformed("not a summary")
    if document.get("partial") or document.get("corpus") != corpus:
        return None
    if not document.get("complete"):
        raise Malformed("not of a finished run")
    entry = fields.mapping(document, "trend")
    return Point(
        name=fields.text(entry, "name"),
        created=fields.text(entry, "created"),
        revision=fields.text(entry, "revision"),
        state=fields.text(entry, "state"),
        logs=int(fields.number(entry, "logs") or 0),
        comparable=fields.text(entry, "comparable"),
        ratio=fields.numbers(entry.get("ratio")),
        wall_s=fields.numbers(entry.get("wall_s")),
    )
