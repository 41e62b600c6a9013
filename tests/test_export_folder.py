"""Paths written back into a copy of a folder that rosbag2 recorded: its parts as they were, and one more."""

import pathlib
import shutil

import numpy as np
import pytest
from logs_maker import LogMaker, drive, grid, joints, path, typestore, yard
from mcap.reader import make_reader
from results_maker import results_data
from rosbags.interfaces import (
    ConnectionExtRosbag2,
    Qos,
    QosDurability,
    QosHistory,
    QosLiveliness,
    QosReliability,
    QosTime,
)
from rosbags.rosbag2 import Reader, StoragePlugin, Writer

import replay.cli
from replay.logs import ReadOptions, read_cases
from replay.logs.container.scan import scan
from replay.run.plain import path_from_document

QUICK = ["--method", "shortcut", "--shortcut.tries", "10", "--no-recording", "--export"]
LISTED = """rosbag2_bagfile_information:
  version: 5
  storage_identifier: mcap
  relative_file_paths:
    - b.mcap
    - a.mcap
"""


def run(*arguments: str | pathlib.Path) -> int:
    return replay.cli.main([str(argument) for argument in arguments])


@pytest.fixture
def bag(tmp_path: pathlib.Path) -> pathlib.Path:
    """Two parts that give their channels the same numbers: vehicle and map in one, the paths in the other."""
    truck, axle = drive()
    folder = tmp_path / "bag_2024.01"
    folder.mkdir()
    LogMaker().vehicle().add("/map", grid(yard()), 1).write(folder / "b.mcap")
    paths = LogMaker().add("/other", joints({}), 1).add("/truck", path(truck), 2)
    paths.add("/trailer", path(axle), 2).write(folder / "a.mcap")
    (folder / "metadata.yaml").write_text(LISTED)
    return folder


@pytest.fixture
def copy(bag: pathlib.Path) -> pathlib.Path:
    out = bag.parent / "out"
    assert run("optimize", bag, *QUICK, "--out", out) == 0
    return out / "bag_2024.01.optimised"


def test_every_part_is_copied_byte_for_byte(bag: pathlib.Path, copy: pathlib.Path) -> None:
    for name in ("a.mcap", "b.mcap"):
        assert (copy / name).read_bytes() == (bag / name).read_bytes()
    names = {file.name for file in copy.iterdir()}
    assert names == {"a.mcap", "b.mcap", "optimised.mcap", "metadata.yaml"}


def test_rosbags_reads_the_messages_of_all_parts_and_the_new_paths(bag: pathlib.Path, copy: pathlib.Path) -> None:
    store = typestore()
    document = results_data(copy.parent / "bag_2024.01.results.json")
    expected = path_from_document(document["methods"][0]["path"]).samples.states
    with Reader(copy) as reader:
        counts = {connection.topic: connection.msgcount for connection in reader.connections}
        messages = {connection.topic: data for connection, _, data in reader.messages()}
    names = {"/map", "/other", "/truck", "/trailer", "/replay/shortcut/path", "/replay/shortcut/trailer_path"}
    assert counts == dict.fromkeys(names, 1)
    assert set(messages) == names
    found = store.deserialize_cdr(messages["/replay/shortcut/path"], "nav_msgs/msg/Path")
    for pose, state in ((found.poses[0], expected[0]), (found.poses[-1], expected[-1])):
        assert (pose.pose.position.x, pose.pose.position.y) == (state[0], state[1])


def test_the_official_reader_finds_the_new_part_whole_and_indexed(copy: pathlib.Path) -> None:
    with (copy / "optimised.mcap").open("rb") as file:
        reader = make_reader(file, validate_crcs=True)
        topics = [channel.topic for _, channel, _ in reader.iter_messages()]
        summary = reader.get_summary()
    assert sorted(topics) == ["/replay/shortcut/path", "/replay/shortcut/trailer_path"]
    assert summary is not None
    assert len(summary.chunk_indexes) == 1
    assert scan(copy / "optimised.mcap", lambda _: True).findings == ()


def test_the_copy_is_read_as_its_log_was_and_may_be_exported_again(bag: pathlib.Path, copy: pathlib.Path) -> None:
    (before,), (after,) = read_cases(bag), read_cases(copy)
    np.testing.assert_array_equal(after.problem.recorded.samples.states, before.problem.recorded.samples.states)
    (exported,) = read_cases(copy, ReadOptions(path_topic="/replay/shortcut/path"))
    assert exported.read.hitch == "trailer path"
    assert run("optimize", copy, *QUICK, "--out", bag.parent / "again") == 0
    again = bag.parent / "again" / f"{copy.name}.optimised"
    assert (again / "optimised.mcap").read_bytes() == (copy / "optimised.mcap").read_bytes()
    assert (again / "optimised_1.mcap").is_file()


def test_topics_keep_the_quality_of_service_under_which_they_were_offered(tmp_path: pathlib.Path) -> None:
    store, forever = typestore(), QosTime(2**31 - 1, 999_999_999)
    latched = Qos(
        QosHistory.KEEP_LAST,
        1,
        QosReliability.RELIABLE,
        QosDurability.TRANSIENT_LOCAL,
        forever,
        forever,
        QosLiveliness.AUTOMATIC,
        forever,
        False,
    )
    truck, axle = drive()
    topics = {"/map": (grid(yard()), [latched]), "/truck": (path(truck), []), "/trailer": (path(axle), [])}
    with Writer(tmp_path / "bag", version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, (message, qos) in topics.items():
            kind = message.__msgtype__
            connection = writer.add_connection(topic, kind, typestore=store, offered_qos_profiles=qos)
            writer.write(connection, 1, store.serialize_cdr(message, kind))
    assert run("optimize", tmp_path / "bag", *QUICK, "--out", tmp_path) == 0
    with Reader(tmp_path / "bag.optimised") as reader:
        bags = ((each.topic, each.ext) for each in reader.connections)
        offered = {topic: [*bag.offered_qos_profiles] for topic, bag in bags if isinstance(bag, ConnectionExtRosbag2)}
    assert {topic: offered[topic] for topic in topics} == {topic: qos for topic, (_, qos) in topics.items()}


def test_an_earlier_copy_is_replaced(bag: pathlib.Path, copy: pathlib.Path) -> None:
    before = {file.name: file.read_bytes() for file in copy.iterdir()}
    (copy / "metadata.yaml").write_text("half")
    assert run("optimize", bag, *QUICK, "--out", copy.parent) == 0
    assert {file.name: file.read_bytes() for file in copy.iterdir()} == before


def test_a_bag_of_which_a_part_is_lost_has_no_copy(bag: pathlib.Path, capsys: pytest.CaptureFixture[str]) -> None:
    shutil.copy(bag / "b.mcap", bag / "c.mcap")
    (bag / "metadata.yaml").write_text(LISTED + "    - d.mcap\n")
    assert run("optimize", bag, *QUICK, "--out", bag.parent / "out") == 1
    assert "part d.mcap is missing" in capsys.readouterr().err
    assert [file.name for file in (bag.parent / "out").iterdir()] == ["bag_2024.01.results.json"]


def test_a_file_in_the_place_of_the_copy_is_told_in_one_line(
    bag: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out = bag.parent / "out"
    out.mkdir()
    (out / "bag_2024.01.optimised").write_text("mine")
    assert run("optimize", bag, *QUICK, "--out", out) == 1
    assert "bag_2024.01.optimised: cannot be written: File exists" in capsys.readouterr().err
    assert (out / "bag_2024.01.optimised").read_text() == "mine"
