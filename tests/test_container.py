"""The container reader: what it reads, what it refuses to open, and how it speaks."""

import hashlib
import os
import pickle
from collections import Counter
from collections.abc import Callable
from pathlib import Path

import pytest
from mcap.reader import NonSeekingReader
from mcap.writer import CompressionType
from mcap_bytes import DEFINITIONS, HEADER, channel, chunk, codes, container, message, record, schema, some_log, text

from replay.base.errors import LogError, printable
from replay.logs.container.log import Channel, Log
from replay.logs.container.records import MAGIC
from replay.logs.container.scan import scan

DATA = Path(__file__).parent / "data"
REAL_LOGS = sorted(DATA.glob("*.mcap"))


def every(_: Channel) -> bool:
    return True


# ---- sound files


@pytest.mark.parametrize("compression", list(CompressionType))
@pytest.mark.parametrize("chunked", [True, False])
def test_messages_by_another_writer_come_back_in_order_of_time(
    scanned: Callable[..., Log], compression: CompressionType, chunked: bool
) -> None:
    maker = some_log(compression=compression, chunked=chunked, chunk_size=200)
    log = scanned(maker.bytes())
    found = [(m.channel.topic, m.log_time, m.data) for m in log.messages]
    assert found == [(topic, time, data) for topic, _, _, _, _, data, time in maker.messages]
    assert not log.findings
    assert not log.lost
    assert (log.profile, log.metadata[0].name, log.metadata[0].values) == ("ros2", "vehicle", {"wheelbase": "3.6"})
    assert {c.topic: c.schema.name for c in log.channels if c.schema} == {
        "/topic0": "c/msg/D",
        "/topic1": "a/msg/B",
        "/topic2": "a/msg/B",
    }


@pytest.mark.parametrize("file", REAL_LOGS, ids=lambda file: file.stem)
def test_real_logs_have_the_counts_that_another_reader_finds(file: Path) -> None:
    with file.open("rb") as stream:
        expected = Counter(channel.id for _, channel, _ in NonSeekingReader(stream).iter_messages())
    log = scan(file, every)
    assert {i: n for i, n in log.counts.items() if n} == dict(expected)
    assert len(log.messages) == expected.total()
    assert not log.findings
    assert log.sha256 == hashlib.sha256(file.read_bytes()).hexdigest()


def test_payloads_of_other_topics_are_counted_and_not_kept(tmp_path: Path) -> None:
    file = some_log().write(tmp_path / "log.mcap")
    log = scan(file, lambda channel: channel.topic == "/topic1")
    assert {m.channel.topic for m in log.messages} == {"/topic1"}
    assert sum(log.counts.values()) == 12
    assert scan(file, lambda _: False).messages == ()


def test_private_unknown_and_extended_records_are_no_damage(scanned: Callable[..., Log]) -> None:
    header = record(1, text("ros2") + text("x") + b"a new field")
    definitions = schema() + channel(extra=b"\7" * 9)
    unknown = record(0x80, b"private") + record(0x7E, b"of the future")
    log = scanned(container(unknown, chunk(definitions + message() + unknown), definitions, unknown, header=header))
    assert log.counts == {1: 1}
    assert not log.findings


def test_absent_checksums_are_allowed(scanned: Callable[..., Log]) -> None:
    log = scanned(container(chunk(DEFINITIONS + message(), crc=0), data_crc=0))
    assert log.counts == {1: 1}
    assert not log.findings


# ---- files that are not logs


@pytest.mark.parametrize(
    ("content", "code", "says"),
    [
        (b"", "E_EMPTY", "empty"),
        (MAGIC[:4], "E_NOT_MCAP", "first 4 bytes"),
        (b"\x89MCAP1\r\n rest", "E_NOT_MCAP", "another major version"),
        (b"#ROSBAG V2.0\n" + bytes(64), "E_NOT_MCAP", "ROS 1 bag"),
        (b"SQLite format 3\0" + bytes(84), "E_NOT_MCAP", "sqlite3"),
        (b"\x1f\x8b\x08\0" + bytes(20), "E_NOT_MCAP", "gzip"),
        (b"PK\x03\x04" + bytes(20), "E_NOT_MCAP", "zip"),
        (b"version https://git-lfs.github.com/spec/v1\noid sha256:00\n", "E_NOT_MCAP", "Git LFS pointer"),
        (b"hello\nworld\n" * 10, "E_NOT_MCAP", "text file"),
        (bytes(range(128, 256)), "E_NOT_MCAP", "no MCAP file"),
        (MAGIC, "E_TRUNCATED", "cut off"),
        (MAGIC + HEADER, "E_TRUNCATED", "cut off"),
    ],
)
def test_what_is_no_log_is_named(scanned: Callable[..., Log], content: bytes, code: str, says: str) -> None:
    with pytest.raises(LogError, match=says) as caught:
        scanned(content)
    assert caught.value.code == code
    assert str(caught.value).isprintable()


def test_only_regular_files_are_opened(tmp_path: Path) -> None:
    fifo, folder, missing = tmp_path / "fifo.mcap", tmp_path / "bag", tmp_path / "missing.mcap"
    os.mkfifo(fifo)
    folder.mkdir()
    (folder / "bag_0.mcap").write_bytes(b"")
    loop = tmp_path / "loop.mcap"
    loop.symlink_to(loop)
    for path, code in ((fifo, "E_NOT_A_FILE"), (missing, "E_NOT_FOUND"), (loop, "E_NOT_FOUND")):
        with pytest.raises(LogError) as caught:
            scan(path, every)
        assert caught.value.code == code
    with pytest.raises(LogError, match=r"bag_0\.mcap") as caught:
        scan(folder, every)
    assert caught.value.code == "E_NOT_A_FILE"


# ---- what is shown to people


def test_text_from_a_log_cannot_reach_the_terminal_as_control_characters(scanned: Callable[..., Log]) -> None:
    topic = "/evil\x1b[2J\x07\r\n[OK] all passed \u202e"
    log = scanned(container(chunk(schema() + channel(topic=topic) + message())))
    assert all(line.isprintable() for line in log.warnings)
    assert codes(log) == {"W_TOPIC"}
    with pytest.raises(LogError) as caught:
        scanned(container(chunk(schema() + channel(topic=topic) + channel(topic="/other"))))
    assert str(caught.value).isprintable()
    assert printable("a\x1b[0m\nb\u202ec\ud800") == "a\\x1b[0m\\nb\\u202ec\\ud800"
    assert len(printable("x" * 1000, 50)) == 50


def test_errors_survive_the_way_to_another_process() -> None:
    error = LogError("E_X", "a.mcap", "something")
    again = pickle.loads(pickle.dumps(error))
    assert (str(again), again.code, again.path, again.exit_status) == ("a.mcap: something [E_X]", "E_X", "a.mcap", 2)
