"""Making a run the baseline, or taking some of its results over into it."""

import fnmatch
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import Any

from replay.base.errors import ReplayError
from replay.regress.baseline import Baseline
from replay.regress.compare import Entry, baseline_entry, compare_log, is_other_log
from replay.regress.corpus import Known
from replay.regress.differing import uncompared

ACCEPT_ERROR = "E_ACCEPT"


@dataclass(frozen=True, kw_only=True)
class Wanted:
    """Which results are taken over: all that fit both; an empty list takes all."""

    logs: Sequence[str] = ()
    """Patterns of names."""
    methods: Sequence[str] = ()

    def __bool__(self) -> bool:
        """Whether anything is left out."""
        return bool(self.logs or self.methods)

    def fits_log(self, name: str) -> bool:
        """Whether something of that log is taken over."""
        return not self.logs or any(fnmatch.fnmatchcase(name, pattern) for pattern in self.logs)

    def fits(self, entry: Mapping[str, Any]) -> bool:
        """Whether a change, an entry of `compare_log`, is taken over."""
        return self.fits_log(entry["log"]) and (not self.methods or entry["method"] in self.methods)


@dataclass(frozen=True, kw_only=True)
class Accepted:
    """What accepting a run comes to."""

    baseline: Baseline
    changes: Sequence[Entry] = field(default=())
    """Every change against the baseline before."""
    kept: int = 0
    """Results that stay as they were, because they were not wanted."""


def accepted(
    before: Baseline,
    documents: Iterable[Mapping[str, Any]],
    known: Sequence[Known],
    head: Mapping[str, Any],
    wanted: Wanted | None = None,
) -> Accepted:
    """The baseline that a run makes. Raises ReplayError (E_ACCEPT) where what is wanted cannot be taken over.

    What a known issue covers keeps the figures that it had: else the issue would be what is expected from now on.
    """
    wanted = wanted or Wanted()
    if wanted and before.logs and uncompared(before, head.get("options") or {}):
        raise ReplayError(ACCEPT_ERROR, "the run was made with other weights than the baseline; accept the whole run")
    logs: dict[str, Mapping[str, Any]] = {}
    changes: list[Entry] = []
    left: set[str] = set(before.logs)
    num_fitting = 0
    for document in documents:
        name = document["log"]
        left.discard(name)
        old = before.logs.get(name)
        if not wanted.fits_log(name):
            logs |= {} if old is None else {name: old}
            continue
        entries = compare_log(document, old, known)
        new = _kept(baseline_entry(document), old, entries)
        if wanted.methods:
            num, new = _of_methods(document, old, new, wanted.methods)
            num_fitting += num
        else:
            num_fitting += 1
        logs |= {} if new is None else {name: new}
        changes += [entry for entry in entries if entry["verdict"] != "same" and wanted.fits(entry)]
    for name in left if wanted else ():  # those that the run has not got
        if wanted.methods or not wanted.fits_log(name):
            logs[name] = before.logs[name]
        else:
            num_fitting += 1
    if wanted and not num_fitting:
        named = [*(f"--only {pattern}" for pattern in wanted.logs), *(f"--method {name}" for name in wanted.methods)]
        raise ReplayError(ACCEPT_ERROR, f"the run has no result for {' '.join(named)}")
    made = replace(before, logs=logs) if wanted and before.logs else _whole(head, logs)
    return Accepted(baseline=made, changes=changes, kept=_untouched(before, wanted))


def _whole(head: Mapping[str, Any], logs: Mapping[str, Any]) -> Baseline:
    about = {key: str(head.get(key) or "") for key in ("created", "revision")}
    options = str(head.get("options_fingerprint") or "")
    return Baseline(**about, options=options, settings=head.get("options") or {}, logs=logs)


def _of_methods(
    document: Mapping[str, Any], old: Mapping[str, Any] | None, new: Mapping[str, Any], methods: Sequence[str]
) -> tuple[int, Mapping[str, Any] | None]:
    """The old entry of a log with the new figures of some methods, and how many these are.

    Raises ReplayError (E_ACCEPT) where the old figures are of another log: in one entry, they would be mixed.
    """
    taken = {number: {m: f for m, f in found.items() if m in methods} for number, found in new["cases"].items()}
    num = sum(map(len, taken.values()))
    if not num:
        return 0, old
    if old is None or old.get("error") is not None:
        return num, {**new, "cases": taken}
    if is_other_log(document, old):
        name = document["log"]
        raise ReplayError(ACCEPT_ERROR, f"{name} is another log than the baseline's: accept it with all its methods")
    cases = {number: dict(found) for number, found in old["cases"].items()}
    for number, found in taken.items():
        cases[number] = {m: f for m, f in cases.get(number, {}).items() if m not in methods} | found
    return num, {**old, "cases": cases}


def _untouched(before: Baseline, wanted: Wanted) -> int:
    """Results of the baseline that are not wanted."""
    return sum(
        not wanted.fits({"log": name, "method": method})
        for name, entry in before.logs.items()
        for found in entry["cases"].values()
        for method in found
    )


def _kept(entry: Entry, old: Mapping[str, Any] | None, entries: Iterable[Entry]) -> Mapping[str, Any]:
    """A log's entry with the old figures of what is known."""
    for change in entries:
        if change["verdict"] != "known" or old is None:
            continue
        if not change["case"]:
            return old
        number = change["case"].rpartition("/")[2]
        figures = old["cases"].get(number, {}).get(change["method"])
        if figures is not None and change["key"] == "status":
            entry["cases"].setdefault(number, {})[change["method"]] = figures
        elif figures is not None and change["key"] in figures:
            entry["cases"][number][change["method"]][change["key"]] = figures[change["key"]]
    return entry
