"""The plain data of an MCAP file, and a cursor that reads the fields of one record.

Everything here is bounded: a length that the file states is compared with the bytes that are there
before anything is allocated.
"""

import struct
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

MAGIC: Final = b"\x89MCAP0\r\n"
MIB: Final = 1 << 20
GIB: Final = 1 << 30

HEADER, FOOTER, SCHEMA, CHANNEL, MESSAGE, CHUNK = range(1, 7)
MESSAGE_INDEX, CHUNK_INDEX, ATTACHMENT, ATTACHMENT_INDEX = range(7, 11)
STATISTICS, METADATA, METADATA_INDEX, SUMMARY_OFFSET, DATA_END = range(11, 16)
RECORD_NAMES: Final = (
    "zero", "Header", "Footer", "Schema", "Channel", "Message", "Chunk", "Message Index", "Chunk Index",
    "Attachment", "Attachment Index", "Statistics", "Metadata", "Metadata Index", "Summary Offset", "Data End",
)  # fmt: skip


def record_name(opcode: int) -> str:
    """The format's word for a record, or its number."""
    return RECORD_NAMES[opcode] if opcode < len(RECORD_NAMES) else f"0x{opcode:02x}"


@dataclass(frozen=True, kw_only=True)
class Limits:
    """What one log may cost. The defaults leave room for hours of recording and none for bombs."""

    record: int = 256 * MIB
    """Largest record that is held in memory [bytes]; larger ones are skipped and reported."""
    chunk: int = 64 * MIB
    """Largest chunk after decompression [bytes]."""
    total: int = 2 * GIB
    """Largest sum of all chunks after decompression [bytes]; reading stops there."""
    records: int = 20_000_000
    """Most records of one file, in and outside chunks; reading stops there."""
    kept: int = GIB
    """Most payload of wanted messages that is kept [bytes]."""
    channels: int = 4096
    """Most channels, and most schemas."""


class Malformed(ValueError):
    """The fields of a record do not fit into the record."""


class Schema(NamedTuple):
    """How the messages of a channel are laid out."""

    name: str
    """`pkg/Type` is written `pkg/msg/Type`."""
    encoding: str
    data: bytes


class Channel(NamedTuple):
    """A stream of messages on one topic."""

    id: int
    topic: str
    encoding: str
    schema: Schema | None
    schema_id: int
    """0: the channel has no schema; otherwise `schema` is None only where the log lacks it."""
    qos: str = ""
    """The quality-of-service profiles under which it was offered, as rosbag2 writes them (YAML)."""


class Message(NamedTuple):
    """One message of a wanted channel."""

    channel: Channel
    log_time: int
    """When it was recorded [ns]."""
    data: bytes


class Metadata(NamedTuple):
    """A metadata record; `duplicates` are keys that occur more than once."""

    name: str
    values: Mapping[str, str]
    duplicates: tuple[str, ...]


class Finding(NamedTuple):
    """Something odd about the file. `lost`: messages of the recording are missing because of it."""

    code: str
    text: str
    lost: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class Log:
    """What one MCAP file holds, or the parts of one recording."""

    path: Path
    sha256: str
    """Of the file; for a folder, of a list with one line for each part: its sum, two blanks, its name."""
    size: int
    profile: str
    library: str
    channels: tuple[Channel, ...]
    counts: Mapping[int, int]
    """Messages per channel id, wanted or not."""
    messages: tuple[Message, ...]
    """Of wanted channels, by log time, then in the order of the file."""
    metadata: tuple[Metadata, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def stem(self) -> str:
        """What its cases are called: the file's name without its ending, or the folder's."""
        return self.path.resolve().name if self.path.is_dir() else self.path.stem

    @property
    def lost(self) -> bool:
        """Whether part of the log could not be read."""
        return any(finding.lost for finding in self.findings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line per finding."""
        return tuple(f"{finding.text} [{finding.code}]" for finding in self.findings)


class Cursor:
    """Reads the fields of one record's body, front to back, never past its end."""

    __slots__ = ("data", "end", "pos")

    def __init__(self, data: bytes, start: int = 0, end: int | None = None) -> None:
        self.data = data
        self.pos = start
        self.end = len(data) if end is None else end

    def take(self, count: int, what: str) -> bytes:
        """The next `count` bytes."""
        if count > self.end - self.pos:
            raise Malformed(f"{what} claims {count} bytes, {self.end - self.pos} are left in its record")
        start, self.pos = self.pos, self.pos + count
        return self.data[start : self.pos]

    def u16(self, what: str) -> int:
        """The next unsigned 16-bit integer."""
        return int.from_bytes(self.take(2, what), "little")

    def u32(self, what: str) -> int:
        """The next unsigned 32-bit integer."""
        return int.from_bytes(self.take(4, what), "little")

    def u64(self, what: str) -> int:
        """The next unsigned 64-bit integer."""
        return int.from_bytes(self.take(8, what), "little")

    def blob(self, what: str) -> bytes:
        """Bytes with a 32-bit length before them."""
        return self.take(self.u32(what), what)

    def text(self, what: str) -> str:
        """UTF-8 text with a 32-bit length before it."""
        raw = self.blob(what)
        try:
            return raw.decode("utf-8")
        except UnicodeDecodeError:
            raise Malformed(f"{what} is not UTF-8") from None

    def text_map(self, what: str) -> tuple[dict[str, str], tuple[str, ...]]:
        """A map of texts; of a repeated key the first value stands and the key is named."""
        inner = Cursor(self.blob(what))
        values: dict[str, str] = {}
        duplicates: list[str] = []
        while inner.pos < inner.end:
            key, value = inner.text(f"a key of {what}"), inner.text(f"a value of {what}")
            if key in values:
                duplicates.append(key)
            else:
                values[key] = value
        return values, tuple(duplicates)


RECORD_PREFIX: Final = struct.Struct("<BQ")  # opcode, length of the body
MESSAGE_PREFIX: Final = struct.Struct("<HIQQ")  # channel, sequence number, log time, publish time
