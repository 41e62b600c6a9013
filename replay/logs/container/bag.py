"""A copy of a folder that rosbag2 recorded, with a part added that holds new messages.

The parts are copied byte for byte, and `metadata.yaml` is written again from what they hold. It is written last, as
rosbag2 does itself: a folder without it is not finished.
"""

import json
import pathlib
import shutil
from collections.abc import Mapping, Sequence
from typing import Final

from replay.base.errors import LogError, ReplayError
from replay.base.files import WRITE_ERROR, atomic_write
from replay.logs.container.append import NewTopic, refuse_lost, time_span, write_log
from replay.logs.container.folder import METADATA, open_log, parts_of
from replay.logs.container.log import Log

_VERSION: Final = 4
"""Version of `metadata.yaml`: the last one that needs no more than the parts hold; every later rosbag2 reads it."""


def write_bag(
    log: Log, folder: pathlib.Path, topics: Sequence[NewTopic], metadata: Mapping[str, Mapping[str, str]]
) -> None:
    """Copy the bag `log` to `folder` and add a part with new topics and metadata records; read it back.

    Files of other names that are there stay, and are not listed.

    Raises:
        LogError: E_EXPORT, where part of the bag is lost, or its copy cannot be read back.
        ReplayError: E_WRITE, where a file cannot be written.
    """
    refuse_lost(log)
    names, _ = parts_of(log.path)
    try:
        folder.mkdir(exist_ok=True)
        (folder / METADATA).unlink(missing_ok=True)
    except OSError as error:
        raise ReplayError(WRITE_ERROR, f"{folder}: cannot be written: {error.strerror}") from error
    for name in names:
        with atomic_write(folder / name) as temporary:
            shutil.copyfile(log.path / name, temporary)
    added = _free_name(names)
    with atomic_write(folder / added) as temporary, temporary.open("wb") as file:
        write_log(file, topics, metadata)
    names = [*names, added]
    with atomic_write(folder / METADATA) as temporary:
        temporary.write_text(_metadata(folder, names, log, topics), encoding="utf-8", errors="surrogateescape")
    copy = open_log(folder, lambda _: False)
    expected = sum(log.counts.values()) + sum(len(topic.messages) for topic in topics)
    if copy.lost or sum(copy.counts.values()) != expected:
        raise LogError("E_EXPORT", log.path, "its copy cannot be read back: messages are missing")


def _free_name(names: Sequence[str]) -> str:
    """A name for the new part that no other has."""
    number, name = 0, "optimised.mcap"
    while name in names:
        number += 1
        name = f"optimised_{number}.mcap"
    return name


def _metadata(folder: pathlib.Path, names: Sequence[str], log: Log, topics: Sequence[NewTopic]) -> str:
    """The text of `metadata.yaml`."""
    times = [time for name in names for time in time_span(folder / name)] or [0]
    counted = [
        (channel.topic, channel.schema.name, channel.encoding, channel.qos, log.counts.get(channel.id, 0))
        for channel in log.channels
        if channel.schema is not None
    ]
    counted += [(topic.topic, topic.schema, "cdr", "", len(topic.messages)) for topic in topics]
    lines = [
        "rosbag2_bagfile_information:",
        f"  version: {_VERSION}",
        "  storage_identifier: mcap",
        "  relative_file_paths:",
        *(f"    - {_quoted(name)}" for name in names),
        "  duration:",
        f"    nanoseconds: {max(times) - min(times)}",
        "  starting_time:",
        f"    nanoseconds_since_epoch: {min(times)}",
        f"  message_count: {sum(count for *_, count in counted)}",
        "  topics_with_message_count:",
    ]
    for topic, kind, encoding, qos, count in counted:
        lines += [
            "    - topic_metadata:",
            f"        name: {_quoted(topic)}",
            f"        type: {_quoted(kind)}",
            f"        serialization_format: {_quoted(encoding)}",
            f"        offered_qos_profiles: {_quoted(qos)}",
            f"      message_count: {count}",
        ]
    return "\n".join([*lines, '  compression_format: ""', '  compression_mode: ""', ""])


def _quoted(text: str) -> str:
    """A scalar of YAML, which includes JSON's."""
    return json.dumps(text, ensure_ascii=False)
