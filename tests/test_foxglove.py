"""Foxglove messages in protobuf and JSON: what they become, and what is refused."""

import json
from collections.abc import Callable
from typing import Any

import foxglove_maker as fox
import logs_maker as make
import numpy as np
import pytest

from replay.base.errors import LogError
from replay.logs.messages.foxglove import MESSAGE_TYPES
from replay.logs.messages.foxglove_definitions import MESSAGES
from replay.logs.messages.types import PayloadError
from replay.run.case import Case

Read = Callable[..., list[Case]]
Refusal = Callable[..., LogError]
TRUCK, AXLE = make.drive()
BOTH = pytest.mark.parametrize("encoding", ["protobuf", "json"])


def decode(each: Any, encoding: str = "protobuf") -> Any:
    family = MESSAGE_TYPES[each.DESCRIPTOR.full_name]
    if encoding == "json":
        return family.decoder(("json", "jsonschema"), b"")(json.dumps(fox.tree(each)).encode())
    return family.decoder(("protobuf", "protobuf"), fox.definition(each))(each.SerializeToString())


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
    assert "not probabilities" in refused(fox.grid(np.array([[0.0, 1.5]]), kind=7))


def test_single_poses_of_foxglove_make_a_path(read: Read) -> None:
    maker = fox.added(make.LogMaker().vehicle(), "/map", fox.grid(make.yard()), 1)
    for number, (x, y, yaw) in enumerate(TRUCK):
        stamp = fox.time(number * 200_000_000)
        each = fox.message("PoseInFrame", timestamp=stamp, frame_id="map", pose=fox.pose(x, y, yaw))
        fox.added(maker, "/driven", each, 2 + number)
    (case,) = read(maker)
    np.testing.assert_allclose(case.problem.recorded.goal[:3], TRUCK[-1], atol=1e-9)
    assert decode(fox.message("PoseInFrame")).poses.tolist() == [[0.0] * 7]


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
    assert set(MESSAGE_TYPES) <= set(MESSAGES)
