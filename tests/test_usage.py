"""Messages about wrong usage: what is expected, with an example."""

import shlex
import subprocess

import pytest

import replay.cli
from optim.methods import METHODS
from replay.cli.settings import READ, RUN, settled
from replay.cli.usage import example
from tools.processes import REPLAY

REGRESS_COUNTS = ("jobs", "seed", "memory-limit", "shuffle")


@pytest.mark.parametrize(
    "command", [name for name in replay.cli.COMMANDS if name not in ("methods", "optimize", "vehicle")]
)
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


@pytest.mark.parametrize(
    ("arguments", "said"),
    [
        (["optimize", "--occupied-from", "0.65"], "--occupied-from is 0.65, expected a whole number [%]"),
        (["info", "--case", "0.5"], "--case is 0.5, expected a whole number"),
        (["optimize", "--jobs", "1.6"], "--jobs is 1.6, expected a whole number"),
        (["optimize", "--seed=1.7"], "--seed is 1.7, expected a whole number"),
        (["optimize", "--shortcut.tries", "many"], "--shortcut.tries is many, expected a whole number"),
        (
            ["optimize", "--shortcut.tries", "1" + "0" * 400],
            f"--shortcut.tries is 1{'0' * 38}…, expected a whole number",
        ),
        (["optimize", "--shortcut.tries", "nan"], "--shortcut.tries is nan, expected a whole number"),
        *((["regress", f"--{name}", "1.5"], f"--{name} is 1.5, expected a whole number") for name in REGRESS_COUNTS),
    ],
)
def test_a_fraction_is_refused_where_a_whole_number_is_expected(arguments, said, capsys):
    command, *flags = arguments
    assert replay.cli.main([command, "x.mcap", *flags]) == 2
    assert capsys.readouterr().err == f"replay: {said} (see `replay {command} --help`)\n"


def test_whole_numbers_may_be_written_with_a_point_or_in_another_base(capsys):
    assert replay.cli.main(["info", "x.mcap", "--case", "2.0", "--occupied-from", "0x20"]) == 2
    assert "x.mcap" in capsys.readouterr().err


@pytest.mark.parametrize("command", ["audit", "compare"])
@pytest.mark.parametrize(("content", "kind"), [(b"\x89MCAP0\r\n", "an MCAP log"), (b"RRF2\xff", "a Rerun recording")])
def test_a_file_of_another_kind_is_named_where_results_are_expected(command, content, kind, tmp_path, capsys):
    (tmp_path / "a.rrd").write_bytes(content)
    assert replay.cli.main([command, *[str(tmp_path / "a.rrd")] * 2]) == 2
    assert f"a.rrd: not JSON: it is {kind}; expected a results file, STEM.results.json" in capsys.readouterr().err


def test_methods_that_are_named_are_listed_alone(capsys):
    assert replay.cli.main(["methods", "DDP"]) == 0
    said = capsys.readouterr().out
    assert said.startswith("ddp: ")
    assert "--scp." not in said
    assert replay.cli.main(["methods", "dpp"]) == 2
    assert "Did you mean 'ddp'?" in capsys.readouterr().err


def test_a_file_in_the_place_of_the_folder_is_called_one(tmp_path, capsys):
    (tmp_path / "out").write_text("")
    assert replay.cli.main(["optimize", "x.mcap", "--out", str(tmp_path / "out")]) == 2
    assert "out: it is a file, expected a folder" in capsys.readouterr().err


def test_names_of_methods_may_be_in_capitals_and_all_stands_for_all():
    def chosen(names):
        return list(settled([{RUN: {"method": (names,)}}]).methods)

    assert chosen("DDP, Shortcut+SCP") == ["ddp", "shortcut+scp"]
    assert chosen("all") == list(METHODS)
    assert chosen("scp+ddp,all") == ["scp+ddp", *METHODS]


@pytest.mark.parametrize(("word", "gear"), [("reverse", -1), ("forward", 1), (-1, -1), (1, 1)])
def test_a_gear_may_be_a_word(word, gear):
    assert settled([{READ: {"start_direction": word}}]).read.start_direction == gear
