"""MCAP files for tests, byte by byte: what no writer would write."""

import struct
import zlib

from logs_maker import LogMaker

from replay.logs.container.log import Log
from replay.logs.container.records import MAGIC


def text(value: str | bytes) -> bytes:
    raw = value.encode() if isinstance(value, str) else value
    return struct.pack("<I", len(raw)) + raw


def record(opcode: int, body: bytes, length: int | None = None) -> bytes:
    """A record; its length is stated rightly unless another is given."""
    return struct.pack("<BQ", opcode, len(body) if length is None else length) + body


def schema(number: int = 1, name: str = "a/msg/B", definition: bytes = b"int32 x") -> bytes:
    return record(3, struct.pack("<H", number) + text(name) + text("ros2msg") + text(definition))


def channel(number: int = 1, schema_id: int = 1, topic: str | bytes = "/x", extra: bytes = b"") -> bytes:
    return record(4, struct.pack("<HH", number, schema_id) + text(topic) + text("cdr") + text(b"") + extra)


def message(channel_id: int = 1, time: int = 0, data: bytes = b"payload") -> bytes:
    return record(5, struct.pack("<HIQQ", channel_id, 0, time, time) + data)


def chunk(
    records: bytes,
    *,
    compression: str = "",
    packed: bytes | None = None,
    size: int | None = None,
    crc: int | None = None,
    packed_size: int | None = None,
) -> bytes:
    """A chunk of records; what it states of its content is right unless given otherwise."""
    payload = records if packed is None else packed
    head = struct.pack(
        "<QQQI", 0, 0, len(records) if size is None else size, zlib.crc32(records) if crc is None else crc
    )
    stated = len(payload) if packed_size is None else packed_size
    return record(6, head + text(compression) + struct.pack("<Q", stated) + payload)


HEADER = record(1, text("ros2") + text("by hand"))
DEFINITIONS = schema() + channel()
FOOTER = record(2, struct.pack("<QQI", 0, 0, 0))


def container(*records: bytes, data_crc: int | None = None, header: bytes = HEADER) -> bytes:
    """A whole file without summary, with the right checksum of its data unless another is given."""
    body = MAGIC + header + b"".join(records)
    crc = zlib.crc32(body) if data_crc is None else data_crc
    return body + record(15, struct.pack("<I", crc)) + FOOTER + MAGIC


def codes(log: Log) -> set[str]:
    """What was found wrong, by its codes."""
    return {finding.code for finding in log.findings}


def some_log(**options: object) -> LogMaker:
    """Twelve messages of two types on three topics, and a metadata record."""
    maker = LogMaker(**options)  # type: ignore[arg-type]
    for i in range(12):
        kind = "a/msg/B" if i % 3 else "c/D"
        maker.add_raw(f"/topic{i % 3}", kind, bytes([i]) * (20 + 7 * i), i // 2, definition=b"int32 x\n" * (i % 3 + 1))
    maker.metadata.append(("vehicle", {"wheelbase": "3.6"}))
    return maker
