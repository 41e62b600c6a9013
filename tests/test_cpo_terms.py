"""The cost of the points of coordinate points optimisation, and the discs in it."""

import dataclasses

import numpy as np
import pytest
import shapely
from scenes import random_problem
from shapes import random_blocks

from optim.methods.cpo.bfgs import minimise_bfgs
from optim.methods.cpo.discs import axle_point, covering_discs
from optim.methods.cpo.method import Cpo
from optim.methods.cpo.points import ENDS, RecordedAxle, spread
from optim.methods.cpo.terms import BAND, Terms, bends, headings, truck_bends
from optim.model.clearance import distance_field
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle

BOUNDS = (-25.0, -25.0, 25.0, 25.0)
VEHICLES = [Vehicle(), Vehicle(hitch_to_axle=12.036, trailer_rear=14.0), Vehicle(truck_width=2.2, trailer_width=0.8)]


def winding_points(seed: int, count: int = 24) -> np.ndarray:
    """Points half a metre apart on a curve that turns left and right, with noise."""
    rng = np.random.default_rng(seed)
    heading = np.cumsum(0.15 * np.sin(np.arange(count) / 2.5 + seed))
    steps = 0.5 * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    return np.cumsum(steps, axis=0) + rng.normal(0.0, 0.01, (count, 2))


def terms_near_blocks(seed: int, **options) -> Terms:
    scene = make_scene(random_blocks(np.random.default_rng(seed), 12, spread=14.0))
    vehicle = options.pop("vehicle", Vehicle(max_hitch=0.4, max_steer=0.3))
    chosen = {"d_max": 1.0, "obstacle": 100.0, "curvature": 1000.0, "smoothness": 40.0, "change": 500.0} | options
    field = distance_field(scene, 0.25, BOUNDS)
    return Terms(vehicle=vehicle, discs=covering_discs(vehicle, 0.1), field=field, spacing=0.5, **chosen)


def differences(function, points: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Central differences of a function of points (M, 2), last axes (M, 2)."""
    columns = []
    for index in np.ndindex(*points.shape):
        shift = np.zeros_like(points)
        shift[index] = step
        columns.append((function(points + shift) - function(points - shift)) / (2.0 * step))
    return np.stack(columns, axis=-1).reshape(*np.shape(columns[0]), *points.shape)


@pytest.mark.parametrize("seed", range(4))
@pytest.mark.parametrize("only", ["obstacle", "curvature", "smoothness", "change", None])
@pytest.mark.parametrize("is_point", [False, True])
def test_the_gradient_of_every_term_is_its_derivative_near_obstacles_and_where_the_turn_changes_sign(
    seed, only, is_point
):
    weights = {} if only is None else dict.fromkeys(("obstacle", "curvature", "smoothness", "change"), 0.0)
    weights |= {} if only is None else {only: 1.0}
    terms = terms_near_blocks(seed, **weights)
    if is_point:
        terms = dataclasses.replace(terms, discs=axle_point(terms.vehicle), d_max=3.0)
    points = winding_points(seed)
    kappa, _ = bends(points)
    assert (kappa > 0.05).any()
    assert (kappa < -0.05).any()
    value, gradient, _ = terms.evaluate(points)
    assert value > 0.0 or (only == "obstacle" and is_point)
    expected = differences(lambda moved: terms.evaluate(moved, with_metric=False)[0], points)
    np.testing.assert_allclose(gradient, expected, atol=1e-6 * max(1.0, np.abs(expected).max()))


def test_points_inside_an_obstacle_are_pushed_out_by_a_gradient_that_is_the_derivative():
    terms = terms_near_blocks(1)
    terms = dataclasses.replace(
        terms, field=distance_field(make_scene([[[2, -3], [8, -3], [8, 3], [2, 3]]]), 0.25, BOUNDS)
    )
    points = winding_points(0)
    _, gradient, _ = terms.evaluate(points)
    expected = differences(lambda moved: terms.evaluate(moved)[0], points)
    np.testing.assert_allclose(gradient, expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.parametrize("seed", range(3))
def test_curvatures_and_headings_have_their_derivatives(seed):
    points = winding_points(seed)

    def rows_of(jacobian: np.ndarray, width: int) -> np.ndarray:
        flat = jacobian.reshape(len(jacobian), -1)
        return np.stack([flat[i, 2 * i : 2 * i + width] for i in range(len(flat))])

    for function in (bends, headings):
        expected = rows_of(differences(lambda moved, f=function: f(moved)[0], points), 6)
        np.testing.assert_allclose(function(points)[1], expected, atol=1e-6)

    def truck(moved: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        return truck_bends(moved, *bends(moved), 8.0)

    expected = rows_of(differences(lambda moved: truck(moved)[0], points), 8)
    np.testing.assert_allclose(truck(points)[1], expected, atol=1e-5)


def test_on_a_circle_the_curvatures_are_those_of_both_axles():
    angle = np.arange(40) * 0.5 / 20.0
    points = 20.0 * np.stack([np.cos(angle), np.sin(angle)], axis=1)
    kappa, by_kappa = bends(points)
    np.testing.assert_allclose(kappa, 1.0 / 20.0, rtol=1e-4)
    truck, _ = truck_bends(points, kappa, by_kappa, 8.0)
    np.testing.assert_allclose(truck, 1.0 / np.hypot(20.0, 8.0), rtol=1e-4)
    backwards, _ = bends(points[::-1])
    np.testing.assert_allclose(backwards, -kappa[::-1], rtol=1e-12)


def test_the_metric_is_the_second_derivative_where_the_cost_is_a_square_of_linear_terms():
    terms = terms_near_blocks(0, obstacle=0.0, curvature=0.0, change=0.0)
    points = winding_points(0, 12)
    _, _, metric = terms.evaluate(points)
    assert metric is not None
    expected = differences(lambda moved: terms.evaluate(moved)[1].ravel(), points, 1e-4).reshape(24, 24)
    full = sum(np.diag(metric[k, : 24 - k], -k) for k in range(BAND))
    full = full + np.tril(full, -1).T
    np.testing.assert_allclose(full, expected, atol=1e-6 * np.abs(expected).max())


def test_weights_are_integrals_so_that_the_cost_does_not_depend_on_the_spacing():
    vehicle = Vehicle()
    values = []
    for count in (101, 201, 401):
        s = np.linspace(0.0, 40.0, count)
        points = np.stack([s, 2.0 * np.sin(s / 5.0)], axis=1)
        terms = dataclasses.replace(terms_near_blocks(0, vehicle=vehicle), spacing=40.0 / (count - 1))
        values.append(terms.evaluate(points)[0])
    assert values[1] == pytest.approx(values[0], rel=0.03)
    assert values[2] == pytest.approx(values[1], rel=0.02)


@pytest.mark.parametrize("vehicle", VEHICLES)
@pytest.mark.parametrize("excess", [0.02, 0.1, 0.5, 3.0])
def test_the_discs_contain_both_bodies_and_protrude_by_no_more_than_the_excess(vehicle, excess):
    discs = covering_discs(vehicle, excess)
    for body, (front, rear, half) in enumerate(vehicle.footprints):
        mine = discs.body == body
        rectangle = shapely.box(-rear, -half, front, half)
        inside = np.random.default_rng(0).uniform((-rear, -half), (front, half), (4000, 2))
        edge = shapely.get_coordinates(rectangle.exterior.segmentize(0.01))
        points = np.concatenate([inside, edge])
        centre, radius = discs.centre[mine], discs.radius[mine]
        depth = radius - np.linalg.norm(points[:, None] - centre, axis=2)
        assert (depth.max(axis=1) >= -1e-9).all()
        reach = np.abs(centre - [(front - rear) / 2.0, 0.0]) + radius[:, None] - [(front + rear) / 2.0, half]
        assert reach.max() <= excess + 1e-9


def test_two_samples_at_each_end_are_anchored_with_the_recorded_curvature():
    problem = random_problem(2)
    for segment in problem.recorded.segments:
        axle = RecordedAxle.of(problem.vehicle, segment)
        row = spread(axle, axle.flat[:, :2], axle.share, 0.5, np.empty((0, 2)))
        assert row.anchored[: ENDS + 1].all()
        assert row.anchored[-ENDS - 1 :].all()
        assert not row.anchored[ENDS + 1 : -ENDS - 1].any()
        np.testing.assert_allclose(row.on_path[[0, -1]], axle.flat[[0, -1], :2], atol=1e-12)
        np.testing.assert_allclose(bends(row.xy)[0][[0, -1]], axle.flat[[0, -1], 3], atol=1e-3)


def test_anchored_points_stay_where_they_were_recorded_while_the_others_move():
    problem = random_problem(4)
    segment = problem.recorded.segments[1]
    axle = RecordedAxle.of(problem.vehicle, segment)
    row = spread(axle, axle.flat[:, :2], axle.share, 0.5, np.array([[0.4, 0.5]]))
    middle = row.anchored & (row.share > 0.3) & (row.share < 0.7)
    assert middle.sum() >= 3
    done = minimise_bfgs(
        terms_near_blocks(0, obstacle=0.0, vehicle=problem.vehicle).evaluate,
        row.xy, ~row.anchored, memory=100, max_iterations=50, tolerance=1e-6, max_step=0.5,
    )  # fmt: skip
    np.testing.assert_array_equal(done.points[row.anchored], row.xy[row.anchored])
    assert np.abs(done.points - row.xy).max() > 1e-3


@pytest.mark.parametrize("memory", [20, 1000])
def test_the_points_come_to_rest_where_plain_bfgs_does_with_far_fewer_steps(memory):
    from scipy.optimize import minimize

    problem = random_problem(1, num_blocks=40)
    segment = problem.recorded.segments[1]
    axle = RecordedAxle.of(problem.vehicle, segment)
    row = spread(axle, axle.flat[:, :2], axle.share, 0.3, np.empty((0, 2)))
    terms, free = Cpo(d_max=1.5).terms(problem, row.spacing), ~row.anchored
    assert dataclasses.replace(terms, curvature=0.0, smoothness=0.0, change=0.0).evaluate(row.xy)[0] > 0.0
    points = row.xy.copy()

    def cost(unknowns: np.ndarray) -> tuple[float, np.ndarray]:
        points[free] = unknowns.reshape(-1, 2)
        value, gradient, _ = terms.evaluate(points, with_metric=False)
        return value, gradient[free].ravel()

    plain = minimize(cost, row.xy[free].ravel(), jac=True, method="BFGS", options={"maxiter": 2000})
    done = minimise_bfgs(terms.evaluate, row.xy, free, memory=memory, max_iterations=500, tolerance=1e-12, max_step=0.5)
    assert done.value <= plain.fun * (1.0 + 1e-6)
    assert done.iterations < plain.nit / 3
