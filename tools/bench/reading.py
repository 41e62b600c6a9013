"""How fast logs are read, and with how much memory: each figure is that of a process of its own, the best of several.

Usage: python tools/bench/reading.py [LOG.mcap ...] [--repeat N]

Without logs, three are made in a temporary folder: one map and one path among 200 MB of other topics, in chunks without
compression, with lz4 and with zstd. For each log: reading it and decoding every message that is understood, wall and
CPU time; poses that were decoded; the largest resident memory of the process, and that before reading. Linux.
"""

import argparse
import importlib
import json
import pathlib
import subprocess
import sys
import tempfile
import time
from typing import Any

import numpy as np

from tools.script import existing, from_one, run

ROOT = pathlib.Path(__file__).resolve().parents[2]
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

MIB = 1 << 20
PICTURES = 200
"""Messages of 1 MB among which map and path lie."""
SMALL = 20
"""Small messages beside each of them."""


def make_log(path: pathlib.Path, compression: str) -> None:
    """A log of 200 MB: pictures that look random, small messages, one map of a million cells and one path."""
    from mcap.writer import CompressionType

    make: Any = importlib.import_module("logs_maker")
    random = np.random.default_rng(1)
    truck, _ = make.drive()
    cells = make.yard(200.0, 200.0, 0.2)
    maker = make.LogMaker(compression=CompressionType[compression.upper()], chunk_size=4 * MIB).vehicle()
    for number in range(PICTURES):
        picture = random.integers(0, 256, 1_000_000, np.uint8).tobytes()
        maker.add_raw("/camera", "sensor_msgs/msg/CompressedImage", picture, number)
        for _ in range(SMALL):
            maker.add_raw("/state", "example_msgs/msg/State", bytes(64), number)
        if number == PICTURES // 3:
            maker.add("/map", make.grid(cells), number)
        if number == PICTURES // 2:
            maker.add("/plan", make.path(truck), number)
    maker.write(path)


def measure(path: pathlib.Path) -> dict[str, Any]:
    """Read one log, in this process."""
    from replay.logs.container.folder import open_log
    from replay.logs.meaning.topics import is_wanted, topics_of

    before = _peak_mib()
    wall, cpu = time.perf_counter(), time.process_time()
    log = open_log(path, is_wanted)
    poses = 0
    for topic in topics_of(log):
        for index in range(len(topic.messages)):
            content = topic.decode(index)
            poses += len(content.poses) if topic.message_type.role == "path" else 0
    return {
        "wall_s": time.perf_counter() - wall,
        "cpu_s": time.process_time() - cpu,
        "mib": log.size / MIB,
        "messages": sum(log.counts.values()),
        "poses": poses,
        "peak_mib": _peak_mib(),
        "before_mib": before,
    }


def _peak_mib() -> float:
    """The largest resident memory so far; the kernel's own count goes on from the process that started this one."""
    status = pathlib.Path("/proc/self/status").read_text()
    return int(status.partition("VmHWM:")[2].split()[0]) / 1024.0


def best(path: pathlib.Path, repeat: int) -> dict[str, Any]:
    """The fastest of several processes, and the most memory that any of them took."""
    runs = []
    for _ in range(repeat):
        call = [sys.executable, __file__, str(path), "--child"]
        done = subprocess.run(call, stdout=subprocess.PIPE, text=True)
        if done.returncode != 0:
            raise SystemExit(done.returncode)  # it has said why
        runs.append(json.loads(done.stdout))
    fastest = min(runs, key=lambda run: run["cpu_s"])
    return fastest | {"peak_mib": max(run["peak_mib"] for run in runs), "wall_s": min(run["wall_s"] for run in runs)}


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("logs", nargs="*", type=existing, metavar="LOG")
    parser.add_argument("--repeat", type=from_one, default=3, help="processes for each log (default: %(default)s)")
    parser.add_argument("--child", action="store_true", help=argparse.SUPPRESS)
    arguments = parser.parse_args()
    if arguments.child:
        print(json.dumps(measure(arguments.logs[0])))
        return
    with tempfile.TemporaryDirectory() as folder:
        logs = list(arguments.logs)
        if not logs:
            for compression in ("none", "lz4", "zstd"):
                logs.append(pathlib.Path(folder) / f"{compression}.mcap")
                make_log(logs[-1], compression)
        print("| log | MiB | messages | poses | wall [s] | CPU [s] | peak memory [MiB] | before reading [MiB] |")
        print("|---|--:|--:|--:|--:|--:|--:|--:|")
        for log in logs:
            found = best(log, arguments.repeat)
            cells = [f"{found['mib']:.1f}", f"{found['messages']}", f"{found['poses']}", f"{found['wall_s']:.2f}"]
            cells += [f"{found['cpu_s']:.2f}", f"{found['peak_mib']:.0f}", f"{found['before_mib']:.0f}"]
            print(f"| {log.name} | {' | '.join(cells)} |")


if __name__ == "__main__":
    run(main)
