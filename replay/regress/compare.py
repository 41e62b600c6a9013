"""A log's results against the baseline's, its declared expectation and the known issues; each finding a plain entry."""

import glob
from collections.abc import Collection, Iterable, Mapping, Sequence
from typing import Any

from replay.base.numbers import count
from replay.regress.corpus import Known
from replay.regress.gate import Metric, Value, metrics_of
from replay.report.model import CRASHES, FAILING

Entry = dict[str, Any]


def compare_log(
    document: Mapping[str, Any],
    before: Mapping[str, Any] | None,
    known: Sequence[Known] = (),
    *,
    whole: bool = True,
    without: Collection[str] = (),
) -> list[Entry]:
    """What a log's document says against the baseline's entry of it (`baseline_entry`), entries of verdicts.json.

    `whole`: all methods were run, so that one of the baseline that is not there is missing, and the declared
    expectation can be judged. `without`: metrics that are not compared.
    """
    before = before or {}
    if document.get("error") is not None:
        found = [_refused(document, before)]
    else:
        if is_other_log(document, before):
            found, before = _other_log(document, before), {}
        else:
            found = _results(document, before, whole)
        found += _expectation(document, before) if whole else []
    return [_excused(entry, known) for entry in found if not entry["method"] or entry["key"] not in without]


def is_other_log(document: Mapping[str, Any], before: Mapping[str, Any]) -> bool:
    """Whether a log's content is not that of which the baseline has its figures."""
    return before.get("sha256") not in (None, document.get("sha256"))


def missing_log(name: str, known: Sequence[Known] = (), *, now: str | None = None) -> Entry:
    """A log of the baseline that is not in the run, unless under the name that it has `now`."""
    before = "there" if now is None else name
    return _excused(_entry(name, key="log", before=before, after=now, verdict="missing"), known)


def gone(known: Iterable[Known], found: Sequence[Mapping[str, Any]], *, partial: bool = False) -> list[Entry]:
    """An entry for each known issue that no longer shows on logs where its method came to an end and was compared.

    Of a `partial` run only issues of one log and one method are told: a pattern may concern what was left out.
    """
    shown = [entry for entry in found if entry["verdict"] == "known"]
    ran = [e for e in found if e["key"] == "status" and e["verdict"] != "new" and e["after"] != "failed"]
    passing = []
    for issue in known:
        logs = [e["log"] for e in ran if issue.covers(e["log"], e["method"], issue.key)]
        if partial and (glob.has_magic(issue.log) or glob.has_magic(issue.method)):
            continue
        if logs and not any(issue.covers(e["log"], e["method"], e["key"]) for e in shown):
            method = "" if "*" in issue.method else issue.method
            note = f"the known issue passes; take it out of corpus.toml: {issue.note}".rstrip(": ")
            passing.append(
                _entry(logs[0], method=method, key="known issue", after="passes", verdict="better", note=note)
            )
    return passing


def baseline_entry(document: Mapping[str, Any]) -> Entry:
    """What a baseline keeps of a log's document: the figures that are compared."""
    error = document.get("error")
    if error is not None:
        return {"sha256": document.get("sha256"), "error": error["code"], "cases": {}}
    cases = {
        _number(case): {m["name"]: {metric.key: metric.value for metric in metrics_of(m)} for m in case["methods"]}
        for case in document["cases"]
    }
    return {"sha256": document.get("sha256"), "error": None, "cases": cases}


def worst(entries: Iterable[Mapping[str, Any]]) -> str:
    """crashed, worse (also for what is missing) or same."""
    verdicts = {entry["verdict"] for entry in entries}
    if "crashed" in verdicts:
        return "crashed"
    return "worse" if verdicts & FAILING else "same"


def _number(case: Mapping[str, Any]) -> str:
    """Of a request within its log."""
    return case["case"].rpartition("/")[2]


def _refused(document: Mapping[str, Any], before: Mapping[str, Any]) -> Entry:
    """A log that could not be used."""
    code, expect = document["error"]["code"], document.get("expect") or ""
    message = document["error"]["message"]
    was = before.get("error") or ("read" if before.get("cases") else None) or expect or None
    if code == expect or (was == code and code not in CRASHES):
        verdict = "same" if before else "new"
    elif code in CRASHES:
        verdict = "same" if was == code else "crashed"
    else:
        verdict = "new" if was is None else "worse"
    note = message if verdict in FAILING else ""
    return _entry(document["log"], key="error", before=was, after=code, verdict=verdict, note=note)


def _other_log(document: Mapping[str, Any], before: Mapping[str, Any]) -> list[Entry]:
    """That a log's results are those of other content; of these, what has crashed alone is told."""
    number = sum(len(case["methods"]) for case in document["cases"])
    note = f"{document['log']} is another log than the baseline's: {count(number, 'result')} not compared"
    shas = {"before": _short(before["sha256"]), "after": _short(document.get("sha256"))}
    entries = _results(document, {}, whole=False)
    crashed = [entry for entry in entries if entry["verdict"] == "crashed"]
    return [_entry(document["log"], key="sha256", **shas, verdict="changed", note=note), *crashed]


def _short(sha256: Any) -> str:
    return str(sha256 or "")[:12]


def _results(document: Mapping[str, Any], before: Mapping[str, Any], whole: bool) -> list[Entry]:
    found: list[Entry] = []
    cases = dict(before.get("cases") or {})
    for case in document["cases"]:
        methods = dict(cases.pop(_number(case), {}))
        for method in case["methods"]:
            where = {"case": case["case"], "method": method["name"]}
            found += _method(document["log"], where, method, methods.pop(method["name"], {}))
        if whole:
            found += [
                _entry(document["log"], case=case["case"], method=m, key="result", before="there", verdict="missing")
                for m in methods
            ]
    for number in cases:
        name = f"{document['log']}/{number}"
        found.append(_entry(document["log"], case=name, key="case", before="there", verdict="missing"))
    return found


def _method(log: str, where: Mapping[str, str], method: Mapping[str, Any], before: Mapping[str, Value]) -> list[Entry]:
    """All figures of one result; of one that crashed, that alone."""
    metrics = metrics_of(method)
    if method["status"] == "failed" and before.get("status") != "failed":
        status = metrics[0]
        reason = str(method.get("reason") or "")
        return [_measured(log, where, status, before.get("status"), "crashed", reason)]
    return [_measured(log, where, m, before.get(m.key), m.verdict(before.get(m.key))) for m in metrics]


def _measured(log: str, where: Mapping[str, str], metric: Metric, before: Value, verdict: str, note: str = "") -> Entry:
    figures = {"unit": metric.unit, "direction": metric.direction, "rel_tol": metric.rel_tol, "abs_tol": metric.abs_tol}
    return _entry(log, **where, key=metric.key, before=before, after=metric.value, verdict=verdict, note=note) | figures


def _expectation(document: Mapping[str, Any], before: Mapping[str, Any]) -> list[Entry]:
    """What the corpus declares of a log that could be read."""
    expect = document.get("expect") or ""
    note = f"against what {document.get('declared') or 'corpus.toml'} expects"
    if before.get("error"):
        was = before["error"]
        verdict = "worse" if was == expect else "better"
        note = note if was == expect else ""
        return [_entry(document["log"], key="error", before=was, after="read", verdict=verdict, note=note)]
    if expect.startswith("E_"):
        return [_entry(document["log"], key="expect", before=expect, after="read", verdict="worse", note=note)]
    found = []
    for case in document["cases"] if expect in ("improved", "kept") else ():
        statuses = {method["status"] for method in case["methods"]}
        came = "improved" if "improved" in statuses else "kept"
        if came != expect:
            verdict = "worse" if expect == "improved" else "better"
            place = {"case": case["case"], "key": "expect", "note": note}
            found.append(_entry(document["log"], **place, before=expect, after=came, verdict=verdict))
    return found


def _excused(entry: Entry, known: Sequence[Known]) -> Entry:
    """The entry, as known where an issue covers it: where it fails, or where a method still does not come to an end."""
    still = entry["key"] == "status" and entry["after"] == "failed"
    if entry["verdict"] in FAILING or still:
        for issue in known:
            if issue.covers(entry["log"], entry["method"], entry["key"]):
                return entry | {"verdict": "known", "note": issue.note}
    return entry


def _entry(
    log: str,
    *,
    case: str = "",
    method: str = "",
    key: str,
    before: Value = None,
    after: Value = None,
    verdict: str,
    note: str = "",
) -> Entry:
    about = {"unit": "-", "direction": "exact", "rel_tol": None, "abs_tol": None}
    place = {"log": log, "case": case, "method": method, "key": key}
    return place | about | {"before": before, "after": after, "verdict": verdict, "note": note}
