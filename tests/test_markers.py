"""Markers as obstacles: footprints, and which markers are there at the time of a path."""

from collections.abc import Callable
from typing import Any

import logs_maker as make
import numpy as np
import pytest
from shapely import Polygon, union_all

from replay.base.errors import LogError
from replay.logs.meaning.markers import marker_polygons
from replay.logs.meaning.planar import Refusal
from replay.logs.messages.types import Header, Marker
from replay.run.case import Case

Read = Callable[..., list[Case]]
TRUCK, AXLE = make.drive()


def marker(kind: int, scale: tuple[float, float, float], **fields: Any) -> Marker:
    values: dict[str, Any] = {"pose": np.array([0.0, 0.0, 0.0, 0.0, 0.0, 0.0, 1.0]), "points": np.zeros((0, 3))}
    values |= {name: np.asarray(value, float) for name, value in fields.items()}
    return Marker(header=Header(0, "map"), ns="a", id=1, type=kind, action=0, scale=np.array(scale), **values)


def area_of(*markers: Marker, height: float = 4.2) -> tuple[float, list[str]]:
    polygons, notes = marker_polygons(markers, height)
    return (union_all([Polygon(p) for p in polygons]).area if polygons else 0.0), notes


def test_shapes_become_their_footprints() -> None:
    turned = [1.0, 2.0, 0.5, 0.0, 0.0, np.sin(0.3), np.cos(0.3)]
    (box,), _ = marker_polygons([marker(1, (4.0, 2.0, 1.0), pose=turned)], 4.2)
    expected = np.array([[2, 1], [-2, 1], [-2, -1], [2, -1]]) @ np.array(
        [[np.cos(0.6), np.sin(0.6)], [-np.sin(0.6), np.cos(0.6)]]
    )
    assert Polygon(box).symmetric_difference(Polygon(np.array([1.0, 2.0]) + expected)).area < 1e-9
    round_area, _ = area_of(marker(3, (2.0, 2.0, 1.0)))
    assert np.pi < round_area < 1.03 * np.pi
    square = [[0, 0, 0], [4, 0, 0], [4, 4, 0], [0, 4, 0], [0, 0, 0]]
    assert area_of(marker(4, (0.2, 0.0, 0.0), points=square))[0] == pytest.approx(4.2**2 - 3.8**2)
    assert area_of(marker(4, (0.2, 0.0, 0.0), points=square[:3]))[0] == pytest.approx(0.2 * 8.0)
    assert area_of(marker(5, (0.2, 0.0, 0.0), points=square[:4]))[0] == pytest.approx(2 * 0.2 * 4.0)
    triangles = [[0, 0, 0], [2, 0, 0], [0, 2, 0], [0, 2, 0], [2, 0, 0], [2, 2, 0]]
    assert area_of(marker(11, (1.0, 2.0, 1.0), points=triangles))[0] == pytest.approx(8.0)
    assert area_of(marker(6, (1.0, 1.0, 1.0), points=[[0, 0, 0], [5, 0, 0]]))[0] == pytest.approx(2.0)


def test_upright_faces_and_poles_do_not_vanish() -> None:
    wall = [[0, 0, 0], [3, 0, 0], [3, 0, 2]]
    assert area_of(marker(11, (1.0, 1.0, 1.0), points=wall))[0] == pytest.approx(0.03)
    pole = [[1, 1, 0], [1, 1, 3]]
    assert area_of(marker(5, (0.2, 0.0, 0.0), points=pole))[0] == pytest.approx(0.04)


def test_a_tilted_box_casts_the_hull_of_its_corners() -> None:
    tilt = [0.0, 0.0, 1.0, np.sin(np.pi / 8.0), 0.0, 0.0, np.cos(np.pi / 8.0)]  # 45 degrees of roll
    assert area_of(marker(1, (4.0, 1.0, 1.0), pose=tilt))[0] == pytest.approx(4.0 * np.sqrt(2.0))


def test_what_the_truck_passes_under_or_over_is_ignored() -> None:
    for z, expected in ((5.0, 0.0), (4.6, 1.0), (-0.6, 0.0), (-0.4, 1.0)):
        area, notes = area_of(marker(1, (1.0, 1.0, 1.0), pose=[0, 0, z, 0, 0, 0, 1]))
        assert area == pytest.approx(expected)
        assert bool(notes) == (expected == 0.0)
    area, notes = area_of(marker(9, (1.0, 1.0, 1.0)), marker(0, (1.0, 1.0, 1.0)))
    assert area == 0.0
    assert len(notes) == 2


@pytest.mark.parametrize(
    ("fields", "code"),
    [
        ({"pose": [np.nan, 0, 0, 0, 0, 0, 1]}, "E_NONFINITE"),
        ({"pose": [0, 0, 0, 0, 0, 0, 2]}, "E_QUATERNION"),
        ({"points": [[0, 0, 0], [np.inf, 0, 0]]}, "E_NONFINITE"),
    ],
)
def test_markers_that_cannot_be_are_refused(fields: dict[str, Any], code: str) -> None:
    with pytest.raises(Refusal) as caught:
        marker_polygons([marker(5, (1.0, 1.0, 1.0), **fields)], 4.2)
    assert caught.value.code == code


def test_markers_are_added_changed_and_deleted_up_to_the_time_of_the_path(read: Read) -> None:
    def box(number: int, x: float, action: int = 0, ns: str = "a") -> Any:
        return make.marker(1, (1.0, 1.0, 1.0), (x, 2.0, 0.0), z=0.5, id=number, action=action, ns=ns)

    maker = make.LogMaker().vehicle()
    maker.add("/walls", make.markers(box(1, 5.0), box(2, 8.0), box(1, 11.0, ns="b")), 1)
    maker.add("/truck", make.path(TRUCK), 2)
    maker.add("/walls", make.markers(box(1, 6.0), box(2, 0.0, action=2)), 3)
    maker.add("/truck", make.path(make.shifted(TRUCK, 0.1)), 4)
    maker.add("/walls", make.markers(box(0, 0.0, action=3, ns=""), box(7, 14.0)), 5)
    maker.add("/truck", make.path(make.shifted(TRUCK, 0.2)), 6)
    places = [sorted(float(p[:, 0].mean()) for p in case.problem.scene.polygons) for case in read(maker)]
    assert places == [pytest.approx([5.0, 8.0, 11.0]), pytest.approx([6.0, 11.0]), pytest.approx([14.0])]


def test_markers_in_another_frame_are_refused(refusal: Callable[..., LogError]) -> None:
    maker = make.LogMaker().add("/walls", make.markers(make.marker(1, (1.0, 1.0, 1.0), frame="base"))).vehicle()
    assert refusal(maker.add("/truck", make.path(TRUCK))).code == "E_FRAME"
