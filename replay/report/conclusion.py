"""The verdict on a run in a few lines, for the command line; their number does not grow with the run."""

from collections.abc import Sequence

from msgspec import Struct

from replay.base.numbers import count
from replay.report import Report
from replay.report.facts import acceptable, is_declared
from replay.report.groups import failing_lines, groups
from replay.report.run_data import RunData

_MOST_LINES = 20
_MOST_EQUAL = 5


class Conclusion(Struct, frozen=True, kw_only=True):
    """The verdict on a run and its reasons, one line each."""

    state: str
    """failed, passed, unfinished, unjudged or empty."""
    headline: str
    failing: tuple[str, ...]
    failing_more: int
    """Number of further lines like these."""
    known: tuple[str, ...]
    """Known issues that show."""
    passing: tuple[str, ...]
    """Known issues that no longer show."""
    unread: tuple[str, ...]
    """Logs that could not be read although nothing announces it."""
    unwritten: str
    """Number of recordings that could not be written, and why the first could not; empty where all could."""
    equal: str
    """Logs with the same content; empty where there are none."""
    damaged: tuple[str, ...]
    """Files of the run that cannot be read."""
    against_corpus: tuple[str, ...]
    """Results that contradict what `corpus.toml` expects."""
    acceptable: bool
    """Whether accepting the run would mend any failure."""
    other_options: str
    complete: bool
    files: tuple[str, ...]
    """Reports that were written."""


def conclude(report: Report) -> Conclusion:
    """Put a report into a few lines."""
    run = report.run
    together = groups(run)
    failing, more = failing_lines(together)
    declared = [change.note for change in run.failing if is_declared(change) and change.note]
    return Conclusion(
        state=report.summary.state,
        headline=report.summary.headline,
        failing=tuple(failing),
        failing_more=more,
        known=tuple([group.sentence for group in together if group.verdict == "known"][:_MOST_LINES]),
        passing=_few([change.note for change in run.changes if change.key == "known issue"]),
        unread=_few([f"{e.log}: {e.error}" + (f"; {e.cure}" if e.cure else "") for e in run.unexpected]),
        unwritten=_unwritten(run),
        equal=_equal(run),
        damaged=_few(run.damaged),
        against_corpus=tuple(dict.fromkeys(declared)),
        acceptable=acceptable(run),
        other_options=report.summary.other_options,
        complete=report.summary.complete,
        files=tuple(map(str, report.files)),
    )


def _unwritten(run: RunData) -> str:
    reasons = run.unwritten
    if not reasons:
        return ""
    return f"{count(len(reasons), 'recording')} could not be written: {next(iter(reasons.values()))}"


def _equal(run: RunData) -> str:
    names: dict[str, dict[str, None]] = {}
    for row in run.rows:
        names.setdefault(row.sha256, {})[row.log] = None
    same = [" = ".join(logs) for sha256, logs in names.items() if sha256 and len(logs) > 1]
    more = f", and {len(same) - _MOST_EQUAL} more" if len(same) > _MOST_EQUAL else ""
    return f"logs with the same content: {', '.join(same[:_MOST_EQUAL])}{more}" if same else ""


def _few(lines: Sequence[str]) -> tuple[str, ...]:
    """The first lines, and how many more there are."""
    more = len(lines) - _MOST_LINES
    return (*lines[:_MOST_LINES], *([f"and {more} more, in the report"] if more > 0 else []))
