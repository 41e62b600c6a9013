"""`replay --install-completion`: the command that cyclopts makes for it, loaded only when it is called."""

from cyclopts.completion.install import create_install_completion_command

from replay.cli import make_app

install_completion = create_install_completion_command(make_app().install_completion, add_to_startup=True)
