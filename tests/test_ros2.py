"""Decoders of ROS 2 messages, against messages that other software wrote."""

import io
import struct
import time
from typing import Any

import logs_maker as make
import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from mcap_ros2.writer import Writer as Ros2Writer
from rosbags.typesys import Stores

from replay.logs.container.scan import scan
from replay.logs.messages.cdr import CdrError
from replay.logs.messages.definition import MAX_FIELDS, MAX_TEXT, matching_definition
from replay.logs.messages.ros2 import MESSAGE_TYPES
from replay.logs.messages.types import DefinitionError, Grid, Marker, PoseSeries

STORES = [Stores.ROS2_FOXY, Stores.ROS2_GALACTIC, Stores.ROS2_HUMBLE, Stores.ROS2_JAZZY, Stores.ROS2_KILTED]
frames = st.text(max_size=12)
numbers = st.floats(allow_nan=False, width=64)


def decode(message: Any, layout: int = 0) -> Any:
    return MESSAGE_TYPES[message.__msgtype__].decode(make.serialised(message), layout)


def definition(kind: str, store: Stores = Stores.ROS2_HUMBLE) -> bytes:
    return make.typestore(store).generate_msgdef(kind, ros_version=2)[0].encode()


# ---- decoders


@settings(max_examples=60, deadline=None)
@given(
    head=frames,
    rows=st.lists(st.tuples(st.integers(0, 2**31 - 1), st.integers(0, 10**9 - 1), frames), max_size=12),
    repeat=st.integers(1, 4),
    seed=st.integers(0, 2**32 - 1),
)
def test_a_path_comes_back_exactly_whatever_its_frames_are(
    head: str, rows: list[tuple[int, int, str]], repeat: int, seed: int
) -> None:
    rows = [row for row in rows for _ in range(repeat)]  # runs of equal frames and changes of frame
    values = np.random.default_rng(seed).normal(size=(len(rows), 7))
    stamps = [seconds * make.SECOND + nanoseconds for seconds, nanoseconds, _ in rows]
    poses = [
        make.ros(
            "geometry_msgs/msg/PoseStamped",
            header=make.header(frame, stamp),
            pose=make.pose(v[0], v[1], 0.0, z=float(v[2]), quaternion=v[3:].tolist()),
        )
        for (_, _, frame), stamp, v in zip(rows, stamps, values, strict=True)
    ]
    message = make.ros(make.PATH, header=make.header(head, 7 * make.SECOND + 5), poses=poses)
    series: PoseSeries = decode(message)
    np.testing.assert_array_equal(series.poses, values)
    np.testing.assert_array_equal(series.stamps, stamps)
    assert series.header == (7 * make.SECOND + 5, head)
    assert series.frames == {frame for _, _, frame in rows}


@given(cells=st.lists(st.integers(-128, 127), max_size=40), frame=frames, origin=st.tuples(*[numbers] * 3))
@settings(max_examples=60, deadline=None)
def test_a_grid_comes_back_exactly(cells: list[int], frame: str, origin: tuple[float, float, float]) -> None:
    message = make.grid(np.array(cells, np.int8).reshape(1, -1), 0.25, frame=frame)
    position = message.info.origin.position
    position.x, position.y, position.z = origin
    grid: Grid = decode(message)
    assert (grid.width, grid.height, grid.resolution, grid.header.frame) == (len(cells), 1, 0.25, frame)
    assert grid.data.tolist() == cells
    assert grid.origin.tolist() == [*origin, 0.0, 0.0, 0.0, 1.0]


@given(
    names=st.tuples(frames, frames, frames, frames),
    values=st.lists(numbers, min_size=10, max_size=10),
    counts=st.tuples(*[st.integers(0, 3)] * 5),
    integers=st.tuples(*[st.integers(-(2**31), 2**31 - 1)] * 3),
)
@settings(max_examples=60, deadline=None)
def test_markers_come_back_whatever_else_they_carry(
    names: tuple[str, ...], values: list[float], counts: tuple[int, ...], integers: tuple[int, ...]
) -> None:
    points = [(float(i), float(-i), 0.5) for i in range(counts[0])]
    one = make.marker(integers[0], values[7:10], points=points, ns=names[0], id=integers[1], action=integers[2])
    position, turn = one.pose.position, one.pose.orientation
    position.x, position.y, position.z, turn.x, turn.y, turn.z, turn.w = values[:7]
    one.header.frame_id, one.text, one.mesh_resource = names[1:]
    one.colors = [make.ros("std_msgs/msg/ColorRGBA", r=0.0, g=0.0, b=0.0, a=1.0)] * counts[1]
    one.texture.data = np.arange(counts[2], dtype=np.uint8)
    one.uv_coordinates = [make.ros("visualization_msgs/msg/UVCoordinate", u=0.0, v=1.0)] * counts[3]
    one.mesh_file.data = np.arange(counts[4], dtype=np.uint8)
    two = make.marker(1, (1.0, 2.0, 3.0), (4.0, 5.0, 0.0))
    found: tuple[Marker, ...] = decode(make.markers(one, two, one))
    for marker in (found[0], found[2], *decode(one)):
        assert (marker.type, marker.id, marker.action) == integers
        assert (marker.ns, marker.header.frame) == (names[0], names[1])
        assert [*marker.pose, *marker.scale] == values
        assert marker.points.tolist() == [list(point) for point in points]
    assert found[1].scale.tolist() == [1.0, 2.0, 3.0]


def test_markers_of_older_distributions_are_read() -> None:
    store = make.typestore(Stores.ROS2_FOXY)
    kind = "visualization_msgs/msg/Marker"
    new = make.marker(4, (0.2, 0.0, 0.0), (1.0, 2.0, 0.3), points=[(1, 2, 3)], ns="walls", id=7)
    fields = {name: getattr(new, name) for name in store.types[kind].__dataclass_fields__ if name != "__msgtype__"}
    data = bytes(store.serialize_cdr(store.types[kind](**fields), kind))
    family = MESSAGE_TYPES[kind]
    layout = matching_definition(kind, definition(kind, Stores.ROS2_FOXY), family.standards)
    (marker,) = family.decode(data, layout)
    assert (marker.ns, marker.id, marker.points.tolist()) == ("walls", 7, [[1.0, 2.0, 3.0]])


def test_a_log_by_the_ros2_writer_is_read(tmp_path: Any) -> None:
    out = io.BytesIO()
    writer = Ros2Writer(out)
    pose = {"position": {"x": 1.0, "y": 2.0, "z": 0.0}, "orientation": {"x": 0.0, "y": 0.0, "z": 0.6, "w": 0.8}}
    header = {"stamp": {"sec": 3, "nanosec": 4}, "frame_id": "map"}
    for kind, message in (
        (make.PATH, {"header": header, "poses": [{"header": header, "pose": pose}] * 3}),
        (
            make.GRID,
            {
                "header": header,
                "info": {"map_load_time": header["stamp"], "resolution": 0.1, "width": 2, "height": 1, "origin": pose},
                "data": [-1, 100],
            },
        ),
    ):
        schema = writer.register_msgdef(kind, definition(kind).decode())
        writer.write_message("/" + kind, schema, message, log_time=5)
    writer.finish()
    file = tmp_path / "log.mcap"
    file.write_bytes(out.getvalue())
    log = scan(file, lambda _: True)
    found = {}
    for message in log.messages:
        schema = message.channel.schema
        assert schema is not None
        family = MESSAGE_TYPES[schema.name]
        found[family.role] = family.decode(
            message.data, matching_definition(schema.name, schema.data, family.standards)
        )
    assert found["path"].poses.tolist() == [[1.0, 2.0, 0.0, 0.0, 0.0, 0.6, 0.8]] * 3
    assert found["path"].stamps.tolist() == [3 * make.SECOND + 4] * 3
    assert found["grid"].data.tolist() == [-1, 100]
    assert found["grid"].resolution == np.float32(0.1)


# ---- damaged payloads


def some_messages() -> dict[str, Any]:
    return {
        make.PATH: make.path([(i, 2.0, 0.1) for i in range(4)]),
        make.GRID: make.grid(np.zeros((3, 5), np.int8)),
        make.MARKERS: make.markers(
            make.marker(4, (1, 1, 1), points=[(0, 0, 0), (1, 1, 1)], ns="a"), make.marker(1, (1, 1, 1))
        ),
    }


@pytest.mark.parametrize("kind", [make.PATH, make.GRID, make.MARKERS])
def test_no_shortened_payload_is_taken_for_a_message(kind: str) -> None:
    data = make.serialised(some_messages()[kind])
    for size in range(len(data) - 3):
        with pytest.raises(CdrError):
            MESSAGE_TYPES[kind].decode(data[:size], 0)
    with pytest.raises(CdrError, match="left over"):
        MESSAGE_TYPES[kind].decode(data + bytes(4), 0)


@pytest.mark.parametrize("kind", [make.PATH, make.GRID, make.MARKERS])
def test_damaged_payloads_raise_nothing_but_cdr_errors(kind: str) -> None:
    data = make.serialised(some_messages()[kind])
    rng = np.random.default_rng(3)
    refused = 0
    for _ in range(3000):
        changed = bytearray(data)
        for place in rng.integers(0, len(data), rng.integers(1, 4)):
            changed[place] = rng.integers(256)
        try:
            MESSAGE_TYPES[kind].decode(bytes(changed), 0)
        except CdrError:
            refused += 1
    assert refused > 100


def test_counts_beyond_the_payload_are_refused_before_anything_is_allocated() -> None:
    header = b"\0\1\0\0" + bytes(8) + struct.pack("<I", 1) + bytes(4)
    start = time.process_time()
    for kind in (make.PATH, make.MARKERS):
        with pytest.raises(CdrError, match="claims 4294967295 elements"):
            MESSAGE_TYPES[kind].decode((header if kind == make.PATH else b"\0\1\0\0") + b"\xff" * 4 + bytes(60), 0)
    assert time.process_time() - start < 5.0


@pytest.mark.parametrize(("kind", "says"), [(0, "big-endian CDR"), (7, "XCDR2"), (11, "unknown")])
def test_other_encapsulations_are_named(kind: int, says: str) -> None:
    with pytest.raises(CdrError, match=says):
        MESSAGE_TYPES[make.PATH].decode(bytes([0, kind, 0, 0]) + bytes(100), 0)


def test_times_that_are_none_and_text_that_is_none_are_refused() -> None:
    data = bytearray(make.serialised(make.path([(0, 0, 0)] * 3, frame="abc")))
    bad_time = data.copy()
    bad_time[4 + 4 : 4 + 8] = struct.pack("<I", 4_000_000_000)
    with pytest.raises(CdrError, match="nanosec"):
        MESSAGE_TYPES[make.PATH].decode(bytes(bad_time), 0)
    for change in (b"m\xff\xfe\0", b"abcd"):
        bad = data.replace(b"abc\0", change)
        with pytest.raises(CdrError, match=r"UTF-8|NUL"):
            MESSAGE_TYPES[make.PATH].decode(bytes(bad), 0)


def test_a_path_whose_frames_change_all_the_time_is_read_in_linear_time() -> None:
    one = make.serialised(make.path([(0, 0, 0)], frame="aa"))
    two = make.serialised(make.path([(0, 0, 0)] * 2, frame="aa"))
    element = two[len(one) :]
    other = element.replace(b"aa\0", b"bb\0")
    count = 40_001
    data = one[:20] + struct.pack("<I", count) + one[24:] + (other + element) * (count // 2)
    start = time.process_time()
    series = MESSAGE_TYPES[make.PATH].decode(data, 0)
    assert len(series.poses) == count
    assert series.frames == {"aa", "bb"}
    assert time.process_time() - start < 3.0


# ---- definitions


@pytest.mark.parametrize("store", STORES, ids=lambda store: store.name)
@pytest.mark.parametrize("kind", sorted(MESSAGE_TYPES))
def test_the_definitions_of_every_distribution_are_known(kind: str, store: Stores) -> None:
    matching_definition(kind, definition(kind, store), MESSAGE_TYPES[kind].standards)


def test_comments_blanks_constants_defaults_and_short_names_do_not_matter() -> None:
    written = definition(make.GRID).decode()
    written = written.replace("float64 w", "float64   w 1  # unit").replace(
        "nav_msgs/MapMetaData info", "MapMetaData info"
    )
    written = "# a map\r\n\n" + written.replace("int8[] data", "int8 FREE = 0\nint8 FULL=100\nint8[] data").replace(
        "\n", "\r\n"
    )
    written = written.replace("MSG: std_msgs/Header", "MSG: std_msgs/msg/Header")
    assert matching_definition(make.GRID, written.encode(), MESSAGE_TYPES[make.GRID].standards) == 0


@pytest.mark.parametrize(
    ("text", "says"),
    [
        (b"", "expected 'std_msgs/Header header'"),
        (b"\xff\xfe", "not UTF-8"),
        (b"!!!", "expected a type and a name"),
        (b"float64 x\nfloat64 x\n", "expected 'std_msgs/Header header'"),
        (b"nav_msgs/Path inner\n", "expected 'std_msgs/Header header'"),
        (b"int32 " + b"A" * 40 + b"a=1\nfloat64 x\n", "expected 'std_msgs/Header header'"),
        (b"".join(b"float64 f%d\n" % i for i in range(10000)), f"{MAX_FIELDS} fields"),
        (b"# " + b"x" * MAX_TEXT, "bytes, at most"),
        (b"# " + b"x" * 5000, "characters, at most"),
        (b"".join(b"MSG: d/T%d\nd/T%d t\n" % (i, i + 1) for i in range(300)), "256 types"),
    ],
)
def test_a_definition_that_is_not_the_standard_one_is_refused_at_once(text: bytes, says: str) -> None:
    start = time.process_time()
    with pytest.raises(DefinitionError, match=says):
        matching_definition(make.PATH, text, MESSAGE_TYPES[make.PATH].standards)
    assert time.process_time() - start < 1.0


def test_the_difference_from_the_standard_definition_is_named() -> None:
    swapped = definition(make.PATH).replace(b"float64 x\nfloat64 y\n", b"float64 y\nfloat64 x\n")
    with pytest.raises(DefinitionError, match="field 1 of geometry_msgs/Point is 'float64 y', expected 'float64 x'"):
        matching_definition(make.PATH, swapped, MESSAGE_TYPES[make.PATH].standards)
    more = definition(make.PATH).replace(b"string frame_id", b"string frame_id\nuint8 new")
    with pytest.raises(DefinitionError, match="std_msgs/Header has the unknown field 'new'"):
        matching_definition(make.PATH, more, MESSAGE_TYPES[make.PATH].standards)
