"""Foxglove messages in protobuf and JSON: what they become, and what is refused."""

import contextlib
import json
from collections.abc import Callable
from typing import Any

import foxglove_maker as fox
import logs_maker as make
import numpy as np
import pytest
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet

from replay.case import Case
from replay.errors import LogError
from replay.logs import json_messages, wire
from replay.logs.content import PayloadError
from replay.logs.foxglove import FAMILIES
from replay.logs.layout import LayoutError
from replay.logs.structure import MESSAGES

Read = Callable[..., list[Case]]
Refusal = Callable[..., LogError]
TRUCK, AXLE = make.drive()
BOTH = pytest.mark.parametrize("encoding", ["protobuf", "json"])


def decode(each: Any, encoding: str = "protobuf") -> Any:
    family = FAMILIES[each.DESCRIPTOR.full_name]
    if encoding == "json":
        return family.reader(("json", "jsonschema"), b"")(json.dumps(fox.tree(each)).encode())
    return family.reader(("protobuf", "protobuf"), fox.definition(each))(each.SerializeToString())


def refused(each: Any, encoding: str = "protobuf") -> str:
    with pytest.raises(PayloadError) as caught:
        decode(each, encoding)
    assert str(caught.value).isprintable()
    return str(caught.value)


# ---- what they become


@BOTH
def test_poses_come_back_exactly(encoding: str) -> None:
    series = decode(fox.poses(TRUCK, "odom", 12 * make.SECOND + 5), encoding)
    assert series.header == (12 * make.SECOND + 5, "odom")
    np.testing.assert_array_equal(series.poses[:, :2], TRUCK[:, :2])
    np.testing.assert_array_equal(series.poses[:, 5:], [[np.sin(a / 2), np.cos(a / 2)] for a in TRUCK[:, 2]])
    assert set(series.stamps.tolist()) == {12 * make.SECOND + 5}


@BOTH
@pytest.mark.parametrize(
    ("kind", "given"),
    [(1, [0, 100, 255, 65]), (2, [0, 100, -1, 65]), (7, [0.0, 1.0, -1.0, 0.65]), (8, [0.0, 1.0, np.nan, 0.65])],
)
def test_grids_of_any_type_of_number_become_occupancy(encoding: str, kind: int, given: list[float]) -> None:
    if encoding == "json" and kind == 8:
        kind = 7
    each = decode(fox.grid(np.array([given, given]), 0.25, (1.0, 2.0, 0.5), kind=kind), encoding)
    assert (each.width, each.height, each.resolution) == (4, 2, 0.25)
    assert each.data.tolist() == [0, 100, -1, 65] * 2
    assert each.origin[:2].tolist() == [1.0, 2.0]


def test_one_field_of_several_is_read_from_padded_rows() -> None:
    each = fox.grid(np.zeros((2, 3), np.int8))
    each.fields.insert(0, fox.message("PackedElementField", name="height", offset=0, type=7))
    each.fields[1].offset = 4
    each.cell_stride, each.row_stride = 6, 20
    rows = np.zeros((2, 20), np.uint8)
    rows[:, [4, 10, 16]] = [[1, 2, 3], [4, 5, 6]]
    each.data = rows.tobytes()
    assert decode(each).data.tolist() == [1, 2, 3, 4, 5, 6]


@pytest.mark.parametrize(
    ("change", "says"),
    [
        (lambda g: g.cell_size.__setattr__("y", 0.3), "squares"),
        (lambda g: g.__setattr__("row_stride", 0), "contradict"),
        (lambda g: g.__setattr__("row_stride", 7), "contradict"),
        (lambda g: g.__setattr__("column_count", 2**32 - 1), "contradict"),
        (lambda g: g.fields[0].__setattr__("offset", 1), "contradict"),
        (lambda g: g.fields[0].__setattr__("type", 0), "the type 0, expected 1 to 8"),
        (lambda g: g.fields.pop(), "the fields none"),
        (lambda g: g.fields.append(g.fields[0]), "'occupancy', 'occupancy'"),
        (lambda g: g.__setattr__("data", b"\x65" * 8), "the value 101"),
        (lambda g: g.__setattr__("data", b"\xf0" * 8), "the value -16"),
    ],
)
def test_grids_that_contradict_themselves_are_refused(change: Callable[[Any], Any], says: str) -> None:
    each = fox.grid(np.zeros((2, 4), np.int8))
    change(each)
    assert says in refused(each)


def test_grids_of_numbers_that_are_no_probabilities_are_refused() -> None:
    assert "no probabilities" in refused(fox.grid(np.array([[0.0, 1.5]]), kind=7))


def test_an_empty_grid_has_no_cells() -> None:
    each = fox.grid(np.zeros((2, 2), np.int8))
    each.column_count, each.data = 0, b""
    assert decode(each).data.tolist() == []


@BOTH
def test_the_shapes_of_a_scene_become_obstacles(read: Read, encoding: str) -> None:
    size = (2.0, 4.0, 1.0)
    ring = [(0.0, 0.0, 0.0), (3.0, 0.0, 0.0), (3.0, 3.0, 0.0)]
    shapes = fox.entity(
        "shapes",
        cubes=[fox.cube((40.0, 30.0, np.pi / 2.0), size)],
        spheres=[fox.message("SpherePrimitive", pose=fox.pose(45.0, 30.0, 0.0), size=fox.vector((1.0, 1.0, 1.0)))],
        cylinders=[
            fox.message(
                "CylinderPrimitive",
                pose=fox.pose(48.0, 30.0, 0.0),
                size=fox.vector(size),
                bottom_scale=0.5,
                top_scale=1.0,
            )
        ],
        lines=[
            fox.message(
                "LinePrimitive",
                type=kind,
                pose=fox.pose(5.0 + 5.0 * kind, 33.0, 0.0),
                thickness=0.2,
                points=fox.points(ring),
            )
            for kind in (0, 1)
        ],
        triangles=[
            fox.message(
                "TriangleListPrimitive", pose=fox.pose(20.0, 33.0, 0.0), points=fox.points(ring), indices=[2, 1, 0]
            )
        ],
        texts=[fox.message("TextPrimitive", text="gate")],
    )
    maker = fox.added(make.LogMaker().vehicle(), "/scene", fox.scene(shapes), 1, encoding)
    (case,) = read(maker.add("/truck", make.path(TRUCK), 2))
    polygons = case.problem.scene.polygons
    assert len(polygons) == 3 + 2 + 3 + 1
    np.testing.assert_allclose(polygons[0].min(axis=0), [38.0, 29.0], atol=1e-9)
    np.testing.assert_allclose(polygons[-1].max(axis=0), [23.0, 36.0], atol=1e-9)
    assert any("TEXT_VIEW_FACING" in note for note in case.read.notes)


def test_entities_replace_and_delete_each_other_by_name_and_time(read: Read) -> None:
    def box(name: str, x: float, stamp: int = 0) -> Any:
        return fox.entity(name, stamp=stamp, cubes=[fox.cube((x, 35.0, 0.0), (1.0, 1.0, 1.0))] * 2)

    def deletion(stamp: int = 0, kind: int = 0, name: str = "") -> Any:
        return fox.message("SceneEntityDeletion", timestamp=fox.time(stamp), type=kind, id=name)

    def centres(*updates: Any) -> list[float]:
        maker = make.LogMaker().vehicle()
        for number, update in enumerate(updates):
            fox.added(maker, "/scene", update, number)
        (case,) = read(maker.add("/truck", make.path(TRUCK), 20))
        return sorted({float(part.mean(axis=0)[0].round(6)) for part in case.problem.scene.polygons})

    start = fox.scene(box("a", 10.0, 5), box("b", 20.0, 9), box("", 30.0, 5))
    assert centres(start) == [10.0, 20.0, 30.0]
    assert centres(start, fox.scene(box("a", 15.0, 1))) == [15.0, 20.0, 30.0]
    assert centres(start, fox.scene(deletions=[deletion(name="a")])) == [20.0, 30.0]
    assert centres(start, fox.scene(deletions=[deletion(name="")])) == [10.0, 20.0]
    assert centres(start, fox.scene(deletions=[deletion(5, kind=1)])) == [20.0]  # b is newer
    assert centres(start, fox.scene(box("c", 50.0), deletions=[deletion(kind=1)])) == [50.0]


def test_transforms_and_joints_of_foxglove_are_used_as_those_of_ros_are(read: Read) -> None:
    maker = fox.added(make.LogMaker().vehicle(), "/map", fox.grid(make.yard()), 1)
    fox.added(
        maker, "/tf", fox.message("FrameTransforms", transforms=[fox.transform("map", "odom", (3.0, 4.0, 0.0))]), 1
    )
    fox.added(maker, "/tf", fox.transform("odom", "base", (0.0, 0.0, 0.0)), 1)
    fox.added(maker, "/joints", fox.joints(hitch=0.1), 1)
    fox.added(maker, "/truck", fox.poses(make.shifted(TRUCK, -3.0, -4.0), "base"), 2)
    (case,) = read(maker)
    np.testing.assert_allclose(case.problem.recorded.start, [*TRUCK[0], 0.1], atol=1e-9)
    (each,) = decode(fox.message("JointState", name="hitch", position=0.5))
    assert (each.names, each.positions.tolist()) == (("hitch",), [0.5])


# ---- protobuf


def test_the_field_numbers_are_those_of_the_logs_own_descriptors() -> None:
    found = FileDescriptorSet.FromString(fox.definition(fox.poses([])))
    for file in found.file:
        for each in file.message_type:
            for field in each.field:
                field.number += 40
    pool = importlib_pool(found)
    mine = pool("foxglove.PosesInFrame")(frame_id="odom")
    mine.poses.add().position.x = 7.0
    series = FAMILIES["foxglove.PosesInFrame"].reader(("protobuf", "protobuf"), found.SerializeToString())(
        mine.SerializeToString()
    )
    assert (series.header.frame, series.poses[0, 0]) == ("odom", 7.0)


def importlib_pool(found: FileDescriptorSet) -> Callable[[str], Any]:
    """Message classes from descriptors, in a pool of their own."""
    from google.protobuf import descriptor_pool, message_factory

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
    for _ in range(20):
        inner = inner.nested_type.add(name="In")


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"", "not a set of descriptors"),
        (b"\xff" * 40, "damaged"),
        (b"\x0a\xff\x01", "claims 255 bytes"),
        (b"\x0a\x02\x0a\x05", "claims 5 bytes"),
        (bytes(wire.MAX_SET + 1), "at most"),
        (b"\x0a\x00" * 65, "65 files"),
        (_with(lambda f: f.message_type.add(name="PosesInFrame")), "defined twice"),
        (_with(lambda f: f.message_type[0].__setattr__("name", "Other")), "PosesInFrame is not defined"),
        (
            _with(lambda f: f.message_type[0].field[1].__setattr__("type", 5)),
            "'frame_id'.*is 'type 5', expected 'string'",
        ),
        (_with(lambda f: f.message_type[0].field[2].__setattr__("label", 1)), "is 'message', expected"),
        (_with(lambda f: f.message_type[0].field[2].__setattr__("type_name", ".foxglove.Vector3")), "Vector3"),
        (_with(lambda f: f.message_type[0].ClearField("field")), "none of the fields"),
        (_with(lambda f: [f.message_type.add(name=f"M{i}") for i in range(1100)]), "more than 1024 messages"),
        (_with(_deep), "within each other"),
        (_with(lambda f: f.__setattr__("package", "a")).replace(b"\x12\x01a", b"\x12\x01\xff"), "not UTF-8"),
    ],
)
def test_descriptors_that_cannot_be_used_are_an_error_of_one_line(data: bytes, says: str) -> None:
    with pytest.raises(LayoutError, match=says) as caught:
        FAMILIES["foxglove.PosesInFrame"].reader(("protobuf", "protobuf"), data)
    assert "\n" not in str(caught.value)


@pytest.mark.parametrize(
    ("data", "says"),
    [
        (b"\x00\x01", "the number 0"),
        (b"\x0b", "wire type 3"),
        (b"\x12\x05ab", "claims 5 bytes, 2 are left"),
        (b"\x12" + b"\xff" * 9, "cut off"),
        (b"\x12" + b"\xff" * 11, "more than ten bytes"),
        (b"\x12\x02\xff\xfe", "frame_id is not UTF-8"),
        (b"\x10\x05", "frame_id has the wire type 0, expected 2"),
        (b"\x0a\x06\x10\xff\xff\xff\xff\x0f", "no time"),
        (b"\x1a\x00" * 1_000_001, "more than 1000000 messages"),
    ],
)
def test_payloads_that_are_no_such_message_are_refused(data: bytes, says: str) -> None:
    read = FAMILIES["foxglove.PosesInFrame"].reader(("protobuf", "protobuf"), fox.definition(fox.poses([])))
    with pytest.raises(PayloadError, match=says):
        read(data)


def test_a_payload_that_ends_early_never_does_more_than_fail() -> None:
    for each in (
        fox.poses(TRUCK[:2]),
        fox.grid(make.yard(4.0, 4.0)),
        fox.scene(fox.entity("a", cubes=[fox.cube((0, 0, 0), (1, 1, 1))])),
    ):
        data, read = (
            each.SerializeToString(),
            FAMILIES[each.DESCRIPTOR.full_name].reader(("protobuf", "protobuf"), fox.definition(each)),
        )
        for end in range(len(data)):
            with contextlib.suppress(PayloadError):  # or less was sent, and it is whole
                read(data[:end])


def test_a_message_that_comes_in_two_parts_is_put_together_and_unknown_fields_are_passed_over() -> None:
    one = fox.transform("a", "b", (1.0, 0.0, 0.0)).SerializeToString()
    two = fox.message("FrameTransform", translation=fox.message("Vector3", y=2.0)).SerializeToString()
    read = FAMILIES["foxglove.FrameTransform"].reader(
        ("protobuf", "protobuf"), fox.definition(fox.transform("a", "b", (0, 0, 0)))
    )
    (each,) = read(one + two + b"\xa0\x06\x07\xa2\x06\x01x\xa5\x06aaaa\xa1\x06aaaaaaaa")
    assert each.pose[:3].tolist() == [1.0, 2.0, 0.0]


def test_lists_of_indices_may_be_packed_or_not() -> None:
    line = fox.message("LinePrimitive", points=fox.points([(0, 0, 0), (1, 0, 0), (2, 0, 0)]), indices=[2, 0])
    each = fox.scene(fox.entity("a", lines=[line]))
    (_, packed) = decode(each)
    data = each.SerializeToString().replace(b"\x42\x08\x02\0\0\0\0\0\0\0", b"\x45\x02\0\0\0\x45\0\0\0\0")
    (_, loose) = FAMILIES["foxglove.SceneUpdate"].reader(("protobuf", "protobuf"), fox.definition(each))(data)
    assert packed.points.tolist() == loose.points.tolist() == [[2.0, 0.0, 0.0], [0.0, 0.0, 0.0]]
    line.indices.append(3)
    assert "names point 3 of 3" in refused(fox.scene(fox.entity("a", lines=[line])))
    broken = each.SerializeToString().replace(b"\x42\x08\x02\0\0\0\0\0\0\0", b"\x42\x07\x02\0\0\0\0\0\0\x30")
    with pytest.raises(PayloadError):
        FAMILIES["foxglove.SceneUpdate"].reader(("protobuf", "protobuf"), fox.definition(each))(broken)


# ---- JSON


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"\xff", "not UTF-8"),
        (b"{", "no JSON"),
        (b"[]", "is a list, expected an object"),
        (b'{"poses": {}}', "poses is an object, expected a list"),
        (b'{"poses": [7]}', r"poses\[0\] is 7, expected an object"),
        (b'{"poses": [{"position": {"x": "1"}}]}', "x is '1', expected a number"),
        (b'{"poses": [{"position": {"x": true}}]}', "x is True, expected a number"),
        (b'{"poses": [{"position": {"x": 1' + b"0" * 400 + b"}}]}", "a huge number, expected a number"),
        (b'{"poses": [{"position": {"x": NaN}}]}', "NaN is not JSON"),
        (b'{"frame_id": 5}', "frame_id is 5, expected a text"),
        (b'{"frame_id": "a", "frame_id": "b"}', "is there twice"),
        (b'{"timestamp": 5}', "expected an object with sec and nsec"),
        (b'{"timestamp": {"sec": 1.5}}', "expected integers"),
        (b'{"timestamp": {"sec": 1, "nsec": -1}}', "no time"),
        (b"[" * 5000, "more than 32 brackets"),
        (b'{"poses": [' + b"{}," * 1_000_001 + b"{}]}", "more than 1000000 messages"),
        (b" " * (json_messages.MAX_TEXT + 1), "at most"),
    ],
)
def test_json_that_is_no_such_message_is_refused(text: bytes, says: str) -> None:
    with pytest.raises(PayloadError, match=says) as caught:
        FAMILIES["foxglove.PosesInFrame"].reader(("json", "jsonschema"), b"")(text)
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
        FAMILIES["foxglove.Grid"].reader(("json", ""), b"")(json.dumps(tree).encode())


def test_json_truth_values_are_truth_values() -> None:
    tree = {"entities": [{"lines": [{"scale_invariant": 1}]}]}
    with pytest.raises(PayloadError, match="a truth value"):
        FAMILIES["foxglove.SceneUpdate"].reader(("json", ""), b"")(json.dumps(tree).encode())


# ---- in logs


def test_foxglove_messages_in_another_encoding_are_refused_by_name(refusal: Refusal) -> None:
    maker = make.log_of(TRUCK)
    maker.messages.pop()
    error = refusal(
        maker.add_raw("/plan", "foxglove.PosesInFrame", b"", 2, encoding="flatbuffer", schema_encoding="flatbuffer")
    )
    assert (error.code, "'protobuf' with 'protobuf' or 'json'" in str(error)) == ("E_ENCODING", True)
    maker.messages.pop()
    error = refusal(fox.added(maker, "/plan", fox.message("PosesInFrame", frame_id="map"), 2))
    assert error.code == "E_PATH_EMPTY"


def test_every_field_that_is_read_is_foxgloves_own() -> None:
    for name, fields in MESSAGES.items():
        known = fox.message(name.removeprefix("foxglove.")).DESCRIPTOR.fields_by_name
        assert {field.name for field in fields} <= set(known)
        assert all(known[field.name].is_repeated == field.repeated for field in fields)
    assert set(FAMILIES) <= set(MESSAGES)
