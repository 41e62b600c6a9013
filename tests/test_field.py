import numpy as np
import pytest
import shapely
from shapes import random_blocks

from optim.model.clearance import distance_field
from optim.model.scene import make_scene

BOUNDS = (-20.0, -15.0, 25.0, 18.0)


def points_within(rng: np.random.Generator, count: int) -> np.ndarray:
    return rng.uniform((-20.0, -15.0), (25.0, 18.0), (count, 2))


def test_the_nodes_hold_the_signed_distance_to_the_union() -> None:
    rng = np.random.default_rng(4)
    blocks = random_blocks(rng, 12, spread=15.0)
    field = distance_field(make_scene(blocks), 0.5, BOUNDS)
    union = shapely.union_all([shapely.Polygon(block) for block in blocks])
    rows, columns = field.values.shape
    x, y = np.meshgrid(-20.0 + 0.5 * np.arange(columns), -15.0 + 0.5 * np.arange(rows))
    nodes = shapely.points(x, y)
    expected = np.where(
        shapely.contains(union, nodes), -shapely.distance(union.boundary, nodes), shapely.distance(union, nodes)
    )
    np.testing.assert_allclose(field.values, expected, atol=5e-6)
    assert (expected < 0).sum() > 20
    value, _ = field.evaluate(np.stack([x, y], axis=-1))
    np.testing.assert_allclose(value, field.values, atol=1e-9)


def test_a_wall_of_many_boxes_has_no_seams_inside() -> None:
    turn = np.array([[np.cos(0.4), np.sin(0.4)], [-np.sin(0.4), np.cos(0.4)]])
    boxes = [np.array([[k, -2], [k + 1, -2], [k + 1, 2], [k, 2]]) @ turn for k in range(-10, 10)]
    field = distance_field(make_scene(boxes), 0.25, (-5.0, -5.0, 5.0, 5.0))
    value, gradient = field.evaluate(np.array([[0.0, 1.0], [0.5, 1.0], [1.0, 1.0]]) @ turn)
    np.testing.assert_allclose(value, -1.0, atol=0.01)
    np.testing.assert_allclose(gradient, np.broadcast_to([0.0, 1.0] @ turn, (3, 2)), atol=0.02)


def test_the_gradient_is_the_derivative_of_the_value() -> None:
    rng = np.random.default_rng(1)
    field = distance_field(make_scene(random_blocks(rng, 10, spread=15.0)), 0.4, BOUNDS)
    points = points_within(rng, 2000)
    _, gradient = field.evaluate(points)
    step = 1e-5
    for axis in range(2):
        shift = step * np.eye(2)[axis]
        difference = (field.evaluate(points + shift)[0] - field.evaluate(points - shift)[0]) / (2 * step)
        np.testing.assert_allclose(gradient[:, axis], difference, atol=1e-4)
        assert np.median(np.abs(gradient[:, axis] - difference)) < 1e-8


def test_the_gradient_is_continuous_across_cells() -> None:
    rng = np.random.default_rng(2)
    field = distance_field(make_scene(random_blocks(rng, 6, spread=15.0)), 0.5, BOUNDS)
    edge = -20.0 + 0.5 * rng.integers(2, 80, 200).astype(np.float64)
    y = rng.uniform(-14.0, 17.0, 200)
    left = field.evaluate(np.stack([edge - 1e-9, y], axis=1))[1]
    right = field.evaluate(np.stack([edge + 1e-9, y], axis=1))[1]
    np.testing.assert_allclose(left, right, atol=1e-6)


def test_beyond_the_edge_the_nearest_value_holds() -> None:
    field = distance_field(make_scene([[[0, 0], [1, 0], [1, 1], [0, 1]]]), 0.5, (-5.0, -5.0, 5.0, 5.0))
    value, gradient = field.evaluate(np.array([[9.0, 0.5], [5.0, 0.5]]))
    assert value[0] == value[1] == pytest.approx(4.0)
    assert gradient[0, 0] == 0.0


def test_without_obstacles_the_distance_is_infinite_and_flat() -> None:
    value, gradient = distance_field(make_scene([]), 1.0, BOUNDS).evaluate(np.zeros((3, 2)))
    assert (value == np.inf).all()
    assert (gradient == 0.0).all()


@pytest.mark.parametrize(("resolution", "bounds"), [(0.0, BOUNDS), (1.0, (0, 0, 0, 1)), (1.0, (0, 0, np.inf, 1))])
def test_bounds_that_enclose_nothing_are_refused(resolution: float, bounds) -> None:
    with pytest.raises(ValueError, match="expected a positive"):
        distance_field(make_scene([]), resolution, bounds)
