"""Read every prefix of small logs, and every version of them with one bit flipped: nothing altered may be delivered.

Usage: python -m tools.attacks flip-bits [LOG...] [--every N] [--first K] [--jobs N]

Without LOG: small logs of three forms (zstd, lz4, without chunks), with all checksums, message by message. A prefix
gives the first messages of the whole and a warning, a flipped bit a part of the sound messages and a remark. With LOG,
real logs as a whole: a prefix or a flipped bit ends as an error of one line or as cases; those that say nothing is
lost and remark nothing hold the sound log's paths and obstacles. `--every` takes each N-th bit or byte only,
beginning with the K-th. What is otherwise is listed; the exit status is 1 then.
"""

import argparse
import collections
import io
import pathlib
import tempfile
import time
from collections.abc import Callable, Iterator
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any, NamedTuple

from mcap.writer import CompressionType, Writer

from replay.base.errors import LogError
from replay.base.kernels import drop_stale
from replay.logs import read_cases
from replay.logs.container.scan import scan
from tools.script import existing, from_one

FORMS = {
    "zstd": {"compression": CompressionType.ZSTD, "chunk_size": 200},
    "lz4": {"compression": CompressionType.LZ4, "chunk_size": 400},
    "without chunks": {"use_chunking": False},
}


class Read(NamedTuple):
    """What came of reading some bytes."""

    content: Any
    """What was delivered, comparable; None after an error."""
    remarks: frozenset[str]
    """What was said about damage."""


Reader = Callable[[pathlib.Path], Read]


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("logs", type=existing, nargs="*", metavar="LOG")
    parser.add_argument("--every", type=from_one, default=1, help="take each N-th bit or byte (default: all)")
    parser.add_argument("--first", type=int, default=0, help="the first bit or byte (default: %(default)s)")
    parser.add_argument("--jobs", type=from_one, default=1, help="processes (default: %(default)s)")


def main(arguments: argparse.Namespace) -> int:
    """Exit status: 0 where all is as it should be, else 1."""
    drop_stale()
    logs = {log.name: log.read_bytes() for log in arguments.logs} or {name: small_log(name) for name in FORMS}
    reader = whole if arguments.logs else messages
    wrong = 0
    for name, data in logs.items():
        for damage, count in (("prefixes", len(data)), ("flipped bits", 8 * len(data))):
            started = time.monotonic()
            found = collections.Counter[str]()
            for place, verdict in sweep(
                damage, data, reader, range(arguments.first, count, arguments.every), arguments.jobs
            ):
                found[verdict] += 1
                if verdict.startswith("WRONG"):
                    wrong += 1
                    print(f"{name}, {damage} at {place}: {verdict}")
            words = ", ".join(f"{times} {verdict}" for verdict, times in sorted(found.items()))
            seconds = time.monotonic() - started
            print(f"{name} ({len(data)} bytes), {damage}: {found.total()} read in {seconds:.0f} s: {words}", flush=True)
    return int(wrong > 0)


def small_log(form: str) -> bytes:
    """Twelve messages of three channels and a record of metadata, all checksums present."""
    out = io.BytesIO()
    writer = Writer(out, enable_data_crcs=True, **FORMS[form])
    writer.start(profile="ros2", library="flip_bits")
    channels = []
    for number in range(3):
        schema = writer.register_schema(f"a/msg/B{number}", "ros2msg", b"int32 x\n" * (number + 1))
        channels.append(writer.register_channel(f"/topic{number}", "cdr", schema))
    for number in range(12):
        data = bytes([number]) * (20 + 7 * number)
        writer.add_message(channels[number % 3], log_time=number // 2, publish_time=number, data=data)
    writer.add_metadata("vehicle", {"wheelbase": "3.6"})
    writer.finish()
    return out.getvalue()


def messages(path: pathlib.Path) -> Read:
    """Every message of the container, in order."""
    try:
        log = scan(path, lambda _: True)
    except LogError:
        return Read(None, frozenset())
    found = [
        (m.channel.topic, m.channel.schema.name if m.channel.schema else "", m.log_time, m.data) for m in log.messages
    ]
    return Read(found, frozenset(finding.code for finding in log.findings))


def whole(path: pathlib.Path) -> Read:
    """All cases of a log: what a method gets of each."""
    try:
        cases = read_cases(path)
    except LogError:
        return Read(None, frozenset())
    content = [
        (case.problem.vehicle, case.problem.recorded.samples.states.tobytes(), _bytes(case.problem.scene.polygons))
        for case in cases
    ]
    return Read(content, frozenset(note for case in cases for note in case.read.notes))


def _bytes(polygons: Any) -> tuple[bytes, ...]:
    return tuple(polygon.tobytes() for polygon in polygons)


def sweep(damage: str, data: bytes, reader: Reader, places: range, jobs: int) -> Iterator[tuple[int, str]]:
    """Damage at each place, read, and what came of it."""
    with tempfile.TemporaryDirectory() as folder:
        path = pathlib.Path(folder) / "log.mcap"
        path.write_bytes(data)
        sound = reader(path)
        size = max(1, len(places) // (8 * jobs))
        parts = [places[start : start + size] for start in range(0, len(places), size)]
        tasks = [(damage, data, reader, sound, part, path.with_name(f"{k}.mcap")) for k, part in enumerate(parts)]
        if jobs == 1:
            for task in tasks:
                yield from _part(task)
            return
        with ProcessPoolExecutor(jobs, mp_context=get_context("fork")) as pool:
            for found in pool.map(_part, tasks):
                yield from found


def _part(task: tuple[str, bytes, Reader, Read, range, pathlib.Path]) -> list[tuple[int, str]]:
    damage, data, reader, sound, places, path = task
    found = []
    for place in places:
        changed = bytearray(data[:place] if damage == "prefixes" else data)
        if damage != "prefixes":
            changed[place // 8] ^= 1 << place % 8
        path.write_bytes(changed)
        try:
            verdict = judged(damage, reader(path), sound)
        except Exception as error:  # whatever leaks out is what is looked for
            verdict = f"WRONG, {type(error).__name__}: {error}"
        found.append((place, verdict))
    return found


def judged(damage: str, read: Read, sound: Read) -> str:
    """What to say about a reading of damaged bytes, given that of the sound ones."""
    if read.content is None:
        return "refused"
    if not read.remarks - sound.remarks:
        return "WRONG, unnoticed" if read.content == sound.content else "WRONG, altered and unnoticed"
    if read.content == sound.content:
        return "read whole with a remark"
    if damage == "prefixes":
        is_part = read.content == sound.content[: len(read.content)]
    else:
        is_part = not collections.Counter(read.content) - collections.Counter(sound.content)
    return "read in part with a remark" if is_part else "WRONG, altered"
