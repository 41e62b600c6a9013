"""Completion in real shells: keys typed into a terminal, and what the shell makes of them."""

import os
import pathlib
import pty
import select
import shutil
import subprocess
import time

import pytest

import replay.cli
from optim.methods import METHODS
from tools.processes import REPLAY

SHELLS = [
    pytest.param(name, marks=pytest.mark.skipif(shutil.which(name) is None, reason=f"{name} is not installed"))
    for name in ("bash", "zsh")
]
END = "<end of the line>"


@pytest.fixture(scope="module")
def home(tmp_path_factory) -> pathlib.Path:
    """A home with completion installed for both shells, as the command itself installs it."""
    home = tmp_path_factory.mktemp("home")
    environment = {**os.environ, "HOME": str(home)}
    for shell in ("bash", "zsh"):
        done = subprocess.run(
            [*REPLAY, "--install-completion", "--shell", shell],
            env={name: value for name, value in environment.items() if not name.startswith("ZSH")},
            capture_output=True,
            text=True,
            timeout=60,
        )
        assert done.returncode == 0, done.stderr
    with (home / ".zshrc").open("a") as file:
        file.write("autoload -Uz compinit && compinit -u -D\n")
    (home / "logs").mkdir()
    (home / "logs" / "first log.mcap").touch()
    return home


class Terminal:
    """A shell at a terminal."""

    def __init__(self, shell: str, home: pathlib.Path) -> None:
        arguments = {"bash": ["bash", "--noprofile", "--rcfile", str(home / ".bashrc"), "-i"], "zsh": ["zsh", "-i"]}
        environment = {"HOME": str(home), "ZDOTDIR": str(home), "PATH": os.environ["PATH"], "TERM": "dumb"}
        self._mine, its = pty.openpty()
        self._process = subprocess.Popen(
            arguments[shell], stdin=its, stdout=its, stderr=its, env=environment, cwd=home, start_new_session=True
        )
        os.close(its)
        self.type(
            "PS1='' PROMPT='' RPROMPT=''; bind 'set bell-style none' 2>/dev/null; echo re''ady\n", until="ready\r"
        )

    def type(self, keys: str, until: str) -> str:
        """Type, and read until some text is there."""
        os.write(self._mine, keys.encode())
        said, deadline = "", time.monotonic() + 30.0
        while until not in said:
            assert time.monotonic() < deadline, f"{until!r} did not come; there is {said[-2000:]!r}"
            if select.select([self._mine], [], [], 0.2)[0]:
                said += os.read(self._mine, 65536).decode(errors="replace")
        return said

    def completed(self, words: str) -> str:
        """The line that a tabulator at its end makes of some words: as arguments, one to a line."""
        name = f"echo_{time.monotonic_ns()}"
        said = self.type(
            f"replay() {{ printf '%s\\n' \"$@\"; echo '<end of the'' line>' {name}; }}\n{words}\t\n", name + "\r"
        )
        lines = said.replace("\r", "").split("\n")
        return "\n".join(lines[: lines.index(f"{END} {name}")])

    def close(self) -> None:
        self._process.kill()
        self._process.wait(10)
        os.close(self._mine)


@pytest.fixture(params=SHELLS)
def terminal(request, home):
    terminal = Terminal(request.param, home)
    yield terminal
    terminal.close()


def test_commands_options_methods_choices_and_files_are_completed(terminal):
    assert terminal.completed("replay opt").splitlines()[-1] == "optimize"
    assert terminal.completed("replay optimize --weights.len").splitlines()[-1] == "--weights.length"
    assert terminal.completed("replay optimize --method shortc").splitlines()[-1] == "shortcut"
    assert terminal.completed("replay optimize --unknown ob").splitlines()[-1] == "obstacle"
    assert terminal.completed("replay optimize logs/fir").splitlines()[-1] == "logs/first log.mcap"
    assert terminal.completed("replay compare logs/fi").splitlines()[-1] == "logs/first log.mcap"


@pytest.mark.skipif(shutil.which("bash") is None, reason="bash is not installed")
@pytest.mark.parametrize(
    ("words", "expected"),
    [
        (["replay", ""], set(replay.cli.COMMANDS)),
        (["replay", "optimize", "--method", ""], set(METHODS)),
        (["replay", "optimize", "--shortcut.t"], {"--shortcut.tries"}),
        (["replay", "optimize", "--shortcut.variant", ""], {"random", "deterministic"}),
    ],
)
def test_bash_offers_every_choice(home, words, expected):
    program = f"""
        . "{home}/.local/share/bash-completion/completions/replay"
        COMP_WORDS=({" ".join(repr(word) for word in words)}); COMP_CWORD={len(words) - 1}; _replay
        printf '%s\\n' "${{COMPREPLY[@]}}"
    """
    done = subprocess.run(["bash", "--norc", "-c", program], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert set(done.stdout.split()) == expected
