"""`replay audit`: repeat the independent check of results files, from these files alone."""

import pathlib
from collections.abc import Sequence
from typing import Annotated, Any

from cyclopts import Parameter

from replay.base.documents import plain
from replay.base.errors import ReplayError
from replay.cli.console import Common, Voice
from replay.cli.tables import checks_table
from replay.cli.usage import ExitStatus, reflowed
from replay.run.confirm import Confirmation, audit_results
from replay.run.results import audit_document, read_results


@reflowed
def audit(
    results: list[pathlib.Path],
    /,
    *,
    common: Annotated[Common | None, Parameter(name="*")] = None,
) -> int:
    """Repeat the independent check of results files, from these files alone.

    Exit status 1 if a path does not pass, or if a file claims what the repeated check does not confirm.

    Parameters
    ----------
    results
        Files written by `replay optimize`, STEM.results.json.
    """
    voice = Voice(common or Common())
    documents = [_audit_file(voice, path) for path in results]
    unreadable = [document["error"] is not None for document in documents]
    if any(not document["passed"] for document in documents if document["error"] is None):
        status = ExitStatus.SHORT
    elif all(unreadable):
        status = ExitStatus.USAGE
    else:
        status = ExitStatus.PARTIAL if any(unreadable) else ExitStatus.OK
    voice.document({"schema": "replay.audit/1", "exit_status": int(status), "results": documents})
    return status


def _audit_file(voice: Voice, path: pathlib.Path) -> dict[str, Any]:
    """Audit one file, show it, and give the same as plain data."""
    try:
        verdicts = audit_results(read_results(path))
    except ReplayError as error:
        voice.error(str(error))
        return {"file": str(path), "error": str(error), "passed": False, "paths": []}
    passed = all(verdict.report.passed and verdict.confirmed for verdict in verdicts)
    reports = {verdict.name: verdict.report for verdict in verdicts}
    voice.show(f"{path}: {_sentence(verdicts)}", checks_table(reports))
    for verdict in verdicts:
        for sentence in (*verdict.report.failures, *verdict.differences):
            voice.error(f"{path}: {verdict.name}: {sentence}")
    paths = [{"name": v.name, "audit": plain(audit_document(v.report)), "differences": v.differences} for v in verdicts]
    return {"file": str(path), "error": None, "passed": passed, "paths": paths}


def _sentence(verdicts: Sequence[Confirmation]) -> str:
    wrong = [verdict.name for verdict in verdicts if not verdict.report.passed]
    false = [verdict.name for verdict in verdicts if not verdict.confirmed]
    if not wrong and not false:
        return f"all {len(verdicts)} paths pass, and everything that the file claims is confirmed"
    parts = [f"does not pass: {', '.join(wrong)}"] if wrong else []
    return "; ".join([*parts, *([f"not confirmed: {', '.join(false)}"] if false else [])])
