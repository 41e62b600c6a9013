"""The topics of a log: each message is decoded once, as long as what was decoded is not too large to keep."""

from pathlib import Path

import numpy as np
import pytest
from logs_maker import LogMaker, drive, grid, path, sound_log, yard

from replay.base.errors import LogError
from replay.logs.container.folder import open_log
from replay.logs.meaning import topics
from replay.logs.meaning.topics import DecodedMessages, Topic, is_wanted, topics_of
from replay.logs.messages.types import Grid, Header


def opened(maker: LogMaker, folder: Path) -> list[Topic]:
    return topics_of(open_log(maker.write(folder / "log.mcap"), is_wanted))


def test_a_message_is_decoded_once(tmp_path: Path) -> None:
    for topic in opened(sound_log(), tmp_path):
        assert topic.decode(0) is topic.decode(0)


def test_messages_of_topics_with_one_name_and_two_types_are_not_mistaken_for_each_other(tmp_path: Path) -> None:
    maker = LogMaker().add("/both", path(drive()[0]), 1).add("/both", grid(yard()), 2)
    kinds = {type(topic.decode(0)).__name__ for topic in opened(maker, tmp_path)}
    assert kinds == {"PoseSeries", "Grid"}


def test_a_message_that_cannot_be_decoded_is_refused_each_time_with_the_same_words(tmp_path: Path) -> None:
    maker = sound_log(trailer=False)
    kind = "nav_msgs/msg/Path"
    definition = next(each[4] for each in maker.messages if each[1] == kind)
    maker.messages = [each for each in maker.messages if each[1] != kind]
    maker.add_raw("/truck", kind, b"\0\1\0\0short", 2, definition=definition)
    (topic,) = [each for each in opened(maker, tmp_path) if each.name == "/truck"]
    said = []
    for _ in range(2):
        with pytest.raises(LogError) as error:
            topic.decode(0)
        said.append(str(error.value))
    assert said[0] == said[1]
    assert said[0].endswith("[E_PAYLOAD]")


def test_what_is_too_large_to_keep_is_decoded_again(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(topics, "KEPT_BYTES", 10_000)
    decoded, calls = DecodedMessages(), []

    def decode() -> Grid:
        calls.append(1)
        cells = np.zeros(6000, np.int8)
        return Grid(header=Header(0, ""), resolution=1.0, width=60, height=100, origin=np.zeros(7), data=cells)

    for number in (0, 1, 0, 1, 1):
        decoded.get(("/map", "Grid", number), decode)
    assert len(calls) == 4  # the first is kept, the second is not
