"""How the scripts of this folder take their arguments and end: what a user can mend is one line, not a traceback."""

import argparse
import pathlib
import sys
from collections.abc import Callable
from typing import NoReturn

from replay.base.errors import ReplayError


def existing(text: str) -> pathlib.Path:
    """The file or folder that an argument names, for `type=`; an error of usage where there is none."""
    path = pathlib.Path(text)
    if not path.exists():
        raise argparse.ArgumentTypeError(f"{text!r} does not exist")
    return path


def from_one(text: str) -> int:
    """A count that an argument gives, for `type=`: a whole number from 1 on."""
    if not text.isascii() or not text.isdigit() or int(text) < 1:
        raise argparse.ArgumentTypeError(f"{text!r} is not a whole number from 1 on")
    return int(text)


def method_name(text: str) -> str:
    """The name of a method that an argument gives, for `type=`, or names that are joined to a chain by `+`."""
    from optim.methods import METHODS  # most scripts do not ask for one, and it takes a while
    from optim.methods.chain import named

    try:
        named(text, METHODS)
    except KeyError as error:
        raise argparse.ArgumentTypeError(f"no method {error.args[0]!r}; there are {', '.join(METHODS)}") from error
    return text


def run(main: Callable[[], int | None]) -> NoReturn:
    """Call `main` and end with the exit status that it gives, or with the line and the status of a known error."""
    try:
        sys.exit(main())
    except ReplayError as error:
        print(f"{pathlib.Path(sys.argv[0]).name}: error: {error}", file=sys.stderr)
        sys.exit(error.exit_status)
