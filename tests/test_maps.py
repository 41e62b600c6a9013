"""The map at the time of a path: built once, changed by what was logged, and limited in size."""

from collections.abc import Callable

import logs_maker as make
import numpy as np
import pytest

from replay.base.errors import LogError
from replay.run.case import Case

Read = Callable[..., list[Case]]
Refusal = Callable[..., LogError]
TRUCK, _ = make.drive()
SQUARE = np.array([[5.0, 5.0], [8.0, 5.0], [8.0, 8.0], [5.0, 8.0]])
BOX = make.marker(1, (2.0, 2.0, 2.0), (40.0, 30.0, 0.0), id=1)


def three_paths(maker: make.LogMaker) -> make.LogMaker:
    for number in range(3):
        maker.add("/truck", make.path(make.shifted(TRUCK, 0.1 * number)), 3 + number)
    return maker


@pytest.mark.parametrize(
    "message", [make.grid(make.yard()), make.markers(BOX), make.polygon(SQUARE)], ids=["grid", "markers", "polygon"]
)
def test_requests_on_one_map_share_its_scene(read: Read, message: object) -> None:
    first, *others = read(three_paths(make.LogMaker().vehicle().add("/map", message, 1)))
    assert len(others) == 2
    assert all(case.problem.scene is first.problem.scene for case in others)


def test_grids_that_repeat_the_one_before_are_the_same_map(read: Read) -> None:
    maker = make.LogMaker().vehicle()
    for number in range(3):
        maker.add("/map", make.grid(make.yard()), 3 + number)
    first, *others = read(three_paths(maker))
    assert all(case.problem.scene is first.problem.scene for case in others)


def test_markers_are_what_all_messages_up_to_the_path_made_of_them(read: Read) -> None:
    maker = make.LogMaker().vehicle()
    for number in range(3):
        each = make.marker(1, (1.0, 1.0, 1.0), (5.0 + 3.0 * number, 2.0, 0.0), id=number)
        maker.add("/walls", make.markers(each), 3 + number)
    assert [len(case.problem.scene.polygons) for case in read(three_paths(maker))] == [1, 2, 3]


def test_a_marker_that_is_deleted_right_after_all_were_is_gone(read: Read) -> None:
    clear = make.marker(1, (1.0, 1.0, 1.0), action=3)
    one, two = (make.marker(1, (1.0, 1.0, 1.0), (x, 2.0, 0.0), id=int(x)) for x in (5.0, 9.0))
    again = make.marker(1, (1.0, 1.0, 1.0), id=5, action=2)
    unknown = make.marker(1, (1.0, 1.0, 1.0), id=77, action=2)
    log = make.LogMaker().vehicle().add("/walls", make.markers(BOX, clear, one, two, again, unknown, clear, two), 1)
    (case,) = read(log.add("/truck", make.path(TRUCK), 2))
    (polygon,) = case.problem.scene.polygons
    assert polygon[:, 0].mean() == pytest.approx(9.0)


def test_a_map_whose_markers_are_all_deleted_is_none(refusal: Refusal) -> None:
    log = make.LogMaker().vehicle().add("/walls", make.markers(BOX), 1)
    log.add("/walls", make.markers(make.marker(1, (1.0, 1.0, 1.0), action=3)), 2)
    error = refusal(log.add("/truck", make.path(TRUCK), 3))
    assert error.code == "E_NO_MAP"
    assert "all its markers are deleted at that time" in str(error)


def test_markers_that_cover_no_ground_are_no_obstacles(read: Read) -> None:
    point = [(1.0, 1.0, 0.0)]
    speck = [(2.0, 2.0, 0.0), (2.001, 2.0, 0.0), (2.0, 2.001, 0.0)]
    nothing = [
        make.marker(4, (0.2, 0.0, 0.0), points=point, id=2),  # a line of one point
        make.marker(11, (1.0, 1.0, 1.0), points=speck, id=3),  # a triangle of a millimetre
        make.marker(1, (0.0, 1.0, 1.0), (3.0, 3.0, 0.0), id=4),  # a box without a length
    ]
    log = make.LogMaker().vehicle().add("/walls", make.markers(BOX, *nothing), 1)
    (case,) = read(log.add("/truck", make.path(TRUCK), 2))
    assert len(case.problem.scene.polygons) == 1
    assert any("markers that are not obstacles: 3, above the height limit" in note for note in case.read.notes)


def test_a_marker_that_was_never_turned_is_not_turned(read: Read) -> None:
    log = make.LogMaker().vehicle().add("/walls", make.markers(make.marker(1, (4.0, 1.0, 1.0), quaternion=(0.0,) * 4)))
    (case,) = read(log.add("/truck", make.path(TRUCK), 2))
    np.testing.assert_allclose(np.ptp(case.problem.scene.polygons[0], axis=0), [4.0, 1.0])


def test_more_obstacles_than_a_map_may_have_are_refused(refusal: Refusal) -> None:
    places = np.zeros((100_001, 3))
    cubes = make.marker(6, (1.0, 1.0, 1.0), points=places.tolist())
    error = refusal(make.LogMaker().vehicle().add("/walls", make.markers(cubes), 1).add("/truck", make.path(TRUCK), 2))
    assert error.code == "E_TOO_MANY_SHAPES"
    assert "more than 100000 obstacles" in str(error)


def test_more_polygons_of_one_moment_than_a_map_may_have_are_refused(refusal: Refusal) -> None:
    log = make.LogMaker().vehicle().add("/lots", make.polygon(SQUARE), 1)
    log.messages *= 100_001
    error = refusal(log.add("/truck", make.path(TRUCK), 2))
    assert error.code == "E_TOO_MANY_SHAPES"
    assert "more than 100000 polygons" in str(error)


def test_an_end_on_unknown_cells_is_refused_with_the_option_that_frees_them(read: Read, refusal: Refusal) -> None:
    cells = make.yard()
    cells[:, 20:40] = -1  # under the end of the trailer
    error = refusal(make.log_of(TRUCK, cells=cells))
    assert error.code == "E_START_COLLISION"
    assert "the cell there is unknown: `--unknown free`" in str(error)
    assert read(make.log_of(TRUCK, cells=cells), unknown="free")
    cells[:, 38:40] = 100
    assert "--unknown" not in str(refusal(make.log_of(TRUCK, cells=cells)))
    assert "--unknown" not in str(refusal(make.log_of(TRUCK, cells=cells), unknown="free"))
