"""Corners of the reader that real logs reach seldom: odd records, odd definitions, paths that are nearly none."""

import os
import struct
import zlib
from collections.abc import Callable
from pathlib import Path

import logs_maker as make
import numpy as np
import pytest
from mcap_bytes import DEFINITIONS, FOOTER, HEADER, channel, chunk, codes, container, message, record, schema, text

from replay.base.errors import LogError
from replay.logs.container.log import Channel, Log, ReadLimits
from replay.logs.container.scan import scan
from replay.logs.messages.definition import matching_definition
from replay.logs.messages.ros2 import MESSAGE_TYPES
from replay.logs.messages.types import DefinitionError
from replay.run.case import Case

Scanned = Callable[..., Log]
Read = Callable[..., list[Case]]
Refusal = Callable[..., LogError]
TRUCK, AXLE = make.drive()
ONE = DEFINITIONS + message(data=b"a")


def metadata(name: str, *pairs: tuple[str, str]) -> bytes:
    inner = b"".join(text(key) + text(value) for key, value in pairs)
    return record(12, text(name) + struct.pack("<I", len(inner)) + inner)


# ---- records


@pytest.mark.parametrize(
    ("records", "code", "messages"),
    [
        ((ONE, FOOTER, message(data=b"b")), "W_EARLY_FOOTER", 0),
        ((chunk(ONE), bytes(40)), "W_CORRUPT_RECORD", 1),
        ((chunk(ONE), record(0, b"odd")), "W_CORRUPT_RECORD", 1),
        ((HEADER, chunk(ONE)), "W_DUPLICATE_HEADER", 1),
        ((chunk(ONE), metadata("vehicle", ("a", "1"), ("a", "2"))), "W_METADATA", 1),
        ((chunk(ONE), record(3, struct.pack("<H", 0) + text("a") + text("b") + text(b""))), "W_CORRUPT_RECORD", 1),
    ],
)
def test_odd_records_are_reported_and_cost_no_more_than_what_follows_them(
    scanned: Scanned, records: tuple[bytes, ...], code: str, messages: int
) -> None:
    log = scanned(container(*records))
    assert code in codes(log)
    assert len(log.messages) == messages


def test_a_log_whose_header_is_missing_or_late_is_read(scanned: Scanned) -> None:
    log = scanned(container(chunk(ONE), HEADER, header=b""))
    assert "W_NO_HEADER" in codes(log)
    assert [each.data for each in log.messages] == [b"a"]


def test_a_damaged_footer_is_reported(scanned: Scanned) -> None:
    data = container(chunk(ONE))
    cut = data[: -len(FOOTER) - 8] + record(2, b"short") + data[-8:]
    assert "W_CORRUPT_RECORD" in codes(scanned(cut))


def test_a_topic_that_is_defined_where_the_checksum_is_wrong_is_dropped(scanned: Scanned) -> None:
    log = scanned(container(DEFINITIONS, chunk(message(data=b"a")), data_crc=1))
    assert not log.messages
    assert "W_UNVERIFIED" in codes(log)
    assert log.lost


def test_more_channels_than_the_limit_are_an_error(scanned: Scanned) -> None:
    many = b"".join(channel(number) for number in range(1, 5))
    with pytest.raises(LogError) as caught:
        scanned(container(chunk(schema() + many)), ReadLimits(channels=3))
    assert caught.value.code == "E_TOO_MANY_CHANNELS"


def test_an_attachment_is_checked_to_its_end_however_long(scanned: Scanned) -> None:
    for size in (1 << 20, (5 << 20) + 7):
        body = bytes(16) + text("a.bin") + text("x/y") + struct.pack("<Q", size) + bytes(size)
        for crc, found in ((zlib.crc32(body), set()), (zlib.crc32(body) ^ 1, {"W_CRC_ATTACHMENT"})):
            attachment = record(9, body + struct.pack("<I", crc))
            assert codes(scanned(container(attachment, chunk(ONE)))) == found


def test_a_chunk_with_half_a_record_at_its_end_delivers_nothing(scanned: Scanned) -> None:
    log = scanned(container(chunk(ONE), chunk(message(data=b"b") + b"\5\1")))
    assert [each.data for each in log.messages] == [b"a"]
    assert any("2 bytes after its last record" in finding.text for finding in log.findings)


def test_messages_outside_chunks_that_nobody_wants_are_counted(tmp_path: Path) -> None:
    file = tmp_path / "log.mcap"
    file.write_bytes(container(DEFINITIONS, channel(2, topic="/y"), message(1), message(2), message(2)))
    log = scan(file, lambda each: each.topic == "/x")
    assert log.counts == {1: 1, 2: 2}
    assert [each.channel.topic for each in log.messages] == ["/x"]


def test_a_file_that_grows_while_it_is_read_is_no_log_yet(tmp_path: Path) -> None:
    file = tmp_path / "log.mcap"
    file.write_bytes(container(chunk(ONE)))

    def recorded_further(_: Channel) -> bool:
        with file.open("ab") as stream:
            stream.write(b"more")
        return True

    with pytest.raises(LogError, match="the file changed while it was read") as caught:
        scan(file, recorded_further)
    assert caught.value.code == "E_CHANGED"


def test_a_file_that_is_cut_while_it_is_read_is_no_log(tmp_path: Path) -> None:
    file = tmp_path / "log.mcap"
    file.write_bytes(container(chunk(ONE), record(200, bytes(3 << 20)), chunk(message(data=b"b"))))

    def cut_off(_: Channel) -> bool:
        os.truncate(file, 1 << 21)
        return True

    with pytest.raises(LogError, match="the file changed while it was read") as caught:
        scan(file, cut_off)
    assert caught.value.code == "E_CHANGED"


# ---- definitions


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda text: text.split("=" * 80)[0], "is not defined"),
        (lambda text: text.replace("float32 resolution", "float64 resolution"), "expected 'float32 resolution'"),
        (lambda text: text + "int32 more\n", "more"),
    ],
)
def test_a_definition_that_is_not_the_standard_one_is_told_by_its_first_difference(change, says: str) -> None:
    standard = MESSAGE_TYPES["nav_msgs/msg/OccupancyGrid"].standards[0]
    with pytest.raises(DefinitionError, match=says):
        matching_definition("nav_msgs/msg/OccupancyGrid", change(standard).encode(), (standard,))


# ---- what is there at all


def test_a_log_without_a_message_says_so(refusal: Refusal) -> None:
    assert "it holds no messages" in str(refusal(container(chunk(DEFINITIONS))))


def test_a_path_whose_definition_is_missing_is_told_apart_from_none(refusal: Refusal) -> None:
    kind, data = make.GRID, make.serialised(make.grid(make.yard()))
    definition = MESSAGE_TYPES[kind].standards[0].encode()
    map_records = schema(1, kind, definition) + channel(1, topic="/map") + message(1, data=data)
    error = refusal(container(chunk(map_records), chunk(channel(2, schema_id=9, topic="/truck") + message(2))))
    assert error.code == "E_NO_SCHEMA"
    assert "some topics refer to schemas that are missing" in str(error)


def test_a_message_at_no_time_is_refused(refusal: Refusal) -> None:
    log = make.sound_log()
    log.messages[-1] = (*log.messages[-1][:-1], 1 << 63)
    error = refusal(log)
    assert error.code == "E_TIME"
    assert "log time 9223372036854775808 ns is not a time" in str(error)


def test_vehicles_that_differ_leave_open_which_one_is_meant(read: Read, refusal: Refusal) -> None:
    assert read(make.sound_log().vehicle())
    error = refusal(make.sound_log().vehicle(None, wheelbase="3.7"))
    assert error.code == "E_VEHICLE"
    assert "several metadata records 'vehicle'" in str(error)


# ---- paths


def test_of_fewer_trailer_paths_than_truck_paths_the_one_with_the_same_stamp_belongs(read: Read) -> None:
    log = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
    log.add("/truck", make.path(TRUCK), 2).add("/truck", make.path(make.shifted(TRUCK, 1.0)), 5)
    log.add("/trailer", make.path(AXLE), 2)
    cases = read(log, path_topic="/truck", trailer_topic="/trailer")
    assert cases[0].read.hitch == "trailer path"


def test_node_indices_of_a_log_with_several_paths_are_not_used(read: Read) -> None:
    log = make.LogMaker().vehicle().nodes("[0, 5]").add("/map", make.grid(make.yard()), 1)
    log.add("/truck", make.path(TRUCK), 2).add("/truck", make.path(make.shifted(TRUCK, 1.0)), 5)
    cases = read(log)
    assert all(case.problem.nodes is None for case in cases)
    assert any("several paths" in note for note in cases[0].read.notes)


def test_white_noise_beyond_repair_is_refused_with_the_amount(read: Read, refusal: Refusal) -> None:
    noise = np.random.default_rng(1).normal(0.0, 1.0, TRUCK.shape) * (1.0, 1.0, 0.1)
    (case,) = read(make.log_of(TRUCK + 0.08 * noise))
    assert case.problem.recorded.num_cusps == 1
    assert any(note.startswith("path '/truck': its poses have noise of ") for note in case.read.notes)
    error = refusal(make.log_of(TRUCK + 0.4 * noise))
    assert error.code == "E_KINEMATICS"
    assert "cm, expected at most 15 cm" in str(error)


def test_a_trailer_of_one_pose_is_refused(refusal: Refusal) -> None:
    error = refusal(make.log_of(TRUCK, AXLE[:1]), path_topic="/truck", trailer_topic="/trailer")
    assert error.code in ("E_PATH_PAIR", "E_PATH_SHORT", "E_PATH_EMPTY")


def test_too_many_path_topics_ask_for_a_choice(refusal: Refusal) -> None:
    log = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1)
    for number in range(12):
        log.add(f"/plan{number}", make.path(make.shifted(TRUCK, 0.1 * number)), 2)
    error = refusal(log)
    assert error.code == "E_AMBIGUOUS"
    assert "--path-topic" in str(error)


def test_the_only_path_cannot_be_the_trailers(refusal: Refusal) -> None:
    error = refusal(make.log_of(TRUCK), trailer_topic="/truck")
    assert error.code == "E_AMBIGUOUS"
    assert "the only path" in str(error)


# ---- maps


def test_markers_in_several_frames_are_refused(refusal: Refusal) -> None:
    box = (2.0, 2.0, 2.0)
    one, two = make.marker(1, box, (40.0, 30.0, 0.0), id=1), make.marker(1, box, (44.0, 30.0, 0.0), id=2, frame="odom")
    log = make.LogMaker().vehicle().add("/obstacles", make.markers(one, two), 1).add("/truck", make.path(TRUCK), 2)
    assert refusal(log).code == "E_FRAME"
