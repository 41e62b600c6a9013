"""The plain data of an MCAP file: channels, messages, metadata, and the findings about damage."""

from collections import Counter
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Final, NamedTuple

from replay.base.errors import printable

MIB: Final = 1 << 20
GIB: Final = 1 << 30


@dataclass(frozen=True, kw_only=True)
class ReadLimits:
    """Limits on the cost of reading one log. The defaults allow hours of recording and stop decompression bombs."""

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


class Schema(NamedTuple):
    """The message definition of a channel."""

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
    """Time at which it was recorded [ns]."""
    data: bytes


class Metadata(NamedTuple):
    """A metadata record; `duplicates` are keys that occur more than once."""

    name: str
    values: Mapping[str, str]
    duplicates: tuple[str, ...]


class Finding(NamedTuple):
    """A finding about the file. `lost`: messages of the recording are missing because of it."""

    code: str
    text: str
    lost: bool


@dataclass(frozen=True, eq=False, kw_only=True)
class Log:
    """The content of one MCAP file, or of all parts of one recording."""

    path: Path
    sha256: str
    """Checksum of the file; for a folder, of a list with one line for each part: its checksum, two blanks, its name."""
    size: int
    profile: str
    library: str
    channels: tuple[Channel, ...]
    counts: Mapping[int, int]
    """Messages per channel id, wanted or not."""
    messages: tuple[Message, ...]
    """Messages of wanted channels, by log time, then in the order of the file."""
    metadata: tuple[Metadata, ...] = ()
    findings: tuple[Finding, ...] = ()

    @property
    def stem(self) -> str:
        """Prefix of its cases' names: the file's name without its ending, or the folder's."""
        return self.path.resolve().name if self.path.is_dir() else self.path.stem

    @property
    def lost(self) -> bool:
        """True if part of the log could not be read."""
        return any(finding.lost for finding in self.findings)

    @property
    def warnings(self) -> tuple[str, ...]:
        """One line per finding."""
        return tuple(f"{finding.text} [{finding.code}]" for finding in self.findings)


REPORTED_PER_CODE = 5
"""Findings with the same code that are listed one by one; further ones are counted."""


class Findings:
    """Collects findings in the order in which they are made."""

    def __init__(self) -> None:
        self._items: list[Finding] = []
        self._per_code: Counter[str] = Counter()
        self._losing: set[str] = set()

    def add(self, code: str, text: str, *, lost: bool = False) -> None:
        """Note a finding; `lost`: messages of the recording are missing because of it."""
        self._per_code[code] += 1
        if self._per_code[code] <= REPORTED_PER_CODE or (lost and code not in self._losing):
            self._items.append(Finding(code, printable(text, 400), lost))
        if lost:
            self._losing.add(code)

    def all(self) -> tuple[Finding, ...]:
        """The findings, and a line for each code with findings that were only counted."""
        listed = Counter(finding.code for finding in self._items)
        more = {code: count - listed[code] for code, count in self._per_code.items() if count > listed[code]}
        rest = [Finding(code, f"and {count} more of the same kind", False) for code, count in more.items()]
        return (*self._items, *rest)
