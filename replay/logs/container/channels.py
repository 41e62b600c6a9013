"""The schemas and channels of a log, which must never change their meaning."""

from pathlib import Path

from replay.base.errors import LogError
from replay.logs.container import records as r
from replay.logs.container.log import Channel, Schema
from replay.logs.container.records import Malformed, RecordStream

_QOS = "offered_qos_profiles"  # the key of a channel's metadata under which rosbag2 keeps them


def normalised(name: str) -> str:
    """`pkg/Type` as `pkg/msg/Type`: some writers omit the middle."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


class ChannelTable:
    """Table of the schemas and channels that the data section has defined so far."""

    def __init__(self, path: Path, limit: int) -> None:
        self.path = path
        self.limit = limit
        self.schemas: dict[int, Schema] = {}
        self.by_id: dict[int, Channel] = {}
        self.outside_chunks: set[int] = set()
        """Channels that no chunk defines, or whose schema none does."""
        self._loose_schemas: set[int] = set()

    @property
    def channels(self) -> tuple[Channel, ...]:
        """All channels, by id."""
        return tuple(self.by_id[i] for i in sorted(self.by_id))

    def add_schema(self, stream: RecordStream, in_chunk: bool) -> None:
        """Read a Schema record. Raises Malformed, or LogError where it contradicts an earlier one."""
        schema_id, schema = read_schema(stream)
        known = self.schemas.setdefault(schema_id, schema)
        if known != schema:
            text = f"schema {schema_id} is {known.name!r} first and later {schema.name!r} with another definition"
            raise LogError("E_SCHEMA_CONFLICT", self.path, text)
        if len(self.schemas) > self.limit:
            raise LogError("E_TOO_MANY_CHANNELS", self.path, f"more than {self.limit} schemas")
        if in_chunk:
            self._loose_schemas.discard(schema_id)
        elif known is schema:
            self._loose_schemas.add(schema_id)

    def add_channel(self, stream: RecordStream, in_chunk: bool) -> Channel | None:
        """Read a Channel record; the channel if it is new. Raises as `add_schema` does."""
        channel = read_channel(stream, self.schemas)
        known = self.by_id.get(channel.id)
        if known is not None and _meaning(known) != _meaning(channel):
            text = f"channel {channel.id} is topic {known.topic!r} first and later {channel.topic!r}"
            raise LogError("E_CHANNEL_CONFLICT", self.path, f"{text} or otherwise encoded")
        if in_chunk and channel.schema_id not in self._loose_schemas:
            self.outside_chunks.discard(channel.id)
        elif known is None:
            self.outside_chunks.add(channel.id)
        if known is not None:
            return None
        self.by_id[channel.id] = channel
        if len(self.by_id) > self.limit:
            raise LogError("E_TOO_MANY_CHANNELS", self.path, f"more than {self.limit} channels")
        return channel


def _meaning(channel: Channel) -> tuple[object, ...]:
    """The fields in which two records of one channel must agree."""
    return channel.topic, channel.encoding, channel.schema_id


def read_schema(stream: RecordStream) -> tuple[int, Schema]:
    """Identifier and content of a Schema record. Raises Malformed."""
    schema = r.parsed(r.kinds.Schema, stream)
    if schema.id == 0:
        raise Malformed("schema id 0 means 'no schema' and cannot be defined")
    return schema.id, Schema(normalised(schema.name), schema.encoding, schema.data)


def read_channel(stream: RecordStream, schemas: dict[int, Schema]) -> Channel:
    """The content of a Channel record. Raises Malformed."""
    found = r.parsed(r.kinds.Channel, stream)
    metadata, _ = stream.last_map(before=2)
    schema = schemas.get(found.schema_id)
    return Channel(found.id, found.topic, found.message_encoding, schema, found.schema_id, metadata.get(_QOS, ""))
