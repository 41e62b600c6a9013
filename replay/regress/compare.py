"""A log's results compared with the baseline, with the declared expectation and with the known issues."""

import glob
from collections.abc import Collection, Iterable, Mapping, Sequence

import msgspec

from replay.base.numbers import count
from replay.base.schemas.baseline import Figures, LogFigures
from replay.base.schemas.corpus import Known
from replay.base.schemas.log import CRASHES, LogFailure, LogResults, MethodResult
from replay.base.schemas.values import Scalar
from replay.base.schemas.verdicts import FAILING, Comparison, Verdict
from replay.regress.gate import Figure, figures_of, stored

_NOTHING = LogFigures(cases={})
_NO_FIGURES = Figures()


def compare_log(
    log: LogResults,
    before: LogFigures | None,
    known: Sequence[Known] = (),
    *,
    whole: bool = True,
    without: Collection[str] = (),
) -> list[Comparison]:
    """Compare a log's document with the baseline's figures of it.

    `whole`: all methods were run, so that a method of the baseline without a result is missing, and the declared
    expectation can be judged. `without`: figures that are not compared.
    """
    if log.error is not None:
        found = [_refused(log, log.error, before)]
    elif is_other_log(log, before):
        found = _other_log(log, before)
        found += _expectation(log, _NOTHING) if whole else []
    else:
        found = _results(log, before or _NOTHING, whole)
        found += _expectation(log, before or _NOTHING) if whole else []
    return [_excused(each, known) for each in found if not each.method or each.key not in without]


def is_other_log(log: LogResults, before: LogFigures | None) -> bool:
    """Whether the log's content differs from that of the log the baseline was recorded on."""
    return before is not None and before.sha256 not in (None, log.sha256)


def missing_log(name: str, known: Sequence[Known] = (), *, now: str | None = None) -> Comparison:
    """A log of the baseline that is not in the run, or is there under another name (`now`)."""
    before = "there" if now is None else name
    return _excused(Comparison(log=name, key="log", before=before, after=now, verdict="missing"), known)


def gone(known: Iterable[Known], found: Sequence[Comparison], *, partial: bool = False) -> list[Comparison]:
    """One entry for each known issue that no longer shows on logs where its method ended and was compared.

    In a `partial` run only issues of one log and one method count: a pattern may concern what was left out.
    """
    shown = [each for each in found if each.verdict == "known"]
    ran = [each for each in found if each.key == "status" and each.verdict != "new" and each.after != "failed"]
    passing = []
    for issue in known:
        logs = [each.log for each in ran if issue.covers(each.log, each.method, issue.key)]
        if partial and (glob.has_magic(issue.log) or glob.has_magic(issue.method)):
            continue
        if logs and not any(issue.covers(each.log, each.method, each.key) for each in shown):
            method = "" if "*" in issue.method else issue.method
            note = f"the known issue no longer shows; remove it from corpus.toml: {issue.note}".rstrip(": ")
            passing.append(
                Comparison(log=logs[0], method=method, key="known issue", after="passes", verdict="better", note=note)
            )
    return passing


def baseline_entry(log: LogResults) -> LogFigures:
    """The figures of a log's document that a baseline keeps."""
    if log.error is not None:
        return LogFigures(sha256=log.sha256, error=log.error.code, cases={})
    cases = {case_number(case.case): {m.name: stored(m) for m in case.methods} for case in log.cases}
    return LogFigures(sha256=log.sha256, error=None, cases=cases)


def worst(found: Iterable[Comparison]) -> str:
    """crashed, worse (also for what is missing) or same."""
    verdicts = {each.verdict for each in found}
    if "crashed" in verdicts:
        return "crashed"
    return "worse" if verdicts & FAILING else "same"


def case_number(case: str) -> str:
    """The number of a case within its log, from its name."""
    return case.rpartition("/")[2]


def _refused(log: LogResults, error: LogFailure, before: LogFigures | None) -> Comparison:
    """A log that could not be used."""
    known_before = None if before is None else before.error or ("read" if before.cases else None)
    was = known_before or log.expect or None
    verdict: Verdict
    if error.code == log.expect or (was == error.code and error.code not in CRASHES):
        verdict = "new" if before is None else "same"
    elif error.code in CRASHES:
        verdict = "same" if was == error.code else "crashed"
    else:
        verdict = "new" if was is None else "worse"
    note = error.message if verdict in FAILING else ""
    return Comparison(log=log.log, key="error", before=was, after=error.code, verdict=verdict, note=note)


def _other_log(log: LogResults, before: LogFigures | None) -> list[Comparison]:
    """A log whose content changed: its results are not compared, crashes alone are listed."""
    number = sum(len(case.methods) for case in log.cases)
    note = f"{log.log}: the log file changed since the baseline; {count(number, 'result')} not compared"
    was = _short(before.sha256 if before is not None else None)
    changed = Comparison(log=log.log, key="sha256", before=was, after=_short(log.sha256), verdict="changed", note=note)
    results = _results(log, _NOTHING, whole=False)
    return [changed, *(each for each in results if each.verdict == "crashed")]


def _short(sha256: str | None) -> str:
    return (sha256 or "")[:12]


def _results(log: LogResults, before: LogFigures, whole: bool) -> list[Comparison]:
    found: list[Comparison] = []
    cases = dict(before.cases)
    for case in log.cases:
        methods = dict(cases.pop(case_number(case.case), {}))
        for result in case.methods:
            found += _method(log.log, case.case, result, methods.pop(result.name, _NO_FIGURES))
        if whole:
            found += [_missing(log.log, case.case, "result", method) for method in methods]
    return found + [_missing(log.log, f"{log.log}/{number}", "case") for number in cases]


def _missing(log: str, case: str, key: str, method: str = "") -> Comparison:
    return Comparison(log=log, case=case, method=method, key=key, before="there", verdict="missing")


def _method(log: str, case: str, result: MethodResult, before: Figures) -> list[Comparison]:
    """All figures of one result; of a result that crashed, its status alone."""
    where = {"log": log, "case": case, "method": result.name}
    figures = figures_of(result)
    if result.status == "failed" and before.status != "failed":
        return [_compared(where, figures[0], before.status, "crashed", result.reason)]
    values = [(figure, getattr(before, figure.key)) for figure in figures]
    return [_compared(where, figure, value, figure.verdict(value)) for figure, value in values]


def _compared(where: Mapping[str, str], figure: Figure, before: Scalar, verdict: Verdict, note: str = "") -> Comparison:
    return Comparison(
        **where,
        key=figure.key,
        unit=figure.unit,
        direction=figure.direction,
        rel_tol=figure.rel_tol,
        abs_tol=figure.abs_tol,
        before=before,
        after=figure.value,
        verdict=verdict,
        note=note,
    )


def _expectation(log: LogResults, before: LogFigures) -> list[Comparison]:
    """Compare a log that could be read with what the corpus declares about it."""
    note = f"against what {log.declared or 'corpus.toml'} expects"
    if before.error:
        as_declared = before.error == log.expect
        verdict, why = ("worse", note) if as_declared else ("better", "")
        return [Comparison(log=log.log, key="error", before=before.error, after="read", verdict=verdict, note=why)]
    if log.expect.startswith("E_"):
        return [Comparison(log=log.log, key="expect", before=log.expect, after="read", verdict="worse", note=note)]
    found = []
    for case in log.cases if log.expect in ("improved", "kept") else ():
        came = "improved" if any(result.status == "improved" for result in case.methods) else "kept"
        if came != log.expect:
            verdict = "worse" if log.expect == "improved" else "better"
            found.append(
                Comparison(
                    log=log.log, case=case.case, key="expect", before=log.expect, after=came, verdict=verdict, note=note
                )
            )
    return found


def _excused(found: Comparison, known: Sequence[Known]) -> Comparison:
    """Mark a failing comparison as known where an issue covers it; also a method that still fails."""
    still = found.key == "status" and found.after == "failed"
    if found.verdict in FAILING or still:
        for issue in known:
            if issue.covers(found.log, found.method, found.key):
                return msgspec.structs.replace(found, verdict="known", note=issue.note)
    return found
