"""`replay report`: the reports of a regression run, made again from its files."""

import pathlib
from typing import Annotated

from cyclopts import Parameter

from replay.base.errors import ReplayError
from replay.base.files import WRITE_ERROR
from replay.cli.console import Common, Voice
from replay.cli.usage import ExitStatus, reflowed
from replay.report import make_report
from replay.report.facts import state
from replay.report.groups import failing_lines, groups
from replay.report.model import RunData


@reflowed
def report(
    run: pathlib.Path,
    /,
    *,
    history: pathlib.Path | None = None,
    common: Annotated[Common | None, Parameter(name="*")] = None,
) -> int:
    """Make the reports of a regression run again from its files: HTML, JUnit XML, Markdown, Parquet, a JSON summary.

    Exit status 1 if the run shows a regression or a report cannot be written, 3 if the run is unfinished or some of
    its logs or files could not be read.

    Parameters
    ----------
    run
        Folder of the run, written by `replay regress`.
    history
        Folder of the runs from which the trend is read; by default the one in which the run is.
    """
    voice = Voice(common or Common())
    try:
        made = make_report(run, history)
    except ReplayError as error:
        if error.code != WRITE_ERROR:
            raise
        voice.error(str(error))
        return ExitStatus.SHORT
    status = _status(made.run)
    voice.show(str(made.summary["headline"]))
    lines, more = failing_lines(groups(made.run))
    voice.show(*(f"  {line}" for line in lines))
    if more:
        voice.show(f"  and {more} more")
    voice.show(*(f"wrote {path}" for path in made.files))
    for line in made.run.damaged:
        voice.error(f"left out: {line}")
    if not made.run.complete:
        voice.note("the run is unfinished: the same `replay regress` with --resume does the rest")
    files = [str(path) for path in made.files]
    voice.document({"schema": "replay.report/1", "exit_status": int(status), "files": files, "summary": made.summary})
    return status


def _status(run: RunData) -> ExitStatus:
    if state(run) == "failed":
        return ExitStatus.SHORT
    unread = run.damaged or any(not error.expected for error in run.errors)
    return ExitStatus.PARTIAL if unread or not run.complete else ExitStatus.OK
