"""Run thousands of small logs on a Dask cluster of this machine while workers, or the coordinator, are killed.

Usage: python -m tools.attacks worker-storm [--count N] [--workers N] [--worker-kills N] [--coordinator-kills N]
                                     [--method NAME] [--refused] [--seed N]

At the end there must be exactly one valid result for each log. Says how often work on a log began, how much the
coordinator's memory grew between a tenth of the logs and all, and whether any process was left.
"""

import argparse
import os
import pathlib
import random
import signal
import subprocess
import sys
import tempfile
import time
from collections import Counter
from dataclasses import dataclass, field

from replay.base.errors import UsageError
from replay.regress.folder import RunFolder
from tools.attacks.local_cluster import LocalCluster
from tools.attacks.small_logs import write_corpus
from tools.processes import REPLAY, is_running
from tools.script import from_one, method_name

MOST_EXECUTIONS = 1.2
"""Times each log may be worked on, on average."""
MOST_GROWTH = 10.0
"""Memory growth allowed for the coordinator [MiB]."""


@dataclass(kw_only=True)
class Seen:
    """Observations during a run."""

    killed: list[int] = field(default_factory=list)
    coordinators_killed_at: list[int] = field(default_factory=list)
    """Results there were."""
    memory: list[tuple[int, float]] = field(default_factory=list)
    """Results there were, and the coordinator's resident memory [MiB]; of the last coordinator."""
    seconds: float = 0.0
    status: int | None = None


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--count", type=from_one, default=5000, help="logs (default: %(default)s)")
    parser.add_argument("--workers", type=from_one, default=2, help="default: %(default)s")
    parser.add_argument("--worker-kills", type=int, default=5, help="default: %(default)s")
    parser.add_argument("--coordinator-kills", type=int, default=0, help="default: %(default)s")
    parser.add_argument("--method", type=method_name, default="ddp", help="default: %(default)s")
    parser.add_argument(
        "--refused", action="store_true", help="logs that take no time, to look at the coordinator alone"
    )
    parser.add_argument("--seed", type=int, default=0, help="of the times of the kills (default: %(default)s)")


def main(arguments: argparse.Namespace) -> int:
    """Exit status: 0 where all is as it should be, else 1."""
    if not 0 <= arguments.worker_kills <= len(_worker_kills(arguments.count)):
        raise UsageError(
            f"--worker-kills: expected 0 to {len(_worker_kills(arguments.count))} for {arguments.count} logs"
        )
    if not 0 <= arguments.coordinator_kills <= len(_coordinator_kills(arguments.count)):
        raise UsageError(f"--coordinator-kills: expected 0 to {len(_coordinator_kills(arguments.count))}")
    signal.signal(signal.SIGTERM, lambda *_: sys.exit(143))  # what was started is ended then, too
    with tempfile.TemporaryDirectory() as name:
        folder = pathlib.Path(name)
        write_corpus(folder / "corpus", arguments.count, refused=arguments.refused)
        with LocalCluster(folder / "cluster", arguments.workers) as cluster:
            seen = storm(folder, cluster, arguments)
        left = [pid for pid in seen.killed if is_running(pid)]
        return report(next((folder / "runs").iterdir()), arguments.count, seen, left)


def _worker_kills(count: int) -> range:
    """Numbers of results there may be when a worker is killed."""
    return range(count // 20, count - count // 20)


def _coordinator_kills(count: int) -> range:
    """Numbers of results there may be when the coordinator is killed: it has the rest to do."""
    return range(count // 10, count // 2)


def storm(folder: pathlib.Path, cluster: LocalCluster, options: argparse.Namespace) -> Seen:
    """One run to its end, with kills at random times."""
    rng = random.Random(options.seed)
    kills = sorted(rng.sample(_worker_kills(options.count), options.worker_kills))
    coordinator = sorted(rng.sample(_coordinator_kills(options.count), options.coordinator_kills))
    seen, begun = Seen(), time.monotonic()
    process = _coordinator(folder, cluster, options, resume=False)
    while process.poll() is None:
        time.sleep(0.5)
        done = _done(folder)
        seen.memory.append((done, _memory(process.pid)))
        if kills and done >= kills[0]:
            kills.pop(0)
            victim = rng.choice(cluster.workers())
            os.kill(victim, signal.SIGKILL)
            seen.killed.append(victim)
        if coordinator and done >= coordinator[0]:
            coordinator.pop(0)
            process.kill()
            process.wait()
            time.sleep(3.0)  # what its workers had begun comes to an end
            seen.coordinators_killed_at.append(_done(folder))
            seen.memory.clear()
            process = _coordinator(folder, cluster, options, resume=True)
    seen.seconds, seen.status = time.monotonic() - begun, process.returncode
    return seen


def _coordinator(
    folder: pathlib.Path, cluster: LocalCluster, options: argparse.Namespace, *, resume: bool
) -> subprocess.Popen[bytes]:
    words = ["regress", str(folder / "corpus"), "--scheduler", cluster.address, "--method", options.method]
    words += ["--out", str(folder / "runs"), "--recordings", "none", *(["--resume"] if resume else [])]
    return subprocess.Popen([*REPLAY, *words])


def report(run: pathlib.Path, count: int, seen: Seen, left: list[int]) -> int:
    """Print the outcome of a storm; the exit status is 1 where results are lost, repeated too often or left running."""
    folder = RunFolder(run)
    documents = [document.log for document in folder.documents()]
    attempts = Counter((run / "attempts").read_text().split())
    executions = sum(attempts.values()) / count
    since = (seen.coordinators_killed_at or [0])[-1] + count // 10  # a new coordinator has begun from nothing
    grown = growth(seen.memory, since)
    print(
        f"{count} logs in {seen.seconds:.0f} s ({60.0 * count / seen.seconds:.0f} logs/min), exit status {seen.status}"
    )
    print(f"killed: workers {len(seen.killed)}, coordinator at {seen.coordinators_killed_at or 'no time'}")
    print(f"results {len(folder.done())}, valid {len(documents)}, of different logs {len(set(documents))}")
    again = sum(number > 1 for number in attempts.values())
    print(f"executions {sum(attempts.values())}, {executions:.4f} for each log; {again} logs more than once")
    print(f"coordinator's memory: {grown:+.1f} MiB from log {since} to {count}")
    print(f"killed workers that still run: {left or 'none'}")
    whole = len(folder.done()) == len(documents) == len(set(documents)) == count
    return int(not whole or executions > MOST_EXECUTIONS or grown > MOST_GROWTH or bool(left))


def growth(memory: list[tuple[int, float]], since: int) -> float:
    """Most memory after `since` results less that at `since` [MiB]."""
    later = [mib for done, mib in memory if done >= since and mib > 0.0]
    return max(later) - later[0] if later else 0.0


def _done(folder: pathlib.Path) -> int:
    """Results that are there."""
    logs = list((folder / "runs").glob("*/logs"))
    return sum(name.endswith(".json") for each in logs for name in os.listdir(each))  # noqa: PTH208 - thousands


def _memory(pid: int) -> float:
    """Resident memory of a process [MiB]; 0 where it has gone."""
    try:
        lines = pathlib.Path(f"/proc/{pid}/status").read_text().splitlines()
    except OSError:
        return 0.0
    return next((int(line.split()[1]) / 1024.0 for line in lines if line.startswith("VmRSS")), 0.0)
