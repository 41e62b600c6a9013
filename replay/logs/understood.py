"""What each channel of a log was understood as, and what was not, and why: for people, in one line each."""

from typing import Any, Final, NamedTuple

from replay.errors import LogError, printable
from replay.logs.content import PATH_ROLES, Role
from replay.logs.families import FAMILIES
from replay.logs.records import Channel, Log
from replay.logs.topics import Topic, topics_of

_WORDS: Final[dict[Role, str]] = {
    "grid": "map: grid",
    "markers": "map: shapes",
    "polygon": "map: polygons",
    "path": "path",
    "stream": "poses one by one",
    "joints": "joints",
    "transforms": "transforms",
}


class Use(NamedTuple):
    """One channel."""

    role: Role | None
    """What its messages are read as; None if they are not read."""
    text: str
    """What is in them, or why they are not read."""


def uses(log: Log) -> list[Use]:
    """One for each of the log's channels. Every message that can be read is decoded for it."""
    topics = {(topic.name, topic.schema): _used(topic) for topic in topics_of(log)}
    return [_use(log, channel, topics) for channel in log.channels]


def _use(log: Log, channel: Channel, topics: dict[tuple[str, str], Use]) -> Use:
    schema = channel.schema
    if schema is None:
        return Use(None, "not read: its schema is missing" if channel.schema_id else "not read: no schema")
    if schema.name not in FAMILIES:
        return Use(None, "not read: unknown type")
    if not log.counts.get(channel.id):
        return Use(None, "no messages")
    return topics[channel.topic, schema.name]


def _used(topic: Topic) -> Use:
    role = topic.family.role
    sums = [0, 0]
    for index in range(len(topic.messages)):
        try:
            size, most = _size(role, topic.decode(index))
        except LogError as error:
            return Use(None, f"not read: {_reason(topic, error)} [{error.code}]")
        sums = [sums[0] + size, max(sums[1], most)]
    return Use(role, f"{_WORDS[role]}{_amount(role, *sums)}")


def _reason(topic: Topic, error: LogError) -> str:
    """What an error says after the names of the file and the topic."""
    text = error.message.removeprefix(f"{printable(str(topic.log.path))}: ")
    return text.removeprefix(topic.where).lstrip(",: ")


def _size(role: Role, content: Any) -> tuple[int, int]:
    """How much a message holds: added up over all messages, and the most of one."""
    if role == "grid":
        return 0, content.width * content.height
    return (len(content.poses), 0) if role in PATH_ROLES else (len(content), 0)


def _amount(role: Role, total: int, most: int) -> str:
    if role == "grid":
        return f", {most} cells"
    words = {
        "markers": "changes",
        "polygon": "polygons",
        "path": "poses",
        "joints": "states",
        "transforms": "transforms",
    }
    return f", {total} {words[role]}"
