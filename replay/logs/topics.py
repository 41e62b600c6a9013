"""Which topics of a log hold the map and the paths, and their messages, decoded."""

from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from functools import cached_property
from typing import Any, NoReturn

from replay.errors import LogError, printable
from replay.logs.cdr import CdrError
from replay.logs.layout import LayoutError, matching_layout
from replay.logs.planar import Refusal
from replay.logs.records import Channel, Log, Message
from replay.logs.ros2 import FAMILIES, Family

MAP_ROLES = ("grid", "markers")
EXPORTED = "/replay/"
"""Where paths are that this program itself has written into a copy of a log."""


def is_wanted(channel: Channel) -> bool:
    """Whether a channel may hold a map or a path."""
    return channel.schema is not None and channel.schema.name in FAMILIES


@dataclass(frozen=True, eq=False, kw_only=True)
class Topic:
    """All messages of one type on one topic, from however many channels."""

    log: Log
    name: str
    schema: str
    channels: tuple[Channel, ...]
    messages: tuple[Message, ...]

    @property
    def family(self) -> Family:
        """How its messages are read."""
        return FAMILIES[self.schema]

    @property
    def title(self) -> str:
        """For lists in errors."""
        count = len(self.messages)
        return f"{printable(self.name, 80)} ({self.schema}, {count} message{'s' * (count != 1)})"

    def fail(self, code: str, text: str, index: int | None = None) -> NoReturn:
        """Raise a LogError that names the topic, and the message if `index` is given."""
        where = f"{self.family.role} topic {printable(self.name, 80)!r}"
        if index is not None:
            where += f", message {index}"
        raise LogError(code, self.log.path, f"{where}: {text}")

    @cached_property
    def layout(self) -> int:
        """Which standard definition the messages follow. Raises LogError if it is none, or another encoding."""
        layouts = set()
        for channel in self.channels:
            assert channel.schema is not None, "a topic is made of channels with schemas"
            family, schema = self.family, channel.schema
            if (channel.encoding, schema.encoding) != (family.encoding, family.schema_encoding):
                found = f"{channel.encoding[:40]!r} with {schema.encoding[:40]!r} definitions"
                expected = f"{family.encoding!r} with {family.schema_encoding!r} definitions"
                self.fail("E_ENCODING", f"its messages are encoded as {found}, expected {expected}")
            try:
                layouts.add(matching_layout(self.schema, schema.data, family.standards))
            except LayoutError as error:
                self.fail("E_SCHEMA", f"its definition of {self.schema} is not the standard one: {error}")
        if len(layouts) != 1:
            self.fail("E_SCHEMA", f"its channels define {self.schema} differently")
        return layouts.pop()

    def decode(self, index: int) -> Any:
        """The content of a message, by its place in `messages`. Raises LogError."""
        message = self.messages[index]
        if message.log_time >= 1 << 63:
            self.fail("E_TIME", f"log time {message.log_time} ns is no time", index)
        try:
            return self.family.decode(message.data, self.layout)
        except CdrError as error:
            self.fail("E_PAYLOAD", str(error), index)


def topics_of(log: Log) -> list[Topic]:
    """Topics that may hold a map or a path and have messages, by name."""
    groups: dict[tuple[str, str], list[Channel]] = {}
    for channel in log.channels:
        if channel.schema is not None and is_wanted(channel) and log.counts.get(channel.id):
            groups.setdefault((channel.topic, channel.schema.name), []).append(channel)
    found = []
    for (name, schema), channels in sorted(groups.items()):
        ids = {channel.id for channel in channels}
        messages = tuple(message for message in log.messages if message.channel.id in ids)
        found.append(Topic(log=log, name=name, schema=schema, channels=tuple(channels), messages=messages))
    return found


def choose_map(log: Log, topics: Sequence[Topic], name: str | None) -> Topic:
    """The topic with the map. Raises LogError if there is none, or more than one and no name."""
    candidates = [topic for topic in topics if topic.family.role in MAP_ROLES]
    if not candidates:
        raise LogError("E_NO_MAP", log.path, _nothing(log, "map", MAP_ROLES))
    if name is not None:
        return _named(log, candidates, name, "--map-topic")
    if len(candidates) > 1:
        text = f"{len(candidates)} topics hold a map: {titles(candidates)}; choose one with --map-topic"
        raise LogError("E_AMBIGUOUS", log.path, text)
    return candidates[0]


def choose_paths(
    log: Log, topics: Sequence[Topic], truck: str | None, trailer: str | None
) -> tuple[list[Topic], list[Topic]]:
    """Topics that may be the truck's path, and topics that may be the trailer's. Raises LogError if there is none."""
    candidates = [topic for topic in topics if topic.family.role == "path"]
    if not candidates:
        if any(channel.schema is None and channel.schema_id for channel in log.channels):
            text = _nothing(log, "path", ("path",)) + "; some topics refer to schemas that are missing"
            raise LogError("E_NO_SCHEMA", log.path, text)
        raise LogError("E_NO_PATH", log.path, _nothing(log, "path", ("path",)))
    likely = _beside(candidates, truck)
    trailers = likely if trailer is None else [_named(log, candidates, trailer, "--trailer-topic")]
    trucks = likely if truck is None else [_named(log, candidates, truck, "--path-topic")]
    if trailer is not None:
        trucks = [topic for topic in trucks if topic is not trailers[0]]
    if not trucks:
        raise LogError(
            "E_AMBIGUOUS",
            log.path,
            f"topic {printable(trailer)!r} is the only path; it cannot be the trailer's",
        )
    return trucks, trailers


def _beside(candidates: list[Topic], truck: str | None) -> list[Topic]:
    """Recorded paths, unless an exported one was asked for: then the exported ones of the same method."""
    folder = truck.rpartition("/")[0] + "/" if truck is not None and truck.startswith(EXPORTED) else ""
    if folder:
        return [topic for topic in candidates if topic.name.startswith(folder)] or candidates
    return [topic for topic in candidates if not topic.name.startswith(EXPORTED)] or candidates


def titles(topics: Iterable[Topic]) -> str:
    """A list for an error."""
    return ", ".join(topic.title for topic in topics)


def _named(log: Log, candidates: Sequence[Topic], name: str, option: str) -> Topic:
    for topic in candidates:
        if topic.name == name:
            return topic
    text = f"{option} {printable(name)!r} is none of the topics that could be meant: {titles(candidates)}"
    raise LogError("E_NO_TOPIC", log.path, text)


def _nothing(log: Log, what: str, roles: Sequence[str]) -> str:
    schemas = ", ".join(name for name, family in FAMILIES.items() if family.role in roles)
    text = f"no {what} in this log; expected messages of {schemas}"
    present = [c for c in log.channels if log.counts.get(c.id)]
    if present:
        shown = [f"{printable(c.topic, 60)} ({c.schema.name[:60] if c.schema else 'no schema'})" for c in present[:6]]
        text += f"; it holds {', '.join(shown)}" + (f" and {len(present) - 6} more topics" if len(present) > 6 else "")
    else:
        text += "; it holds no messages"
    lost = next((finding.text for finding in log.findings if finding.lost), None)
    return text + (f"; part of the log was lost: {lost}" if lost else "")


def refused(topic: Topic, index: int, error: Refusal) -> NoReturn:
    """Raise what was refused about a message as a LogError."""
    topic.fail(error.code, str(error), index)
