"""Run a corpus here and on a cluster, with one process and with two, in several orders: results must be the same.

Usage: python -m tools.attacks same-results [--count N] [--corpus FOLDER] [--method NAME]...

By default on small logs; times alone may differ. The exit status is 1 if anything else does.
"""

import argparse
import pathlib
import signal
import subprocess
import sys
import tempfile
import time
from typing import Any

from replay.base.documents import plain
from replay.regress.folder import RunFolder
from tools.attacks.local_cluster import LocalCluster
from tools.attacks.small_logs import write_corpus
from tools.processes import REPLAY
from tools.script import existing, from_one, method_name

TIMES = ("wall_s", "reason", "path")
"""Fields that may differ: times, sentences that contain times, and the place of the log."""


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--count", type=from_one, default=300, help="small logs (default: %(default)s)")
    parser.add_argument("--corpus", type=existing, metavar="FOLDER", help="take the logs of this folder")
    parser.add_argument("--method", action="append", type=method_name, help="may be repeated (default: ddp, cpo)")


def main(arguments: argparse.Namespace) -> int:
    """Exit status: 0 where all is as it should be, else 1."""
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # what was started is ended then, too
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        corpus = arguments.corpus or folder / "corpus"
        if arguments.corpus is None:
            write_corpus(corpus, arguments.count)
        common = [str(corpus), "--recordings", "none"]
        common += [word for method in arguments.method or ["ddp", "cpo"] for word in ("--method", method)]
        found = {"here, 1 process": _results(folder / "1", [*common, "--jobs", "1"])}
        found["here, 2 processes, shuffled"] = _results(folder / "2", [*common, "--jobs", "2", "--shuffle", "1"])
        for workers, order in ((1, []), (2, ["--shuffle", "2"])):
            with LocalCluster(folder / f"cluster{workers}", workers) as cluster:
                words = [*common, "--scheduler", cluster.address, *order]
                found[f"Dask, {workers} workers{', shuffled' if order else ''}"] = _results(
                    folder / f"d{workers}", words
                )
    first = next(iter(found.values()))
    for way, documents in found.items():
        differing = sorted(name for name in first | documents if first.get(name) != documents.get(name))
        said = "the same" if not differing else f"{len(differing)} differ: {', '.join(differing[:5])}"
        print(f"{way}: {len(documents)} logs, {said}")
    return int(any(documents != first for documents in found.values()))


def _results(runs: pathlib.Path, words: list[str]) -> dict[str, Any]:
    """The documents of a run, by log, without times."""
    begun = time.monotonic()
    subprocess.run([*REPLAY, "regress", *words, "--out", str(runs), "--quiet"], check=True)
    print(f"{time.monotonic() - begun:.0f} s", file=sys.stderr, flush=True)
    return {log.log: timeless(plain(log)) for log in RunFolder(next(runs.iterdir())).documents()}


def timeless(document: Any) -> Any:
    """A log's document without what may differ between runs."""
    if isinstance(document, dict):
        return {key: timeless(value) for key, value in document.items() if key not in TIMES}
    return [timeless(entry) for entry in document] if isinstance(document, list) else document
