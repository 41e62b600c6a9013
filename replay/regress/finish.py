"""The end of a run, in a process of its own since it needs memory: verdicts.json, run.json, the reports.

Usage: python -m replay.regress.finish RUN HISTORY COMMANDS; prints one JSON document.
"""

import json
import os
import pathlib
import subprocess
import sys
from collections.abc import Mapping, Sequence
from typing import Any

from replay.base.documents import plain
from replay.base.errors import ReplayError
from replay.base.files import atomic_write
from replay.base.numbers import count
from replay.base.strict_json import parse_json
from replay.regress.baseline import Baseline, read_baseline
from replay.regress.compare import Entry, compare_log, gone, missing_log
from replay.regress.corpus import Known
from replay.regress.differing import other_options, uncompared
from replay.regress.store import Store, file_stem
from replay.report import make_report
from replay.report.facts import acceptable, is_declared, state
from replay.report.groups import failing_lines, groups
from replay.report.model import LogError, RunData
from replay.report.reading import VERDICTS_SCHEMA

FINISH_ERROR = "E_REPORT"
_MOST_LINES = 20
_MOST_TWICE = 5


def finish(folder: pathlib.Path, history: pathlib.Path, commands: Mapping[str, str]) -> dict[str, Any]:
    """Judge a run and write its reports in a process of its own; what that says. ReplayError (E_REPORT).

    `commands` are those that the reports give to paste: "accept" makes the run the baseline, "view" shows it.
    """
    words = [str(folder), str(history), json.dumps(dict(commands))]
    command = [sys.executable, "-P", "-m", "replay.regress.finish", *words]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
        raise ReplayError(FINISH_ERROR, f"{folder}: the reports could not be made: {last}")
    return parse_json(done.stdout)


def judge(folder: pathlib.Path) -> list[Entry]:
    """Compare a run with its baseline and write verdicts.json; the entries. The run may be unfinished."""
    store = Store(folder)
    head = store.head()
    known = [Known(**issue) for issue in head.get("known") or ()]
    baseline = read_baseline(head["baseline"]) if head.get("baseline") else Baseline()
    without = uncompared(baseline, head["options"]) if head.get("options") else ()
    entries: list[Entry] = []
    names = []
    absent = {} if head.get("partial") else _absent(baseline, head.get("logs") or ())
    for document in store.documents():
        name = document["log"]
        names.append(name)
        whole = not head.get("partial_methods")
        before = absent.pop(document.get("sha256"), None) if name not in baseline.logs else None
        entries += compare_log(document, baseline.logs.get(before or name), known, whole=whole, without=without)
        if before is not None:
            entries.append(missing_log(before, known, now=name))
            names.append(before)
    if not head.get("partial") and head.get("complete"):
        entries += [missing_log(name, known) for name in sorted(baseline.logs.keys() - set(names))]
    entries += gone(known, entries, partial=bool(head.get("partial")))
    text = json.dumps(plain({"schema": VERDICTS_SCHEMA, "verdicts": entries}), sort_keys=True, indent=0)
    with atomic_write(folder / "verdicts.json") as temporary:
        temporary.write_bytes(text.encode("utf-8", "backslashreplace") + b"\n")
    return entries


def _absent(baseline: Baseline, logs: Sequence[str]) -> dict[str | None, str]:
    """Names of the baseline's logs that are not in the run, by their content: what has it now was renamed."""
    gone_names = sorted(baseline.logs.keys() - set(logs), reverse=True)
    return {sha256: name for name in gone_names if (sha256 := baseline.logs[name].get("sha256"))}


def conclude(folder: pathlib.Path, history: pathlib.Path, commands: Mapping[str, str]) -> dict[str, Any]:
    """Judge a run and make its reports; what the command has to say of it, whose size does not grow with the run's."""
    store = Store(folder)
    head = store.head()
    done = store.done()
    planned = [file_stem(name) + ".json" for name in head.get("logs") or ()]
    about = {"complete": done.issuperset(planned), "commands": dict(commands), "other_options": _other_options(head)}
    store.write_head(_without_schema(head) | about)
    judge(folder)
    report = make_report(folder, history)
    run = report.run
    told = groups(run)
    lines, more = failing_lines(told)
    return {
        "state": state(run),
        "headline": report.summary["headline"],
        "failing": lines,
        "failing_more": more,
        "known": [group.sentence for group in told if group.verdict == "known"][:_MOST_LINES],
        "passing": _few([change.note for change in run.changes if change.key == "known issue"]),
        "unread": _few([_unread(error) for error in run.errors if not error.expected]),
        "unwritten": _unwritten(run),
        "twice": _twice(run),
        "damaged": _few(run.damaged),
        "against_corpus": list(
            dict.fromkeys(change.note for change in run.failing if is_declared(change) and change.note)
        ),
        "acceptable": acceptable(run),
        "other_options": run.other_options,
        "files": [str(path) for path in report.files],
    }


def _unread(error: LogError) -> str:
    return f"{error.log}: {error.error}" + (f"; {error.cure}" if error.cure else "")


def _unwritten(run: RunData) -> str:
    """How many recordings could not be written, and why the first could not."""
    reasons = {row.case: row.recording_error for row in run.rows if row.recording_error}
    first = next(iter(reasons.values()), "")
    return f"{count(len(reasons), 'recording')} could not be written: {first}" if reasons else ""


def _twice(run: RunData) -> str:
    """Which logs have the same content."""
    names: dict[str, dict[str, None]] = {}
    for row in run.rows:
        names.setdefault(row.sha256, {})[row.log] = None
    same = [" = ".join(logs) for sha256, logs in names.items() if sha256 and len(logs) > 1]
    more = f", and {len(same) - _MOST_TWICE} more" if len(same) > _MOST_TWICE else ""
    return f"logs with the same content: {', '.join(same[:_MOST_TWICE])}{more}" if same else ""


def _few(lines: Sequence[str]) -> list[str]:
    """Some lines, and how many more there are."""
    more = len(lines) - _MOST_LINES
    return [*lines[:_MOST_LINES], *([f"and {more} more, in the report"] if more > 0 else [])]


def _other_options(head: Mapping[str, Any]) -> str:
    if not head.get("baseline") or not head.get("options"):
        return ""
    baseline = read_baseline(head["baseline"])
    fingerprint = "" if head.get("partial_methods") else str(head.get("options_fingerprint") or "")
    return other_options(baseline, head["options"], fingerprint)


def _without_schema(head: Mapping[str, Any]) -> dict[str, Any]:
    return {key: value for key, value in head.items() if key != "schema"}


def main() -> int:
    folder, history, commands = sys.argv[1:4]
    try:
        said = conclude(pathlib.Path(folder), pathlib.Path(history), json.loads(commands))
    except ReplayError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    sys.stdout.write(json.dumps(plain(said)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
