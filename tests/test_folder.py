"""Folders that rosbag2 recorded: parts in MCAP, and a metadata.yaml that lists them."""

import pathlib
import shutil
from collections.abc import Callable

import logs_maker as make
import numpy as np
import pytest
from mcap.writer import Writer
from rosbags.rosbag2 import StoragePlugin
from rosbags.rosbag2 import Writer as RosbagsWriter

from replay.base.errors import LogError
from replay.cli import main
from replay.logs import read_cases
from replay.logs.container.folder import METADATA, open_log
from replay.logs.container.log import Log, ReadLimits
from replay.logs.meaning.topics import topics_of
from replay.logs.meaning.understood import uses
from replay.run.case import Case

DATA = pathlib.Path(__file__).parent / "data"
TRUCK, AXLE = make.drive()
LISTED = (
    "rosbag2_bagfile_information:\n  version: 5\n  storage_identifier: mcap\n  relative_file_paths:\n{}  duration:\n"
)


def everything(_: object) -> bool:
    return True


@pytest.fixture
def bag(tmp_path: pathlib.Path) -> pathlib.Path:
    """Two parts: vehicle and map in one, the paths in the other."""
    folder = tmp_path / "bag_2024.01"
    folder.mkdir()
    make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1).write(folder / "b.mcap")
    paths = make.LogMaker().add("/other", make.joints({}), 1).add("/truck", make.path(TRUCK), 2)
    paths.add("/trailer", make.path(AXLE), 2).write(folder / "a.mcap")
    listed(folder, "b.mcap", "'a.mcap'")
    return folder


def listed(folder: pathlib.Path, *names: str, more: str = "") -> None:
    text = LISTED.format("".join(f"    - {name}\n" for name in names))
    (folder / METADATA).write_text(text + more)


def error_of(folder: pathlib.Path) -> LogError:
    with pytest.raises(LogError) as caught:
        read_cases(folder)
    assert str(caught.value).isprintable()
    return caught.value


def test_the_parts_of_a_folder_are_one_log(bag: pathlib.Path) -> None:
    (case,) = read_cases(bag)
    assert (case.name, case.log, case.read.hitch, case.read.lost) == ("bag_2024.01/0", bag, "trailer path", False)
    np.testing.assert_allclose(case.problem.recorded.start[:3], TRUCK[0])
    log = open_log(bag, everything)
    assert [(channel.id, channel.topic) for channel in log.channels] == [
        (1, "/map"), (2, "/other"), (3, "/truck"), (4, "/trailer"),
    ]  # fmt: skip
    assert log.counts == {1: 1, 2: 1, 3: 1, 4: 1}
    assert log.size == sum(part.stat().st_size for part in bag.glob("*.mcap"))
    assert log.sha256 != open_log(bag / "a.mcap", everything).sha256


def test_a_bag_by_rosbags_is_read(tmp_path: pathlib.Path) -> None:
    folder = tmp_path / "bag"
    with RosbagsWriter(folder, version=9, storage_plugin=StoragePlugin.MCAP) as writer:
        for topic, message in (("/map", make.grid(make.yard())), ("/truck", make.path(TRUCK))):
            connection = writer.add_connection(topic, message.__msgtype__, typestore=make.typestore())
            writer.write(connection, 1, make.serialised(message))
    (case,) = read_cases(folder)
    assert case.name == "bag/0"


def test_a_recording_in_parts_by_rosbag2_itself_counts_as_one(tmp_path: pathlib.Path) -> None:
    folder = tmp_path / "multiple_files"
    shutil.copytree(DATA / "multiple_files", folder)

    def read() -> Log:
        return open_log(folder, everything)

    by_number = read()
    assert [finding.code for finding in by_number.findings] == ["W_NO_METADATA"]
    listed(folder, *(f"multiple_files_{i}.mcap" for i in range(3)))
    log = read()
    assert [(channel.topic, log.counts[channel.id]) for channel in log.channels] == [("/chatter", 1324 + 1324 + 529)]
    assert len(log.messages) == 3177
    assert not log.findings
    assert log.sha256 == by_number.sha256
    assert [use.text for use in uses(log, topics_of(log))] == ["not read: unknown type"]


def test_parts_that_are_missing_damaged_or_not_listed_are_told(bag: pathlib.Path) -> None:
    shutil.copy(bag / "a.mcap", bag / "c.mcap")
    (bag / "d.mcap").write_bytes(b"")
    listed(bag, "b.mcap", "a.mcap", "d.mcap", "gone.mcap")
    (case,) = read_cases(bag)
    assert case.read.lost
    for part in ("part gone.mcap is missing", "does not list c.mcap", "part d.mcap is lost"):
        assert any(part in note for note in case.read.notes)
    damaged = bytearray((bag / "a.mcap").read_bytes())
    damaged[len(damaged) // 2] ^= 1
    (bag / "b.mcap").write_bytes(damaged)
    log = open_log(bag, everything)
    assert any(finding.text.startswith("part b.mcap: ") for finding in log.findings)


@pytest.mark.parametrize(
    ("text", "code", "says"),
    [
        (LISTED.format("    - gone.mcap\n"), "E_NOT_A_FILE", "none of the 1 parts"),
        (LISTED.format(""), "E_METADATA", "lists no files"),
        ("nothing", "E_METADATA", "lists no files"),
        (LISTED.format("    - ../b.mcap\n"), "E_METADATA", "'../b.mcap', expected names"),
        (LISTED.format("    - /etc/passwd\n"), "E_METADATA", "expected names"),
        ("storage_identifier: sqlite3\nrelative_file_paths: [bag.db3]\n", "E_METADATA", "stored as 'sqlite3'"),
        ('compression_mode: "file"\nrelative_file_paths: [b.mcap]\n', "E_METADATA", "whole files are compressed"),
        ("relative_file_paths:\n" + "- b.mcap\n" * 200_000, "E_METADATA", "longer than"),
        (
            "relative_file_paths:\n- b.mcap\n" + "".join(f"- {i}.mcap\n" for i in range(1001)),
            "E_TOO_LARGE",
            "at most 1000",
        ),
    ],
)
def test_folders_that_are_no_such_bag_are_refused(bag: pathlib.Path, text: str, code: str, says: str) -> None:
    (bag / METADATA).write_text(text)
    error = error_of(bag)
    assert error.code == code
    assert says in str(error)


def test_other_folders_are_refused(bag: pathlib.Path, tmp_path: pathlib.Path) -> None:
    (bag / METADATA).write_bytes(b"\xff\xfe")
    assert "UTF-8" in str(error_of(bag))
    (bag / METADATA).unlink()
    (bag / METADATA).symlink_to("/proc/self/mem")  # whose first byte cannot be read
    error = error_of(bag)
    assert (error.code, "metadata.yaml cannot be read" in str(error)) == ("E_METADATA", True)
    (bag / METADATA).unlink()
    error = error_of(bag)  # two logs beside each other are not a recording in parts
    assert (error.code, "without metadata.yaml" in str(error)) == ("E_NOT_A_FILE", True)
    empty = tmp_path / "empty"
    empty.mkdir()
    assert "without MCAP files" in str(error_of(empty))
    (empty / METADATA).symlink_to(tmp_path / "nothing")
    assert error_of(empty).code == "E_NOT_A_FILE"


def test_a_bag_none_of_whose_parts_can_be_read_is_refused(bag: pathlib.Path) -> None:
    for part in bag.glob("*.mcap"):
        part.write_bytes(b"no log")
    assert error_of(bag).code == "E_NOT_MCAP"


def test_all_parts_share_the_limit_of_what_is_kept(bag: pathlib.Path) -> None:
    size = sum(len(message.data) for message in open_log(bag / "b.mcap", everything).messages)
    with pytest.raises(LogError) as caught:
        open_log(bag, everything, ReadLimits(kept=size + 1000))
    assert caught.value.code == "E_TOO_LARGE"


@pytest.mark.parametrize("flow", ["[b.mcap, 'a.mcap']", '["b.mcap","a.mcap"]'])
def test_a_list_in_brackets_is_a_list(bag: pathlib.Path, flow: str) -> None:
    (bag / METADATA).write_text(f"relative_file_paths: {flow}\nstorage_identifier: 'mcap'\n")
    assert len(read_cases(bag)) == 1


def test_info_takes_a_folder_and_says_what_was_understood(
    bag: pathlib.Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setenv("COLUMNS", "100")
    assert main(["info", str(bag)]) == 0
    shown = capsys.readouterr().out
    for part in ("map: grid, 60000 cells", "path, 105 poses", "joints, 1 states", "bag_2024.01/0"):
        assert part in shown
    assert all(len(line) <= 100 for line in shown.splitlines() if not line.startswith(str(bag)))


def test_what_was_not_understood_is_told_with_the_reason(
    read: Callable[..., list[Case]], tmp_path: pathlib.Path
) -> None:
    maker = make.sound_log().add_raw("/image", "sensor_msgs/msg/Image", b"x")
    maker.add_raw("/cut", make.PATH, make.serialised(make.path(TRUCK))[:90], definition=maker.messages[1][4])
    maker.add_raw("/json", make.PATH, b"{}", encoding="json").add_raw("/plain", make.PATH, b"")
    maker.add("/lots", make.polygon([(0.0, 0.0)])).add("/shapes", make.markers(make.marker(1, (1.0, 1.0, 1.0))))
    maker.add("/tf", make.transforms(make.transform("a", "b", (0.0, 0.0, 0.0))))
    log = open_log(maker.write(tmp_path / "odd.mcap"), everything)
    found = {channel.topic: use for channel, use in zip(log.channels, uses(log, topics_of(log)), strict=True)}
    assert found["/truck"] == ("path", "path, 105 poses")
    assert found["/image"] == (None, "not read: unknown type")
    assert found["/cut"].text.endswith("[E_PAYLOAD]")
    assert found["/cut"].text.startswith("not read: message 0: poses claims")
    assert found["/json"].text.endswith("[E_ENCODING]")
    assert "is not the standard one" in found["/plain"].text
    texts = {topic: found[topic].text for topic in ("/lots", "/shapes", "/tf")}
    assert texts == {
        "/lots": "map: polygons, 1 polygons",
        "/shapes": "map: shapes, 1 changes",
        "/tf": "transforms, 1 transforms",
    }


def test_channels_without_a_schema_or_without_messages_are_told(tmp_path: pathlib.Path) -> None:
    file = tmp_path / "log.mcap"
    with file.open("wb") as out:
        writer = Writer(out)
        writer.start()
        plain = writer.register_channel("/plain", "json", 0)
        writer.add_message(plain, log_time=1, publish_time=1, data=b"{}")
        writer.register_channel("/path", "cdr", writer.register_schema(make.PATH, "ros2msg", b""))
        writer.finish()
    log = open_log(file, everything)
    assert [use.text for use in uses(log, topics_of(log))] == ["not read: no schema", "no messages"]


def test_real_messages_in_an_encoding_of_their_own_are_told() -> None:
    log = open_log(DATA / "wrong_rmw_test_0.mcap", everything)
    assert [channel.encoding for channel in log.channels] == ["wrong_format"] * 2
    assert {use.text for use in uses(log, topics_of(log))} == {"not read: unknown type"}
    assert sum(log.counts.values()) == sum(open_log(DATA / "cdr_test_0.mcap", everything).counts.values()) == 7
