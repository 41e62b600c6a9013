"""The schemas and channels of a log, which must never change their meaning."""

from pathlib import Path

from replay.base.errors import LogError
from replay.logs.container.log import Channel, Schema
from replay.logs.container.records import Cursor, Malformed

_QOS = "offered_qos_profiles"  # the key of a channel's metadata under which rosbag2 keeps them


def normalised(name: str) -> str:
    """`pkg/Type` as `pkg/msg/Type`: some writers leave the middle out."""
    parts = name.split("/")
    return f"{parts[0]}/msg/{parts[1]}" if len(parts) == 2 else name


class ChannelTable:
    """What Schema and Channel records of the data section have defined so far."""

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

    def add_schema(self, cursor: Cursor, in_chunk: bool) -> None:
        """Read a Schema record. Raises Malformed, or LogError where it contradicts an earlier one."""
        schema_id, schema = read_schema(cursor)
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

    def add_channel(self, cursor: Cursor, in_chunk: bool) -> Channel | None:
        """Read a Channel record; the channel if it is new. Raises as `add_schema` does."""
        channel = read_channel(cursor, self.schemas)
        known = self.by_id.get(channel.id)
        if known is not None and _meaning(known) != _meaning(channel):
            text = (
                f"channel {channel.id} is topic {known.topic!r} first and later {channel.topic!r} or otherwise encoded"
            )
            raise LogError("E_CHANNEL_CONFLICT", self.path, text)
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
    """What a channel that is defined again must agree in."""
    return channel.topic, channel.encoding, channel.schema_id


def read_schema(cursor: Cursor) -> tuple[int, Schema]:
    """Identifier and content of a Schema record."""
    schema_id = cursor.u16("schema id")
    if schema_id == 0:
        raise Malformed("schema id 0 means 'no schema' and cannot be defined")
    return schema_id, Schema(normalised(cursor.text("name")), cursor.text("encoding"), cursor.blob("definition"))


def read_channel(cursor: Cursor, schemas: dict[int, Schema]) -> Channel:
    """The content of a Channel record."""
    channel_id, schema_id = cursor.u16("channel id"), cursor.u16("schema id")
    topic, encoding = cursor.text("topic"), cursor.text("message encoding")
    metadata, _ = cursor.text_map("metadata")
    return Channel(channel_id, topic, encoding, schemas.get(schema_id), schema_id, metadata.get(_QOS, ""))
