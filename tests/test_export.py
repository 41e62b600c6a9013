"""Paths written back into a copy of their log: nothing of the log changes, and other software reads what is new."""

import dataclasses
import io
import json
import pathlib
import struct

import numpy as np
import pytest
import recording_factory as factory
from logs_maker import SECOND, LogMaker, drive, grid, path, sound_log, typestore, yard
from mcap.reader import NonSeekingReader, make_reader
from mcap.records import DataEnd
from mcap.stream_reader import StreamReader
from mcap.writer import CompressionType, IndexType, Writer
from mcap_bytes import DEFINITIONS, chunk, container
from mcap_bytes import channel as channel_record
from mcap_bytes import message as message_record
from mcap_bytes import record as any_record
from mcap_bytes import schema as schema_record
from mcap_ros2.decoder import DecoderFactory
from results_maker import results_data

import replay.cli
from replay.base.errors import LogError
from replay.logs import ReadOptions, read_cases
from replay.logs.container.append import NewTopic, append
from replay.logs.container.scan import scan
from replay.logs.export import PATH, axle_poses, topic_names, write_export
from replay.run.plain import path_from_document

QUICK = ["--method", "shortcut", "--shortcut.tries", "10", "--no-recording", "--export"]


def run(*arguments: str | pathlib.Path) -> int:
    return replay.cli.main([str(argument) for argument in arguments])


def data_section(content: bytes) -> bytes:
    """Everything before the record that ends the data."""
    position = 8
    while content[position] != 15:
        position += 9 + struct.unpack_from("<Q", content, position + 1)[0]
    return content[:position]


def records(content: bytes) -> list[str]:
    """Every record of the data section, in order, as the official reader sees it; chunks are opened."""
    found = []
    for record in StreamReader(io.BytesIO(content), validate_crcs=True).records:
        if isinstance(record, DataEnd):
            break
        found.append(repr(record))
    return found


def bare(**options: bool | IndexType) -> bytes:
    """A log with an attachment, two chunks and private metadata, with or without its summary."""
    out = io.BytesIO()
    writer = Writer(out, chunk_size=64, enable_data_crcs=True, **options)  # type: ignore[arg-type]
    writer.start(profile="ros2", library="tests")
    schema = writer.register_schema("a/msg/B", "ros2msg", b"int32 x")
    channel = writer.register_channel("/x", "cdr", schema, {"offered_qos_profiles": "- depth: 1"})
    for time in (7, 3, 9):
        writer.add_message(channel, log_time=time, publish_time=time, data=40 * bytes([time]))
    writer.add_attachment(create_time=1, log_time=2, name="notes.txt", media_type="text/plain", data=b"hello")
    writer.add_metadata("site", {"name": "yard"})
    writer.finish()
    return out.getvalue()


@pytest.mark.parametrize(
    "options",
    [
        {},
        {"use_chunking": False},
        {"index_types": IndexType.NONE, "repeat_channels": False, "repeat_schemas": False, "use_statistics": False},
        {"use_summary_offsets": False, "index_types": IndexType.CHUNK},
    ],
    ids=["indexed", "without chunks", "without a summary", "without message indexes"],
)
def test_a_copy_holds_every_record_as_it_was_and_then_the_new_ones(tmp_path, options):
    original = bare(**options)
    (tmp_path / "log.mcap").write_bytes(original)
    new = NewTopic(topic="/new", schema="a/msg/B", definition="int32 x", messages=[(5, b"five"), (4, b"four")])
    copy = io.BytesIO()
    append(scan(tmp_path / "log.mcap", lambda _: True), copy, [new], {"more": {"key": "value"}})
    content = copy.getvalue()
    assert content.startswith(data_section(original))
    assert records(content)[: len(records(original))] == records(original)
    reader = make_reader(io.BytesIO(content), validate_crcs=True)
    found = [(channel.topic, message.log_time, message.data) for _, channel, message in reader.iter_messages()]
    old = [("/x", time, 40 * bytes([time])) for time in (3, 7, 9)]
    assert found == sorted([*old, ("/new", 4, b"four"), ("/new", 5, b"five")], key=lambda each: each[1])
    assert [each.name for each in reader.iter_metadata()] == ["site", "more"]
    assert [each.data for each in reader.iter_attachments()] == [b"hello"]
    summary = reader.get_summary()
    assert summary is not None
    assert summary.statistics is not None
    assert (summary.statistics.message_count, summary.statistics.message_start_time) == (5, 3)
    assert summary.statistics.message_end_time == 9
    old_channel = next(channel for channel in summary.channels.values() if channel.topic == "/x")
    assert old_channel.metadata == {"offered_qos_profiles": "- depth: 1"}
    (tmp_path / "copy.mcap").write_bytes(content)
    assert scan(tmp_path / "copy.mcap", lambda _: True).findings == ()


def test_a_damaged_log_is_not_copied(tmp_path):
    content = sound_log(compression=CompressionType.NONE, chunk_size=1).bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: len(data_section(content)) - 3000])
    log = scan(tmp_path / "cut.mcap", lambda _: True)
    assert log.lost
    with pytest.raises(LogError, match="part of it is damaged, and a copy would be too"):
        append(log, io.BytesIO(), [], {})


def test_a_log_that_is_cut_off_after_it_was_read_is_not_copied(tmp_path):
    (tmp_path / "log.mcap").write_bytes(bare())
    log = scan(tmp_path / "log.mcap", lambda _: True)
    (tmp_path / "log.mcap").write_bytes(bare()[:200])
    with pytest.raises(LogError, match="it cannot be copied: the file ends within a record"):
        append(log, io.BytesIO(), [], {})


def test_a_log_with_a_broken_channel_record_is_not_copied(tmp_path):
    broken = any_record(4, struct.pack("<HHI", 2, 1, 1 << 30) + b"/y")  # its topic is longer than its record
    log = tmp_path / "log.mcap"
    log.write_bytes(container(chunk(DEFINITIONS + message_record()), broken))
    with pytest.raises(LogError, match="cannot be copied") as error, (tmp_path / "copy.mcap").open("wb") as file:
        append(scan(log, lambda _: False), file, [], {})
    assert error.value.code == "E_EXPORT"


def test_fields_of_a_later_version_of_the_format_are_copied_into_the_summary(tmp_path):
    extended = channel_record(extra=b"later")
    log = tmp_path / "log.mcap"
    log.write_bytes(container(chunk(schema_record() + extended + message_record())))
    with (tmp_path / "copy.mcap").open("wb") as file:
        append(scan(log, lambda _: False), file, [], {})
    assert (tmp_path / "copy.mcap").read_bytes().count(extended) == 2


def test_a_chunk_without_records_does_not_change_the_times_of_a_copy(tmp_path):
    content = container(chunk(DEFINITIONS + message_record(time=70)), chunk(b""))
    (tmp_path / "log.mcap").write_bytes(content)
    copy = io.BytesIO()
    append(scan(tmp_path / "log.mcap", lambda _: True), copy, [], {"more": {"key": "value"}})
    (tmp_path / "copy.mcap").write_bytes(copy.getvalue())
    log = scan(tmp_path / "copy.mcap", lambda _: True)
    assert log.findings == ()
    assert [(each.data, each.log_time) for each in log.messages] == [(b"payload", 70)]
    assert [each.name for each in log.metadata] == ["more"]


@pytest.fixture(scope="module", params=[CompressionType.ZSTD, CompressionType.LZ4, CompressionType.NONE])
def exported(request, tmp_path_factory) -> tuple[bytes, pathlib.Path]:
    """A log, and the folder with what was made of it."""
    folder = tmp_path_factory.mktemp("exported")
    log = sound_log(compression=request.param).write(folder / "yard.mcap")
    assert run("optimize", log, *QUICK, "--method", "shortcut+shortcut", "--out", folder / "out") == 0
    return log.read_bytes(), folder / "out"


def test_other_software_reads_the_paths_of_truck_and_trailer(exported):
    original, out = exported
    content = (out / "yard.optimised.mcap").read_bytes()
    assert content.startswith(data_section(original))
    document = results_data(out / "yard.results.json")
    expected = {method["name"]: path_from_document(method["path"]).samples.states for method in document["methods"]}
    cases = read_cases(out.parent / "yard.mcap")
    reader = make_reader(io.BytesIO(content), validate_crcs=True, decoder_factories=[DecoderFactory()])
    found = {}
    for schema, channel, message, decoded in reader.iter_decoded_messages():
        if channel.topic.startswith("/replay/"):
            assert schema is not None
            assert (schema.name, schema.encoding, channel.message_encoding) == (PATH, "ros2msg", "cdr")
            assert message.log_time == 2 * SECOND
            again = typestore().deserialize_cdr(message.data, PATH)
            for each in (decoded, again):
                assert (each.header.frame_id, each.header.stamp.sec, each.poses[0].header.frame_id) == ("map", 2, "map")
                where = [(row.pose.position.x, row.pose.position.y) for row in each.poses]
                turn = [2.0 * np.arctan2(row.pose.orientation.z, row.pose.orientation.w) for row in each.poses]
                found[channel.topic] = np.column_stack([where, turn])
    topics = topic_names(list(expected))
    assert topics == {"shortcut": "/replay/shortcut", "shortcut+shortcut": "/replay/shortcut_shortcut"}
    assert sorted(found) == sorted(f"{topic}/{name}" for topic in topics.values() for name in ("path", "trailer_path"))
    for method, states in expected.items():
        poses = axle_poses(cases[0].problem.vehicle, states)
        for body, name in enumerate(("path", "trailer_path")):
            got = found[f"{topics[method]}/{name}"]
            np.testing.assert_array_equal(got[:, :2], poses[:, body, :2])
            np.testing.assert_allclose(np.exp(1j * got[:, 2]), np.exp(1j * poses[:, body, 2]), atol=1e-12)


def test_the_copy_is_read_as_the_log_was_and_an_exported_path_on_demand(exported):
    _, out = exported
    copy = out / "yard.optimised.mcap"
    (before,), (after,) = read_cases(out.parent / "yard.mcap"), read_cases(copy)
    for key in ("x", "y", "theta", "alpha", "phi"):
        for a, b in zip(before.problem.recorded.segments, after.problem.recorded.segments, strict=True):
            np.testing.assert_array_equal(getattr(a, key), getattr(b, key))
    (chosen,) = read_cases(copy, ReadOptions(path_topic="/replay/shortcut/path"))
    assert chosen.read.hitch == "trailer path"
    document = results_data(out / "yard.results.json")
    length = document["methods"][0]["metrics"]["length"]
    assert chosen.problem.recorded.length == pytest.approx(length, rel=1e-3)


def test_info_shows_recorded_and_exported_paths(exported, capsys):
    _, out = exported
    assert run("info", out / "yard.optimised.mcap", "--json") == 0
    (said,) = json.loads(capsys.readouterr().out)["logs"]
    paths = {channel["topic"] for channel in said["channels"] if channel["read_as"] == "path"}
    assert paths >= {"/truck", "/trailer", "/replay/shortcut/path", "/replay/shortcut/trailer_path"}


def test_what_became_of_each_method_stands_in_the_metadata(exported):
    _, out = exported
    reader = NonSeekingReader(io.BytesIO((out / "yard.optimised.mcap").read_bytes()))
    (record,) = (each for each in reader.iter_metadata() if each.name == "replay")
    statuses = json.loads(record.metadata["paths"])["yard/0"]
    assert list(statuses) == ["shortcut", "shortcut+shortcut"]
    assert set(statuses.values()) <= {"improved", "kept"}


def test_all_requests_of_a_log_are_in_one_copy(tmp_path):
    truck, _ = drive()
    maker = LogMaker().vehicle().add("/map", grid(yard()), 1)
    for k in range(2):
        maker.add("/truck", path(truck[: 70 + 20 * k]), 2 + k)
    log = maker.write(tmp_path / "two.mcap")
    assert run("optimize", log, *QUICK, "--out", tmp_path / "out") == 0
    assert len(list((tmp_path / "out").glob("*.mcap"))) == 1
    with (tmp_path / "out" / "two.optimised.mcap").open("rb") as file:
        messages = make_reader(file).iter_messages(topics=["/replay/shortcut/path"])
        assert [message.log_time for _, _, message in messages] == [2 * SECOND, 3 * SECOND]


def test_a_log_that_has_lost_something_has_no_copy_but_its_results(tmp_path, capsys):
    maker = sound_log(compression=CompressionType.NONE, chunk_size=1)
    content = maker.add_raw("/more", "std_msgs/msg/String", b"the last words", 9).bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: content.find(b"the last words") + 5])
    assert run("optimize", tmp_path / "cut.mcap", *QUICK, "--out", tmp_path / "out") == 1
    assert [file.name for file in (tmp_path / "out").iterdir()] == ["cut.results.json"]
    assert "part of it is damaged" in capsys.readouterr().err


def test_a_log_that_is_another_file_by_now_is_refused(tmp_path):
    log = sound_log().write(tmp_path / "yard.mcap")
    made = factory.make_run()
    changed = dataclasses.replace(made, case=dataclasses.replace(made.case, log=log))
    with pytest.raises(LogError, match="it has changed since it was read"):
        write_export([changed], tmp_path / "out.mcap")
    assert not (tmp_path / "out.mcap").exists()


def test_an_input_is_not_overwritten_by_an_export(tmp_path, capsys):
    log = sound_log().write(tmp_path / "yard.mcap")
    other = sound_log().write(tmp_path / "yard.optimised.mcap")
    before = other.read_bytes()
    assert run("optimize", log, other, *QUICK, "--out", tmp_path) == 1
    assert "is an input and will not be overwritten" in capsys.readouterr().err
    assert other.read_bytes() == before


def test_names_of_methods_become_names_that_ros_allows():
    assert topic_names(["a+b", "a_b", "+"]) == {"a+b": "/replay/a_b", "a_b": "/replay/a_bx", "+": "/replay/method"}
