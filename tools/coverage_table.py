"""Coverage by package, from the data of a run of the tests; fails where a part that must be covered is not.

    python -m pytest -n 2 --cov && python tools/coverage_table.py

Lines and branches count alike. Exit status: 0 all well; 1 a part is covered less than it must be, or has no file.
"""

import argparse
import io
import json
import pathlib
import sys
import tempfile
from collections import defaultdict
from collections.abc import Mapping
from contextlib import redirect_stdout
from typing import Any, Final

from tools.script import run

LEAST: Final = {
    "reader": (("replay/logs/",), 90.0),
    "audit": (("optim/audit/",), 90.0),
    "results": (
        ("replay/run/results.py", "replay/run/stored.py", "replay/run/confirm.py", "replay/base/schemas/"),
        90.0,
    ),
}
"""Files or folders of each part that must be covered, and how much of it at least [%]."""

Counts = tuple[int, int, int, int]
"""Statements, those that ran, branches, those that were taken."""


def counts(report: Mapping[str, Any]) -> dict[str, Counts]:
    """Counts by file, of coverage's JSON report."""
    keys = ("num_statements", "covered_lines", "num_branches", "covered_branches")
    found = {name: entry["summary"] for name, entry in report["files"].items()}
    return {name: tuple(summary[key] for key in keys) for name, summary in found.items()}


def share(found: Counts) -> float:
    """Covered share of statements and branches together [%]."""
    statements, ran, branches, taken = found
    return 100.0 * (ran + taken) / (statements + branches) if statements + branches else 100.0


def table(files: Mapping[str, Counts]) -> str:
    """Counts and covered share of each package, and of all."""
    packages: dict[str, list[Counts]] = defaultdict(list)
    for name, found in files.items():
        packages[str(pathlib.PurePosixPath(name).parent)].append(found)
    rows = [(name, _sum(found)) for name, found in sorted(packages.items())] + [("all", _sum([*files.values()]))]
    lines = [f"{'package':28} {'lines':>7} {'branches':>8} {'missed':>7} {'covered':>8}"]
    for name, (statements, ran, branches, taken) in rows:
        missed = statements - ran + branches - taken
        percent = share((statements, ran, branches, taken))
        lines.append(f"{name:28} {statements:7} {branches:8} {missed:7} {percent:6.1f} %")
    return "\n".join(lines)


def too_little(files: Mapping[str, Counts], least: Mapping[str, tuple[tuple[str, ...], float]] = LEAST) -> list[str]:
    """One line for each part of `least` that is covered less than it must be, or of which a file is missing."""
    lines = []
    for part, (places, percent) in least.items():
        found = [number for name, number in files.items() if name.startswith(places)]
        absent = [place for place in places if not any(name.startswith(place) for name in files)]
        if absent:
            lines.append(f"{part}: nothing of {', '.join(absent)} was measured; adapt LEAST of this script")
        elif share(_sum(found)) < percent:
            lines.append(f"{part}: {share(_sum(found)):.1f} % covered, expected at least {percent:g} %")
    return lines


def _sum(found: list[Counts]) -> Counts:
    statements, ran, branches, taken = (sum(column) for column in zip(*found, strict=True))
    return statements, ran, branches, taken


def _report(data: pathlib.Path) -> Mapping[str, Any]:
    from coverage import Coverage  # only the environment of `make dev` holds it

    coverage = Coverage(data_file=str(data))
    coverage.load()
    with tempfile.TemporaryDirectory() as scratch, redirect_stdout(io.StringIO()):
        file = pathlib.Path(scratch) / "coverage.json"
        coverage.json_report(outfile=str(file))
        return json.loads(file.read_text())


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("data", type=pathlib.Path, nargs="?", default=pathlib.Path(".coverage"), metavar="DATA")
    files = counts(_report(parser.parse_args().data))
    print(table(files))
    for line in (missing := too_little(files)):
        print(line, file=sys.stderr)
    return 1 if missing else 0


if __name__ == "__main__":
    run(main)
