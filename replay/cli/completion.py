"""`replay --install-completion`: the command that cyclopts makes for it, loaded only when it is called."""

import pathlib
from typing import Any

from cyclopts.completion.install import create_install_completion_command

from replay.cli import make_app

_MENDED = {
    'COMPREPLY=( $(compgen -f -- "${cur}") )': "local IFS=$'\\n'; COMPREPLY=( $(compgen -f -- \"${cur}\") )",
    "complete -F _replay replay": "complete -o filenames -F _replay replay",
}
"""Corrections of the script for bash, which splits file names at spaces and does not complete into folders."""


def _install(**options: Any) -> pathlib.Path:
    """Write the script for a shell, mended; where it is."""
    path = make_app().install_completion(**options)
    script = path.read_text(encoding="utf-8")
    if "complete -F _replay replay" in script:
        for made, mended in _MENDED.items():
            script = script.replace(made, mended)
        path.write_text(script, encoding="utf-8")
    return path


install_completion = create_install_completion_command(_install, add_to_startup=True)
