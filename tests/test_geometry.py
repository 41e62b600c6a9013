import math

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st

from optim.geometry.polygons import clean_ring, convex_parts, is_convex, pack, signed_area, walls

L_SHAPE = [[0, 0], [4, 0], [4, 1], [1, 1], [1, 3], [0, 3]]


def star(rng: np.random.Generator, count: int) -> np.ndarray:
    """A simple polygon that is star-shaped about the origin and mostly not convex."""
    angle = 2 * np.pi * (np.arange(count) + rng.uniform(0.1, 0.9, count)) / count
    return rng.uniform(1.0, 6.0, count)[:, None] * np.stack([np.cos(angle), np.sin(angle)], axis=1)


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), count=st.integers(5, 25), clockwise=st.booleans())
def test_the_convex_parts_of_a_simple_polygon_are_convex_and_tile_it(seed: int, count: int, clockwise: bool) -> None:
    ring = star(np.random.default_rng(seed), count)
    parts = convex_parts(ring[::-1] if clockwise else ring)
    assert all(is_convex(part) and not part.flags.writeable for part in parts)
    assert sum(signed_area(part) for part in parts) == pytest.approx(abs(signed_area(ring)), rel=1e-9)
    joined = shapely.union_all([shapely.Polygon(part) for part in parts], grid_size=1e-9)
    assert shapely.symmetric_difference(joined, shapely.Polygon(ring)).area < 1e-6
    assert len(parts) <= count - 2


def test_an_l_shape_needs_two_parts() -> None:
    assert len(convex_parts(L_SHAPE)) == 2


def test_a_convex_polygon_comes_back_alone_and_counter_clockwise() -> None:
    square = np.array([[0, 0], [0, 1], [1, 1], [1, 0]])
    (part,) = convex_parts(square)
    assert signed_area(part) == 1.0
    assert {tuple(v) for v in part} == {tuple(v) for v in square}


def test_repeated_closing_and_collinear_vertices_and_spikes_go() -> None:
    ring = [[0, 0], [1, 0], [2, 0], [2, 0], [2, 1], [5, 1], [2, 1], [2, 2], [0, 2], [0, 1], [0, 0]]
    for first in range(len(ring)):
        cleaned = clean_ring(np.roll(ring, first, axis=0))
        assert sorted(cleaned.tolist()) == [[0, 0], [0, 2], [2, 0], [2, 2]]
        assert signed_area(cleaned) == 4.0


def test_a_small_polygon_far_from_the_origin_keeps_its_shape() -> None:
    offset = np.array([512_345.5, 5_812_345.25])
    parts = convex_parts(np.array(L_SHAPE) * 0.1 + offset)
    assert len(parts) == 2
    assert sum(signed_area(part) for part in parts) == pytest.approx(0.06, rel=1e-6)


@pytest.mark.parametrize(
    ("vertices", "message"),
    [
        ([[0, 0], [1, 1], [2, 2]], "no area"),
        ([[0, 0], [1, 0]], "no area"),
        (np.empty((0, 2)), "no area"),
        ([[0, 0], [2, 2], [2, 0], [0, 3]], "not a simple polygon: Self-intersection"),
        ([[0, 0], [1, math.nan], [1, 1]], "not finite"),
        ([[0, 0, 0], [1, 0, 0], [1, 1, 0]], "shape"),
    ],
)
def test_what_is_no_simple_polygon_is_refused_with_the_reason(vertices, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        convex_parts(vertices)


@pytest.mark.parametrize("corners", [3, 4, 7])
def test_walls_leave_no_gap_round_the_outline_and_do_not_reach_inside(corners: int) -> None:
    angle = 2 * np.pi * np.arange(corners) / corners + 0.3
    outline = np.stack([12 * np.cos(angle), 5 * np.sin(angle)], axis=1)
    shape = shapely.Polygon(outline)
    ring = shapely.union_all([shapely.Polygon(wall) for wall in walls(outline, 2.0)])
    assert shapely.intersection(ring, shape).area < 1e-9
    assert shapely.difference(shapely.buffer(shape, 1.99), shapely.union_all([ring, shape])).area < 1e-9


@pytest.mark.parametrize("count", [0, 1, 2, 3, 17, 100])
def test_every_tree_node_holds_its_subtree_and_every_polygon_has_one_leaf(count: int) -> None:
    rng = np.random.default_rng(count)
    polygons = [rng.uniform(-50, 50, 2) + np.array([[0, 0], [1, 0], [0, 1.0]]) for _ in range(count)]
    scene = pack(polygons)
    assert len(scene.item) == max(0, 2 * count - 1)
    assert sorted(scene.item[scene.item >= 0]) == list(range(count))
    for node, end in enumerate(scene.skip):
        held = [polygons[k] - scene.origin for k in scene.item[node:end] if k >= 0]
        points = np.concatenate(held)
        np.testing.assert_array_equal(scene.boxes[node], [*points.min(axis=0), *points.max(axis=0)])
        assert (end == node + 1) == (scene.item[node] >= 0)


def test_packed_normals_are_outward_and_of_unit_length() -> None:
    triangle = np.array([[1.0, 2.0], [5.0, 2.0], [1.0, 5.0]])
    scene = pack([triangle])
    np.testing.assert_allclose(scene.normals, [[0, -1], [0.6, 0.8], [-1, 0]], atol=1e-15)
    assert not any(array.flags.writeable for array in scene)
