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
from replay.logs.container.records import Malformed, Opcode, RecordStream

_LARGEST_ID: Final = 65535
_BLOCK: Final = 1 << 20
_MOST_HEAD: Final = 1 << 16
"""Most bytes of a chunk or attachment that are read for its index [bytes]."""


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


@dataclass
class _Copied(r.McapRecord):
    """A record as the log has it: a later version of the format may have more fields."""

    opcode: Opcode
    body: bytes

    def write(self, stream: r.RecordBuilder) -> None:
        """Append the record."""
        stream.start_record(self.opcode)
        stream.write(self.body)
        stream.finish_record()


@dataclass(kw_only=True)
class _Index:
    """What the summary states about the data section."""

    schemas: dict[int, r.McapRecord] = field(default_factory=dict)
    channels: dict[int, r.McapRecord] = field(default_factory=dict)
    """The first record of each id."""
    chunks: list[r.ChunkIndex] = field(default_factory=list)
    attachments: list[r.AttachmentIndex] = field(default_factory=list)
    metadata: list[r.MetadataIndex] = field(default_factory=list)
    times: list[int] = field(default_factory=list)
    """First and last log time [ns]; empty without messages."""
    counts: dict[int, int] = field(default_factory=dict)
    """Messages per channel."""

    def cover(self, *times: int) -> None:
        """Widen the span of `times` by these [ns]."""
        self.times = [min([*self.times, *times]), max([*self.times, *times])]

    def define(self, opcode: int, body: bytes) -> None:
        """Note a Schema or Channel record. Raises Malformed."""
        if opcode == Opcode.SCHEMA:
            number, known = r.parsed(r.Schema, RecordStream(body)).id, self.schemas
        else:
            number, known = r.parsed(r.Channel, RecordStream(body)).id, self.channels
        known.setdefault(number, _Copied(Opcode(opcode), body))

    def add_chunk(self, index: r.ChunkIndex) -> None:
        """Note a chunk; its message indexes may follow."""
        self.chunks.append(index)
        if index.uncompressed_size:
            self.cover(index.message_start_time, index.message_end_time)

    def statistics(self) -> r.Statistics:
        """The Statistics record."""
        first, last = self.times or (0, 0)
        return r.Statistics(
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
    index = _Index(counts=dict(log.counts))
    try:
        with log.path.open("rb") as source:
            end = _walk(source, index)
            source.seek(0)
            out = _Output(target)
            for start in range(0, end, _BLOCK):
                out.write(source.read(min(_BLOCK, end - start)))
    except (Malformed, BadChunk, EOFError) as error:
        raise LogError("E_EXPORT", log.path, f"it cannot be copied: {error}") from error
    _write_topics(out, index, {channel.schema_id for channel in log.channels}, topics)
    _write_metadata(out, index, metadata)
    out.add(r.DataEnd(out.crc))
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
    open_chunk: r.ChunkIndex | None = None
    while True:
        at = source.tell()
        opcode, length = r.RECORD_PREFIX.unpack(_exactly(source, r.RECORD_PREFIX.size))
        if opcode != Opcode.MESSAGE_INDEX and open_chunk is not None:
            _close(open_chunk, at)
            open_chunk = None
        if opcode == Opcode.DATA_END:
            break
        if opcode == Opcode.CHUNK:
            open_chunk = _chunk_index(_exactly(source, min(length, _MOST_HEAD)), at, length)
            index.add_chunk(open_chunk)
        elif opcode == Opcode.MESSAGE_INDEX and open_chunk is not None:
            open_chunk.message_index_offsets[int.from_bytes(_exactly(source, 2), "little")] = at
        elif opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
            index.define(opcode, _exactly(source, length))
        elif opcode == Opcode.MESSAGE:
            index.cover(r.MESSAGE_PREFIX.unpack(_exactly(source, r.MESSAGE_PREFIX.size))[2])
        elif opcode == Opcode.ATTACHMENT:
            index.attachments.append(_attachment_index(_exactly(source, min(length, _MOST_HEAD)), at, length))
        elif opcode == Opcode.METADATA:
            name = r.parsed(r.Metadata, RecordStream(_exactly(source, length))).name
            index.metadata.append(r.MetadataIndex(at, r.RECORD_PREFIX.size + length, name))
        source.seek(at + r.RECORD_PREFIX.size + length)
    if not set(index.counts) <= set(index.channels):  # most writers define channels within chunks
        for chunk in index.chunks:
            _define_within(source, chunk, index)
    return at


def _chunk_index(head: bytes, at: int, length: int) -> r.ChunkIndex:
    """The index of a chunk whose body begins with `head`; its message indexes are still to come. Raises Malformed."""
    stream = RecordStream(head)
    start, end, size, _ = stream.read8(), stream.read8(), stream.read8(), stream.read4()
    compression, packed = stream.read_prefixed_string(), stream.read8()
    return r.ChunkIndex(
        message_start_time=start,
        message_end_time=end,
        chunk_start_offset=at,
        chunk_length=r.RECORD_PREFIX.size + length,
        message_index_offsets={},
        message_index_length=0,
        compression=compression,
        compressed_size=packed,
        uncompressed_size=size,
    )


def _close(index: r.ChunkIndex, end: int) -> None:
    """Note the position at which a chunk's message indexes end."""
    index.message_index_length = end - index.chunk_start_offset - index.chunk_length


def _define_within(source: BinaryIO, chunk: r.ChunkIndex, index: _Index) -> None:
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


def _attachment_index(head: bytes, at: int, length: int) -> r.AttachmentIndex:
    """The index of an attachment whose body begins with `head`. Raises Malformed."""
    stream = RecordStream(head)
    log_time, create_time = stream.read8(), stream.read8()
    name, media_type = stream.read_prefixed_string(), stream.read_prefixed_string()
    return r.AttachmentIndex(
        offset=at,
        length=r.RECORD_PREFIX.size + length,
        log_time=log_time,
        create_time=create_time,
        data_size=stream.read8(),
        name=name,
        media_type=media_type,
    )


def _exactly(source: BinaryIO, count: int) -> bytes:
    data = source.read(count)
    if len(data) != count:
        raise EOFError("the file ends within a record")
    return data


# ---- what is new


def _bytes(*records: r.McapRecord) -> bytes:
    builder = r.RecordBuilder()
    for record in records:
        record.write(builder)
    return builder.end()


class _Output:
    """Appends to a file; counts its position and the checksum of what was written."""

    def __init__(self, target: BinaryIO) -> None:
        self._target = target
        self.position, self.crc = 0, 0

    def write(self, data: bytes) -> None:
        self._target.write(data)
        self.position += len(data)
        self.crc = zlib.crc32(data, self.crc)

    def add(self, *records: r.McapRecord) -> None:
        """Write records."""
        self.write(_bytes(*records))


def _write_topics(out: _Output, index: _Index, used: set[int], topics: Sequence[NewTopic]) -> None:
    """Write schemas, channels and messages; `used`: ids that channels of the log give as those of their schemas."""
    definitions = {topic.schema: topic.definition for topic in topics}
    ids = _free(used | set(index.schemas), len(definitions))
    schemas = {
        name: r.Schema(id=number, name=name, encoding="ros2msg", data=text.encode())
        for number, (name, text) in zip(ids, definitions.items(), strict=True)
    }
    index.schemas |= {schema.id: schema for schema in schemas.values()}
    messages: list[r.Message] = []
    written: list[r.McapRecord] = []
    for topic, number in zip(topics, _free({*index.channels, *index.counts}, len(topics)), strict=True):
        schema = schemas[topic.schema]
        if schema not in written:
            written.append(schema)
        channel = r.Channel(id=number, topic=topic.topic, message_encoding="cdr", metadata={}, schema_id=schema.id)
        written.append(channel)
        index.channels[number] = channel
        index.counts[number] = len(topic.messages)
        messages += [
            r.Message(channel_id=number, log_time=time, publish_time=time, sequence=0, data=data)
            for time, data in topic.messages
        ]
    out.add(*written)
    messages.sort(key=lambda message: message.log_time)
    if messages and index.chunks:
        _write_chunk(out, index, messages)
    elif messages:
        out.add(*messages)
        index.cover(messages[0].log_time, messages[-1].log_time)


def _free(used: Iterable[int], count: int) -> list[int]:
    """Ids that are not used, from the largest down: logs count from 1 up."""
    taken = set(used)
    return [number for number in range(_LARGEST_ID, 0, -1) if number not in taken][:count]


def _write_chunk(out: _Output, index: _Index, messages: Sequence[r.Message]) -> None:
    """Write messages, sorted by time, as one chunk without compression, and their index."""
    entries = {message.channel_id: r.MessageIndex(message.channel_id, []) for message in messages}
    builder = r.RecordBuilder()
    for message in messages:
        entries[message.channel_id].records.append((message.log_time, builder.count))
        message.write(builder)
    content = builder.end()
    chunk = r.Chunk(
        compression="",
        data=content,
        message_start_time=messages[0].log_time,
        message_end_time=messages[-1].log_time,
        uncompressed_crc=zlib.crc32(content),
        uncompressed_size=len(content),
    )
    data = _bytes(chunk)
    head = data[r.RECORD_PREFIX.size :][:_MOST_HEAD]
    new = _chunk_index(head, out.position, len(data) - r.RECORD_PREFIX.size)
    out.write(data)
    for entry in entries.values():
        new.message_index_offsets[entry.channel_id] = out.position
        out.add(entry)
    _close(new, out.position)
    index.add_chunk(new)


def _write_metadata(out: _Output, index: _Index, metadata: Mapping[str, Mapping[str, str]]) -> None:
    for name, values in metadata.items():
        data = _bytes(r.Metadata(name, dict(values)))
        index.metadata.append(r.MetadataIndex(out.position, len(data), name))
        out.write(data)


def _write_summary(out: _Output, index: _Index) -> None:
    start, out.crc = out.position, 0
    groups: dict[Opcode, Sequence[r.McapRecord]] = {
        Opcode.SCHEMA: [index.schemas[number] for number in sorted(index.schemas)],
        Opcode.CHANNEL: [index.channels[number] for number in sorted(index.channels)],
        Opcode.STATISTICS: [index.statistics()],
        Opcode.CHUNK_INDEX: index.chunks,
        Opcode.ATTACHMENT_INDEX: index.attachments,
        Opcode.METADATA_INDEX: index.metadata,
    }
    offsets = []
    for opcode, group in groups.items():
        if group:
            at = out.position
            out.add(*group)
            offsets.append(r.SummaryOffset(opcode, at, out.position - at))
    offset_start = out.position
    out.add(*offsets)
    footer = r.Footer(start, offset_start, 0)
    footer.summary_crc = zlib.crc32(_bytes(footer)[:-4], out.crc)
    out.add(footer)
    out.write(r.MAGIC)
