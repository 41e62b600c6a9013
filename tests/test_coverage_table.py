"""Coverage by package: what counts, and which part is covered too little."""

import json
import pathlib
import subprocess
import sys

from tools.coverage_table import counts, table, too_little

FILES = {"pack/room/a.py": (90, 80, 10, 5), "pack/room/b.py": (10, 10, 0, 0), "pack/other/c.py": (20, 19, 4, 4)}
ROOT = pathlib.Path(__file__).resolve().parent.parent


def test_lines_and_branches_count_alike_and_packages_are_summed() -> None:
    lines = [line.split() for line in table(FILES).splitlines()]
    assert lines[1:] == [
        ["pack/other", "20", "4", "1", "95.8", "%"],
        ["pack/room", "100", "10", "15", "86.4", "%"],
        ["all", "120", "14", "16", "88.1", "%"],
    ]


def test_a_part_that_is_covered_too_little_or_has_moved_away_is_one_line() -> None:
    assert not too_little(FILES, {"room": (("pack/room/",), 86.0)})
    assert too_little(FILES, {"room": (("pack/room/",), 86.5)}) == ["room: 86.4 % covered, expected at least 86.5 %"]
    (line,) = too_little(FILES, {"room": (("pack/room/", "pack/gone.py"), 0.0)})
    assert line.startswith("room: nothing of pack/gone.py was measured")


def test_the_counts_are_those_that_coverage_measured(tmp_path: pathlib.Path) -> None:
    (tmp_path / "part.py").write_text("import sys\nif len(sys.argv) > 1:\n    print('more')\n")
    environment = {"PYTHONPATH": str(ROOT), "COVERAGE_FILE": str(tmp_path / "data")}
    for words in (["run", "--branch", "--include=part.py", "part.py"], ["json", "-o", "found.json"]):
        command = [sys.executable, "-m", "coverage", *words]
        subprocess.run(command, cwd=tmp_path, env=environment, check=True, capture_output=True)
    assert counts(json.loads((tmp_path / "found.json").read_text())) == {"part.py": (3, 2, 2, 1)}
