"""Changes put together: what got worse, how often, and by how much."""

import statistics
from collections import defaultdict
from collections.abc import Iterable
from dataclasses import dataclass

from msgspec.structs import replace

from replay.base.numbers import count, percent
from replay.base.schemas.summary import Change
from replay.base.schemas.verdicts import FAILING, VERDICTS, Verdict
from replay.report.facts import class_of_logs, ranked, sentence
from replay.report.run_data import RunData

_MOST_NAMES = 8
_MOST_LINES = 20


@dataclass(frozen=True, kw_only=True)
class Group:
    """Changes of one metric of one method in one class of logs; a log with other content is a group of its own."""

    verdict: Verdict
    method: str
    key: str
    kind: str
    """Class of the logs."""
    changes: tuple[Change, ...]
    """The largest relative change first."""

    @property
    def worst(self) -> Change:
        """The one with the largest relative change."""
        return self.changes[0]

    @property
    def median(self) -> float | None:
        """Median of the relative changes, where there are any [-]."""
        known = [relative for change in self.changes if (relative := change.relative) is not None]
        return statistics.median(known) if known else None

    @property
    def sentence(self) -> str:
        """The changes in one line."""
        if len(self.changes) == 1:
            return sentence(self.worst)
        where = count(len(self.changes), "case") + (f" of class {self.kind}" if self.kind else "")
        if self.key == "log":
            return f"{count(len(self.changes), 'log')} {self.verdict}: {self.names}"
        if self.verdict in ("crashed", "missing") or self.key == "result":
            why = f"; the first: {self.worst.note}" if self.verdict == "crashed" and self.worst.note else ""
            return f"{self.method or 'logs'} {self.verdict} on {where}: {self.names}{why}"
        median = percent(self.median)
        typical = f", by {median} at the median" if median else ""
        verdict = "is a known issue" if self.verdict == "known" else self.verdict
        return f"{self.method or 'logs'}: {self.key} {verdict} on {where}{typical}; most: {sentence(self.worst)}"

    @property
    def names(self) -> str:
        """Names of the cases or logs, as many as a line holds."""
        names = [change.case or change.log for change in self.changes]
        more = len(names) - _MOST_NAMES
        return ", ".join(names[:_MOST_NAMES]) + (f" and {more} more" if more > 0 else "")


def notable(run: RunData) -> list[Change]:
    """Changes worth a line, the gravest first; a new log or a new result is one change, without its figures."""
    of_log: dict[str, set[str]] = defaultdict(set)
    of_result: dict[tuple[str, str, str], set[str]] = defaultdict(set)
    for change in run.changes:
        of_log[change.log].add(change.verdict)
        of_result[change.log, change.case, change.method].add(change.verdict)

    def shortened(change: Change) -> Change:
        if not change.method or of_result[change.log, change.case, change.method] != {"new"}:
            return change
        about = replace(change, key="result", unit="", direction="", before=None, after=None, tolerance="", note="")
        return replace(about, case="", method="", key="log") if of_log[change.log] == {"new"} else about

    return list(dict.fromkeys(shortened(change) for change in ranked(run.changes)))


def groups(run: RunData) -> list[Group]:
    """All changes, by verdict, method, metric and class; the gravest verdict first, of equal ones the most cases."""
    kinds = class_of_logs(run)
    found: dict[tuple[Verdict, str, str, str, str], list[Change]] = {}
    for change in notable(run):
        alone = change.log if change.verdict == "changed" or (change.key == "log" and change.after) else ""
        kind = "" if change.key == "log" else kinds.get(change.log, "")
        place = (change.verdict, change.method, change.key, kind, alone)
        found.setdefault(place, []).append(change)
    made = [
        Group(verdict=verdict, method=method, key=key, kind=kind, changes=tuple(changes))
        for (verdict, method, key, kind, _), changes in found.items()
    ]
    return sorted(made, key=lambda group: (VERDICTS.index(group.verdict), -len(group.changes)))


def gravest(found: Iterable[Group]) -> list[Group]:
    """Groups with which the run fails."""
    return [group for group in found if group.verdict in FAILING]


def failing_lines(found: Iterable[Group]) -> tuple[list[str], int]:
    """One line for each of the gravest groups with which the run fails, and the number of further ones."""
    lines = [group.sentence for group in gravest(found)]
    return lines[:_MOST_LINES], max(0, len(lines) - _MOST_LINES)
