"""A copy of an MCAP log with messages added: every byte of its data section as it was, then the new records.

The index and the summary at the end of the file are made anew, since they state what a file holds. Where the log has
chunks, the new messages are in a chunk too: a reader that uses the index looks into chunks only.
"""

import pathlib
import struct
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, Final

from replay.base.errors import LogError
from replay.logs.container import records as r
from replay.logs.container.compression import BadChunk, unpack_chunk
from replay.logs.container.log import Log, ReadLimits
from replay.logs.container.records import Cursor, Malformed

_LARGEST_ID: Final = 65535
_BLOCK: Final = 1 << 20


@dataclass(frozen=True, eq=False, kw_only=True)
class NewTopic:
    """Messages of one new channel."""

    topic: str
    schema: str
    """Name of the messages' type."""
    definition: str
    """Of the type, in the encoding `ros2msg`."""
    messages: Sequence[tuple[int, bytes]]
    """Log time [ns] and payload (`cdr`) of each."""


@dataclass(kw_only=True)
class _Index:
    """What the summary says about the data section, gathered on the way."""

    schemas: dict[int, bytes] = field(default_factory=dict)
    channels: dict[int, bytes] = field(default_factory=dict)
    """Whole records, the first of each id."""
    chunks: list[bytes] = field(default_factory=list)
    attachments: list[bytes] = field(default_factory=list)
    metadata: list[bytes] = field(default_factory=list)
    """Records of the summary."""
    num_chunks: int = 0
    times: list[int] = field(default_factory=list)
    """First and last log times of what holds messages [ns]."""
    counts: dict[int, int] = field(default_factory=dict)

    def cover(self, *times: int) -> None:
        """Widen the span of `times` by these [ns]."""
        self.times = [min([*self.times, *times]), max([*self.times, *times])]


def append(log: Log, target: BinaryIO, topics: Sequence[NewTopic], metadata: Mapping[str, Mapping[str, str]]) -> None:
    """Write a copy of a log, and after its records new topics and metadata records.

    Raises LogError (E_EXPORT) where part of the log is lost: what is damaged cannot be copied and read on.
    """
    refuse_lost(log)
    try:
        with log.path.open("rb") as source:
            _copy(source, target, log, topics, metadata)
    except (Malformed, BadChunk, EOFError) as error:
        raise LogError("E_EXPORT", log.path, f"it cannot be copied: {error}") from error


def refuse_lost(log: Log) -> None:
    """Raise LogError (E_EXPORT) where part of a log is lost."""
    if log.lost:
        found = next(finding.text for finding in log.findings if finding.lost)
        raise LogError("E_EXPORT", log.path, f"part of it is damaged, and a copy would be too: {found}")


def write_log(target: BinaryIO, topics: Sequence[NewTopic], metadata: Mapping[str, Mapping[str, str]]) -> None:
    """Write a log of new topics and metadata records alone, in one chunk: rosbag2 finds messages by their index."""
    index, out = _Index(), _Output(target)
    out.write(r.MAGIC + _record(r.HEADER, _text("ros2") + _text("")))
    _write_topics(out, index, set(), topics, chunked=True)
    _write_end(out, index, metadata)


def time_span(path: pathlib.Path) -> list[int]:
    """First and last log time of an undamaged log's messages [ns]; empty where it has none."""
    index = _Index()
    with path.open("rb") as source:
        _walk(source, index)
    return index.times


def _copy(
    source: BinaryIO, target: BinaryIO, log: Log, topics: Sequence[NewTopic], metadata: Mapping[str, Mapping[str, str]]
) -> None:
    index = _Index(counts=dict(log.counts))
    end = _walk(source, index)
    source.seek(0)
    out = _Output(target)
    for start in range(0, end, _BLOCK):
        out.write(source.read(min(_BLOCK, end - start)))
    used = {channel.schema_id for channel in log.channels}
    _write_topics(out, index, used, topics, chunked=index.num_chunks > 0)
    _write_end(out, index, metadata)


def _write_end(out: "_Output", index: _Index, metadata: Mapping[str, Mapping[str, str]]) -> None:
    """What follows the messages: metadata records, the end of the data section, summary."""
    for name, values in metadata.items():
        body = _text(name) + _text_map(values)
        index.metadata.append(_metadata_index(out.position, len(body), name))
        out.write(_record(r.METADATA, body))
    out.write(_record(r.DATA_END, struct.pack("<I", out.crc)))
    _write_summary(out, index)


# ---- what is there


def _walk(source: BinaryIO, index: _Index) -> int:
    """Gather what the summary needs; where the data section ends [bytes]."""
    source.seek(len(r.MAGIC))
    chunks: list[tuple[int, int]] = []
    pending: _PendingChunk | None = None
    while True:
        at = source.tell()
        opcode, length = r.RECORD_PREFIX.unpack(_exactly(source, r.RECORD_PREFIX.size))
        if opcode != r.MESSAGE_INDEX and pending is not None:
            index.chunks.append(pending.record(at))
            pending = None
        if opcode == r.DATA_END:
            break
        if opcode == r.CHUNK:
            chunks.append((at, length))
            pending = _PendingChunk(at, length, _exactly(source, min(length, 256)), index)
        elif opcode == r.MESSAGE_INDEX and pending is not None:
            pending.offsets[int.from_bytes(_exactly(source, 2), "little")] = at
        elif opcode in (r.SCHEMA, r.CHANNEL):
            _define(index, opcode, _exactly(source, length))
        elif opcode == r.MESSAGE:
            time = r.MESSAGE_PREFIX.unpack(_exactly(source, r.MESSAGE_PREFIX.size))[2]
            index.cover(time)
        elif opcode == r.ATTACHMENT:
            index.attachments.append(_attachment_index(source, at, length))
        elif opcode == r.METADATA:
            name = Cursor(_exactly(source, length)).text("name of metadata")
            index.metadata.append(_metadata_index(at, length, name))
        source.seek(at + r.RECORD_PREFIX.size + length)
    if not set(index.counts) <= set(index.channels):  # most writers define channels within chunks
        for place, size in chunks:
            _definitions_within(source, place, size, index)
    return at


class _PendingChunk:
    """A chunk whose message indexes are still to come."""

    def __init__(self, at: int, length: int, head: bytes, index: _Index) -> None:
        self._at, self._length = at, r.RECORD_PREFIX.size + length
        cursor = Cursor(head)
        self._times = cursor.u64("start time"), cursor.u64("end time")
        self._size, _ = cursor.u64("uncompressed size"), cursor.u32("checksum")
        self._compression = cursor.text("compression")
        self._packed = cursor.u64("records length")
        self.offsets: dict[int, int] = {}
        index.num_chunks += 1
        if self._size:
            index.cover(*self._times)

    def record(self, end: int) -> bytes:
        """The Chunk Index; `end` is where the message indexes end."""
        offsets = b"".join(struct.pack("<HQ", *item) for item in self.offsets.items())
        return _record(
            r.CHUNK_INDEX,
            struct.pack("<QQQQ", *self._times, self._at, self._length)
            + struct.pack("<I", len(offsets))
            + offsets
            + struct.pack("<Q", end - self._at - self._length)
            + _text(self._compression)
            + struct.pack("<QQ", self._packed, self._size),
        )


def _define(index: _Index, opcode: int, body: bytes) -> None:
    known = index.schemas if opcode == r.SCHEMA else index.channels
    known.setdefault(Cursor(body).u16("id"), _record(opcode, body))


def _definitions_within(source: BinaryIO, at: int, length: int, index: _Index) -> None:
    source.seek(at + r.RECORD_PREFIX.size)
    limits = ReadLimits()
    data, _, _ = unpack_chunk(_exactly(source, length), limits.chunk, limits.total)
    position = 0
    while position < len(data):
        opcode, size = r.RECORD_PREFIX.unpack_from(data, position)
        position += r.RECORD_PREFIX.size
        if opcode in (r.SCHEMA, r.CHANNEL):
            _define(index, opcode, data[position : position + size])
        position += size


def _metadata_index(at: int, length: int, name: str) -> bytes:
    """A Metadata Index of a record at a place, with a body of `length` bytes."""
    return _record(r.METADATA_INDEX, struct.pack("<QQ", at, r.RECORD_PREFIX.size + length) + _text(name))


def _attachment_index(source: BinaryIO, at: int, length: int) -> bytes:
    cursor = Cursor(_exactly(source, min(length, 1 << 16)))
    log_time, create_time = cursor.u64("log time"), cursor.u64("create time")
    name, media_type = cursor.text("name"), cursor.text("media type")
    size = r.RECORD_PREFIX.size + length
    fields = struct.pack("<QQQQQ", at, size, log_time, create_time, cursor.u64("data length"))
    return _record(r.ATTACHMENT_INDEX, fields + _text(name) + _text(media_type))


def _exactly(source: BinaryIO, count: int) -> bytes:
    data = source.read(count)
    if len(data) != count:
        raise EOFError("the file ends within a record")
    return data


# ---- what is new


class _Output:
    """Writes on, and knows where it is and the checksum of what it wrote."""

    def __init__(self, target: BinaryIO) -> None:
        self._target = target
        self.position, self.crc = 0, 0

    def write(self, data: bytes) -> None:
        self._target.write(data)
        self.position += len(data)
        self.crc = zlib.crc32(data, self.crc)


def _write_topics(out: _Output, index: _Index, used: set[int], topics: Sequence[NewTopic], *, chunked: bool) -> None:
    """`used`: ids that channels of the log name as their schemas', whether there are such schemas or not."""
    schemas = list(dict.fromkeys(topic.schema for topic in topics))
    schema_ids = dict(zip(schemas, _free(used | set(index.schemas), len(schemas)), strict=True))
    definitions: list[bytes] = []
    for topic in topics:
        number = schema_ids[topic.schema]
        if number not in index.schemas:
            body = _text(topic.schema) + _text("ros2msg") + _text(topic.definition)
            _define(index, r.SCHEMA, struct.pack("<H", number) + body)
            definitions.append(index.schemas[number])
    channel_ids = _free({*index.channels, *index.counts}, len(topics))
    messages: list[tuple[int, int, bytes]] = []
    for topic, number in zip(topics, channel_ids, strict=True):
        body = _text(topic.topic) + _text("cdr") + _text_map({})
        _define(index, r.CHANNEL, struct.pack("<HH", number, schema_ids[topic.schema]) + body)
        definitions.append(index.channels[number])
        index.counts[number] = len(topic.messages)
        messages += [(time, number, data) for time, data in topic.messages]
    for definition in definitions:
        out.write(definition)
    messages.sort(key=lambda message: message[0])
    if messages:
        (_write_chunk if chunked else _write_messages)(out, index, messages)


def _free(used: Iterable[int], count: int) -> list[int]:
    """Ids that are not used, from the largest down: logs count from 1 up."""
    taken = set(used)
    return [number for number in range(_LARGEST_ID, 0, -1) if number not in taken][:count]


def _message(time: int, channel: int, data: bytes) -> bytes:
    return _record(r.MESSAGE, r.MESSAGE_PREFIX.pack(channel, 0, time, time) + data)


def _write_messages(out: _Output, index: _Index, messages: Sequence[tuple[int, int, bytes]]) -> None:
    for message in messages:
        out.write(_message(*message))
    index.cover(messages[0][0], messages[-1][0])


def _write_chunk(out: _Output, index: _Index, messages: Sequence[tuple[int, int, bytes]]) -> None:
    content, entries = b"", {channel: b"" for _, channel, _ in messages}
    for time, channel, data in messages:
        entries[channel] += struct.pack("<QQ", time, len(content))
        content += _message(time, channel, data)
    head = struct.pack("<QQQI", messages[0][0], messages[-1][0], len(content), zlib.crc32(content))
    head += _text("") + struct.pack("<Q", len(content))
    chunk = _PendingChunk(out.position, len(head) + len(content), head, index)
    out.write(_record(r.CHUNK, head + content))
    for channel, each in entries.items():
        chunk.offsets[channel] = out.position
        out.write(_record(r.MESSAGE_INDEX, struct.pack("<HI", channel, len(each)) + each))
    index.chunks.append(chunk.record(out.position))


def _write_summary(out: _Output, index: _Index) -> None:
    start, out.crc = out.position, 0
    counts = b"".join(struct.pack("<HQ", *item) for item in sorted(index.counts.items()))
    numbers = (len(index.schemas), len(index.channels), len(index.attachments), len(index.metadata), index.num_chunks)
    statistics = struct.pack("<QHIIII", sum(index.counts.values()), *numbers)
    statistics += struct.pack("<QQI", *(index.times or [0, 0]), len(counts)) + counts
    groups = {
        r.SCHEMA: [index.schemas[number] for number in sorted(index.schemas)],
        r.CHANNEL: [index.channels[number] for number in sorted(index.channels)],
        r.STATISTICS: [_record(r.STATISTICS, statistics)],
        r.CHUNK_INDEX: index.chunks,
        r.ATTACHMENT_INDEX: index.attachments,
        r.METADATA_INDEX: index.metadata,
    }
    offsets = []
    for opcode, group in groups.items():
        if group:
            content = b"".join(group)
            offsets.append(_record(r.SUMMARY_OFFSET, struct.pack("<BQQ", opcode, out.position, len(content))))
            out.write(content)
    offset_start = out.position
    out.write(b"".join(offsets))
    head = r.RECORD_PREFIX.pack(r.FOOTER, 20) + struct.pack("<QQ", start, offset_start)
    out.write(head)
    out.write(struct.pack("<I", out.crc))
    out.write(r.MAGIC)


def _record(opcode: int, body: bytes) -> bytes:
    return r.RECORD_PREFIX.pack(opcode, len(body)) + body


def _text(text: str) -> bytes:
    data = text.encode("utf-8")
    return struct.pack("<I", len(data)) + data


def _text_map(values: Mapping[str, str]) -> bytes:
    data = b"".join(_text(key) + _text(value) for key, value in values.items())
    return struct.pack("<I", len(data)) + data
