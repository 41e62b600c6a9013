import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import random_blocks, random_convex, random_states, signed_distance

from optim.geometry.collision import gap_along, point_kernel, separating_gap
from optim.geometry.collision import signed_distance as kernel_distance
from optim.geometry.polygons import pack
from optim.numerics.arrays import frozen

RECT = st.tuples(st.floats(-6, 6), st.floats(-6, 6), st.floats(-4, 4), st.floats(0.05, 7.0), st.floats(0.05, 2.0))


def rectangle(x: float, y: float, heading: float, hx: float, hy: float) -> tuple[float, ...]:
    return float(x), float(y), float(np.cos(heading)), float(np.sin(heading)), float(hx), float(hy)


def corners(rect: tuple[float, ...]) -> np.ndarray:
    cx, cy, c, s, hx, hy = rect
    local = np.array([[-hx, -hy], [hx, -hy], [hx, hy], [-hx, hy]])
    return np.array([cx, cy]) + local @ np.array([[c, s], [-s, c]])


def moved(rect: tuple[float, ...], origin: np.ndarray) -> tuple[float, ...]:
    return (rect[0] - float(origin[0]), rect[1] - float(origin[1]), *rect[2:])


@settings(max_examples=400, deadline=None)
@given(rect=RECT, seed=st.integers(0, 2**32 - 1))
def test_the_distance_is_shapelys_and_the_depth_is_that_of_the_difference_set(rect, seed: int) -> None:
    polygon = random_convex(np.random.default_rng(seed), np.zeros(2), 2.0)
    scene = pack([polygon])
    body = rectangle(*rect)
    distance = kernel_distance(scene, 0, moved(body, scene.origin))[0]
    assert distance == pytest.approx(signed_distance(corners(body), polygon), abs=1e-9)


def test_three_thousand_random_pairs_agree_with_shapely_in_distance_witness_and_normal() -> None:
    rng = np.random.default_rng(0)
    for _ in range(3000):
        polygon = random_convex(rng, np.zeros(2), 2.0)
        scene = pack([polygon])
        body = rectangle(*rng.uniform([-7, -7, -4, 0.1, 0.1], [7, 7, 4, 7, 2]))
        d, bx, by, ox, oy, nx, ny = kernel_distance(scene, 0, moved(body, scene.origin))
        assert d == pytest.approx(signed_distance(corners(body), polygon), abs=1e-10)
        assert np.hypot(nx, ny) == pytest.approx(1.0, abs=1e-9)
        np.testing.assert_allclose([bx - d * nx, by - d * ny], [ox, oy], atol=1e-9)
        assert gap_along(scene, 0, moved(body, scene.origin), nx, ny) == pytest.approx(d, abs=1e-9)


@settings(max_examples=100, deadline=None)
@given(rect=RECT, seed=st.integers(0, 2**32 - 1), angle=st.floats(-4, 4))
def test_no_direction_shows_a_larger_gap_than_the_signed_distance(rect, seed: int, angle: float) -> None:
    scene = pack([random_convex(np.random.default_rng(seed), np.zeros(2), 2.0)])
    body = moved(rectangle(*rect), scene.origin)
    distance = kernel_distance(scene, 0, body)[0]
    assert gap_along(scene, 0, body, float(np.cos(angle)), float(np.sin(angle))) <= distance + 1e-12
    gap = separating_gap(scene, 0, body, np.inf)
    assert gap <= distance + 1e-12
    assert (gap > 0.0) == (distance > 0.0)
    if distance <= 0.0:
        assert gap == pytest.approx(distance, abs=1e-12)


def test_an_obstacles_third_edge_normal_can_be_the_only_one_that_separates() -> None:
    # a rectangle beside the slanted side of a triangle: both its axes and the triangle's two other normals overlap
    scene = pack([np.array([[0.0, 0.0], [4.0, 0.0], [0.0, 4.0]])])
    body = moved((2.6, 2.6, 1.0, 0.0, 0.5, 0.5), scene.origin)
    assert separating_gap(scene, 0, body, np.inf) == pytest.approx(0.2 / np.sqrt(2.0))


@pytest.mark.parametrize("count", [0, 1, 40, 400])
def test_the_tree_finds_the_nearest_of_many_polygons(count: int) -> None:
    rng = np.random.default_rng(count)
    polygons = random_blocks(rng, count)
    scene = pack(polygons)
    points = random_states(rng, 200)[:, :2]
    every = [
        [kernel_distance(scene, k, (*(point - scene.origin), 1.0, 0.0, 0.0, 0.0))[0] for k in range(count)]
        for point in points
    ]
    expected = np.min(every, axis=1, initial=np.inf)
    np.testing.assert_allclose(point_kernel(scene, frozen(points)), expected, atol=1e-12)
