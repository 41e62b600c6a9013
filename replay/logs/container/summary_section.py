"""Comparison of the summary at a log's end with what was read. Nothing is ever looked up in the summary."""

import zlib
from collections.abc import Iterator
from typing import NamedTuple

from replay.logs.container import records as r
from replay.logs.container.channels import ChannelTable, read_channel, read_schema
from replay.logs.container.log import MIB, Schema
from replay.logs.container.log_bytes import Source
from replay.logs.container.records import Malformed, Opcode, RecordStream

_NAME_CHARACTERS = frozenset("abcdefghijklmnopqrstuvwxyzABCDEFGHIJKLMNOPQRSTUVWXYZ0123456789._-")


class Attachment(NamedTuple):
    """Facts about an attachment; its content is not kept."""

    name: str
    sound: bool
    odd_name: bool


def read_attachment(source: Source, length: int) -> Attachment:
    """Read past an Attachment record of `length` bytes and check its checksum. Raises Malformed."""
    head = source.read(min(length, MIB))
    try:
        name, size, start = _attachment_head(r.RecordStream(head))
        body = start + size
        if body + 4 > length:
            raise Malformed(f"its content claims {size} bytes in a record of {length}")
    except Malformed:
        source.skip(length - len(head))
        raise
    crc = zlib.crc32(head[:body])
    at = len(head)
    tail = head[body : body + 4]
    while at < length:
        part = source.read(min(length - at, MIB))
        crc = zlib.crc32(part[: max(0, body - at)], crc)
        tail += part[max(0, body - at) : max(0, body + 4 - at)]
        at += len(part)
    stated = int.from_bytes(tail[:4], "little")
    odd = not 0 < len(name) <= 100 or name[0] in ".-" or not set(name) <= _NAME_CHARACTERS
    return Attachment(name, stated in (0, crc), odd)


def _attachment_head(stream: RecordStream) -> tuple[str, int, int]:
    """Name, size and start of an attachment's content: `mcap.records` would hold it in memory. Raises Malformed."""
    stream.read(16)  # log time, create time
    try:
        name, _ = stream.read_prefixed_string(), stream.read_prefixed_string()
    except UnicodeDecodeError:
        raise Malformed("its name is not UTF-8") from None
    return name, stream.read8(), stream.position


class SummarySection:
    """Facts from the data section (`chunks`, `attachments`) and claims from the summary."""

    def __init__(self) -> None:
        self.chunks: list[tuple[int, int | None, int | None]] = []
        """Offset, start and end time; the times are None for a chunk that was dropped."""
        self.attachments: list[int] = []
        self.start = 0
        self._chunk_indexes: list[tuple[int, int, int]] = []
        self._attachment_indexes: list[int] = []
        self._schemas: dict[int, Schema] = {}
        self._channels: dict[int, tuple[str, str]] = {}
        self._statistics: int | None = None
        self._num_records = 0

    def add(self, opcode: int, stream: RecordStream) -> None:
        """Note one record of the summary. Raises Malformed, also for a record that may not stand there."""
        self._num_records += 1
        if opcode == Opcode.CHUNK_INDEX:
            start, end, offset = stream.read8(), stream.read8(), stream.read8()  # the rest is long and not used
            self._chunk_indexes.append((offset, start, end))
        elif opcode == Opcode.ATTACHMENT_INDEX:
            self._attachment_indexes.append(stream.read8())
        elif opcode == Opcode.SCHEMA:
            schema_id, schema = read_schema(stream)
            self._schemas[schema_id] = schema
        elif opcode == Opcode.CHANNEL:
            channel = read_channel(stream, {})
            self._channels[channel.id] = channel.topic, channel.encoding
        elif opcode == Opcode.STATISTICS:
            self._statistics = stream.read8()
        elif 0 < opcode <= Opcode.DATA_END and opcode not in (Opcode.METADATA_INDEX, Opcode.SUMMARY_OFFSET):
            raise Malformed("such a record may not stand there; it is not used")

    def check_footer(self, body: bytes, crc: int) -> Iterator[tuple[str, str]]:
        """Code and text of what is wrong with the Footer. `crc`: of the summary up to the Footer's fields."""
        footer = r.parsed(r.kinds.Footer, RecordStream(body))
        if footer.summary_crc and footer.summary_crc != zlib.crc32(body[:16], crc):
            yield "W_CRC_SUMMARY", "the checksum of the summary is wrong; it is not needed"
        if footer.summary_start != (self.start if self._num_records else 0):
            text = f"the Footer says that the summary begins at byte {footer.summary_start}"
            yield "W_INDEX", f"{text}, it begins at {self.start}"

    def contradictions(self, table: ChannelTable, num_messages: int) -> Iterator[tuple[str, str]]:
        """Code and text of each claim that the data section does not bear out."""
        if self._chunk_indexes:
            yield from (("W_INDEX", text) for text in self._index_errors(table))
        if self._attachment_indexes and sorted(self._attachment_indexes) != self.attachments:
            count = len(self._attachment_indexes)
            yield "W_INDEX", f"the index names {count} attachments, {len(self.attachments)} are there"
        if self._statistics not in (None, num_messages):
            yield "W_STATISTICS", f"the log counts {self._statistics} messages, {num_messages} were read"
        for i, (topic, encoding) in self._channels.items():
            known = table.by_id.get(i)
            if known is not None and (known.topic, known.encoding) != (topic, encoding):
                yield "W_CONFLICT", f"the summary calls topic {known.topic!r} {topic!r}; the data counts"
        if any(table.schemas.get(i, schema) != schema for i, schema in self._schemas.items()):
            yield "W_CONFLICT", "the summary defines a schema otherwise than the data; the data counts"

    def _index_errors(self, table: ChannelTable) -> Iterator[str]:
        indexed = sorted(self._chunk_indexes)
        if [offset for offset, _, _ in indexed] != [offset for offset, _, _ in self.chunks]:
            yield f"the index names {len(indexed)} chunks, the data holds {len(self.chunks)} or others"
        elif any(b[1] is not None and a != b for a, b in zip(indexed, self.chunks, strict=True)):
            yield "the index gives wrong times for a chunk"
        missing = set(table.by_id) - set(self._channels)  # it may list channels that have no messages
        if missing:
            yield f"the summary lacks {len(missing)} of {len(table.by_id)} channels"
