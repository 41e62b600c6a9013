"""Commands that messages give to paste: they name this program as it was called, which need not be on the PATH."""

import pathlib
import shlex
import shutil
import sys


def program(name: str = "replay") -> str:
    """The word that runs this program, or one that is installed beside it."""
    called = pathlib.Path(sys.argv[0])
    if called.stem != "replay":  # run as a module, or by a test
        return name
    beside = called.with_name(name + called.suffix)
    found = shutil.which(name)
    if not beside.exists() or (found is not None and pathlib.Path(found).samefile(beside)):
        return name
    return str(beside)


def recordings_to_paste(folder: pathlib.Path) -> str:
    """A command line that opens every recording of a folder in one viewer, as a shell takes it."""
    return f"{shlex.quote(program('rerun'))} {shlex.quote(str(folder))}/*.rrd"


def to_paste(*words: str) -> str:
    """A command line of this program, as a shell takes it."""
    return shlex.join([program(), *words])
