"""End `replay optimize` at random times and look at what it leaves: nothing, or whole files.

Usage: python -m tools.attacks kill-storm LOG [--kills N] [--signal KILL|TERM|INT|HUP] [--seed N]

Each run writes into the same folder and gets the signal after a random part of the time that a whole run takes.
After each, every file with a final name is read back: results as `replay audit` reads them, recordings chunk by chunk.
No process of the run may be left. A run that was told to end (not killed) must say so by its exit status, without a
traceback, and leave no temporary file. At the end one run is left alone: it must end well, and sweep what is left.
"""

import argparse
import collections
import dataclasses
import pathlib
import random
import signal
import subprocess
import tempfile
import time

from replay.base.errors import ReplayError
from replay.recording.writing import Unwritable, verify
from replay.run.results import read_results
from tools.processes import REPLAY, is_running
from tools.script import existing, from_one

PASSING = (".tmp", ".run")
"""Ends of the names of files that only last as long as a run."""
STARTING_S = 0.5
"""Before it has started, Python itself answers a signal, with another status and perhaps a traceback [s]."""
WAIT_S = 10.0
"""Time that a run has to end in after it was told to [s]."""
NEVER = -1000
"""In the place of the exit status of a run that did not end in that time."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Ended:
    """How one run ended."""

    seconds: float
    """From its start, or from the signal if there was one."""
    status: int
    """Its exit status; -N if signal N ended it, `NEVER` if nothing did."""
    said: str
    """On standard error."""
    left: tuple[int, ...] = ()
    """Processes of the run that go on."""


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("log", type=existing, metavar="LOG")
    parser.add_argument("--kills", type=from_one, default=200, help="default: %(default)s")
    parser.add_argument("--signal", default="KILL", choices=["KILL", "TERM", "INT", "HUP"], help="default: %(default)s")
    parser.add_argument("--seed", type=int, default=0, help="of the random times (default: %(default)s)")


def main(arguments: argparse.Namespace) -> int:
    """Exit status: 0 where all is as it should be, else 1."""
    rng, number = random.Random(arguments.seed), getattr(signal, f"SIG{arguments.signal}")
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        optimise(arguments.log, folder)  # compiles, if need be
        whole = min(optimise(arguments.log, folder).seconds for _ in range(2))
        wrong, unfinished, statuses, slowest = [], 0, collections.Counter[int](), 0.0
        for count in range(arguments.kills):
            for file in folder.iterdir():
                if file.suffix not in PASSING:
                    file.unlink()
            after = rng.uniform(0.1, 1.1) * whole
            ended = optimise(arguments.log, folder, number, after)
            left = [file.name for file in folder.iterdir() if file.suffix in PASSING]
            unfinished += bool(left)
            statuses[ended.status] += 1
            slowest = max(slowest, ended.seconds)
            words = [*torn_files(folder), *misbehaviour(ended, number, after, left, folder)]
            wrong += [f"{arguments.signal} {count} after {after:.2f} s: {each}" for each in words]
        optimise(arguments.log, folder)
        remaining = sorted(file.name for file in folder.iterdir())
    print("\n".join(wrong) or "nothing torn, nothing wrong")
    print(f"{arguments.kills} times SIG{arguments.signal} within {1.1 * whole:.1f} s; ended within {slowest:.2f} s")
    print("exit statuses:", ", ".join(f"{status} {times} times" for status, times in sorted(statuses.items())))
    print(f"after {unfinished} of them a temporary file was left")
    print("after a last run, undisturbed:", ", ".join(remaining))
    return int(bool(wrong) or any(name.endswith(PASSING) for name in remaining))


def optimise(log: pathlib.Path, folder: pathlib.Path, number: int = 0, after: float | None = None) -> Ended:
    """One run with the quickest method; it gets signal `number` after some seconds, if given."""
    arguments = ["optimize", str(log), "--method", "ddp", "--out", str(folder), "--quiet"]
    started = time.monotonic()
    with tempfile.TemporaryFile() as said:
        process = subprocess.Popen([*REPLAY, *arguments], stdout=subprocess.DEVNULL, stderr=said)
        try:
            status = process.wait(after)
        except subprocess.TimeoutExpired:
            children, started = children_of(process.pid), time.monotonic()
            process.send_signal(number)
            status = _ended(process)
        else:
            children = []
            if status != 0:
                raise SystemExit(f"a run that was not disturbed ended with exit status {status}") from None
        seconds = time.monotonic() - started
        said.seek(0)
        words = said.read().decode(errors="replace")
    return Ended(seconds=seconds, status=status, said=words, left=still_running(children))


def _ended(process: subprocess.Popen[bytes]) -> int:
    try:
        return process.wait(WAIT_S)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait()
        return NEVER


def children_of(pid: int) -> list[int]:
    """The processes that a process has started and that are still there; none where it is gone itself."""
    try:
        return [int(word) for word in pathlib.Path(f"/proc/{pid}/task/{pid}/children").read_text().split()]
    except OSError:
        return []


def still_running(pids: list[int]) -> tuple[int, ...]:
    """Those that run on for more than a second; a zombie does not."""
    deadline = time.monotonic() + 1.0
    while found := tuple(pid for pid in pids if is_running(pid)):
        if time.monotonic() > deadline:
            return found
        time.sleep(0.01)
    return ()


def misbehaviour(ended: Ended, number: int, after: float, left: list[str], folder: pathlib.Path) -> list[str]:
    """What is wrong with how a run ended that got a signal after so many seconds, and left these temporary files."""
    wrong = [f"process {pid} goes on" for pid in ended.left]
    if ended.status == NEVER:
        wrong.append(f"goes on {WAIT_S:g} s after it was told to end")
    if ended.status == 0 and len([file for file in folder.iterdir() if file.suffix not in PASSING]) < 2:
        wrong.append("exit status 0 without both files")
    if number == signal.SIGKILL or after < STARTING_S:
        return wrong
    if ended.status not in (0, 128 + number, -number):
        wrong.append(f"exit status {ended.status}")
    if "Traceback" in ended.said:
        wrong.append(f"a traceback: {ended.said[-300:]!r}")
    return wrong + [f"left {name}" for name in left]


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
