"""The command line: `replay optimize | info | vehicle | methods | compare | audit | regress | report`.

This module stays light: a command's module, and with it numpy, numba and Rerun, is imported when the command is
called, so that `replay --help` answers at once. Each command is a thin shell over library functions.
"""

import sys
from collections.abc import Sequence

from cyclopts import App, CycloptsError, MissingArgumentError, UnknownCommandError
from rich.console import Console

from replay.base.errors import USAGE_ERROR, OutputLost, ReplayError, unknown
from replay.base.kernels import drop_stale
from replay.base.threads import use_one_thread
from replay.cli.interrupts import like_ctrl_c
from replay.cli.invoked import to_paste
from replay.cli.usage import ExitStatus, command_of, drop_output, example

COMMANDS = {
    "optimize": "Improve the recorded paths of logs; write a Rerun recording and a results file for each.",
    "info": "Show what was understood of logs: channels, map, path, vehicle, notes.",
    "vehicle": "Print a vehicle as TOML, each line with its unit and meaning: to be changed, and read by --vehicle.",
    "methods": "List the methods and their options.",
    "compare": "Show two runs of one request, or two methods of one run, side by side.",
    "audit": "Repeat the independent check of results files, from these files alone.",
    "regress": "Run every log of a corpus with every method, compare with a baseline, write reports.",
    "report": "Make the reports of a regression run again from its files.",
}
"""The commands and their line in the help; each is the function of its own name in `replay.cli.<name>`."""


def main(arguments: Sequence[str] | None = None) -> int:
    """Run one command, by default the process's own; returns the exit status (see `ExitStatus`)."""
    tokens = list(sys.argv[1:] if arguments is None else arguments)
    with like_ctrl_c() as ending:
        return ending.status(_run(tokens))


def _run(tokens: list[str]) -> int:
    try:
        use_one_thread()
        if tokens and tokens[0] in COMMANDS:
            drop_stale()
        # A new console for each call: `regress`, an application in its module, would keep its first one and its width.
        console = Console()
        app = make_app()
        status = app(tokens, console=console, exit_on_error=False, print_error=False, result_action="return_value")
    except UnknownCommandError:  # its own text would import every command to name them
        _explain(unknown("command", tokens[0], COMMANDS), ())
        return ExitStatus.USAGE
    except CycloptsError as error:
        command = error.command_chain or ()
        _explain(_missing(error, command) if isinstance(error, MissingArgumentError) else str(error), command)
        return ExitStatus.USAGE
    except ReplayError as error:
        if error.code == USAGE_ERROR:
            _explain(error.message, command_of(tokens))
        else:
            _say(f"replay: {error.message}")
        return error.exit_status
    except KeyboardInterrupt:
        _say("replay: interrupted")
        return ExitStatus.INTERRUPTED
    except BrokenPipeError:  # the reader of our output has ended, as in `replay methods | head -1`
        drop_output()
        return ExitStatus.OK
    except OutputLost as error:
        drop_output()
        _say(f"replay: {error}")
        return ExitStatus.SHORT
    return int(status or ExitStatus.OK)


def make_app() -> App:
    """The application with its commands, none of them imported yet."""
    app = App(
        name="replay",
        help="Improves recorded parking paths of a truck with one trailer, read from MCAP logs, checks every result"
        " independently, and shows the comparison in a Rerun recording.",
        help_format="plaintext",  # markdown would cost another tenth of a second
        help_epilogue="Exit status: 0 all well; 1 a method or an audit failed; 2 wrong usage or unusable input;"
        " 3 part of the input was lost or some inputs could not be read; 130 interrupted.",
        version=_version,
        suppress_keyboard_interrupt=False,
    )
    for name, line in COMMANDS.items():
        app.command(f"replay.cli.{name}:{name}", name=name, help=line)
    app.command(
        "replay.cli.completion:install_completion",
        name="--install-completion",
        help="Install completion for the shell in use, or --shell bash, zsh or fish.",
    )
    return app


def _version() -> str:
    import importlib.metadata  # a fiftieth of a second

    return importlib.metadata.version("truck-trailer-replay")


def _missing(error: MissingArgumentError, command: Sequence[str]) -> str:
    """Message for a missing argument: what is expected, with an example."""
    if error.argument is None or not command:
        return str(error)
    name = error.argument.name
    if name.startswith("-"):
        return f"{name} expects a value"
    return f"expected {name}, as in `{example(' '.join(command))}`"


def _explain(message: str, command: Sequence[str]) -> None:
    """One line about arguments that cannot be used, and where the help is."""
    _say(f"replay: {' '.join(message.split())} (see `{to_paste(*command, '--help')}`)")


def _say(line: str) -> None:
    sys.stderr.write(line + "\n")
