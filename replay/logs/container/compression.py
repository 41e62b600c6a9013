"""Decoding of one chunk's records, never more than one byte over what the chunk declares."""

import zlib

import lz4.frame
import zstandard

from replay.logs.container import records as r
from replay.logs.container.log import MIB

ZSTD_WINDOW = 128 * MIB  # largest back-reference window that a decoder may allocate [bytes]


class BadChunk(ValueError):
    """A chunk that must be dropped; `code` says which check it failed."""

    def __init__(self, code: str, text: str) -> None:
        self.code = code
        super().__init__(text)


def unpack_chunk(body: bytes, limit: int, total_left: int) -> tuple[bytes, int, int]:
    """The records of a Chunk, decompressed and verified, with its start and end time.

    Args:
        body: the body of the Chunk record.
        limit: most bytes that one chunk may hold after decompression.
        total_left: most bytes that the file may still hold after decompression.

    Raises:
        BadChunk: too large, unknown compression, sizes that contradict each other, wrong checksum.
        Malformed: fields that do not fit into the record.
    """
    chunk = r.parsed(r.kinds.Chunk, r.RecordStream(body))
    size = chunk.uncompressed_size
    if size > limit:
        raise BadChunk("W_CHUNK_TOO_LARGE", f"declares {size} bytes, more than the limit of {limit}")
    if size > total_left:
        raise BadChunk("W_TOTAL_TOO_LARGE", f"declares {size} bytes, {total_left} are left of the file's limit")
    records = _decode(chunk.compression, chunk.data, size)
    if len(records) != size:
        more = "more" if len(records) > size else f"{len(records)}"
        raise BadChunk("W_CHUNK_SIZE", f"declares {size} bytes and holds {more}")
    if chunk.uncompressed_crc and zlib.crc32(records) != chunk.uncompressed_crc:
        raise BadChunk("W_CRC_CHUNK", "checksum is wrong")
    return records, chunk.message_start_time, chunk.message_end_time


def _decode(compression: str, packed: bytes, size: int) -> bytes:
    """Decode at most `size` + 1 bytes."""
    if compression == "":
        return packed
    if compression == "zstd":
        return _zstd(packed, size)
    if compression == "lz4":
        return _lz4(packed, size)
    raise BadChunk("W_COMPRESSION_UNKNOWN", f"compression {compression[:40]!r} is none of '', 'lz4', 'zstd'")


def _zstd(packed: bytes, size: int) -> bytes:
    try:
        stated = zstandard.frame_content_size(packed)  # -1: the frame does not say
        if stated not in (-1, size):
            raise BadChunk("W_CHUNK_SIZE", f"declares {size} bytes, its zstd frame {stated}")
        decoder = zstandard.ZstdDecompressor(max_window_size=ZSTD_WINDOW)
        if stated == size:
            return decoder.decompress(packed, max_output_size=size)
        with decoder.stream_reader(packed) as reader:
            return reader.read(size + 1)
    except (zstandard.ZstdError, MemoryError) as error:
        raise BadChunk("W_CHUNK_DECODE", f"zstd data cannot be decoded ({error})") from None


def _lz4(packed: bytes, size: int) -> bytes:
    try:
        return lz4.frame.LZ4FrameDecompressor().decompress(packed, max_length=size + 1)
    except (RuntimeError, MemoryError, EOFError) as error:
        raise BadChunk("W_CHUNK_DECODE", f"lz4 data cannot be decoded ({error})") from None
