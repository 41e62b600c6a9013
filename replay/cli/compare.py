"""`replay compare`: two runs of one request, or two methods of one run, side by side."""

import math
import pathlib
from typing import Annotated

from cyclopts import Parameter
from rich import box
from rich.table import Table

from replay.base.errors import UsageError, printable
from replay.cli.console import Common, Voice
from replay.cli.usage import ExitStatus, reflowed
from replay.run.side_by_side import QUANTITIES, Pair, SideBySide, overlay, to_document
from replay.run.side_by_side import compare as compare_files

_ROWS = {
    "objective": ("J", 1.0, 2),
    "length": ("length [m]", 1.0, 2),
    "cusps": ("gear changes", 1.0, 0),
    "steering_variation": ("steering variation [°]", math.degrees(1.0), 0),
    "min_clearance": ("clearance [m]", 1.0, 3),
    "wall_s": ("time [s]", 1.0, 2),
}
"""Title, factor to the title's unit, digits."""


@reflowed
def compare(
    a: pathlib.Path,
    b: pathlib.Path,
    /,
    *,
    out: pathlib.Path | None = None,
    common: Annotated[Common | None, Parameter(name="*")] = None,
) -> int:
    """Show two runs of one request, or two methods of one run, side by side.

    Parameters
    ----------
    a
        Results file; or one of its methods, as in bay_01.results.json:scp.
    b
        Likewise; :ddp alone is a method of the first one's file. Of two files, methods are compared by their names.
    out
        Rerun recording to write, with the paths of both in one picture, as in compared.rrd.
    """
    voice = Voice(common or Common())
    if out is not None and out.suffix != ".rrd":
        raise UsageError(f"--out {out}: expected the name of a recording, as in --out compared.rrd")
    comparison = compare_files(str(a), str(b))
    if out is not None:
        from replay.recording import write_recording  # Rerun takes a second to load

        run, looks = overlay(comparison)
        write_recording(run, out, looks)
    for side, name in ((comparison.a, "A"), (comparison.b, "B")):
        method = f", {side.method}" if side.method is not None else ""
        voice.show(f"{name}: {side.file}{method}")
    voice.show(_table(comparison))
    for note in comparison.notes:
        voice.note(note)
    if out is not None:
        voice.show(f"wrote {out}")
    voice.document({**to_document(comparison), "files": [] if out is None else [str(out)]})
    return ExitStatus.OK


def _table(comparison: SideBySide) -> Table:
    table = Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column("path", overflow="fold", max_width=24)
    table.add_column("quantity", no_wrap=True)
    for heading in ("A", "B", "B - A", "%"):
        table.add_column(heading, justify="right", no_wrap=True)
    for pair in comparison.pairs:
        table.add_row(printable(pair.name, 60), "status", pair.a.status, pair.b.status, "", "")
        for k, quantity in enumerate(QUANTITIES):
            table.add_row(*_row(pair, quantity), end_section=k == len(QUANTITIES) - 1)
    return table


def _row(pair: Pair, quantity: str) -> list[str]:
    title, scale, digits = _ROWS[quantity]
    values = [scale * entry.values[quantity] for entry in (pair.a, pair.b)]
    difference, relative = scale * pair.difference(quantity), pair.relative(quantity)
    shown = ["free" if value == math.inf else _number(value, digits) for value in values]
    change = f"{difference:+z.{digits}f}" if math.isfinite(difference) else ""
    share = f"{100.0 * relative:+z.1f}" if math.isfinite(relative) else ""
    return ["", title, *shown, change, share]


def _number(value: float, digits: int) -> str:
    return f"{value:.{digits}f}" if math.isfinite(value) else ""
