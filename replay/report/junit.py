"""JUnit XML, as CI servers read it: one test case for each log's case and method."""

import xml.etree.ElementTree as ET
from collections import defaultdict
from collections.abc import Iterable, Sequence

from replay.base.errors import printable
from replay.base.numbers import count, fixed, percent, shown
from replay.base.schemas.summary import Change, MethodTiming, UnreadLog
from replay.report.facts import class_of_logs, is_failing, ranked, sentence
from replay.report.run_data import ResultRow, RunData

Key = tuple[str, str, str]


def junit(run: RunData) -> bytes:
    """The run as JUnit XML: one suite for each method, and one for logs that could not be used."""
    by_key: dict[Key, list[Change]] = defaultdict(list)
    for change in ranked(run.changes):
        by_key[change.log, change.case, change.method].append(change)
    suites: dict[str, list[ET.Element]] = {name: [] for name in run.methods}
    for row in run.rows:
        changes = by_key.pop((row.log, row.case, row.method), [])
        suites[row.method].append(_test(row.method, row.case, row.kind, row.result.wall_s, changes, row))
    kinds = class_of_logs(run)
    for error in run.errors:
        changes = [change for key in list(by_key) if key[0] == error.log for change in by_key.pop(key)]
        suites.setdefault("logs", []).append(_unread(error, changes))
    for (log, case, method), changes in by_key.items():  # compared, but not in the run
        test = _test(method or "logs", case or log, kinds.get(log, ""), None, changes)
        suites.setdefault(method or "logs", []).append(test)
    if run.timing:
        suites["timing"] = [_timed(each, run.against) for each in run.timing]
    root = ET.Element("testsuites", {"name": f"replay regress {run.name}"})
    for name, tests in suites.items():
        root.append(_suite(name, tests, run))
    for key in ("tests", "failures", "errors", "skipped"):
        root.set(key, str(sum(int(suite.get(key, "0")) for suite in root)))
    root.set("time", _seconds(sum(float(suite.get("time", "0")) for suite in root)))
    ET.indent(root)
    return ET.tostring(root, encoding="utf-8", xml_declaration=True) + b"\n"


def _suite(name: str, tests: Sequence[ET.Element], run: RunData) -> ET.Element:
    counts = {key: sum(test.find(tag) is not None for test in tests) for key, tag in _OUTCOMES.items()}
    time = sum(float(test.get("time", "0")) for test in tests)
    suite = ET.Element("testsuite", {"name": name, "tests": str(len(tests))})
    for key, number in counts.items():
        suite.set(key, str(number))
    suite.set("time", _seconds(time))
    if run.head.created:
        suite.set("timestamp", run.head.created)
    properties = ET.SubElement(suite, "properties")
    head = run.head
    about = {"revision": head.revision, "corpus": head.corpus.path, "partial": head.partial}
    if head.other_options:
        about["other options"] = head.other_options
    about["complete"] = "yes" if head.complete else "no"
    for key, value in about.items():
        ET.SubElement(properties, "property", {"name": key, "value": value})
    suite.extend(tests)
    return suite


_OUTCOMES = {"failures": "failure", "errors": "error", "skipped": "skipped"}


def _test(
    method: str, case: str, kind: str, wall_s: float | None, changes: Iterable[Change], row: ResultRow | None = None
) -> ET.Element:
    """One test case with its outcome: at most one of error, failure and skipped, as readers expect."""
    name = f"{kind or 'log'}.{case}".replace("/", ".")
    test = ET.Element("testcase", {"classname": name, "name": f"{case} {method}", "time": _seconds(wall_s or 0.0)})
    changes = list(changes)
    failing = [change for change in changes if is_failing(change)]
    crashed = [change for change in failing if change.verdict == "crashed"]
    known = [change for change in changes if change.verdict == "known"]
    if failing:
        tag = "error" if crashed else "failure"
        first = (crashed or failing)[0]
        outcome = ET.SubElement(test, tag, {"message": sentence(first), "type": first.verdict})
        outcome.text = "\n".join(explained(change) for change in failing)
        if row is not None and row.recording:
            outcome.text += f"\nrecording: {row.recording}"
        if row is not None and row.recording_error:
            outcome.text += f"\nrecording: could not be written: {row.recording_error}"
        if row is not None and row.result.reason:
            outcome.text += f"\n{row.result.status} ({row.result.stop}): {row.result.reason}"
    elif known:
        ET.SubElement(test, "skipped", {"message": f"known issue: {known[0].note or sentence(known[0])}"})
    return test


def _timed(timed: MethodTiming, against: str) -> ET.Element:
    test = ET.Element("testcase", {"classname": "timing", "name": f"timing {timed.method}", "time": _seconds(0.0)})
    if timed.slower:
        line = f"{timed.method} is slower than {against}: {fixed(timed.ratio, 3)} times"
        line += f", 95 % interval {fixed(timed.low, 3)} to {fixed(timed.high, 3)}, {count(timed.logs, 'log')}"
        ET.SubElement(test, "failure", {"message": line, "type": "slower"}).text = line
    return test


def explained(change: Change) -> str:
    """One comparison with everything that decided it."""
    unit = f" {change.unit}" if change.unit not in ("", "-") else ""
    parts = [f"{change.verdict}: {change.key or 'the result'}"]
    if change.before is not None or change.after is not None:
        parts.append(f"before {shown(change.before, 9)}{unit}, after {shown(change.after, 9)}{unit}")
    if relative := percent(change.relative):
        parts.append(relative)
    if change.direction:
        parts.append(f"{change.direction} is better" if change.direction in ("lower", "higher") else change.direction)
    if change.tolerance:
        parts.append(f"tolerance {change.tolerance}")
    if change.note:
        parts.append(change.note)
    return ", ".join(parts)


def _unread(error: UnreadLog, changes: Sequence[Change]) -> ET.Element:
    test = _test("reading", error.log, error.kind, None, changes)
    if not error.expected and not any(test.find(tag) is not None for tag in _OUTCOMES.values()):
        message = printable(error.error, 300)
        ET.SubElement(test, "error", {"message": message, "type": "unread"}).text = error.error
    return test


def _seconds(value: float) -> str:
    return f"{value:.3f}"
