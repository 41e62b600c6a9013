"""A run as a Rerun recording, with its blueprint in the same file. Only this package knows Rerun.

Timelines: `progress` (0 to 1000, gear changes aligned where the paths have as many; every view lives on it),
`arc_cm` (distance driven, cm), `iteration` (0 for the start, then one step for each iterate).
Entities, with <path> = recorded or a method's name (- for a chain's +):

    /scene/map, obstacles, ends, scale, legend                           static
    /scene/<path>/path, cusps, swept, closest, audit, rejected       static
    /scene/recorded/logged_poses                                     static, where the path was repaired
    /scene/<path>/vehicle/{truck,trailer}                            outlines, moved by transforms
    /scene/<path>/whisker                                            line to the nearest obstacle, where it is near
    /scene/<path>/iterate                                            one polyline per iterate
    /signals/<signal>/<path>, /signals/<signal>/limit                scalars; on `iteration` each iterate's extreme
    /gear/<path>                                                     states; on `iteration` numbers of gear changes
    /solver/<quantity>/<method>, turned_down below, level beside     scalars by iteration
    /solver/residuals_log10/<residual>/<method>                      each relative to its tolerance
    /report/{summary,convergence,residuals,vehicle,run,audit}     markdown
"""

import pathlib
from collections.abc import Mapping

from replay.base.errors import ReplayError
from replay.base.files import atomic_write
from replay.base.style import Style
from replay.run.outcome import Run

__all__ = ["prepare", "write_recording"]


def prepare() -> None:
    """Load what writes recordings ahead of the first one; that takes a second."""
    from replay.recording.writing import warm_up  # imports rerun: 1 s

    warm_up()


def write_recording(run: Run, path: pathlib.Path, looks: Mapping[str, Style] | None = None) -> None:
    """Write the run as one .rrd file that opens on its verdict. `looks` are styles by method, if not their own.

    The file is written under a temporary name, read back, and only then gets its name: a file of that name is
    whole. Raises ReplayError if it cannot be written; nothing is left of it then.
    """
    from replay.recording.writing import Unwritable, write  # imports rerun: 1 s

    with atomic_write(path) as temporary:
        try:
            write(run, temporary, looks)
        except Unwritable as error:
            raise ReplayError("E_RECORDING", f"{path}: cannot be written: {error}") from error
