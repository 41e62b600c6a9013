"""Reading CDR, the byte layout of ROS 2 messages: little-endian XCDR1, every length checked before it is used.

Fields are aligned to their size, counted from the end of the four-byte encapsulation header.
"""

import struct

import numpy as np
from numpy.typing import NDArray

from replay.logs.messages.types import PayloadError

HEADER_SIZE = 4
_KINDS = {0: "big-endian CDR", 2: "big-endian PL_CDR", 3: "PL_CDR", 6: "big-endian XCDR2", 7: "XCDR2"}
_U32 = struct.Struct("<I")
_I32 = struct.Struct("<i")


class CdrError(PayloadError):
    """A payload that does not fit its layout; the text names the field."""


class CdrReader:
    """Reads one message from front to back. `field` in each method is what an error calls the value."""

    __slots__ = ("data", "end", "pos")

    def __init__(self, data: bytes) -> None:
        if len(data) < HEADER_SIZE:
            raise CdrError(f"{len(data)} bytes are less than the encapsulation header")
        kind = data[0] << 8 | data[1]
        if kind != 1:
            name = _KINDS.get(kind, "unknown")
            raise CdrError(f"encapsulation kind 0x{kind:04x} ({name}), expected 0x0001 (little-endian CDR)")
        self.data = data
        self.pos = HEADER_SIZE
        self.end = len(data)

    def align(self, size: int) -> None:
        """Skip the padding before a field of `size` bytes."""
        self.pos += (HEADER_SIZE - self.pos) % size

    def _next(self, size: int, field: str) -> int:
        start = self.pos
        if size > self.end - start:
            raise CdrError(f"{field} needs {size} bytes, {max(0, self.end - start)} are left")
        self.pos = start + size
        return start

    def u32(self, field: str) -> int:
        """An unsigned 32-bit integer."""
        self.align(4)
        return _U32.unpack_from(self.data, self._next(4, field))[0]

    def i32(self, field: str) -> int:
        """A signed 32-bit integer."""
        self.align(4)
        return _I32.unpack_from(self.data, self._next(4, field))[0]

    def u8(self, field: str) -> int:
        """A byte, or a boolean."""
        return self.data[self._next(1, field)]

    def numbers(self, dtype: str, count: int, field: str) -> NDArray:
        """`count` numbers in a row as a read-only view, for instance of dtype ``<f8``."""
        size = np.dtype(dtype).itemsize
        if count:  # an empty sequence has no padding after its count
            self.align(size)
        return np.frombuffer(self.data, dtype, count, self._next(size * count, field))

    def rows(self, dtype: np.dtype, count: int, field: str) -> NDArray:
        """`count` records in a row as a read-only view; the first must begin where its own alignment asks for."""
        return np.frombuffer(self.data, dtype, count, self._next(dtype.itemsize * count, field))

    def text(self, field: str) -> str:
        """A string: its length with the closing NUL, then UTF-8."""
        size = self.u32(f"length of {field}")
        start = self._next(size, field)
        raw = self.data[start : self.pos]
        if raw and raw[-1] != 0:
            raise CdrError(f"{field} does not end with NUL")
        try:
            return raw[:-1].decode("utf-8")
        except UnicodeDecodeError:
            raise CdrError(f"{field} is not UTF-8") from None

    def count(self, element_size: int, field: str) -> int:
        """The number of elements of a sequence, each of at least `element_size` bytes."""
        count = self.u32(f"count of {field}")
        if count * element_size > self.end - self.pos:
            raise CdrError(f"{field} claims {count} elements, {self.end - self.pos} bytes are left")
        return count

    def finish(self) -> None:
        """The whole payload must have been read; up to three bytes of padding are allowed."""
        if self.end - self.pos > 3:
            raise CdrError(f"{self.end - self.pos} bytes are left over after the last field")
