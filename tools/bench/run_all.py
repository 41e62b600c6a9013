"""The whole comparison with other software in one go; writes tools/bench/RESULTS.md.

Usage: python tools/bench/run_all.py [--only SECTION] [--logs NAME ...] [--rows FOLDER] [--report]

Measured rows are kept in the folder (default out/bench), each in a file of its own: a run that was interrupted goes
on where it stopped, and what is to be measured anew is deleted there. `--report` only writes the report from them.
Peers come with `pip install -e '.[bench]'`; those that are not installed are left out, and the report says so.
"""

import argparse
import pathlib

from replay.base.threads import use_one_thread

use_one_thread()

from replay.base.kernels import drop_stale  # noqa: E402 - after the threads have been settled
from tools.script import run  # noqa: E402

ROOT = pathlib.Path(__file__).resolve().parents[2]
RESULTS = pathlib.Path(__file__).resolve().parent / "RESULTS.md"
RECORDINGS = ROOT / "recordings"
SECTIONS = ("paths", "inner", "pairs", "scaling", "floors", "start")


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--only", choices=SECTIONS, help="measure this section alone")
    names = sorted(log.stem for log in RECORDINGS.glob("*.mcap"))
    parser.add_argument(
        "--logs", nargs="+", choices=names, default=names, metavar="NAME", help="of logs in recordings/ (default: all)"
    )
    parser.add_argument("--rows", type=pathlib.Path, default=ROOT / "out" / "bench", help="folder of measured rows")
    parser.add_argument("--report", action="store_true", help="write the report without measuring")
    options = parser.parse_args()
    drop_stale()
    # not before the arguments are known: what crocoddyl is given is compiled by the import
    from tools.bench.peers import floors, inner, machine, pairs, paths, paths_report, scaling, start

    runs = (paths.run, inner.run, pairs.run, scaling.run, floors.run, start.run)
    reports = (paths_report.report, inner.report, pairs.report, scaling.report, floors.report, start.report)
    if not options.report:
        for name, measure in zip(SECTIONS, runs, strict=True):
            if options.only in (None, name):
                measure([RECORDINGS / f"{log}.mcap" for log in sorted(options.logs)], options.rows / name)
    parts = [machine.head(options.rows)]
    for name, report in zip(SECTIONS, reports, strict=True):
        if any((options.rows / name).glob("*.json")):
            parts.append(report(options.rows / name))
    RESULTS.write_text("\n\n".join(parts) + "\n", encoding="utf-8")
    return 0


if __name__ == "__main__":
    run(main)
