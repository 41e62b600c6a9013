"""Records of an MCAP file; the only module that uses the `mcap` package.

`mcap.records` parses the bodies, through a stream that cannot read past the end of its record: every length that the
file states is compared with the bytes that are there before anything is allocated. Its readers of whole files are not
used: they trust the index, skip unknown records and decompress without a limit.
"""

import io
import struct
from typing import Final, Protocol, TypeVar

from mcap import records as kinds
from mcap.data_stream import ReadDataStream, RecordBuilder
from mcap.opcode import Opcode
from mcap.writer import MCAP0_MAGIC, CompressionType, Writer

__all__ = ["CompressionType", "Opcode", "RecordBuilder", "Writer", "kinds"]

MAGIC: Final = MCAP0_MAGIC
RECORD_PREFIX: Final = struct.Struct("<BQ")  # opcode, length of the body
MESSAGE_PREFIX: Final = struct.Struct("<HIQQ")  # channel, sequence number, log time, publish time
_NAMES: Final = {int(opcode): opcode.name.replace("_", " ").title() for opcode in Opcode}

Record = TypeVar("Record", covariant=True)


class Malformed(ValueError):
    """The fields of a record do not fit into the record."""


def record_name(opcode: int) -> str:
    """Name of a record in the specification, or its opcode."""
    return _NAMES.get(opcode, f"0x{opcode:02x}")


class RecordStream(ReadDataStream):
    """The fields of one record's body, ``data[start:end]``, front to back; raises Malformed at its end."""

    def __init__(self, data: bytes, start: int = 0, end: int | None = None) -> None:
        super().__init__(io.BytesIO())
        self.data = data
        self.position = start
        self._end = len(data) if end is None else end
        self._strings: list[tuple[str, int]] = []
        """Each string that was read, and the position after it."""

    @property
    def count(self) -> int:
        """Position in `data`; `mcap.records` compares it with the end of a map."""
        return self.position

    def read(self, length: int) -> bytes:
        """The next `length` bytes."""
        if length > self._end - self.position:
            raise Malformed(f"a field claims {length} bytes, {self._end - self.position} are left in its record")
        start, self.position = self.position, self.position + length
        return self.data[start : self.position]

    def rest(self) -> bytes:
        """All bytes that are left."""
        return self.read(self._end - self.position)

    def read_prefixed_string(self) -> str:
        """UTF-8 text with a 32-bit length before it."""
        text = super().read_prefixed_string()
        self._strings.append((text, self.position))
        return text

    def last_map(self, before: int) -> tuple[dict[str, str], tuple[str, ...]]:
        """The map after the first `before` strings, which ends the record, and its repeated keys.

        The first value of a repeated key is kept; `mcap.records` keeps the last one, and reads on past a map's end.
        """
        _, at = self._strings[before - 1]
        if at + 4 + int.from_bytes(self.data[at : at + 4], "little") != self.position:
            raise Malformed("a map ends within one of its strings")
        values: dict[str, str] = {}
        repeated: list[str] = []
        texts = [text for text, _ in self._strings[before:]]
        for key, value in zip(texts[::2], texts[1::2], strict=True):
            if key in values:
                repeated.append(key)
            values.setdefault(key, value)
        return values, tuple(repeated)


class _Readable(Protocol[Record]):
    @staticmethod
    def read(stream: ReadDataStream) -> Record: ...


def parsed(kind: _Readable[Record], stream: RecordStream) -> Record:
    """The record of a kind, such as `kinds.Schema`, whose body is in `stream`. Raises Malformed."""
    try:
        return kind.read(stream)
    except UnicodeDecodeError:
        raise Malformed("a string is not UTF-8") from None
