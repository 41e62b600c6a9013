"""Fuzz what reads foreign bytes, guided by coverage. Needs atheris (`pip install atheris`, Linux).

Usage: python tools/fuzz.py TARGET [--minutes M] [--corpus FOLDER] [--seed N]

    container   the reader of MCAP files, on damaged and invented files
    messages    the decoders of ROS 2 messages and the check of their definitions
    meaning     whole logs: maps, paths and metadata, up to a case
    metadata    the records `vehicle` and `path_nodes`
    results     results files, and the audit of what they hold

Whatever ends in one of the errors of one line (`replay.errors`) is well. Anything else, or an input that takes over
5 seconds, ends the run; its bytes are in a file crash-* or timeout-* in the corpus folder then, which `--corpus` keeps.
"""

import argparse
import contextlib
import importlib
import json
import os
import pathlib
import sys
import tempfile
from collections.abc import Callable, Iterator
from typing import Any

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

atheris: Any = importlib.import_module("atheris")
with atheris.instrument_imports(include=["replay"]):
    from replay.errors import ReplayError
    from replay.logs.assemble import read_cases
    from replay.logs.container import scan
    from replay.logs.content import PayloadError
    from replay.logs.layout import LayoutError, matching_layout
    from replay.logs.planar import Refusal
    from replay.logs.records import Metadata
    from replay.logs.ros2 import FAMILIES
    from replay.logs.vehicle import nodes_of, vehicle_of
    from replay.results import audit_results, read_results

logs_maker: Any = importlib.import_module("logs_maker")

SLOWEST_S = 5
BETWEEN = b"\xfe\xed\xfa\xce"
"""Between the parts of an input of `meaning`: map, path, trailer's path, hitch_to_axle, indices of nodes."""
TOPICS = (("/map", "nav_msgs/msg/OccupancyGrid"), ("/truck", "nav_msgs/msg/Path"), ("/trailer", "nav_msgs/msg/Path"))
LARGEST = 100_000  # bytes of an input; sound logs of a few messages have 5,000


def container(path: pathlib.Path, data: bytes) -> None:
    path.write_bytes(data)
    log = scan(path, lambda _: True)
    assert all(isinstance(message.data, bytes) for message in log.messages)


def messages(path: pathlib.Path, data: bytes) -> None:
    del path
    families = sorted(FAMILIES)
    name = families[data[0] % len(families)] if data else families[0]
    family = FAMILIES[name]
    with contextlib.suppress(PayloadError):
        family.decode(data[1:], 0)
    with contextlib.suppress(LayoutError):
        matching_layout(name, data[1:], family.standards, ("ros2msg", "ros2idl")[data[0] % 2] if data else "ros2msg")


def meaning(path: pathlib.Path, data: bytes) -> None:
    parts = (*data.split(BETWEEN, 4), b"", b"", b"", b"")[:5]
    maker = logs_maker.LogMaker()
    for (topic, kind), body in zip(TOPICS, parts, strict=False):
        if body:
            maker.add_raw(topic, kind, body, definition=FAMILIES[kind].standards[0].encode())
    maker.metadata = [("vehicle", {"wheelbase": "3.6", "hitch_to_axle": parts[3].decode(errors="replace") or "8"})]
    maker.nodes(parts[4].decode(errors="replace"))
    path.write_bytes(maker.bytes())
    read_cases(path)


def metadata(path: pathlib.Path, data: bytes) -> None:
    del path
    provider = atheris.FuzzedDataProvider(data)
    words = [provider.ConsumeUnicodeNoSurrogates(60) for _ in range(6)]
    values: dict[str, str] = dict(zip(("wheelbase", "hitch_to_axle", "max_steer", words[0]), words[1:], strict=False))
    with contextlib.suppress(Refusal):
        vehicle_of([Metadata(name="vehicle", values=values, duplicates=())])
    with contextlib.suppress(Refusal):
        text = provider.ConsumeUnicodeNoSurrogates(10_000)
        nodes_of([Metadata(name="path_nodes", values={"indices": text}, duplicates=())], 50)


def results(path: pathlib.Path, data: bytes) -> None:
    path.write_bytes(data)
    audit_results(read_results(path))


TARGETS: dict[str, Callable[[pathlib.Path, bytes], None]] = {
    each.__name__: each for each in (container, messages, meaning, metadata, results)
}


def seeds(target: str) -> Iterator[bytes]:
    """Sound inputs to begin with."""
    logs = [(ROOT / "tests" / "data" / name).read_bytes() for name in ("talker.mcap", "only_topics.mcap")]
    truck, trailer = logs_maker.drive(reverse=2.0)
    cells = logs_maker.yard(width=60.0, height=40.0, resolution=1.0)
    bodies = [
        logs_maker.serialised(each)
        for each in (logs_maker.grid(cells, 1.0), logs_maker.path(truck), logs_maker.path(trailer))
    ]
    if target == "container":
        yield from (*logs, logs_maker.log_of(truck, trailer, cells, resolution=1.0).bytes())
    elif target == "meaning":
        yield BETWEEN.join((*bodies, b"8", b"[0, 5]"))
    elif target == "messages":
        numbers = [sorted(FAMILIES).index(kind) for _, kind in TOPICS]
        yield from (bytes([number]) + body for number, body in zip(numbers, bodies, strict=True))
        yield from (
            bytes([number]) + FAMILIES[kind].standards[0].encode()
            for number, (_, kind) in zip(numbers, TOPICS, strict=True)
        )
    elif target == "metadata":
        yield b'"wheelbase"3.6 8 [0, 3, 7]'
    else:
        yield _small_results()


def _small_results() -> bytes:
    """The results of the smallest run: one method that gives the recorded path back."""
    random_problem = importlib.import_module("scenes").random_problem

    from optim.methods.shortcut import Shortcut
    from replay.case import Case, ReadReport
    from replay.results import to_document
    from replay.run import run_case

    problem = random_problem(1, lengths=(2.0, 2.0), num_blocks=1)
    read = ReadReport(poses=9, hitch="trailer path", max_deviation_m=0.0, max_deviation_rad=0.0)
    case = Case(
        name="x/0", log=pathlib.Path("x.mcap"), sha256="0" * 64, problem=problem, read=read, map=None, frame="map"
    )
    run = run_case(case, {"shortcut": Shortcut(tries=1)})
    return json.dumps(to_document(run)).encode()


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("target", choices=TARGETS)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--corpus", type=pathlib.Path, help="folder of inputs, kept and added to")
    parser.add_argument("--seed", type=int, default=1)
    arguments = parser.parse_args()
    with contextlib.ExitStack() as stack:
        folder = arguments.corpus or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        for number, data in enumerate(seeds(arguments.target)):
            (folder / f"seed-{number}").write_bytes(data)
            with contextlib.suppress(ReplayError):  # compiling is not counted as slow
                TARGETS[arguments.target](pathlib.Path(tempfile.gettempdir()) / f"warm-{os.getpid()}", data)
        path = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory(dir="/dev/shm"))) / "input"
        call = TARGETS[arguments.target]

        def one(data: bytes) -> None:
            with contextlib.suppress(ReplayError):
                call(path, data)

        limits = (f"-timeout={SLOWEST_S}", f"-max_total_time={round(60 * arguments.minutes)}", f"-max_len={LARGEST}")
        options = (*limits, f"-seed={arguments.seed}", "-rss_limit_mb=2048", f"-artifact_prefix={folder}/")
        atheris.Setup([sys.argv[0], *options, str(folder)], one)
        atheris.Fuzz()


if __name__ == "__main__":
    main()
