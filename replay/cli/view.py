"""`replay view`: the recordings of a run as one dataset, served to viewers on this machine."""

import pathlib
import shlex
import threading
from typing import TYPE_CHECKING, Annotated, Any

from cyclopts import Parameter
from rich.table import Table

from replay.base.errors import ReplayError, printable
from replay.cli.console import Common, Voice
from replay.cli.invoked import program, to_paste
from replay.cli.options import WholeNumber
from replay.cli.usage import ExitStatus, reflowed

if TYPE_CHECKING:
    from replay.recording.dataset import Dataset

VIEW_ERROR = "E_VIEW"


@reflowed
def view(
    run: pathlib.Path,
    /,
    *,
    port: WholeNumber = 0,
    common: Annotated[Common | None, Parameter(name="*")] = None,
) -> int:
    """Serve the recordings of a run as one Rerun dataset: a table to sort, and a link to each recording.

    Only this machine can reach it. Ends with Ctrl-C.

    Parameters
    ----------
    run
        Folder of a run written by `replay regress`, or any folder of recordings.
    port
        Port of the loopback interface; 0 takes a free one.
    """
    voice = Voice(common or Common())
    if not 0 <= port <= 65535:
        raise ReplayError(VIEW_ERROR, f"--port {port}: expected 0 to 65535")
    files = recordings(run)
    from replay.recording.dataset import served  # Rerun takes a second to load

    with served(printable(run.resolve().name) or "recordings", files, port) as dataset:
        for line in dataset.skipped:
            voice.error(f"left out: {line}")
        voice.show(_table(dataset))
        voice.show(*_links(dataset))
        voice.document(_document(dataset))
        voice.note("serving; Ctrl-C ends it")
        threading.Event().wait()
    return ExitStatus.OK


def recordings(run: pathlib.Path) -> list[pathlib.Path]:
    """The recordings of a run's folder, or of any folder. ReplayError (E_VIEW) where there are none."""
    try:
        folder = run / "recordings" if (run / "recordings").is_dir() else run
        files = sorted(path for path in folder.iterdir() if path.suffix == ".rrd" and path.is_file())
    except (OSError, ValueError) as error:
        reason = getattr(error, "strerror", None) or str(error)
        raise ReplayError(VIEW_ERROR, f"{run}: {reason}; expected the folder of a run or of recordings") from error
    if not files:
        hint = f"`{to_paste('regress', 'CORPUS', '--recordings', 'all')}` writes one for each log"
        raise ReplayError(VIEW_ERROR, f"{folder}: holds no recording (*.rrd); {hint}")
    return files


def _table(dataset: "Dataset") -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("recording", "status", "best", "J"):
        table.add_column(heading, justify="right" if heading == "J" else "left", no_wrap=True)
    for entry in dataset.entries:
        found = entry.properties
        before, after = found.get("objective_before"), found.get("objective_after")
        cost = f"{before:.2f} → {after:.2f}" if before is not None and after is not None else ""
        words = (entry.name, found.get("status") or "", found.get("best_method") or "")
        table.add_row(*(printable(word, 60) for word in words), cost)
    return table


def _links(dataset: "Dataset") -> list[str]:
    """Commands that open the recordings: lines to copy, which a table would fold."""
    viewer = shlex.quote(program("rerun"))
    lines = [f"{viewer} {shlex.quote(entry.url)}  # {entry.name}" for entry in dataset.entries]
    return ["", *lines, f"{viewer} {shlex.quote(dataset.url)}  # the table of all"]


def _document(dataset: "Dataset") -> dict[str, Any]:
    entries = [{"name": e.name, "url": e.url, "properties": e.properties} for e in dataset.entries]
    return {"schema": "replay.view/1", "url": dataset.url, "recordings": entries, "skipped": dataset.skipped}
