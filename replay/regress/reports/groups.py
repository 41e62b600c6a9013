"""Changes put together: what got worse, how often, and by how much."""

import statistics
from collections.abc import Iterable
from dataclasses import dataclass

from replay.regress.reports.facts import class_of_logs, ranked, sentence
from replay.regress.reports.model import FAILING, VERDICTS, Change, RunData
from replay.regress.reports.numbers import count, percent


@dataclass(frozen=True, kw_only=True)
class Group:
    """Changes of one metric of one method in one class of logs; of a log that is another one, that alone."""

    verdict: str
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
        """Of the relative changes, where there are any."""
        known = [relative for change in self.changes if (relative := change.relative) is not None]
        return statistics.median(known) if known else None

    @property
    def sentence(self) -> str:
        """What happened, in one line."""
        if len(self.changes) == 1:
            return sentence(self.worst)
        where = count(len(self.changes), "case") + (f" of class {self.kind}" if self.kind else "")
        if self.verdict in ("crashed", "missing"):
            return f"{self.method or 'logs'} {self.verdict} on {where}"
        median = percent(self.median)
        typical = f", by {median} at the median" if median else ""
        return f"{self.method}: {self.key} {self.verdict} on {where}{typical}; most: {sentence(self.worst)}"


def groups(run: RunData) -> list[Group]:
    """All changes, by verdict, method, metric and class; the gravest verdict first, of equal ones the most cases."""
    kinds = class_of_logs(run)
    found: dict[tuple[str, str, str, str, str], list[Change]] = {}
    for change in ranked(run.changes):
        alone = change.log if change.verdict == "changed" else ""
        place = (change.verdict, change.method, change.key, kinds.get(change.log, ""), alone)
        found.setdefault(place, []).append(change)
    made = [
        Group(verdict=verdict, method=method, key=key, kind=kind, changes=tuple(changes))
        for (verdict, method, key, kind, _), changes in found.items()
    ]
    return sorted(made, key=lambda group: (VERDICTS.index(group.verdict), -len(group.changes)))


def gravest(found: Iterable[Group]) -> list[Group]:
    """Those with which the run fails."""
    return [group for group in found if group.verdict in FAILING]
