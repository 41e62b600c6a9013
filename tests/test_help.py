"""What the command says and does before it works: its help, its version, its threads."""

import os
import pathlib
import subprocess
import sys
from typing import Any

import pytest

import replay.cli


def in_a_process(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=120, **options)


def test_help_loads_nothing_heavy():
    program = (
        "import sys; from replay.cli import main; status = main(['--help'])\n"
        "heavy = {'numpy', 'numba', 'scipy', 'rerun', 'shapely', 'pyarrow', 'optim'} & set(sys.modules)\n"
        "assert not heavy and status == 0, heavy"
    )
    done = in_a_process("-c", program)
    assert done.returncode == 0, done.stderr
    for command in replay.cli.COMMANDS:
        assert command in done.stdout


@pytest.mark.parametrize("command", [*([name] for name in replay.cli.COMMANDS), ["regress", "accept"]], ids=" ".join)
def test_every_option_has_a_line_of_help_that_only_the_terminal_breaks(
    command: list[str], monkeypatch: pytest.MonkeyPatch, capsys: pytest.CaptureFixture[str]
) -> None:
    for columns in ("80", "2000"):  # a width that was met before must not stay
        monkeypatch.setenv("COLUMNS", columns)
        capsys.readouterr()
        assert replay.cli.main([*command, "--help"]) == 0
    lines = [line.strip("│ ") for line in capsys.readouterr().out.splitlines() if line.startswith("│")]
    assert "--json" in [line.split()[0] for line in lines]
    for line in lines:
        name, _, text = line.removeprefix("*").strip().partition("  ")
        assert name.startswith("-") or name.isupper() or name == "accept", "a line that is broken, or no help"
        assert len(text.split()) > 2, name


def test_the_installed_command_says_its_version():
    script = pathlib.Path(sys.executable).with_name("replay")
    done = subprocess.run([script, "--version"], capture_output=True, text=True, timeout=60)
    assert (done.returncode, done.stderr) == (0, "")
    assert done.stdout.strip() == "0.1.0"


def test_numerical_libraries_are_told_to_use_one_thread():
    program = (
        "import os; from replay.cli import main; main(['--version'])\n"
        "assert os.environ['OMP_NUM_THREADS'] == '1' and os.environ['OPENBLAS_NUM_THREADS'] == '1'"
    )
    environment = {key: value for key, value in os.environ.items() if not key.endswith("_NUM_THREADS")}
    done = in_a_process("-c", program, env=environment | {"OMP_NUM_THREADS": "3"})
    assert done.returncode == 0, done.stderr
