"""The whole comparison with other software in one go; writes tools/bench/RESULTS.md.

Usage: python tools/bench/run_all.py [--only SECTION] [--logs NAME ...] [--rows FOLDER] [--report]

Measured rows are kept in the folder (default out/bench), each in a file of its own: a run that was interrupted goes
on where it stopped, and what is to be measured anew is deleted there. `--report` only writes the report from them.
Peers come with `pip install -e '.[bench]'`; those that are not installed are left out, and the report says so.
"""

import argparse
import pathlib
import sys

from replay.cli import use_one_thread

use_one_thread()

from replay.kernels import drop_stale  # noqa: E402 - after the threads have been settled
from tools.bench.peers import floors, inner, machine, pairs, paths, paths_report, scaling, start  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
RESULTS = pathlib.Path(__file__).resolve().parent / "RESULTS.md"
SECTIONS = {
    "paths": (paths.run, paths_report.report),
    "inner": (inner.run, inner.report),
    "pairs": (pairs.run, pairs.report),
    "scaling": (scaling.run, scaling.report),
    "floors": (floors.run, floors.report),
    "start": (start.run, start.report),
}


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=SECTIONS, help="measure this section alone")
    parser.add_argument("--logs", nargs="*", help="names of logs in recordings/ (default: all)")
    parser.add_argument("--rows", type=pathlib.Path, default=ROOT / "out" / "bench", help="folder of measured rows")
    parser.add_argument("--report", action="store_true", help="write the report without measuring")
    options = parser.parse_args()
    drop_stale()
    logs = sorted((ROOT / "recordings").glob("*.mcap"))
    logs = [log for log in logs if options.logs is None or log.stem in options.logs]
    if not options.report:
        for name, (run, _) in SECTIONS.items():
            if options.only in (None, name):
                run(logs, options.rows / name)
    parts = [machine.head(options.rows)]
    parts += [
        report(options.rows / name)
        for name, (_, report) in SECTIONS.items()
        if any((options.rows / name).glob("*.json"))
    ]
    RESULTS.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    sys.exit(main())
