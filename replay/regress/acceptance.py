"""Make a run the baseline, or take some of its results over into it."""

import fnmatch
import pathlib
from collections.abc import Iterable, Sequence
from dataclasses import dataclass

from msgspec.structs import fields, replace

from replay.base.errors import ReplayError
from replay.base.schemas.baseline import BASELINE_SCHEMA, Baseline, Figures, LogFigures
from replay.base.schemas.corpus import Known
from replay.base.schemas.log import LogResults
from replay.base.schemas.run import RunHead
from replay.base.schemas.verdicts import Comparison
from replay.regress.baseline import read_baseline
from replay.regress.compare import baseline_entry, case_number, compare_log, is_other_log
from replay.regress.folder import RunFolder
from replay.regress.options import uncompared

ACCEPT_ERROR = "E_ACCEPT"
_FIGURES = frozenset(field.name for field in fields(Figures))


@dataclass(frozen=True, kw_only=True)
class Selection:
    """Results that are taken over: all that fit both lists; an empty list fits all."""

    logs: Sequence[str] = ()
    """Patterns of names."""
    methods: Sequence[str] = ()

    def __bool__(self) -> bool:
        """Whether anything is left out."""
        return bool(self.logs or self.methods)

    def has_log(self, name: str) -> bool:
        """Whether results of that log are taken over."""
        return not self.logs or any(fnmatch.fnmatchcase(name, pattern) for pattern in self.logs)

    def has(self, log: str, method: str) -> bool:
        """Whether the results of that method on that log are taken over."""
        return self.has_log(log) and (not self.methods or method in self.methods)

    @property
    def flags(self) -> str:
        """The selection as flags of the command line."""
        return " ".join([*(f"--only {name}" for name in self.logs), *(f"--method {name}" for name in self.methods)])


@dataclass(frozen=True, kw_only=True)
class Acceptance:
    """A new baseline, and how it differs from the one before."""

    baseline: Baseline
    changes: Sequence[Comparison]
    """Every change against the baseline before."""
    kept: int
    """Number of results that stay as they were, because they were not selected."""
    lost: Sequence[str]
    """Logs of the baseline before that are not in the new one."""


def accept_run(
    run: pathlib.Path, file: pathlib.Path | None = None, selection: Selection | None = None
) -> tuple[pathlib.Path, Acceptance]:
    """Compute the baseline that the run in a folder makes, and the file for it; nothing is written.

    `file` is by default the one that the run was compared with. Raises ReplayError (E_ACCEPT) where the run is not fit
    to be a baseline, and as `read_baseline` and `accepted`.
    """
    folder = RunFolder(run)
    head = folder.head()
    if head.partial:
        raise ReplayError(ACCEPT_ERROR, f"{run}: a partial run ({head.partial}) cannot become the baseline")
    if not head.complete:
        raise ReplayError(ACCEPT_ERROR, f"{run}: an unfinished run cannot become the baseline; --resume does the rest")
    if file is None and head.accept_to is None:
        raise ReplayError(ACCEPT_ERROR, f"{run}: was compared with no file; name one: --baseline FILE")
    file = file or pathlib.Path(str(head.accept_to))
    before = read_baseline(file if file.exists() else None)
    return file, accepted(before, folder.documents(), head, selection)


def accepted(
    before: Baseline, documents: Iterable[LogResults], head: RunHead, selection: Selection | None = None
) -> Acceptance:
    """Compute the baseline that a run makes. Raises ReplayError (E_ACCEPT) where a selection cannot be taken over.

    Results that a known issue covers keep the figures that they had: else the issue would be what is expected.
    """
    selection = selection or Selection()
    if selection and before.logs and uncompared(before, head.options):
        raise ReplayError(ACCEPT_ERROR, "the run was made with other weights than the baseline; accept the whole run")
    logs: dict[str, LogFigures] = {}
    changes: list[Comparison] = []
    num_taken = 0
    for document in documents:
        num, entry, found = _taken(document, before.logs.get(document.log), head.known, selection)
        num_taken += num
        changes += found
        logs |= {} if entry is None else {document.log: entry}
    for name in before.logs.keys() - logs.keys() if selection else ():
        if selection.methods or not selection.has_log(name):
            logs[name] = before.logs[name]
        else:
            num_taken += 1
    if selection and not num_taken:
        raise ReplayError(ACCEPT_ERROR, f"the run has no result for {selection.flags}")
    made = replace(before, logs=logs) if selection and before.logs else _whole(head, logs)
    lost = sorted(before.logs.keys() - made.logs.keys())
    return Acceptance(baseline=made, changes=changes, kept=_num_kept(before, selection), lost=lost)


def _taken(
    document: LogResults, old: LogFigures | None, known: Sequence[Known], selection: Selection
) -> tuple[int, LogFigures | None, list[Comparison]]:
    """The number of results taken over from a log's document, the log's new entry, and the changes."""
    if not selection.has_log(document.log):
        return 0, old, []
    found = compare_log(document, old, known)
    changes = [each for each in found if each.verdict != "same" and selection.has(each.log, each.method)]
    new = _with_known(baseline_entry(document), old, found)
    if not selection.methods:
        return 1, new, changes
    return *_of_methods(document, old, new, selection.methods), changes


def _whole(head: RunHead, logs: dict[str, LogFigures]) -> Baseline:
    return Baseline(
        schema=BASELINE_SCHEMA,
        created=head.created,
        revision=head.revision,
        options_fingerprint=head.options_fingerprint,
        options=head.options,
        logs=logs,
    )


def _of_methods(
    document: LogResults, old: LogFigures | None, new: LogFigures, methods: Sequence[str]
) -> tuple[int, LogFigures | None]:
    """The old entry of a log with the new figures of some methods, and how many these are.

    Raises ReplayError (E_ACCEPT) where the old figures are of other content: one entry would mix them.
    """
    taken = {number: {m: f for m, f in found.items() if m in methods} for number, found in new.cases.items()}
    num = sum(map(len, taken.values()))
    if not num:
        return 0, old
    if old is None or old.error is not None:
        return num, replace(new, cases=taken)
    if is_other_log(document, old):
        name = document.log
        raise ReplayError(
            ACCEPT_ERROR, f"{name}: the log file changed since the baseline; accept it with all its methods"
        )
    cases = {number: dict(found) for number, found in old.cases.items()}
    for number, found in taken.items():
        cases[number] = {m: f for m, f in cases.get(number, {}).items() if m not in methods} | found
    return num, replace(old, cases=cases)


def _num_kept(before: Baseline, selection: Selection) -> int:
    """Number of results of the baseline that are not selected."""
    return sum(
        not selection.has(name, method)
        for name, entry in before.logs.items()
        for found in entry.cases.values()
        for method in found
    )


def _with_known(new: LogFigures, old: LogFigures | None, found: Iterable[Comparison]) -> LogFigures:
    """A log's new figures with the old ones where a known issue covers them."""
    cases: dict[str, dict[str, Figures]] = {number: dict(methods) for number, methods in new.cases.items()}
    for each in found:
        if each.verdict != "known" or old is None:
            continue
        if not each.case:
            return old
        number = case_number(each.case)
        figures = old.cases.get(number, {}).get(each.method)
        if figures is not None and each.key == "status":
            cases.setdefault(number, {})[each.method] = figures
        elif figures is not None and each.key in _FIGURES:
            now = cases[number][each.method]
            cases[number][each.method] = replace(now, **{each.key: getattr(figures, each.key)})
    return replace(new, cases=cases)
