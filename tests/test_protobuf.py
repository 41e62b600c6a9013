"""Protocol buffers and JSON as they come in logs: what is ignored, what is refused, and with which words."""

import contextlib
import json
import time
from collections.abc import Callable
from typing import Any

import foxglove_maker as fox
import logs_maker as make
import numpy as np
import pytest
from google.protobuf import descriptor_pool, message_factory
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from test_foxglove import decode, refused

from replay.logs.messages import json_messages, protobuf
from replay.logs.messages.foxglove import MESSAGE_TYPES
from replay.logs.messages.types import DefinitionError, PayloadError

TRUCK, _ = make.drive()


# ---- protobuf


def test_the_field_numbers_are_those_of_the_logs_own_descriptors() -> None:
    found = FileDescriptorSet.FromString(fox.definition(fox.poses([])))
    for file in found.file:
        for each in file.message_type:
            for field in each.field:
                field.number += 40
    pool = classes_of(found)
    mine = pool("foxglove.PosesInFrame")(frame_id="odom")
    mine.poses.add().position.x = 7.0
    series = MESSAGE_TYPES["foxglove.PosesInFrame"].decoder(("protobuf", "protobuf"), found.SerializeToString())(
        mine.SerializeToString()
    )
    assert (series.header.frame, series.poses[0, 0]) == ("odom", 7.0)


def classes_of(found: FileDescriptorSet) -> Callable[[str], Any]:
    """Message classes from descriptors, in a pool of their own."""
    pool = descriptor_pool.DescriptorPool()
    todo = list(found.file)
    while todo:
        file = todo.pop(0)
        try:
            pool.AddSerializedFile(file.SerializeToString())
        except TypeError:  # what it imports is not there yet
            todo.append(file)
    return lambda name: message_factory.GetMessageClass(pool.FindMessageTypeByName(name))


def _with(change: Callable[[FileDescriptorProto], Any]) -> bytes:
    found = FileDescriptorSet.FromString(fox.definition(fox.poses([])))
    change(next(file for file in found.file if file.name.endswith("PosesInFrame.proto")))
    return found.SerializeToString()


def _deep(file: FileDescriptorProto) -> None:
    inner = file.message_type[0]
    for _ in range(1100):
        inner = inner.nested_type.add(name="In")


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "not a set of descriptors"),
        (b"\xff" * 40, "damaged"),
        (b"\x0a\xff\x01", "damaged"),
        (b"\x0a\x02\x0a\x05", "damaged"),
        (bytes(protobuf.MAX_SET + 1), "at most"),
        (b"\x0a\x00" * 65, "65 files"),
        (_with(lambda f: f.message_type.add(name="PosesInFrame")), "duplicate symbol"),
        (_with(lambda f: f.message_type[0].__setattr__("name", "Other")), "PosesInFrame is not defined"),
        (
            _with(lambda f: f.message_type[0].field[1].__setattr__("type", 5)),
            "'frame_id'.*is 'type 5', expected 'string'",
        ),
        (
            _with(lambda f: f.message_type[0].field[2].__setattr__("label", 1)),
            "is 'foxglove.Pose', expected 'foxglove.Pose\\[\\]'",
        ),
        (_with(lambda f: f.message_type[0].field[2].__setattr__("type_name", ".foxglove.Vector3")), "Vector3"),
        (_with(lambda f: f.message_type[0].ClearField("field")), "none of the fields"),
        (_with(lambda f: [f.message_type.add(name=f"M{i}") for i in range(1100)]), "more than 1024 messages"),
        (_with(_deep), "more than 1024 messages|damaged"),
        (
            _with(lambda f: f.__setattr__("package", "a")).replace(b"\x12\x01a", b"\x12\x01\xff"),
            "damaged|not defined",
        ),
    ],
)
def test_descriptors_that_cannot_be_used_are_an_error_of_one_line(data: bytes, says: str) -> None:
    with pytest.raises(DefinitionError, match=says) as caught:
        MESSAGE_TYPES["foxglove.PosesInFrame"].decoder(("protobuf", "protobuf"), data)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"\x00\x01", "damaged"),
        (b"\x0b", "damaged"),
        (b"\x1b\x1c", "poses has the wire type 3"),
        (b"\x12\x05ab", "damaged, or no foxglove.PosesInFrame"),
        (b"\x12" + b"\xff" * 9, "damaged"),
        (b"\x12" + b"\xff" * 11, "damaged"),
        (b"\x12\x02\xff\xfe", "damaged"),
        (b"\x10\x05", "frame_id has the wire type 0"),
        (b"\x0a\x06\x10\xff\xff\xff\xff\x0f", "not a time"),
        (b"\x1a\x04\x0a\x02\x08\x01", "foxglove.Vector3.x has the wire type 0"),
        (b"\x1a\x00" * 1_000_001, "more than 1000000 messages"),
        (bytes(protobuf.MAX_MESSAGE + 1), "at most 16777216"),
        (b"\xf8\x07\x01" * 22_000, "66000 bytes of it are fields that its definition does not have"),
    ],
)
def test_payloads_that_are_no_such_message_are_refused(data: bytes, says: str) -> None:
    read = MESSAGE_TYPES["foxglove.PosesInFrame"].decoder(("protobuf", "protobuf"), fox.definition(fox.poses([])))
    with pytest.raises(PayloadError, match=says):
        read(data)


@pytest.mark.parametrize("mebibytes", [1, 15, 60])
def test_a_message_of_unknown_fields_costs_little_time(mebibytes: int) -> None:
    read = MESSAGE_TYPES["foxglove.PosesInFrame"].decoder(("protobuf", "protobuf"), fox.definition(fox.poses([])))
    data = b"\xf8\x07\x01" * ((mebibytes << 20) // 3)
    began = time.process_time()
    with contextlib.suppress(PayloadError):
        read(data)
    assert time.process_time() - began < 2.0


def _imports(file: FileDescriptorProto, *names: str) -> None:
    file.dependency.extend(names)


def test_files_are_read_after_those_that_they_import_and_in_no_circle() -> None:
    found = FileDescriptorSet.FromString(fox.definition(fox.poses([])))
    files = list(found.file)
    for order in (files, files[::-1]):
        data = FileDescriptorSet(file=order).SerializeToString()
        MESSAGE_TYPES["foxglove.PosesInFrame"].decoder(("protobuf", "protobuf"), data)
    for file in (files[0].name, "nowhere.proto"):
        with pytest.raises(DefinitionError, match="imports itself, or a file that is not in the descriptors"):
            MESSAGE_TYPES["foxglove.PosesInFrame"].decoder(
                ("protobuf", "protobuf"), _with(lambda each, file=file: _imports(each, file))
            )


def test_the_times_that_every_runtime_knows_may_be_missing_from_the_set() -> None:
    found = FileDescriptorSet.FromString(fox.definition(fox.poses([])))
    kept = [file for file in found.file if not file.name.startswith("google/")]
    read = MESSAGE_TYPES["foxglove.PosesInFrame"].decoder(
        ("protobuf", "protobuf"), FileDescriptorSet(file=kept).SerializeToString()
    )
    assert read(fox.poses([(1.0, 2.0, 0.0)], stamp=5).SerializeToString()).header.stamp == 5


def test_what_one_log_defines_does_not_change_what_another_means() -> None:
    other = _with(lambda f: f.message_type[0].field[1].__setattr__("number", 50))
    for definition, frame in ((fox.definition(fox.poses([])), "map"), (other, "")) * 2:
        read = MESSAGE_TYPES["foxglove.PosesInFrame"].decoder(("protobuf", "protobuf"), definition)
        assert read(fox.poses([(1.0, 2.0, 0.0)]).SerializeToString()).header.frame == frame


def test_a_payload_that_ends_early_never_does_more_than_fail() -> None:
    for each in (
        fox.poses(TRUCK[:2]),
        fox.grid(make.yard(4.0, 4.0)),
        fox.scene(fox.entity("a", cubes=[fox.cube((0, 0, 0), (1, 1, 1))])),
    ):
        data, read = (
            each.SerializeToString(),
            MESSAGE_TYPES[each.DESCRIPTOR.full_name].decoder(("protobuf", "protobuf"), fox.definition(each)),
        )
        for end in range(len(data)):
            with contextlib.suppress(PayloadError):  # or less was sent, and it is whole
                read(data[:end])


def test_a_message_that_comes_in_two_parts_is_put_together_and_unknown_fields_are_passed_over() -> None:
    one = fox.transform("a", "b", (1.0, 0.0, 0.0)).SerializeToString()
    two = fox.message("FrameTransform", translation=fox.message("Vector3", y=2.0)).SerializeToString()
    read = MESSAGE_TYPES["foxglove.FrameTransform"].decoder(
        ("protobuf", "protobuf"), fox.definition(fox.transform("a", "b", (0, 0, 0)))
    )
    (each,) = read(one + two + b"\xa0\x06\x07\xa2\x06\x01x\xa5\x06aaaa\xa1\x06aaaaaaaa")
    assert each.pose[:3].tolist() == [1.0, 2.0, 0.0]


def test_lists_of_indices_may_be_packed_or_not() -> None:
    line = fox.message("LinePrimitive", points=fox.points([(0, 0, 0), (1, 0, 0), (2, 0, 0)]), indices=[2, 0])
    each = fox.scene(fox.entity("a", lines=[line]))
    (_, packed) = decode(each)
    data = each.SerializeToString().replace(b"\x42\x08\x02\0\0\0\0\0\0\0", b"\x45\x02\0\0\0\x45\0\0\0\0")
    (_, loose) = MESSAGE_TYPES["foxglove.SceneUpdate"].decoder(("protobuf", "protobuf"), fox.definition(each))(data)
    assert packed.points.tolist() == loose.points.tolist() == [[2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    line.indices.append(3)
    assert "names point 3 of 3" in refused(fox.scene(fox.entity("a", lines=[line])))
    broken = each.SerializeToString().replace(b"\x42\x08\x02\0\0\0\0\0\0\0", b"\x42\x07\x02\0\0\0\0\0\0\x30")
    with pytest.raises(PayloadError):
        MESSAGE_TYPES["foxglove.SceneUpdate"].decoder(("protobuf", "protobuf"), fox.definition(each))(broken)


# ---- JSON


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"\xff", "not UTF-8"),
        (b"{", "not JSON"),
        (b"[]", "is a list, expected an object"),
        (b'{"poses": {}}', "poses is an object, expected a list"),
        (b'{"poses": [7]}', r"poses\[0\] is 7, expected an object"),
        (b'{"poses": [{"position": {"x": "1"}}]}', "x is '1', expected a number"),
        (b'{"poses": [{"position": {"x": true}}]}', "x is True, expected a number"),
        (b'{"poses": [{"position": {"x": 1' + b"0" * 400 + b"}}]}", "a huge number, expected a number"),
        (b'{"poses": [{"position": {"x": NaN}}]}', "NaN is not JSON"),
        (b'{"frame_id": 5}', "frame_id is 5, expected a text"),
        (b'{"frame_id": "a", "frame_id": "b"}', "appears twice"),
        (b'{"timestamp": 5}', "expected an object with sec and nsec"),
        (b'{"timestamp": {"sec": 1.5}}', "expected integers"),
        (b'{"timestamp": {"sec": 1, "nsec": -1}}', "not a time"),
        (b"[" * 5000, "more than 32 brackets"),
        (b'{"poses": [' + b"{}," * 1_000_001 + b"{}]}", "more than 1000000 messages"),
        (b" " * (json_messages.MAX_TEXT + 1), "at most"),
    ],
)
def test_json_that_is_no_such_message_is_refused(text: bytes, says: str) -> None:
    with pytest.raises(PayloadError, match=says) as caught:
        MESSAGE_TYPES["foxglove.PosesInFrame"].decoder(("json", "jsonschema"), b"")(text)
    assert str(caught.value).isprintable()


@pytest.mark.parametrize(
    ("key", "value", "says"),
    [
        ("data", "%%%", "base64"),
        ("column_count", -1, "an integer from 0"),
        ("column_count", 2**32, "integer"),
        ("data", 5, "text"),
    ],
)
def test_json_grids_with_other_values_are_refused(key: str, value: Any, says: str) -> None:
    tree = fox.tree(fox.grid(np.zeros((2, 2), np.int8))) | {key: value}
    with pytest.raises(PayloadError, match=says):
        MESSAGE_TYPES["foxglove.Grid"].decoder(("json", ""), b"")(json.dumps(tree).encode())


def test_json_truth_values_are_truth_values() -> None:
    tree = {"entities": [{"lines": [{"scale_invariant": 1}]}]}
    with pytest.raises(PayloadError, match="a truth value"):
        MESSAGE_TYPES["foxglove.SceneUpdate"].decoder(("json", ""), b"")(json.dumps(tree).encode())
