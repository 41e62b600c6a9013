"""Reports of a regression run, made from the files of its folder alone, so that they can be made again at any time.

report.html     for people; one file that needs no network
junit.xml       for CI servers
report.md       for a pull request
rows.parquet    for analysts; one row for each case and method
summary.json    for programs, and for the trend of later runs
"""

import json
import pathlib
from collections.abc import Sequence
from dataclasses import dataclass

from replay.base.documents import plain
from replay.base.files import atomic_write
from replay.base.run_folder import SUMMARY_FILE
from replay.base.schemas.summary import SUMMARY_SCHEMA, Summary
from replay.report.facts import by_class, by_method, headline, ranked, state, tally
from replay.report.history import point, trend
from replay.report.run_data import RunData
from replay.report.run_files import read_run

__all__ = ["FILES", "Report", "make_report", "summarize"]

FILES = ("report.html", "junit.xml", "report.md", "rows.parquet", SUMMARY_FILE)


@dataclass(frozen=True, kw_only=True)
class Report:
    """A run as it was read, its summary, and the files that were written."""

    run: RunData
    summary: Summary
    files: Sequence[pathlib.Path]


def make_report(folder: pathlib.Path, history: pathlib.Path | None = None) -> Report:
    """Read a run and write its reports into its folder, each whole or not at all.

    `history` is the folder of runs from which the trend is read, by default the one that contains the run. Raises
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
        SUMMARY_FILE: json.dumps(plain(summary), indent=1, sort_keys=True).encode() + b"\n",
    }
    for name in FILES:
        with atomic_write(folder / name) as temporary:
            if name in texts:
                temporary.write_bytes(texts[name])
            else:
                write_parquet(run, temporary)
    return Report(run=run, summary=summary, files=[folder / name for name in FILES])


def summarize(run: RunData) -> Summary:
    """The run's figures as a document."""
    head = run.head
    return Summary(
        schema=SUMMARY_SCHEMA,
        run=run.name,
        created=head.created,
        revision=head.revision,
        corpus=head.corpus.path,
        complete=head.complete,
        partial=head.partial,
        compared=run.compared,
        other_options=head.other_options or "",
        state=state(run),
        headline=headline(run),
        logs=len(run.logs),
        results=len(run.rows),
        verdicts=tally(run.changes),
        against=run.against,
        timing=run.timing,
        changes=tuple(ranked(run.changes)),
        unread=run.errors,
        damaged=run.damaged,
        methods=by_method(run),
        classes=by_class(run),
        trend=point(run),
    )
