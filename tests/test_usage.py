"""What a user is told who calls a command wrongly: what is expected, with an example."""

import shlex
import subprocess

import pytest

import replay.cli
from replay.cli.usage import example
from tools.processes import REPLAY


@pytest.mark.parametrize("command", [name for name in replay.cli.COMMANDS if name not in ("methods", "optimize")])
def test_a_missing_argument_is_asked_for_with_an_example(command, capsys):
    assert replay.cli.main([command]) == 2
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert said.startswith("replay: expected ")
    assert f"as in `{example(command)}`" in said
    assert shlex.split(example(command))[:2] == ["replay", command]


@pytest.mark.parametrize("flag", ["--method", "--out", "--shortcut.tries"])
def test_a_missing_value_is_asked_for_by_its_flag(flag, capsys):
    assert replay.cli.main(["optimize", "x.mcap", flag]) == 2
    assert capsys.readouterr().err.startswith(f"replay: {flag} expects a value")


@pytest.mark.parametrize("folder", ["/proc/x", "/dev/null/x"])
def test_a_folder_that_cannot_be_made_is_told_with_a_way_out(folder, capsys):
    assert replay.cli.main(["optimize", "x.mcap", "--out", folder]) == 2
    said = capsys.readouterr().err
    assert said.startswith(f"replay: --out {folder}: the folder cannot be made: ")
    assert "choose one that you may write to, as in --out out" in said


def test_a_reader_that_goes_after_the_first_line_is_no_failure():
    command = [*REPLAY, "methods"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True)
    assert process.stdout is not None
    process.stdout.close()
    _, error = process.communicate(timeout=60)
    assert (process.returncode, error) == (0, "")
