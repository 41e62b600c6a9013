"""The topics of a log with their decoded messages, and the choice of those with the map and the paths."""

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any, NoReturn

import numpy as np

from optim.numerics.arrays import frozen, frozen_int
from replay.base.errors import LogError, printable
from replay.logs.container.log import Channel, Log, Message
from replay.logs.meaning.planar import Refusal
from replay.logs.messages import MESSAGE_TYPES
from replay.logs.messages.types import (
    MAP_ROLES,
    PATH_ROLES,
    Decode,
    DefinitionError,
    Grid,
    MessageType,
    PayloadError,
    PoseSeries,
    Role,
)

EXPORTED = "/replay/"
"""Topic prefix of paths that this program wrote into a copy of a log."""


KEPT_BYTES = 128 << 20
"""Decoded messages of one log are kept up to this estimated size, so that each message is decoded once."""
_OBJECT_BYTES = 1000
"""Estimated size of a decoded message or part without its arrays."""


def is_wanted(channel: Channel) -> bool:
    """True if the messages of a channel are of a type that is understood."""
    return channel.schema is not None and channel.schema.name in MESSAGE_TYPES


class DecodedMessages:
    """Decoded messages, and the errors of those that cannot be decoded, by topic, type and number; bounded in size."""

    def __init__(self) -> None:
        self._found: dict[tuple[str, str, int], Any] = {}
        self._bytes_left = KEPT_BYTES

    def get(self, key: tuple[str, str, int], decode: Callable[[], Any]) -> Any:
        """The result of `decode` for a message; raises its LogError. `decode` is called again only beyond the bound."""
        found = self._found.get(key)
        if found is None:
            try:
                found = decode()
            except LogError as error:
                found = error
            self._bytes_left -= _bytes_of(found)
            if self._bytes_left > 0:
                self._found[key] = found
        if isinstance(found, LogError):
            raise found
        return found


def _bytes_of(decoded: Any) -> int:
    """Estimated size of a decoded message."""
    if isinstance(decoded, Grid):
        return _OBJECT_BYTES + decoded.data.nbytes
    if isinstance(decoded, PoseSeries):
        return _OBJECT_BYTES + decoded.poses.nbytes + decoded.stamps.nbytes
    if isinstance(decoded, tuple):
        return sum(_OBJECT_BYTES + getattr(part, "points", _NO_POINTS).nbytes for part in decoded)
    return _OBJECT_BYTES


_NO_POINTS = np.empty((0, 3))


@dataclass(frozen=True, eq=False, kw_only=True)
class Topic:
    """All messages of one type on one topic, from however many channels."""

    log: Log
    name: str
    schema: str
    channels: tuple[Channel, ...]
    messages: tuple[Message, ...]
    decoded: DecodedMessages = field(default_factory=DecodedMessages)
    """Shared by all topics of a log."""

    @property
    def message_type(self) -> MessageType:
        """Type of its messages."""
        return MESSAGE_TYPES[self.schema]

    @property
    def title(self) -> str:
        """Name, type and size, for lists in errors."""
        count = self.num_logged
        return f"{printable(self.name, 80)} ({self.schema}, {count} message{'s' * (count != 1)})"

    @property
    def num_logged(self) -> int:
        """Number of its messages in the log."""
        return len(self.messages)

    @property
    def where(self) -> str:
        """First words of its errors."""
        role = "pose" if self.message_type.role == "stream" else self.message_type.role
        return f"{role} topic {printable(self.name, 80)!r}"

    def fail(self, code: str, text: str, index: int | None = None) -> NoReturn:
        """Raise a LogError that names the topic, and the message if `index` is given."""
        where = self.where
        if index is not None:
            where += f", message {index}"
        raise LogError(code, self.log.path, f"{where}: {text}")

    @cached_property
    def _decoders(self) -> dict[int, Decode]:
        """The decoder of each channel. Raises LogError for an encoding or message definition that is not read."""
        return {channel.id: self._decoder(channel) for channel in self.channels}

    def _decoder(self, channel: Channel) -> Decode:
        schema, kind = channel.schema, self.message_type
        assert schema is not None, "a topic is made of channels with schemas"
        encodings = channel.encoding, schema.encoding
        if encodings not in kind.encodings:
            found = f"{encodings[0][:40]!r} with {encodings[1][:40]!r} definitions"
            expected = " or ".join(f"{message!r} with {each!r}" for message, each in kind.encodings)
            self.fail("E_ENCODING", f"its messages are encoded as {found}, expected {expected} definitions")
        try:
            return kind.decoder(encodings, schema.data)
        except DefinitionError as error:
            self.fail("E_SCHEMA", f"its definition of {self.schema} is not the standard one: {error}")

    def decode(self, index: int) -> Any:
        """The decoded message of a number in `messages`. Raises LogError."""
        return self.decoded.get((self.name, self.schema, index), lambda: self._decode(index))

    def _decode(self, index: int) -> Any:
        message = self.messages[index]
        if message.log_time >= 1 << 63:
            self.fail("E_TIME", f"log time {message.log_time} ns is not a time", index)
        decode = self._decoders[message.channel.id]
        try:
            return decode(message.data)
        except PayloadError as error:
            self.fail("E_PAYLOAD", str(error), index)


@dataclass(frozen=True, eq=False, kw_only=True)
class Stream(Topic):
    """A topic of single poses, read as one path: its only message is the last of them."""

    each: Topic
    """The topic itself."""

    @property
    def num_logged(self) -> int:
        """Number of its messages in the log."""
        return self.each.num_logged

    def decode(self, index: int) -> PoseSeries:
        """All poses, by the time of their stamps, else of the log. Raises LogError."""
        return self._joined

    @cached_property
    def _joined(self) -> PoseSeries:
        series: list[PoseSeries] = [self.each.decode(i) for i in range(len(self.each.messages))]
        stamps = np.concatenate([one.stamps for one in series])
        if not stamps.any():
            stamps = np.array([message.log_time for message in self.each.messages], np.int64)
        speeds = [one.speed for one in series if one.speed is not None]
        return PoseSeries(
            header=series[0].header,
            stamps=frozen_int(stamps),
            poses=frozen(np.concatenate([one.poses for one in series])),
            frames=frozenset(one.header.frame for one in series),
            speed=frozen(np.concatenate(speeds)) if len(speeds) == len(series) else None,
        )


def _as_path(topic: Topic) -> Topic:
    if topic.message_type.role != "stream":
        return topic
    return Stream(
        log=topic.log,
        name=topic.name,
        schema=topic.schema,
        channels=topic.channels,
        messages=topic.messages[-1:],
        each=topic,
    )


def topics_of(log: Log) -> list[Topic]:
    """Topics that may hold a map or a path and have messages, by name."""
    groups: dict[tuple[str, str], list[Channel]] = {}
    for channel in log.channels:
        if channel.schema is not None and is_wanted(channel) and log.counts.get(channel.id):
            groups.setdefault((channel.topic, channel.schema.name), []).append(channel)
    found, decoded = [], DecodedMessages()
    for (name, schema), channels in sorted(groups.items()):
        ids = {channel.id for channel in channels}
        messages = tuple(message for message in log.messages if message.channel.id in ids)
        found.append(
            Topic(log=log, name=name, schema=schema, channels=tuple(channels), messages=messages, decoded=decoded)
        )
    return found


def choose_map(log: Log, topics: Sequence[Topic], name: str | None) -> Topic:
    """The topic with the map. Raises LogError if there is none, or more than one and no name."""
    candidates = [topic for topic in topics if topic.message_type.role in MAP_ROLES]
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
    paths = [topic for topic in topics if topic.message_type.role == "path"]
    streams = [topic for topic in topics if topic.message_type.role == "stream" and len(topic.messages) > 1]
    named = (truck, trailer)  # beside paths, streams are used only where an option names one
    candidates = [_as_path(topic) for topic in paths + [each for each in streams if not paths or each.name in named]]
    if not candidates:
        if any(channel.schema is None and channel.schema_id for channel in log.channels):
            text = _nothing(log, "path", PATH_ROLES) + "; some topics refer to schemas that are missing"
            raise LogError("E_NO_SCHEMA", log.path, text)
        raise LogError("E_NO_PATH", log.path, _nothing(log, "path", PATH_ROLES))
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


def _nothing(log: Log, what: str, roles: Sequence[Role]) -> str:
    schemas = ", ".join(name for name, kind in MESSAGE_TYPES.items() if kind.role in roles)
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
