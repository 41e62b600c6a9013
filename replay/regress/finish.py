"""The end of a run, in a process of its own since it needs memory: verdicts.json, run.json, the reports.

Usage: python -m replay.regress.finish RUN HISTORY COMMANDS; prints one JSON document.
"""

import json
import os
import pathlib
import subprocess
import sys
from collections.abc import Sequence

import msgspec

from replay.base.documents import parse_json, plain
from replay.base.errors import ReplayError
from replay.base.run_folder import VERDICTS_FILE
from replay.base.schemas.baseline import Baseline
from replay.base.schemas.run import Commands, RunHead
from replay.base.schemas.verdicts import VERDICTS_SCHEMA, Comparison, Verdicts
from replay.regress.baseline import read_baseline
from replay.regress.compare import compare_log, gone, missing_log
from replay.regress.folder import RunFolder, file_stem, write_document
from replay.regress.options import other_options, uncompared
from replay.report import make_report
from replay.report.conclusion import Conclusion, conclude

FINISH_ERROR = "E_REPORT"


def finish(folder: pathlib.Path, history: pathlib.Path, commands: Commands) -> Conclusion:
    """Judge a run and write its reports in a process of its own. Raises ReplayError (E_REPORT)."""
    words = [str(folder), str(history), json.dumps(plain(commands))]
    command = [sys.executable, "-P", "-m", "replay.regress.finish", *words]
    environment = os.environ | {"PYTHONPATH": os.pathsep.join(filter(None, sys.path))}
    done = subprocess.run(command, capture_output=True, text=True, env=environment)
    if done.returncode != 0:
        last = (done.stderr.strip().splitlines() or [f"exit status {done.returncode}"])[-1]
        raise ReplayError(FINISH_ERROR, f"{folder}: the reports could not be made: {last}")
    return parse_json(done.stdout, Conclusion)


def judge(folder: RunFolder) -> list[Comparison]:
    """Compare a run, which may be unfinished, with its baseline, and write verdicts.json."""
    head = folder.head()
    baseline = read_baseline(head.baseline)
    without = uncompared(baseline, head.options)
    found: list[Comparison] = []
    names = []
    renamed = {} if head.partial else _absent(baseline, head.logs)
    for document in folder.documents():
        name = document.log
        names.append(name)
        old = renamed.pop(document.sha256, None) if name not in baseline.logs else None
        before = baseline.logs.get(old or name)
        found += compare_log(document, before, head.known, whole=not head.partial_methods, without=without)
        if old is not None:
            found.append(missing_log(old, head.known, now=name))
            names.append(old)
    if not head.partial and head.complete:
        found += [missing_log(name, head.known) for name in sorted(baseline.logs.keys() - set(names))]
    found += gone(head.known, found, partial=bool(head.partial))
    text = json.dumps(plain(Verdicts(schema=VERDICTS_SCHEMA, comparisons=tuple(found))), sort_keys=True, indent=0)
    write_document(folder.path / VERDICTS_FILE, text)
    return found


def _absent(baseline: Baseline, logs: Sequence[str]) -> dict[str | None, str]:
    """Names of the baseline's logs that are not in the run, by their content: a log with it was renamed."""
    names = sorted(baseline.logs.keys() - set(logs), reverse=True)
    return {sha256: name for name in names if (sha256 := baseline.logs[name].sha256)}


def judge_and_report(path: pathlib.Path, history: pathlib.Path, commands: Commands) -> Conclusion:
    """Judge a run and make its reports in this process. Raises ReplayError."""
    folder = RunFolder(path)
    head = folder.head()
    complete = folder.done().issuperset(file_stem(name) + ".json" for name in head.logs)
    about = {"complete": complete, "commands": commands, "other_options": _other_options(head)}
    folder.write_head(msgspec.structs.replace(head, **about))
    judge(folder)
    return conclude(make_report(path, history))


def _other_options(head: RunHead) -> str:
    if head.baseline is None or head.options is None:
        return ""
    fingerprint = "" if head.partial_methods else head.options_fingerprint
    return other_options(read_baseline(head.baseline), head.options, fingerprint)


def main() -> int:
    """Judge and report the run that the arguments name; returns the exit status."""
    folder, history, commands = sys.argv[1:4]
    try:
        found = judge_and_report(pathlib.Path(folder), pathlib.Path(history), parse_json(commands, Commands))
    except ReplayError as error:
        sys.stderr.write(f"{error}\n")
        return 1
    sys.stdout.write(json.dumps(plain(found)))
    return 0


if __name__ == "__main__":
    sys.exit(main())
