"""Kill `replay optimize` at random times and look at what it leaves: nothing, or whole files.

Usage: python tools/kill_storm.py LOG [--kills N] [--seed N]

Each run writes into the same folder and is killed (SIGKILL) after a random part of the time that a whole run takes.
After each, every file with a final name is read back: results as `replay audit` reads them, recordings chunk by chunk.
At the end one run is left alone: it must end well and leave no temporary file behind.
"""

import argparse
import pathlib
import random
import subprocess
import sys
import tempfile
import time

from replay.errors import ReplayError
from replay.recording.writing import Unwritable, verify
from replay.results import read_results

PASSING = (".tmp", ".run")
"""Ends of the names of files that only last as long as a run."""
_START = "import sys; from replay.cli import main; sys.exit(main(sys.argv[1:]))"


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("log", type=pathlib.Path)
    parser.add_argument("--kills", type=int, default=200)
    parser.add_argument("--seed", type=int, default=0)
    arguments = parser.parse_args()
    rng = random.Random(arguments.seed)
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        run(arguments.log, folder)  # compiles, if need be
        whole = min(run(arguments.log, folder) for _ in range(2))
        torn, unfinished = [], 0
        for number in range(arguments.kills):
            for file in folder.iterdir():
                if file.suffix not in PASSING:
                    file.unlink()
            run(arguments.log, folder, kill_after=rng.uniform(0.1, 1.1) * whole)
            torn += [f"kill {number}: {words}" for words in torn_files(folder)]
            unfinished += any(file.suffix in PASSING for file in folder.iterdir())
        run(arguments.log, folder)
        left = sorted(file.name for file in folder.iterdir())
    print("\n".join(torn) or "no torn file")
    print(f"{arguments.kills} kills within {1.1 * whole:.1f} s; after {unfinished} of them a temporary file was left")
    print("after a last run, undisturbed:", ", ".join(left))
    return int(bool(torn) or any(name.endswith(PASSING) for name in left))


def run(log: pathlib.Path, folder: pathlib.Path, kill_after: float | None = None) -> float:
    """One run with the quickest method, its seconds; killed after some, if given."""
    arguments = ["optimize", str(log), "--method", "ddp", "--out", str(folder), "--quiet"]
    started = time.monotonic()
    process = subprocess.Popen([sys.executable, "-c", _START, *arguments], stdout=subprocess.DEVNULL)
    try:
        status = process.wait(kill_after)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
    else:
        if status != 0:
            raise SystemExit(f"a run that was not killed ended with exit status {status}")
    return time.monotonic() - started


def torn_files(folder: pathlib.Path) -> list[str]:
    """What is wrong with the files that have final names."""
    wrong = []
    for file in folder.iterdir():
        try:
            if file.suffix == ".json":
                read_results(file)
            elif file.suffix == ".rrd":
                verify(file, [])
        except (ReplayError, Unwritable) as error:
            wrong.append(str(error))
    return wrong


if __name__ == "__main__":
    sys.exit(main())
