"""One line for each channel of a log: its use and size, or the reason why it is not read."""

from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from replay.base.errors import LogError, printable
from replay.logs.container.log import Channel, Log
from replay.logs.meaning.topics import Topic
from replay.logs.messages import MESSAGE_TYPES
from replay.logs.messages.types import PATH_ROLES, Role

_WORDS: Final[dict[Role, tuple[str, str]]] = {
    "grid": ("map: grid", "cells"),
    "markers": ("map: shapes", "changes"),
    "polygon": ("map: polygons", "polygons"),
    "path": ("path", "poses"),
    "stream": ("poses one by one", "poses"),
    "joints": ("joints", "states"),
    "transforms": ("transforms", "transforms"),
}
"""Name of a role, and of the unit that is counted."""


class Use(NamedTuple):
    """Use of one channel."""

    role: Role | None
    """Use of its messages; None if they are not read."""
    text: str
    """Use and size in words, or the reason why they are not read."""


def uses(log: Log, topics: Sequence[Topic]) -> list[Use]:
    """One for each of the log's channels; `topics` are the log's. Every message that can be read is decoded for it."""
    used = {(topic.name, topic.schema): _used(topic) for topic in topics}
    return [_use(log, channel, used) for channel in log.channels]


def _use(log: Log, channel: Channel, topics: dict[tuple[str, str], Use]) -> Use:
    schema = channel.schema
    if schema is None:
        return Use(None, "not read: its schema is missing" if channel.schema_id else "not read: no schema")
    if schema.name not in MESSAGE_TYPES:
        return Use(None, "not read: unknown type")
    if not log.counts.get(channel.id):
        return Use(None, "no messages")
    return topics[channel.topic, schema.name]


def _used(topic: Topic) -> Use:
    role = topic.message_type.role
    sizes: list[int] = []
    for index in range(len(topic.messages)):
        try:
            sizes.append(_size(role, topic.decode(index)))
        except LogError as error:
            return Use(None, f"not read: {_reason(topic, error)} [{error.code}]")
    what, counted = _WORDS[role]
    amount = max(sizes, default=0) if role == "grid" else sum(sizes)  # each grid replaces the one before
    return Use(role, f"{what}, {amount} {counted}")


def _reason(topic: Topic, error: LogError) -> str:
    """Text of an error after the names of the file and the topic."""
    text = error.message.removeprefix(f"{printable(str(topic.log.path))}: ")
    return text.removeprefix(topic.where).lstrip(",: ")


def _size(role: Role, decoded: Any) -> int:
    """Number of units in one decoded message."""
    if role == "grid":
        return decoded.width * decoded.height
    return len(decoded.poses) if role in PATH_ROLES else len(decoded)
