"""`replay report`: the reports of a regression run, made again from its files."""

import pathlib
from typing import Annotated

from cyclopts import Parameter

from replay.base.documents import plain
from replay.base.errors import ReplayError
from replay.base.files import WRITE_ERROR
from replay.cli.console import Common, Voice
from replay.cli.usage import ExitStatus, reflowed
from replay.report import make_report
from replay.report.conclusion import Conclusion, conclude


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
    found = conclude(made)
    status = _status(found)
    voice.show(found.headline)
    voice.show(*(f"  {line}" for line in found.failing))
    if found.failing_more:
        voice.show(f"  and {found.failing_more} more")
    voice.show(*(f"wrote {file}" for file in found.files))
    for line in made.run.damaged:
        voice.error(f"left out: {line}")
    if not found.complete:
        voice.note("the run is unfinished: the same `replay regress` with --resume does the rest")
    document = {"schema": "replay.report/1", "exit_status": int(status), "files": list(found.files)}
    voice.document(document | {"summary": plain(made.summary)})
    return status


def _status(found: Conclusion) -> ExitStatus:
    if found.state == "failed":
        return ExitStatus.SHORT
    return ExitStatus.PARTIAL if found.damaged or found.unread or not found.complete else ExitStatus.OK
