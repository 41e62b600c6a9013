"""Reports of a regression run, made from the files of its folder alone, so that they can be made again at any time.

report.html     for people; one file that needs no network
junit.xml       for CI servers
report.md       for a pull request
rows.parquet    for analysts; one row for each case and method
summary.json    for programs, and for the trend of later runs
"""

import json
import pathlib
from collections.abc import Mapping, Sequence
from dataclasses import asdict, dataclass
from typing import Any

from replay.base.files import atomic_write
from replay.report.facts import by_class, by_method, headline, ranked, state, tally
from replay.report.history import SUMMARY, SUMMARY_SCHEMA, Point, point, trend
from replay.report.model import RunData
from replay.report.reading import read_run

__all__ = ["FILES", "Report", "make_report"]

FILES = ("report.html", "junit.xml", "report.md", "rows.parquet", SUMMARY)


@dataclass(frozen=True, kw_only=True)
class Report:
    """What was read and what was written."""

    run: RunData
    summary: Mapping[str, Any]
    """The content of summary.json."""
    files: Sequence[pathlib.Path]


def make_report(folder: pathlib.Path, history: pathlib.Path | None = None) -> Report:
    """Read a run and write its reports into its folder, each whole or not at all.

    `history` is the folder of runs from which the trend is read, by default that in which the run is. Raises
    ReplayError (E_RUN) where there is no run, E_WRITE where a file cannot be written.
    """
    from replay.report.html import page
    from replay.report.junit import junit
    from replay.report.markdown import markdown
    from replay.report.parquet import write_parquet

    run = read_run(folder)
    points = trend(run, history or folder.resolve().parent)
    summary = summarize(run)
    texts = {
        "report.html": page(run, points).encode("utf-8", "backslashreplace"),
        "junit.xml": junit(run),
        "report.md": markdown(run).encode("utf-8", "backslashreplace"),
        SUMMARY: json.dumps(summary, indent=1, sort_keys=True).encode() + b"\n",
    }
    for name in FILES:
        with atomic_write(folder / name) as temporary:
            if name in texts:
                temporary.write_bytes(texts[name])
            else:
                write_parquet(run, temporary)
    return Report(run=run, summary=summary, files=[folder / name for name in FILES])


def summarize(run: RunData) -> dict[str, Any]:
    """The run's figures as plain data."""
    here: Point = point(run)
    return {
        "schema": SUMMARY_SCHEMA,
        "run": run.name,
        "created": run.created,
        "revision": run.revision,
        "corpus": run.corpus,
        "complete": run.complete,
        "partial": run.partial,
        "compared": run.compared,
        "other_options": run.other_options,
        "state": state(run),
        "headline": headline(run),
        "logs": len(run.logs),
        "results": len(run.rows),
        "verdicts": tally(run.changes),
        "against": run.against,
        "timing": [asdict(each) for each in run.timing],
        "changes": [asdict(change) for change in ranked(run.changes)],
        "unread": [asdict(error) for error in run.errors],
        "damaged": list(run.damaged),
        "methods": {name: asdict(found) for name, found in by_method(run).items()},
        "classes": {k: {name: asdict(f) for name, f in found.items()} for k, found in by_class(run).items()},
        "trend": asdict(here),
    }
