"""Processes that scripts and tests start and look after: the command `replay`, and whether a process still runs."""

import pathlib
import sys
from typing import Final

REPLAY: Final = (sys.executable, "-c", "import sys; from replay.cli import main; sys.exit(main(sys.argv[1:]))")
"""The command `replay` of the Python that runs this, whatever is installed beside it."""


def is_running(pid: int) -> bool:
    """Whether a process goes on; one that has ended and was not yet waited for does not."""
    try:
        return pathlib.Path(f"/proc/{pid}/stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
