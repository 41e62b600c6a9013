"""A copy of an MCAP log with messages added: its data section byte for byte, then the new records.

The index and the summary at the end of the file are written again, since they state what a file holds. Where the log
has chunks, the new messages are in a chunk too: a reader that uses the index looks into chunks only.
"""

import pathlib
import zlib
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass, field
from typing import BinaryIO, Final

from replay.base.errors import LogError
from replay.logs.container import records as r
from replay.logs.container.compression import BadChunk, unpack_chunk
from replay.logs.container.log import Log, ReadLimits
from replay.logs.container.records import Malformed, Opcode, RecordStream, kinds

_LARGEST_ID: Final = 65535
_BLOCK: Final = 1 << 20
_HEAD: Final = 1 << 16
"""Bytes of a chunk or attachment that are read for its index [bytes]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class NewTopic:
    """Messages of one new channel."""

    topic: str
    schema: str
    """Name of the message type."""
    definition: str
    """Message definition, encoded as `ros2msg`."""
    messages: Sequence[tuple[int, bytes]]
    """Log time [ns] and payload (`cdr`) of each."""


@dataclass(kw_only=True)
class _Index:
    """Statements of the summary about the data section."""

    schemas: dict[int, bytes] = field(default_factory=dict)
    channels: dict[int, bytes] = field(default_factory=dict)
    """The first record of each id, as it is: a later version of the format may have more fields."""
    chunks: list[kinds.ChunkIndex] = field(default_factory=list)
    attachments: list[kinds.AttachmentIndex] = field(default_factory=list)
    metadata: list[kinds.MetadataIndex] = field(default_factory=list)
    times: list[int] = field(default_factory=list)
    """First and last log time [ns]; empty without messages."""
    counts: dict[int, int] = field(default_factory=dict)
    """Messages per channel."""

    def cover(self, *times: int) -> None:
        """Widen the span of `times` by these [ns]."""
        self.times = [min([*self.times, *times]), max([*self.times, *times])]

    def define(self, opcode: int, body: bytes) -> None:
        """Note a Schema or Channel record. Raises Malformed."""
        kind, known = (kinds.Schema, self.schemas) if opcode == Opcode.SCHEMA else (kinds.Channel, self.channels)
        number = r.parsed(kind, RecordStream(body)).id
        known.setdefault(number, r.RECORD_PREFIX.pack(opcode, len(body)) + body)

    def add_chunk(self, at: int, head: bytes, length: int) -> kinds.ChunkIndex:
        """Note a chunk whose body of `length` bytes begins with `head`; give its index, without message indexes."""
        stream = RecordStream(head)
        start, end, size, _ = stream.read8(), stream.read8(), stream.read8(), stream.read4()
        compression, packed = stream.read_prefixed_string(), stream.read8()
        total = r.RECORD_PREFIX.size + length
        self.chunks.append(kinds.ChunkIndex(total, at, compression, packed, end, 0, {}, start, size))
        if size:
            self.cover(start, end)
        return self.chunks[-1]

    def add_attachment(self, at: int, head: bytes, length: int) -> None:
        """Note an attachment whose body of `length` bytes begins with `head`. Raises Malformed."""
        stream = RecordStream(head)
        log_time, create_time = stream.read8(), stream.read8()
        name, media_type = stream.read_prefixed_string(), stream.read_prefixed_string()
        size, total = stream.read8(), r.RECORD_PREFIX.size + length
        self.attachments.append(kinds.AttachmentIndex(at, total, log_time, create_time, size, name, media_type))

    def statistics(self) -> kinds.Statistics:
        """The Statistics record."""
        first, last = self.times or (0, 0)
        return kinds.Statistics(
            message_count=sum(self.counts.values()),
            schema_count=len(self.schemas),
            channel_count=len(self.channels),
            attachment_count=len(self.attachments),
            metadata_count=len(self.metadata),
            chunk_count=len(self.chunks),
            message_start_time=first,
            message_end_time=last,
            channel_message_counts=dict(sorted(self.counts.items())),
        )


def append(log: Log, target: BinaryIO, topics: Sequence[NewTopic], metadata: Mapping[str, Mapping[str, str]]) -> None:
    """Write a copy of a log, and after its records new topics and metadata records.

    Raises LogError (E_EXPORT) where part of the log is lost or damaged: the copy would be damaged too.
    """
    refuse_lost(log)
    index, out = _Index(counts=dict(log.counts)), _Output(target)
    try:
        with log.path.open("rb") as source:
            end = _walk(source, index)
            source.seek(0)
            for start in range(0, end, _BLOCK):
                out.write(source.read(min(_BLOCK, end - start)))
    except (Malformed, BadChunk, EOFError) as error:
        raise LogError("E_EXPORT", log.path, f"it cannot be copied: {error}") from error
    _write_topics(out, index, {channel.schema_id for channel in log.channels}, topics)
    for name, values in metadata.items():
        data = _bytes(kinds.Metadata(name, dict(values)))
        index.metadata.append(kinds.MetadataIndex(out.position, len(data), name))
        out.write(data)
    out.write(_bytes(kinds.DataEnd(out.crc)))
    _write_summary(out, index)


def refuse_lost(log: Log) -> None:
    """Raise LogError (E_EXPORT) where part of a log is lost."""
    if log.lost:
        found = next(finding.text for finding in log.findings if finding.lost)
        raise LogError("E_EXPORT", log.path, f"part of it is damaged, and a copy would be too: {found}")


def write_log(target: BinaryIO, topics: Sequence[NewTopic], metadata: Mapping[str, Mapping[str, str]]) -> None:
    """Write a log of new topics and metadata records alone, in chunks: rosbag2 finds messages by their index."""
    writer = r.Writer(target, compression=r.CompressionType.NONE, enable_data_crcs=True)
    writer.start(profile="ros2", library="")
    schemas = {topic.schema: topic.definition for topic in topics}
    ids = {name: writer.register_schema(name, "ros2msg", text.encode()) for name, text in schemas.items()}
    messages: list[tuple[int, int, bytes]] = []
    for topic in topics:
        channel = writer.register_channel(topic.topic, "cdr", ids[topic.schema])
        messages += [(time, channel, data) for time, data in topic.messages]
    for time, channel, data in sorted(messages, key=lambda message: message[0]):
        writer.add_message(channel, log_time=time, publish_time=time, data=data)
    for name, values in metadata.items():
        writer.add_metadata(name, dict(values))
    writer.finish()


def time_span(path: pathlib.Path) -> list[int]:
    """First and last log time of an undamaged log's messages [ns]; empty where it has none."""
    index = _Index()
    with path.open("rb") as source:
        _walk(source, index)
    return index.times


# ---- what is there


def _walk(source: BinaryIO, index: _Index) -> int:
    """Fill `index` from the data section; return where that ends [bytes]. Raises Malformed, BadChunk, EOFError."""
    source.seek(len(r.MAGIC))
    chunk: kinds.ChunkIndex | None = None
    while True:
        at = source.tell()
        opcode, length = r.RECORD_PREFIX.unpack(_exactly(source, r.RECORD_PREFIX.size))
        if opcode != Opcode.MESSAGE_INDEX and chunk is not None:
            chunk.message_index_length = at - chunk.chunk_start_offset - chunk.chunk_length
            chunk = None
        if opcode == Opcode.DATA_END:
            break
        if opcode == Opcode.CHUNK:
            chunk = index.add_chunk(at, _exactly(source, min(length, _HEAD)), length)
        elif opcode == Opcode.MESSAGE_INDEX and chunk is not None:
            chunk.message_index_offsets[int.from_bytes(_exactly(source, 2), "little")] = at
        else:
            _enter(source, index, at, opcode, length)
        source.seek(at + r.RECORD_PREFIX.size + length)
    if not set(index.counts) <= set(index.channels):  # most writers define channels within chunks
        for each in index.chunks:
            _define_within(source, each, index)
    return at


def _enter(source: BinaryIO, index: _Index, at: int, opcode: int, length: int) -> None:
    """Enter a record outside of chunks into the index; `source` is at its content, `at` is where the record begins."""
    if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
        index.define(opcode, _exactly(source, length))
    elif opcode == Opcode.MESSAGE:
        index.cover(r.MESSAGE_PREFIX.unpack(_exactly(source, r.MESSAGE_PREFIX.size))[2])
    elif opcode == Opcode.ATTACHMENT:
        index.add_attachment(at, _exactly(source, min(length, _HEAD)), length)
    elif opcode == Opcode.METADATA:
        name = r.parsed(kinds.Metadata, RecordStream(_exactly(source, length))).name
        index.metadata.append(kinds.MetadataIndex(at, r.RECORD_PREFIX.size + length, name))


def _define_within(source: BinaryIO, chunk: kinds.ChunkIndex, index: _Index) -> None:
    """Note the schemas and channels that a chunk defines."""
    source.seek(chunk.chunk_start_offset + r.RECORD_PREFIX.size)
    limits = ReadLimits()
    body = _exactly(source, chunk.chunk_length - r.RECORD_PREFIX.size)
    data, _, _ = unpack_chunk(body, limits.chunk, limits.total)
    position = 0
    while position < len(data):
        opcode, size = r.RECORD_PREFIX.unpack_from(data, position)
        position += r.RECORD_PREFIX.size
        if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            index.define(opcode, data[position : position + size])
        position += size


def _exactly(source: BinaryIO, count: int) -> bytes:
    data = source.read(count)
    if len(data) != count:
        raise EOFError("the file ends within a record")
    return data


# ---- what is new


class _Output:
    """Appends to a file; counts its position and the checksum of what was written."""

    def __init__(self, target: BinaryIO) -> None:
        self._target = target
        self.position, self.crc = 0, 0

    def write(self, data: bytes) -> None:
        self._target.write(data)
        self.position += len(data)
        self.crc = zlib.crc32(data, self.crc)


def _bytes(*records: kinds.McapRecord) -> bytes:
    builder = r.RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


def _write_topics(out: _Output, index: _Index, used: set[int], topics: Sequence[NewTopic]) -> None:
    """Write schemas, channels and messages; `used`: ids that channels of the log give as those of their schemas."""
    texts = {topic.schema: topic.definition for topic in topics}
    schema_ids = dict(zip(texts, _free(used | set(index.schemas), len(texts)), strict=True))
    channel_ids = _free({*index.channels, *index.counts}, len(topics))
    messages: list[kinds.Message] = []
    for topic, number in zip(topics, channel_ids, strict=True):
        schema = schema_ids[topic.schema]
        if schema not in index.schemas:
            text = texts[topic.schema].encode()
            index.schemas[schema] = _bytes(kinds.Schema(schema, text, "ros2msg", topic.schema))
            out.write(index.schemas[schema])
        index.channels[number] = _bytes(kinds.Channel(number, topic.topic, "cdr", {}, schema))
        out.write(index.channels[number])
        index.counts[number] = len(topic.messages)
        messages += [kinds.Message(number, time, data, time, 0) for time, data in topic.messages]
    messages.sort(key=lambda message: message.log_time)
    if messages and index.chunks:
        _write_chunk(out, index, messages)
    elif messages:
        out.write(_bytes(*messages))
        index.cover(messages[0].log_time, messages[-1].log_time)


def _free(used: Iterable[int], count: int) -> list[int]:
    """Ids that are not used, from the largest down: logs count from 1 up."""
    taken = set(used)
    return [number for number in range(_LARGEST_ID, 0, -1) if number not in taken][:count]


def _write_chunk(out: _Output, index: _Index, messages: Sequence[kinds.Message]) -> None:
    """Write messages, sorted by time, as one chunk without compression, and their index."""
    entries = {message.channel_id: kinds.MessageIndex(message.channel_id, []) for message in messages}
    builder = r.RecordBuilder()
    for message in messages:
        entries[message.channel_id].records.append((message.log_time, builder.count))
        message.write(builder)
    content = builder.end()
    first, last = messages[0].log_time, messages[-1].log_time
    data = _bytes(kinds.Chunk("", content, last, first, zlib.crc32(content), len(content)))
    body = data[r.RECORD_PREFIX.size :]
    chunk = index.add_chunk(out.position, body, len(body))
    out.write(data)
    start = out.position
    for entry in entries.values():
        chunk.message_index_offsets[entry.channel_id] = out.position
        out.write(_bytes(entry))
    chunk.message_index_length = out.position - start


def _write_summary(out: _Output, index: _Index) -> None:
    start, out.crc = out.position, 0
    groups = {
        Opcode.SCHEMA: b"".join(index.schemas[number] for number in sorted(index.schemas)),
        Opcode.CHANNEL: b"".join(index.channels[number] for number in sorted(index.channels)),
        Opcode.STATISTICS: _bytes(index.statistics()),
        Opcode.CHUNK_INDEX: _bytes(*index.chunks),
        Opcode.ATTACHMENT_INDEX: _bytes(*index.attachments),
        Opcode.METADATA_INDEX: _bytes(*index.metadata),
    }
    offsets: list[kinds.SummaryOffset] = []
    for opcode, group in groups.items():
        if group:
            offsets.append(kinds.SummaryOffset(opcode, out.position, len(group)))
            out.write(group)
    footer = kinds.Footer(start, out.position, 0)
    out.write(_bytes(*offsets))
    footer.summary_crc = zlib.crc32(_bytes(footer)[:-4], out.crc)
    out.write(_bytes(footer) + r.MAGIC)
