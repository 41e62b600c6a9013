"""The container reader on damaged and hostile files: what it drops, what it reports, what it never believes."""

import struct
import zlib
from collections import Counter
from collections.abc import Callable

import lz4.frame
import pytest
import zstandard
from mcap.writer import CompressionType
from mcap_bytes import DEFINITIONS, channel, chunk, codes, container, message, record, schema, some_log, text

from replay.base.errors import LogError
from replay.logs.container.log import Channel, Log, ReadLimits


def every(_: Channel) -> bool:
    return True


# ---- damage


def test_a_damaged_chunk_is_dropped_whole_and_the_others_are_read(scanned: Callable[..., Log]) -> None:
    bad = bytearray(chunk(message(data=b"b" * 50) + message(data=b"c" * 50)))
    bad[-10] ^= 4
    log = scanned(container(chunk(DEFINITIONS + message(data=b"a")), bytes(bad), chunk(message(data=b"d"))))
    assert [m.data for m in log.messages] == [b"a", b"d"]
    assert log.lost
    assert "W_CRC_CHUNK" in codes(log)


@pytest.mark.parametrize(
    ("bad", "code"),
    [
        (chunk(message(), compression="brotli"), "W_COMPRESSION_UNKNOWN"),
        (chunk(message(), compression="ZSTD"), "W_COMPRESSION_UNKNOWN"),
        (chunk(message(), size=3), "W_CHUNK_SIZE"),
        (chunk(message(), size=1 << 40), "W_CHUNK_TOO_LARGE"),
        (chunk(message(), packed_size=1 << 40), "W_CORRUPT_RECORD"),
        (chunk(message(), compression="zstd"), "W_CHUNK_DECODE"),
        (chunk(message(), compression="lz4"), "W_CHUNK_DECODE"),
        (chunk(b"", compression="zstd", size=1000, packed=zstandard.compress(bytes(50_000_000))), "W_CHUNK_SIZE"),
        (
            chunk(
                b"",
                compression="zstd",
                size=1000,
                packed=zstandard.ZstdCompressor(write_content_size=False).compress(bytes(50_000_000)),
            ),
            "W_CHUNK_SIZE",
        ),
        (chunk(b"", compression="lz4", size=1000, packed=lz4.frame.compress(bytes(50_000_000))), "W_CHUNK_SIZE"),
        (chunk(record(5, b"short", 3) + message()), "W_CORRUPT_RECORD"),
        (chunk(message() + bytes(30)), "W_CORRUPT_RECORD"),
    ],
)
def test_a_chunk_that_fails_a_check_delivers_nothing(scanned: Callable[..., Log], bad: bytes, code: str) -> None:
    log = scanned(container(chunk(DEFINITIONS + message(data=b"a")), bad, chunk(message(data=b"d"))))
    assert [m.data for m in log.messages] == [b"a", b"d"]
    assert code in codes(log)
    assert log.lost


def test_a_record_that_does_not_fit_its_fields_is_skipped_and_the_next_one_is_read(scanned: Callable[..., Log]) -> None:
    bad = record(4, struct.pack("<HHI", 9, 0, 0xFFFFFFFF) + b"/topic")
    nested = chunk(message())
    log = scanned(container(chunk(bad + DEFINITIONS + nested + record(5, b"short") + message())))
    assert log.counts == {1: 1}
    assert codes(log) == {"W_CORRUPT_RECORD"}


def test_a_map_whose_last_string_goes_past_its_end_is_no_map(scanned: Callable[..., Log]) -> None:
    pair = text("key") + text("value")
    sound = record(12, text("a") + struct.pack("<I", len(pair)) + pair)
    short = record(12, text("b") + struct.pack("<I", len(pair) - 2) + pair)
    log = scanned(container(DEFINITIONS, message(), sound, short))
    assert [each.name for each in log.metadata] == ["a"]
    assert codes(log) == {"W_CORRUPT_RECORD"}


def test_the_first_value_of_a_repeated_key_counts_and_the_key_is_named(scanned: Callable[..., Log]) -> None:
    pairs = text("key") + text("first") + text("key") + text("second")
    log = scanned(container(DEFINITIONS, message(), record(12, text("a") + struct.pack("<I", len(pairs)) + pairs)))
    assert [(dict(each.values), each.duplicates) for each in log.metadata] == [({"key": "first"}, ("key",))]
    assert codes(log) == {"W_METADATA"}


@pytest.mark.parametrize("length", [1 << 63, (1 << 64) - 1, 5 << 30, 1000])
def test_a_length_beyond_the_file_ends_the_reading_with_a_report(scanned: Callable[..., Log], length: int) -> None:
    log = scanned(container(chunk(DEFINITIONS + message()), record(0x7D, b"tiny", length)))
    assert log.counts == {1: 1}
    assert codes(log) == {"W_CORRUPT_RECORD"}
    assert log.lost


def test_messages_of_undefined_channels_are_reported_once(scanned: Callable[..., Log]) -> None:
    log = scanned(container(chunk(DEFINITIONS + message(77) * 9 + message())))
    assert log.counts == {1: 1}
    assert [f.code for f in log.findings] == ["W_NO_CHANNEL"]
    assert log.lost


def test_messages_outside_chunks_of_a_chunked_log_need_the_checksum_of_the_data(scanned: Callable[..., Log]) -> None:
    records = chunk(DEFINITIONS + message(data=b"a")), message(data=b"loose")
    for data_crc, expected in ((None, 2), (0, 1), (123, 1)):
        log = scanned(container(*records, data_crc=data_crc))
        assert len(log.messages) == expected
        assert log.lost == (expected == 1)


def test_a_log_without_chunks_counts_unless_its_checksum_is_wrong(scanned: Callable[..., Log]) -> None:
    for data_crc, expected in ((None, 2), (0, 2), (123, 0)):
        assert len(scanned(container(DEFINITIONS, message(), message(), data_crc=data_crc)).messages) == expected


def test_definitions_that_change_their_meaning_are_an_error(scanned: Callable[..., Log]) -> None:
    again = chunk(DEFINITIONS + message())
    assert scanned(container(again, again)).counts == {1: 2}
    for change, code in (
        (schema(definition=b"int64 x"), "E_SCHEMA_CONFLICT"),
        (channel(topic="/y"), "E_CHANNEL_CONFLICT"),
    ):
        with pytest.raises(LogError) as caught:
            scanned(container(again, chunk(change + message())))
        assert caught.value.code == code


def test_the_summary_is_compared_and_never_believed(scanned: Callable[..., Log]) -> None:
    data = some_log(chunk_size=200).bytes()
    start = struct.unpack_from("<Q", data, len(data) - 28)[0]
    for lie in (len(data) + 1000, (1 << 64) - 1, 8, start + 3):
        changed = data[:-28] + struct.pack("<Q", lie) + data[-20:]
        log = scanned(changed)
        assert len(log.messages) == 12
        assert {"W_CRC_SUMMARY", "W_INDEX"} <= codes(log)
        assert not log.lost
    # a Chunk Index (opcode 8) made unreadable, then a message count that is not true
    for opcode, code in ((8, "W_INDEX"), (11, "W_STATISTICS")):
        changed = bytearray(data)
        at = _find_record(data, start, opcode)
        changed[at + 9 + (16 if opcode == 8 else 0)] ^= 1
        log = scanned(bytes(changed))
        assert len(log.messages) == 12
        assert code in codes(log)


def _find_record(data: bytes, at: int, opcode: int) -> int:
    while data[at] != opcode:
        at += 9 + struct.unpack_from("<Q", data, at + 1)[0]
    return at


def test_bytes_after_the_end_are_reported_and_not_mixed_in(scanned: Callable[..., Log]) -> None:
    data = container(chunk(DEFINITIONS + message()))
    assert codes(scanned(data + b"\xaa" * 100)) == {"W_TRAILING_BYTES"}
    twice = scanned(data * 2)
    assert twice.counts == {1: 1}
    assert twice.lost


def test_attachments_are_checked_and_never_unpacked(scanned: Callable[..., Log]) -> None:
    def attachment(name: str, crc: int | None = None, size: int = 4) -> bytes:
        body = bytes(16) + text(name) + text("x/y") + struct.pack("<Q", size) + b"data"
        return record(9, body + struct.pack("<I", zlib.crc32(body) if crc is None else crc))

    sound = chunk(DEFINITIONS + message())
    assert not scanned(container(sound, attachment("a.yaml"))).findings
    assert codes(scanned(container(sound, attachment("a.yaml", crc=1)))) == {"W_CRC_ATTACHMENT"}
    assert codes(scanned(container(sound, attachment("../../x")))) == {"W_ATTACHMENT_NAME"}
    assert codes(scanned(container(sound, attachment("a.yaml", size=1 << 62)))) == {"W_CORRUPT_RECORD"}


def test_limits_end_the_reading_before_memory_does(scanned: Callable[..., Log]) -> None:
    data = container(chunk(DEFINITIONS + message()), chunk(message()), chunk(message()))
    one = len(DEFINITIONS + message())
    log = scanned(data, ReadLimits(total=one + len(message())))
    assert (log.counts, codes(log)) == ({1: 2}, {"W_TOTAL_TOO_LARGE"})
    log = scanned(data, ReadLimits(records=4))
    assert codes(log) >= {"W_TOTAL_TOO_LARGE"}
    log = scanned(data, ReadLimits(record=80))
    assert codes(log) >= {"W_RECORD_TOO_LARGE"}
    for limits, code in ((ReadLimits(kept=40), "E_TOO_LARGE"), (ReadLimits(channels=0), "E_TOO_MANY_CHANNELS")):
        with pytest.raises(LogError) as caught:
            scanned(data, limits)
        assert caught.value.code == code


# ---- sweeps


def _shapes() -> dict[str, bytes]:
    return {
        "zstd": some_log(chunk_size=200).bytes(),
        "lz4": some_log(compression=CompressionType.LZ4, chunk_size=400).bytes(),
        "unchunked": some_log(chunked=False).bytes(),
    }


def _delivered(log: Log) -> list[tuple[str, str, int, bytes]]:
    return [
        (m.channel.topic, m.channel.schema.name if m.channel.schema else "", m.log_time, m.data) for m in log.messages
    ]


@pytest.mark.parametrize("shape", ["zstd", "lz4", "unchunked"])
def test_every_prefix_delivers_a_growing_part_of_the_messages_and_a_warning(
    scanned: Callable[..., Log], shape: str
) -> None:
    data = _shapes()[shape]
    whole = _delivered(scanned(data))
    most = 0
    refused: list[tuple[str, int]] = []
    for size in range(0, len(data), 7):
        try:
            log = scanned(data[:size])
        except LogError as error:
            refused.append((error.code, most))  # most: nothing was delivered before
            continue
        found = _delivered(log)
        assert found == whole[: len(found)]
        assert len(found) >= most
        assert "W_TRUNCATED" in codes(log)
        most = len(found)
    assert most == len(whole)
    assert set(refused) == {("E_EMPTY", 0), ("E_NOT_MCAP", 0), ("E_TRUNCATED", 0)}


@pytest.mark.parametrize("shape", ["zstd", "lz4", "unchunked"])
def test_no_flipped_bit_delivers_an_altered_message(scanned: Callable[..., Log], shape: str) -> None:
    data = _shapes()[shape]
    sound = Counter(_delivered(scanned(data)))
    unnoticed = 0
    for bit in range(0, 8 * len(data), 61):  # a prime: every bit of the byte has its turn
        changed = bytearray(data)
        changed[bit // 8] ^= 1 << bit % 8
        try:
            log = scanned(bytes(changed))
        except LogError:
            continue
        assert Counter(_delivered(log)) <= sound
        unnoticed += not log.findings
    assert unnoticed == 0
