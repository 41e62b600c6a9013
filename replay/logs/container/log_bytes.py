"""The bytes of a log file, front to back, each read once and counted into both checksums."""

import contextlib
import errno
import hashlib
import os
import stat
import zlib
from pathlib import Path

from replay.base.errors import LogError
from replay.logs.container.log import MIB
from replay.logs.container.records import MAGIC

_FIRST_BYTES = (
    (b"#ROSBAG V", "a ROS 1 bag; convert it to MCAP"),
    (b"SQLite format 3\0", "a rosbag2 sqlite3 file; convert it to MCAP (`ros2 bag convert`)"),
    (b"\x1f\x8b", "a gzip file; unpack it first"),
    (b"\x28\xb5\x2f\xfd", "a zstd file; unpack it first"),
    (b"\x04\x22\x4d\x18", "an lz4 file; unpack it first"),
    (b"PK\x03\x04", "a zip archive; unpack it first"),
    (b"version https://git-lfs", "a Git LFS pointer; fetch the file itself (`git lfs pull`)"),
    (b"RRF", "a Rerun recording"),
    (b"\x89MCAP", "an MCAP file of another major version"),
)


class Cut(Exception):
    """The file ended inside a record."""


class Source:
    """A regular file opened for reading from its first byte to its last."""

    def __init__(self, path: Path) -> None:
        self.path = path
        try:
            # O_NONBLOCK: opening a FIFO must not wait for somebody to write into it
            fd = os.open(path, os.O_RDONLY | os.O_CLOEXEC | os.O_NONBLOCK)
        except OSError as error:
            code = (
                "E_NOT_FOUND" if isinstance(error, FileNotFoundError) or error.errno == errno.ELOOP else "E_UNREADABLE"
            )
            raise LogError(code, path, f"cannot be opened ({error.strerror})") from None
        self._state = os.fstat(fd)
        if not stat.S_ISREG(self._state.st_mode):
            os.close(fd)
            is_folder = stat.S_ISDIR(self._state.st_mode)
            text = not_a_file(path) if is_folder else "not a regular file, expected an MCAP log"
            raise LogError("E_NOT_A_FILE", path, text)
        self._file = os.fdopen(fd, "rb", buffering=MIB)
        self.size = self._state.st_size
        self.left = self.size
        self.crc = 0
        self._sha = hashlib.sha256()

    def __enter__(self) -> "Source":
        return self

    def __exit__(self, *_: object) -> None:
        self.close()

    def close(self) -> None:
        """Close the file."""
        self._file.close()

    @property
    def position(self) -> int:
        """Bytes read so far."""
        return self.size - self.left

    def read(self, count: int) -> bytes:
        """Exactly `count` bytes; `Cut` if the file has fewer. Never allocates more than the file holds."""
        if count > self.left:
            raise Cut
        data = self._file.read(count)
        self.left -= len(data)
        self._sha.update(data)
        self.crc = zlib.crc32(data, self.crc)
        if len(data) != count:  # shorter than when it was opened
            raise Cut
        return data

    def skip(self, count: int) -> None:
        """Read past `count` bytes without keeping them."""
        while count > 0:
            count -= len(self.read(min(count, MIB)))

    def tail(self, count: int) -> bytes:
        """The last `count` bytes of the file, without reading on."""
        return os.pread(self._file.fileno(), count, max(0, self.size - count))

    def check_magic(self) -> None:
        """Read the first eight bytes; raise a `LogError` that says what the file is if it is not an MCAP file."""
        if self.size == 0:
            raise LogError("E_EMPTY", self.path, "the file is empty: nothing was written to it")
        first = self.read(min(self.size, len(MAGIC)))
        if first == MAGIC:
            return
        first += self.read(min(self.left, 512))
        raise LogError("E_NOT_MCAP", self.path, f"this is {_looks_like(first)}, expected an MCAP log")

    def finish(self) -> str:
        """Read what is left and give the SHA-256 of the whole file; raise if it changed in the meantime."""
        with contextlib.suppress(Cut):  # it is shorter than it was: reported below
            self.skip(self.left)
        now = os.fstat(self._file.fileno())
        if (now.st_size, now.st_mtime_ns) != (self._state.st_size, self._state.st_mtime_ns):
            raise LogError("E_CHANGED", self.path, "the file changed while it was read; is it still being recorded?")
        return self._sha.hexdigest()


def _looks_like(first: bytes) -> str:
    for start, name in _FIRST_BYTES:
        if first.startswith(start):
            return name
    if MAGIC.startswith(first):
        return f"the first {len(first)} bytes of an MCAP file and nothing else"
    text = first[:256].decode("utf-8", errors="ignore")
    if text and len(text) > 0.9 * len(first[:256]) and text.replace("\n", "").replace("\t", "").isprintable():
        return f"a text file (it begins with {text.splitlines()[0][:40]!r})"
    return f"no MCAP file (it begins with {first[:8].hex(' ')})"


def not_a_file(path: Path) -> str:
    """Text for a folder that is not a log; names its files."""
    inside = sorted(p.name for p in path.glob("*.mcap"))
    if not inside:
        return "a folder without MCAP files, expected an MCAP log"
    listed = ", ".join(inside[:5]) + (f" and {len(inside) - 5} more" if len(inside) > 5 else "")
    return f"a folder without metadata.yaml, expected an MCAP log or a rosbag2 folder; give the files in it: {listed}"
