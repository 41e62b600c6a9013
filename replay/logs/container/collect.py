"""Collection of the records of the data section: channels, counts, and wanted messages."""

from collections import Counter
from collections.abc import Callable
from pathlib import Path
from typing import NamedTuple

from replay.base.errors import LogError, printable
from replay.logs.container import records as r
from replay.logs.container.channels import ChannelTable
from replay.logs.container.log import Channel, Findings, Message, Metadata, ReadLimits
from replay.logs.container.records import Malformed, Opcode, RecordStream


class _Loose(NamedTuple):
    """A message outside chunks, waiting for the verdict on the data section."""

    channel: Channel
    log_time: int
    data: bytes | None


class Collector:
    """Takes the records one by one, in the order of the file."""

    def __init__(self, path: Path, wanted: Callable[[Channel], bool], limits: ReadLimits, findings: Findings) -> None:
        self.path = path
        self.limits = limits
        self.findings = findings
        self.table = ChannelTable(path, limits.channels)
        self.counts: Counter[int] = Counter()
        self.messages: list[Message] = []
        self.metadata: list[Metadata] = []
        self.num_records = 0
        self._wanted = wanted
        self._is_wanted: dict[int, bool] = {}
        self._loose: list[_Loose] = []
        self._orphans: set[int] = set()
        self._kept_bytes = 0

    # ---- records outside chunks

    def add(self, opcode: int, stream: RecordStream, *, in_chunk: bool = False) -> None:
        """A Schema, Channel, Message, or else a Metadata record. Raises Malformed, LogError."""
        if opcode == Opcode.SCHEMA:
            self.table.add_schema(stream, in_chunk)
        elif opcode == Opcode.CHANNEL:
            self._add_channel(stream, in_chunk)
        elif opcode == Opcode.MESSAGE:
            self._add_loose(stream)
        else:
            self._add_metadata(stream)

    def _add_metadata(self, stream: RecordStream) -> None:
        name = r.parsed(r.kinds.Metadata, stream).name
        values, duplicates = stream.last_map(before=1)
        if duplicates:
            self.findings.add("W_METADATA", f"metadata record {name!r} repeats the key {duplicates[0]!r}")
        self.metadata.append(Metadata(name, values, duplicates))

    def _add_channel(self, stream: RecordStream, in_chunk: bool) -> None:
        channel = self.table.add_channel(stream, in_chunk)
        if channel is None:
            return
        self._is_wanted[channel.id] = self._wanted(channel)
        topic = printable(channel.topic, 60)
        if not channel.topic.isprintable() or len(channel.topic) > 256 or ".." in channel.topic.split("/"):
            self.findings.add("W_TOPIC", f"odd topic name {topic!r}")
        if channel.schema is None and channel.schema_id:
            text = f"topic {topic!r}: its schema {channel.schema_id} is missing"
            self.findings.add("W_NO_SCHEMA", text, lost=True)

    def _add_loose(self, stream: RecordStream) -> None:
        prefix = stream.read(r.MESSAGE_PREFIX.size)
        channel_id, _, log_time, _ = r.MESSAGE_PREFIX.unpack(prefix)
        channel = self._known_channel(channel_id)
        if channel is not None:
            data = stream.rest() if self._is_wanted[channel_id] else None
            self._count_bytes(len(data or b""))
            self._loose.append(_Loose(channel, log_time, data))

    def _known_channel(self, channel_id: int) -> Channel | None:
        channel = self.table.by_id.get(channel_id)
        if channel is None and channel_id not in self._orphans:
            self._orphans.add(channel_id)
            text = f"messages refer to channel {channel_id}, which is not defined"
            self.findings.add("W_NO_CHANNEL", text, lost=True)
        return channel

    # ---- chunks

    def add_chunk(self, data: bytes, number: int) -> None:
        """Add all records of a chunk, or none: its framing is checked to the end first.

        Raises:
            Malformed: the framing is broken.
        """
        found: list[tuple[int, int, int]] = []
        pos, end, prefix = 0, len(data), r.RECORD_PREFIX
        while pos < end:
            if end - pos < prefix.size:
                raise Malformed(f"{end - pos} bytes after its last record")
            opcode, length = prefix.unpack_from(data, pos)
            pos += prefix.size
            if length > end - pos:
                raise Malformed(f"a {r.record_name(opcode)} in it claims {length} bytes, {end - pos} are left")
            if opcode == 0 and length == 0:
                raise Malformed("zeros where a record should begin")
            found.append((opcode, pos, pos + length))
            pos += length
        self.num_records += len(found)
        message = int(Opcode.MESSAGE)
        for opcode, start, stop in found:
            if opcode == message and stop - start >= r.MESSAGE_PREFIX.size:
                self._add_chunk_message(data, start, stop)
            else:
                self._add_other(opcode, data, start, stop, number)

    def _add_chunk_message(self, data: bytes, start: int, stop: int) -> None:
        channel_id, _, log_time, _ = r.MESSAGE_PREFIX.unpack_from(data, start)
        wanted = self._is_wanted.get(channel_id)
        if wanted is False:
            self.counts[channel_id] += 1
        elif wanted is None:
            self._known_channel(channel_id)
        else:
            self._count_bytes(stop - start)
            payload = data[start + r.MESSAGE_PREFIX.size : stop]
            self._keep(self.table.by_id[channel_id], log_time, payload)

    def _add_other(self, opcode: int, data: bytes, start: int, stop: int, number: int) -> None:
        try:
            if opcode in (Opcode.SCHEMA, Opcode.CHANNEL):
                self.add(opcode, RecordStream(data, start, stop), in_chunk=True)
            elif opcode == Opcode.MESSAGE:
                raise Malformed(f"{stop - start} bytes are less than its header")
            elif opcode <= Opcode.DATA_END:
                raise Malformed("such a record may not stand inside a chunk")
        except Malformed as error:
            text = f"{r.record_name(opcode)} in chunk {number} is skipped: {error}"
            self.findings.add("W_CORRUPT_RECORD", text, lost=opcode == Opcode.MESSAGE)

    # ---- messages

    def _count_bytes(self, size: int) -> None:
        self._kept_bytes += size
        if self._kept_bytes > self.limits.kept:
            text = f"maps and paths take more than {self.limits.kept >> 20} MiB in this log; cut it into parts"
            raise LogError("E_TOO_LARGE", self.path, text)

    def _keep(self, channel: Channel, log_time: int, data: bytes | None) -> None:
        self.counts[channel.id] += 1
        if data is not None:
            self.messages.append(Message(channel, log_time, data))

    def settle(self, *, verified: bool | None, doubtful: bool) -> None:
        """Decide about what lies outside chunks, when the whole file has been read.

        verified: the checksum of the data section holds, or does not, or is not there (None).
        doubtful: without a checksum, messages outside chunks do not count.
        """
        if verified or (verified is None and not doubtful):
            for message in self._loose:
                self._keep(*message)
            if doubtful and self._loose:
                self.findings.add("W_UNINDEXED", f"{len(self._loose)} messages lie outside chunks; they are used")
        elif self._loose:
            text = f"{len(self._loose)} messages outside chunks are dropped: no checksum vouches for them"
            self.findings.add("W_UNVERIFIED", text, lost=True)
        if verified is False:
            self._drop_loose_channels()

    def _drop_loose_channels(self) -> None:
        """Messages whose topic or type stands outside chunks, where something is wrong."""
        suspects = [self.table.by_id[i] for i in sorted(self.table.outside_chunks)]
        dropped = [channel for channel in suspects if self.counts.pop(channel.id, 0)]
        if dropped:
            ids = {channel.id for channel in dropped}
            self.messages = [message for message in self.messages if message.channel.id not in ids]
            topic = printable(dropped[0].topic, 60)
            text = f"topic {topic!r} is dropped: it is defined outside chunks, where the checksum is wrong"
            self.findings.add("W_UNVERIFIED", text, lost=True)
