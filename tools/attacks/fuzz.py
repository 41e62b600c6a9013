"""Fuzz what reads foreign bytes, guided by coverage. Needs atheris (`pip install atheris`, Linux).

Usage: python -m tools.attacks fuzz TARGET [--minutes M] [--corpus FOLDER] [--seed N]

    container   the reader of MCAP files, on damaged and invented files
    messages    the decoders of ROS 2 messages and the check of their definitions
    idl         definitions in IDL
    protobuf    the decoders of Foxglove's messages in protobuf
    descriptors the definitions of protobuf messages
    json        the decoders of Foxglove's messages in JSON
    meaning     whole logs: maps, paths and metadata, up to a case
    metadata    the records `vehicle` and `path_nodes`
    results     results files, and the audit of what they hold

Whatever ends in one of the errors of one line (`replay.base.errors`) is well. Anything else, or an input that takes
over 5 seconds of processor time, ends the run; its bytes are in a file crash-* in the corpus folder then, or timeout-*
if it did not end at all, which `--corpus` keeps.
"""

import argparse
import contextlib
import functools
import importlib
import json
import pathlib
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any

ROOT = pathlib.Path(__file__).resolve().parent.parent
sys.path[:0] = [str(ROOT), str(ROOT / "tests")]

try:
    atheris: Any = importlib.import_module("atheris")
except ModuleNotFoundError:
    print(f"{__doc__}\nfuzz.py: error: atheris is not installed", file=sys.stderr)
    sys.exit(2)
with atheris.instrument_imports(include=["replay"]):
    from replay.base.errors import ReplayError
    from replay.logs.container.log import Metadata
    from replay.logs.container.scan import scan
    from replay.logs.meaning.assemble import read_cases
    from replay.logs.meaning.planar import Refusal
    from replay.logs.meaning.vehicle import nodes_of, vehicle_of
    from replay.logs.messages import foxglove
    from replay.logs.messages.definition import matching_definition
    from replay.logs.messages.idl import parse_idl
    from replay.logs.messages.ros2 import MESSAGE_TYPES
    from replay.logs.messages.types import DefinitionError, PayloadError
    from replay.run.confirm import audit_results
    from replay.run.results import read_results

logs_maker: Any = importlib.import_module("logs_maker")
foxglove_maker: Any = importlib.import_module("foxglove_maker")
idl_maker: Any = importlib.import_module("idl_maker")

SLOWEST_S = 5.0
"""Of processor time: other work on the machine must not count as ours."""
ENDLESS_S = 120
"""Of the clock on the wall, for what does not end at all."""
BETWEEN = b"\xfe\xed\xfa\xce"
"""Between the parts of an input of `meaning`: map, path, trailer's path, hitch_to_axle, indices of nodes."""
TOPICS = (("/map", "nav_msgs/msg/OccupancyGrid"), ("/truck", "nav_msgs/msg/Path"), ("/trailer", "nav_msgs/msg/Path"))
_KINDS = sorted(foxglove.MESSAGE_TYPES)
LARGEST = 100_000  # bytes of an input; sound logs of a few messages have 5,000


def container(path: pathlib.Path, data: bytes) -> None:
    path.write_bytes(data)
    log = scan(path, lambda _: True)
    assert all(isinstance(message.data, bytes) for message in log.messages)


def messages(path: pathlib.Path, data: bytes) -> None:
    del path
    names = sorted(MESSAGE_TYPES)
    name = names[data[0] % len(names)] if data else names[0]
    kind = MESSAGE_TYPES[name]
    with contextlib.suppress(PayloadError):
        kind.decode(data[1:], 0)
    with contextlib.suppress(DefinitionError):
        matching_definition(name, data[1:], kind.standards)


def idl(path: pathlib.Path, data: bytes) -> None:
    del path
    with contextlib.suppress(DefinitionError):
        parse_idl(data.decode(errors="replace"))


def _foxglove(data: bytes, encodings: tuple[str, str]) -> None:
    decode = _decoder(_KINDS[data[0] % len(_KINDS)] if data else _KINDS[0], encodings)
    with contextlib.suppress(PayloadError):
        decode(data[1:])


@functools.cache
def _decoder(kind: str, encodings: tuple[str, str]) -> Callable[[bytes], Any]:
    definition = foxglove_maker.definition(foxglove_maker.message(kind.removeprefix("foxglove.")))
    return foxglove.MESSAGE_TYPES[kind].decoder(encodings, definition if encodings[0] == "protobuf" else b"")


def protobuf(path: pathlib.Path, data: bytes) -> None:
    del path
    _foxglove(data, ("protobuf", "protobuf"))


def json_messages(path: pathlib.Path, data: bytes) -> None:
    del path
    _foxglove(data, ("json", "jsonschema"))


def descriptors(path: pathlib.Path, data: bytes) -> None:
    del path
    with contextlib.suppress(DefinitionError):
        foxglove.MESSAGE_TYPES["foxglove.SceneUpdate"].decoder(("protobuf", "protobuf"), data)


def meaning(path: pathlib.Path, data: bytes) -> None:
    parts = (*data.split(BETWEEN, 4), b"", b"", b"", b"")[:5]
    maker = logs_maker.LogMaker()
    for (topic, kind), body in zip(TOPICS, parts, strict=False):
        if body:
            maker.add_raw(topic, kind, body, definition=MESSAGE_TYPES[kind].standards[0].encode())
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


# named as above; each is given a scratch file and the bytes
TARGETS: dict[str, Callable[[pathlib.Path, bytes], None]] = {
    each.__name__.removesuffix("_messages"): each
    for each in (container, messages, idl, protobuf, descriptors, json_messages, meaning, metadata, results)
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
        numbers = [sorted(MESSAGE_TYPES).index(kind) for _, kind in TOPICS]
        yield from (bytes([number]) + body for number, body in zip(numbers, bodies, strict=True))
        yield from (
            bytes([number]) + MESSAGE_TYPES[kind].standards[0].encode()
            for number, (_, kind) in zip(numbers, TOPICS, strict=True)
        )
    elif target in ("protobuf", "json", "descriptors"):
        yield from _foxglove_seeds(target)
    elif target == "idl":
        yield from (idl_maker.idl(kind).encode() for kind in MESSAGE_TYPES)
    elif target == "metadata":
        yield b'"wheelbase"3.6 8 [0, 3, 7]'
    else:
        yield _small_results()


def _foxglove_seeds(target: str) -> Iterator[bytes]:
    """One small message of each kind that has parts, or its definition."""
    fox = foxglove_maker
    line = fox.message("LinePrimitive", points=fox.points([(0, 0, 0), (1, 0, 0)]), indices=[1, 0])
    scene = fox.scene(fox.entity("a", cubes=[fox.cube((1, 2, 0), (1, 1, 1))], lines=[line]))
    grid = fox.grid(logs_maker.yard(4.0, 4.0, 1.0))
    links = fox.message("FrameTransforms", transforms=[fox.transform("a", "b", (1, 2, 0))])
    for each in (fox.poses([(1, 2, 0), (2, 2, 0)]), grid, scene, links, fox.joints(hitch=0.1)):
        kind = bytes([_KINDS.index(each.DESCRIPTOR.full_name)])
        if target == "protobuf":
            yield kind + each.SerializeToString()
        elif target == "json":
            yield kind + json.dumps(fox.tree(each)).encode()
        else:
            yield fox.definition(each)


def _small_results() -> bytes:
    """The results of the smallest run: one method that gives the recorded path back."""
    random_problem = importlib.import_module("scenes").random_problem

    from optim.methods.shortcut import Shortcut
    from replay.base.documents import to_bytes
    from replay.run.case import Case, ReadReport
    from replay.run.judge import run_case
    from replay.run.results import to_document

    problem = random_problem(1, lengths=(2.0, 2.0), num_blocks=1)
    read = ReadReport(poses=9, hitch="trailer path", max_deviation_m=0.0, max_deviation_rad=0.0)
    case = Case(
        name="x/0", log=pathlib.Path("x.mcap"), sha256="0" * 64, problem=problem, read=read, map=None, frame="map"
    )
    run = run_case(case, {"shortcut": Shortcut(tries=1)})
    return to_bytes(to_document(run))


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("target", choices=TARGETS)
    parser.add_argument("--minutes", type=float, default=10.0)
    parser.add_argument("--corpus", type=pathlib.Path, help="folder of inputs, kept and added to")
    parser.add_argument("--seed", type=int, default=1)


def main(arguments: argparse.Namespace) -> int | None:
    """Exit status: 0 where all is as it should be, else 1."""
    with contextlib.ExitStack() as stack:
        folder = arguments.corpus or pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory()))
        folder.mkdir(parents=True, exist_ok=True)
        path = pathlib.Path(stack.enter_context(tempfile.TemporaryDirectory(dir="/dev/shm"))) / "input"
        call = TARGETS[arguments.target]
        for number, data in enumerate(seeds(arguments.target)):
            (folder / f"seed-{number}").write_bytes(data)
            with contextlib.suppress(ReplayError):  # compiling is not counted as slow
                call(path, data)

        def one(data: bytes) -> None:
            began = time.process_time()
            with contextlib.suppress(ReplayError):
                call(path, data)
            took = time.process_time() - began
            assert took <= SLOWEST_S, f"it took {took:.1f} s of processor time, expected at most {SLOWEST_S:g} s"

        limits = (f"-timeout={ENDLESS_S}", f"-max_total_time={round(60 * arguments.minutes)}", f"-max_len={LARGEST}")
        options = (*limits, f"-seed={arguments.seed}", "-rss_limit_mb=2048", f"-artifact_prefix={folder}/")
        atheris.Setup([sys.argv[0], *options, str(folder)], one)
        atheris.Fuzz()
