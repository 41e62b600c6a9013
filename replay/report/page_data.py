"""Rows of the page's tables, sorted and cut."""

import urllib.parse
from collections.abc import Mapping
from dataclasses import dataclass

from replay.base.numbers import NO_VALUE, percent, shown
from replay.base.schemas.log import MethodResult
from replay.base.schemas.summary import Change
from replay.base.schemas.values import known
from replay.base.schemas.verdicts import VERDICTS
from replay.report.facts import class_of_logs, cost_ratio
from replay.report.groups import notable
from replay.report.run_data import ResultRow, RunData

MOST_CHANGES = 500
MOST_CASES = 1000
"""Rows of the page's tables: a browser stays quick, and nobody reads more."""


@dataclass(frozen=True, kw_only=True)
class ChangeLine:
    """One line of the table of changes."""

    change: Change
    kind: str
    """Class of the log."""
    href: str | None
    """Link to the case's recording, where there is one."""
    unwritten: str
    """Reason why the recording could not be written."""
    difference: str
    sort: float | None
    """Sort key of the column of differences."""
    traceback: str
    """Traceback of a crash, where an exception was raised."""


@dataclass(frozen=True, kw_only=True)
class ResultCell:
    """One method on one case."""

    status: str
    ratio: float | None
    reason: str


@dataclass(frozen=True, kw_only=True)
class CaseLine:
    """One line of the table of cases."""

    name: str
    kind: str
    tags: str
    verdict: str
    """The gravest of its changes; empty without any."""
    rank: int
    recorded: float | None
    recorded_passed: bool | None
    href: str | None
    results: Mapping[str, ResultCell]


def change_lines(run: RunData) -> list[ChangeLine]:
    """Every change, the gravest first."""
    rows = {(row.log, row.case, row.method): row for row in run.rows}
    kinds = class_of_logs(run)
    hrefs = {row.case: href(row.recording) for row in run.rows if row.recording}
    unwritten = {row.case: row.recording_error for row in run.rows}
    lines = []
    for change in notable(run):
        row = rows.get((change.log, change.case, change.method))
        place = href(row.recording) if row and row.recording else hrefs.get(change.case)
        relative, difference = change.relative, change.difference
        text = NO_VALUE if difference is None else f"{'+' if difference > 0 else ''}{shown(difference, 3)}"
        if relative is not None:
            text = f"{text} ({percent(relative)})"
        sort = relative if relative is not None else difference
        kind = kinds.get(change.log, "")
        trace = (row.result.traceback or "") if row and change.verdict == "crashed" else ""
        lost = unwritten.get(change.case, "")
        lines.append(
            ChangeLine(
                change=change, kind=kind, href=place, unwritten=lost, difference=text, sort=sort, traceback=trace
            )
        )
    return lines


def case_lines(run: RunData) -> list[CaseLine]:
    """Every case, changed ones first, the gravest of them at the top."""
    same = len(VERDICTS)
    gravest: dict[str, int] = {}
    for change in run.changes:
        if change.verdict != "same":
            name = change.case or change.log
            gravest[name] = min(VERDICTS.index(change.verdict), gravest.get(name, same))
    cases: dict[str, list[ResultRow]] = {}
    for row in run.rows:
        cases.setdefault(row.case, []).append(row)
    lines = [_case_line(name, rows, gravest.get(name, same)) for name, rows in cases.items()]
    return sorted(lines, key=lambda line: (line.rank, line.name))


def _case_line(name: str, rows: list[ResultRow], rank: int) -> CaseLine:
    first = rows[0]
    cells = {
        row.method: ResultCell(status=row.result.status, ratio=cost_ratio(row), reason=_reason(row.result))
        for row in rows
    }
    recordings = [row.recording for row in rows if row.recording]
    return CaseLine(
        name=name,
        kind=first.kind,
        tags=", ".join(first.tags),
        verdict=VERDICTS[rank] if rank < len(VERDICTS) else "",
        rank=rank,
        recorded=known(first.recorded.metrics.objective),
        recorded_passed=first.recorded.audit.passed if first.recorded.audit else None,
        href=href(recordings[0]) if recordings else None,
        results=cells,
    )


def _reason(result: MethodResult) -> str:
    return f"{result.stop}. {result.reason}"


def href(recording: str | None) -> str | None:
    """A file within the run's folder as a relative link."""
    return None if recording is None else "./" + urllib.parse.quote(recording)
