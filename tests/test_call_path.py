"""The count of files, functions and moves between files on the way of one log."""

import importlib.util
import os
import pathlib
import re
import subprocess
import sys
import types

import pytest

from tools.call_path import Counter

ROOT = pathlib.Path(__file__).resolve().parent.parent
LOWER = """
def square(x):
    return x * x

def twice(f, x):
    return f(f(x))
"""
UPPER = """
def total(lower, xs):
    return sum([lower.square(x) for x in xs])      # a move for each x, back in between

def by_way_of_a_library(lower, xs):
    return sorted(xs, key=lower.square)             # a move for each x: control is in the library's caller between

def handed_down(lower):
    return lower.twice(lambda x: x + 1, 1)          # down, and up again twice
"""


@pytest.fixture
def made(tmp_path: pathlib.Path) -> dict[str, types.ModuleType]:
    modules = {}
    for name, text in {"upper": UPPER, "lower": LOWER}.items():
        (tmp_path / f"{name}.py").write_text(text)
        spec = importlib.util.spec_from_file_location(name, tmp_path / f"{name}.py")
        assert spec is not None
        assert spec.loader is not None
        modules[name] = importlib.util.module_from_spec(spec)
        spec.loader.exec_module(modules[name])
    return modules


def counted(made: dict[str, types.ModuleType], tmp_path: pathlib.Path, name: str, *arguments: object) -> Counter:
    counter = Counter([os.path.join(tmp_path, "")])  # noqa: PTH118
    with counter.counting():
        getattr(made["upper"], name)(made["lower"], *arguments)
    return counter


def test_functions_files_and_moves_are_counted(made, tmp_path):
    counter = counted(made, tmp_path, "total", [1, 2, 3])
    assert {pathlib.Path(file).stem for file in counter.files} == {"upper", "lower"}
    assert len(counter.functions) == 2, "a comprehension is part of its function"
    assert counter.functions.total() == 4
    assert counter.moves == 3


def test_moves_through_a_library_count_as_well(made, tmp_path):
    assert counted(made, tmp_path, "by_way_of_a_library", [1, 2]).moves == 2
    counter = counted(made, tmp_path, "handed_down")
    assert len(counter.functions) == 3, "a lambda is a function"
    assert counter.moves == 3


def test_other_code_and_what_comes_afterwards_do_not_count(made, tmp_path):
    counter = counted(made, tmp_path, "total", [])
    before = counter.functions.total()
    made["upper"].total(made["lower"], [1, 2])
    assert counter.functions.total() == before == 1
    assert counter.moves == 0


def test_the_way_of_a_log_is_counted_in_one_process():
    words = [sys.executable, "tools/call_path.py", "recordings/lot_01.mcap", "--method", "shortcut", "--list"]
    found = subprocess.run(words, cwd=ROOT, capture_output=True, text=True, check=True)
    files, pairs, last = (part.splitlines() for part in found.stdout.split("\n\n"))
    counts = re.fullmatch(r"(\d+) files, (\d+) functions, (\d+) moves between files", last[-1])
    assert counts is not None
    assert int(counts[1]) == len(files)
    assert int(counts[2]) == sum(int(line.split()[0]) for line in files)
    assert int(counts[3]) >= sum(int(line.split()[0]) for line in pairs) > 0
    assert any(line.endswith(" optim/methods/shortcut.py") for line in files), "the method ran in this process"
