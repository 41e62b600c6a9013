"""The plain data of an MCAP file, and a cursor that reads the fields of one record.

Everything here is bounded: a length that the file states is compared with the bytes that are there
before anything is allocated.
"""

import struct
from typing import Final

MAGIC: Final = b"\x89MCAP0\r\n"

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


class Malformed(ValueError):
    """The fields of a record do not fit into the record."""


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
