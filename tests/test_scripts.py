"""How the scripts of tools/ take arguments and end: what a user can mend is one line."""

import argparse

import pytest

from replay.base.errors import LogError
from tools.script import existing, from_one, method_name, run


def parser() -> argparse.ArgumentParser:
    made = argparse.ArgumentParser(prog="script.py")
    made.add_argument("log", type=existing)
    made.add_argument("--jobs", type=from_one, default=1)
    made.add_argument("--method", type=method_name)
    return made


def test_a_file_that_is_there_a_count_and_a_method_are_taken(tmp_path):
    options = parser().parse_args([str(tmp_path), "--jobs", "12", "--method", "shortcut+scp"])
    assert (options.log, options.jobs, options.method) == (tmp_path, 12, "shortcut+scp")


@pytest.mark.parametrize("count", ["0", "-3", "1.5", "two", "", "²"])
def test_what_is_no_count_is_an_error_of_usage(tmp_path, capsys, count):
    with pytest.raises(SystemExit) as ended:
        parser().parse_args([str(tmp_path), f"--jobs={count}"])
    assert ended.value.code == 2
    assert f"error: argument --jobs: {count!r} is not a whole number from 1 on" in capsys.readouterr().err


def test_a_file_that_is_not_there_is_an_error_of_usage(tmp_path, capsys):
    with pytest.raises(SystemExit) as ended:
        parser().parse_args([str(tmp_path / "absent.mcap")])
    assert ended.value.code == 2
    assert "absent.mcap' does not exist" in capsys.readouterr().err


@pytest.mark.parametrize("name", ["best", "shortcut+best", ""])
def test_a_method_that_is_unknown_is_an_error_of_usage_that_names_the_others(tmp_path, capsys, name):
    with pytest.raises(SystemExit) as ended:
        parser().parse_args([str(tmp_path), f"--method={name}"])
    assert ended.value.code == 2
    assert f"no method {name.rpartition('+')[2]!r}; there are shortcut, " in capsys.readouterr().err


def test_a_known_error_ends_a_script_with_one_line_and_its_status(monkeypatch, capsys):
    def main() -> int:
        raise LogError("E_NO_MAP", "yard.mcap", "holds no map")

    monkeypatch.setattr("sys.argv", ["tools/script.py"])
    with pytest.raises(SystemExit) as ended:
        run(main)
    assert ended.value.code == 2
    assert capsys.readouterr().err == "script.py: error: yard.mcap: holds no map [E_NO_MAP]\n"


def test_an_unknown_error_is_shown_whole():
    def main() -> int:
        raise ZeroDivisionError

    with pytest.raises(ZeroDivisionError):
        run(main)


@pytest.mark.parametrize(("given", "status"), [(1, 1), (0, 0), (None, None)])
def test_a_script_ends_with_the_status_that_it_gives(given, status):
    with pytest.raises(SystemExit) as ended:
        run(lambda: given)
    assert ended.value.code == status
