"""Linearised distances of both bodies from what is near them."""

import numpy as np
import pytest
from scenes import random_problem

from optim.model.clearance import clearance, separations
from optim.model.scene import Scene, make_scene
from optim.model.vehicle import Vehicle

VEHICLES = [Vehicle(), Vehicle(hitch_offset=0.6)]


def _states(seed: int):
    problem = random_problem(seed, num_blocks=12)
    return problem, problem.recorded.samples.states[::7]


@pytest.mark.parametrize("seed", range(4))
def test_the_nearest_row_of_a_body_is_its_clearance(seed):
    problem, states = _states(seed)
    rows = separations(problem.scene, problem.vehicle, states, 3.0)
    nearest = np.full((len(states), 2), np.inf)
    np.minimum.at(nearest, (rows.knot, rows.body), rows.distance)
    exact = clearance(problem.scene, problem.vehicle, states)
    np.testing.assert_allclose(nearest[exact < 3.0], exact[exact < 3.0], atol=1e-12)
    assert (nearest[exact >= 3.0] >= 3.0).all()


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_first_rows_agree_with_finite_differences_of_the_distance_apart_and_overlapping(vehicle):
    problem, states = _states(5)
    states = np.tile(states, (4, 1))
    states += np.random.default_rng(5).normal(0.0, 1.0, states.shape) * [2.0, 2.0, 0.1, 0.1]
    rows = separations(problem.scene, vehicle, states, 2.5)
    first = np.concatenate([[True], np.diff(rows.knot * 10**6 + rows.body * 10**5 + rows.polygon) != 0])
    checked, step = 0, 1e-6
    for r in np.flatnonzero(first):
        alone = Scene(polygons=(problem.scene.polygons[rows.polygon[r]],))
        around = np.repeat(states[rows.knot[r]][None], 8, axis=0)
        for column in range(4):
            around[2 * column, column] += step
            around[2 * column + 1, column] -= step
        values = clearance(alone, vehicle, around)[:, rows.body[r]]
        slope = (values[::2] - values[1::2]) / (2 * step)
        kinked = np.abs(values[::2] + values[1::2] - 2 * rows.distance[r]) > 1e-9
        np.testing.assert_allclose(rows.gradient[r][~kinked], slope[~kinked], atol=1e-6)
        checked += int((~kinked).sum())
    assert checked > 100
    assert (rows.distance[first] < 0.0).sum() > 20


def test_parallel_sides_give_a_row_for_each_end_of_where_they_face_each_other():
    wall = np.array([[-30.0, 3.0], [30.0, 3.0], [30.0, 4.0], [-30.0, 4.0]])
    rows = separations(make_scene([wall]), Vehicle(), np.zeros((1, 4)), 3.0)
    truck = rows.body == 0
    np.testing.assert_allclose(rows.distance[truck], 3.0 - 1.275)
    # turning left brings the front nearer, turning right the rear
    assert rows.gradient[truck, 2].min() < -4.9 < 0.9 < rows.gradient[truck, 2].max()


def test_at_most_the_nearest_polygons_are_given():
    problem, states = _states(1)
    every = separations(problem.scene, problem.vehicle, states, 20.0, most=100)
    few = separations(problem.scene, problem.vehicle, states, 20.0, most=1)
    counts = np.bincount(2 * few.knot + few.body)
    assert counts.max() <= 2
    assert len(few.knot) < len(every.knot)
