import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from hypothesis.extra.numpy import arrays

from optim.geometry.cover import cover_cells
from optim.geometry.polygons import is_convex

GRIDS = st.tuples(st.integers(1, 14), st.integers(1, 14)).flatmap(lambda shape: arrays(bool, shape))


def squares(cells: np.ndarray) -> np.ndarray:
    y, x = np.nonzero(cells)
    return shapely.box(x, y, x + 1, y + 1)


def assert_covers(cells: np.ndarray, polygons: list[np.ndarray]) -> float:
    """Every occupied square must be in the union; what that covers besides, as a share of the occupied area."""
    union = shapely.union_all([shapely.Polygon(polygon) for polygon in polygons])
    assert shapely.contains(shapely.buffer(union, 1e-9), squares(cells)).all()
    return union.area / cells.sum() - 1.0 if cells.any() else union.area


@settings(max_examples=100, deadline=None)
@given(cells=GRIDS, max_extra=st.sampled_from([0.0, 0.05, 0.3, 2.0]))
def test_every_cell_is_covered_by_convex_polygons_within_the_budget(cells: np.ndarray, max_extra: float) -> None:
    polygons = cover_cells(cells, 1.0, max_extra=max_extra)
    assert assert_covers(cells, polygons) <= max_extra + 1e-9
    assert all(is_convex(polygon) and not polygon.flags.writeable for polygon in polygons)
    assert len(polygons) <= cells.sum()


@settings(max_examples=20, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.02, 0.98), max_extra=st.sampled_from([0.0, 0.05, 1.0]))
def test_every_cell_of_a_larger_grid_is_covered_within_the_budget(seed: int, share: float, max_extra: float) -> None:
    cells = np.random.default_rng(seed).random((30, 40)) < share
    assert assert_covers(cells, cover_cells(cells, 1.0, max_extra=max_extra)) <= max_extra + 1e-9


@settings(max_examples=15, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), share=st.floats(0.1, 0.9))
def test_no_polygon_protrudes_by_more_than_a_cells_diagonal(seed: int, share: float) -> None:
    cells = np.random.default_rng(seed).random((15, 15)) < share
    occupied = squares(cells)
    for polygon in cover_cells(cells, 1.0, max_extra=10.0):
        inside = np.random.default_rng(0).dirichlet(np.ones(len(polygon)), 50) @ polygon
        rim = shapely.get_coordinates(shapely.segmentize(shapely.LinearRing(polygon), 0.2))
        points = np.asarray(shapely.points(np.concatenate([inside, rim])))
        assert shapely.distance(points[:, None], occupied).min(axis=1).max() <= np.sqrt(2.0) + 1e-9


def test_the_grid_s_origin_turns_and_moves_the_polygons() -> None:
    cells = np.zeros((4, 6), dtype=bool)
    cells[1, 2:5] = True
    (polygon,) = cover_cells(cells, 0.5, (10.0, -3.0, np.pi / 2))
    expected = [[9.5, -2.0], [9.5, -0.5], [9.0, -0.5], [9.0, -2.0]]
    np.testing.assert_allclose(polygon, expected, atol=1e-12)


@pytest.mark.parametrize(
    ("cells", "count"),
    [
        (np.zeros((5, 5), dtype=bool), 0),
        (np.ones((30, 50), dtype=bool), 1),
        (np.pad(np.zeros((20, 30), dtype=bool), 3, constant_values=True), 4),
    ],
)
def test_plain_shapes_take_the_fewest_rectangles(cells: np.ndarray, count: int) -> None:
    assert len(cover_cells(cells, 0.1, max_extra=0.0)) == count


def test_a_cross_takes_two_overlapping_rectangles() -> None:
    cells = np.zeros((21, 21), dtype=bool)
    cells[9:12] = cells[:, 9:12] = True
    assert len(cover_cells(cells, 1.0)) == 2


def test_a_thick_slanted_wall_becomes_a_few_polygons_and_a_disc_few() -> None:
    y, x = np.mgrid[:300, :300]
    wall = np.abs(y - 0.6 * x - 40) < 20
    disc = np.hypot(y - 150, x - 150) < 120
    assert len(cover_cells(wall, 0.05)) <= 12
    assert len(cover_cells(disc, 0.05)) <= 12


def test_a_thin_diagonal_becomes_one_polygon_when_the_budget_is_given() -> None:
    cells = np.eye(80, dtype=bool)
    assert len(cover_cells(cells, 0.05, max_extra=1.0)) == 1
    assert len(cover_cells(cells, 0.05)) == 80 - 4  # each joint costs a cell: 5 % of 80


@pytest.mark.parametrize(
    ("cells", "resolution", "max_extra", "message"),
    [
        (np.ones(5, dtype=bool), 1.0, 0.05, "shape"),
        (np.ones((2, 2), dtype=bool), 0.0, 0.05, "resolution"),
        (np.ones((2, 2), dtype=bool), 1.0, -0.1, "max_extra"),
    ],
)
def test_what_makes_no_sense_is_refused(cells, resolution: float, max_extra: float, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        cover_cells(cells, resolution, max_extra=max_extra)
