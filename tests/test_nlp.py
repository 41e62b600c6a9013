"""The interior point method: its symbols against the numbers they stand for."""

import numpy as np
import pytest
from scenes import random_problem

from optim.methods.nlp.duals import half_planes, starting_multipliers
from optim.methods.nlp.method import Nlp
from optim.methods.nlp.model import pair_function, step_function
from optim.model.clearance import witnesses
from optim.model.kinematics import rk4_step, rk4_step_jacobian
from optim.model.objective import objective
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle, body_poses


@pytest.mark.parametrize("vehicle", [Vehicle(), Vehicle(hitch_offset=0.6)])
def test_the_symbolic_step_is_the_vehicles_in_value_and_derivative(vehicle):
    import casadi as ca

    step = step_function(vehicle, 1.0)
    q, u = ca.SX.sym("q", 4), ca.SX.sym("u", 4)
    slope = ca.Function("slope", [q, u], [ca.jacobian(step(q, u), ca.vertcat(q, u[:3]))])
    rng = np.random.default_rng(0)
    for _ in range(20):
        state, inputs = rng.normal(size=4) * 0.5, np.append(rng.uniform(0.1, 0.5, 3), rng.choice([-1.0, 1.0]))
        expected = rk4_step(vehicle, state, inputs[0], inputs[1], inputs[2], int(inputs[3]))
        np.testing.assert_allclose(np.asarray(step(state, inputs)).ravel(), expected, atol=1e-12)
        columns = (state[None], inputs[:1], inputs[1:2], inputs[2:3], inputs[3:])
        _, jacobian = rk4_step_jacobian(vehicle, *columns)
        np.testing.assert_allclose(np.asarray(slope(state, inputs)), jacobian[0], atol=1e-9)


def test_multipliers_from_the_witness_normal_give_the_exact_distance():
    problem = random_problem(1, num_blocks=12)
    states, vehicle = problem.recorded.samples.states[::11], problem.vehicle
    headings = body_poses(vehicle, states)[:, :, 2]
    checked = 0
    for polygon in problem.scene.polygons:
        near = witnesses(Scene(polygons=(polygon,)), vehicle, states)
        a, offsets = half_planes(polygon, np.zeros(2), 1.0)
        for body in range(2):
            pair = pair_function(vehicle, body, len(a), 1.0)
            for k in np.flatnonzero(near.distance[:, body] > 1e-3):
                start = starting_multipliers(a, near.normal[k, body], float(headings[k, body]))
                planes = np.concatenate([a[:, 0], a[:, 1], offsets])
                distance, along, across, square = np.asarray(pair(states[k], np.concatenate(start), planes)).ravel()
                assert distance == pytest.approx(near.distance[k, body], abs=1e-9)
                assert max(abs(along), abs(across), abs(square - 1.0)) < 1e-9
                checked += 1
    assert checked > 100


def test_solving_first_without_obstacles_is_an_option():
    problem = random_problem(2)
    later, at_once = Nlp(obstacles_later=True).solve(problem), Nlp().solve(problem)
    assert later.iterations != at_once.iterations
    assert objective(later.path, problem.weights) < objective(problem.recorded, problem.weights)


def test_an_interruption_of_a_callback_reaches_the_caller():
    def interrupt(iterate):
        if iterate.iteration > 2:
            raise KeyboardInterrupt

    with pytest.raises(KeyboardInterrupt):
        Nlp().solve(random_problem(2), interrupt)


@pytest.mark.parametrize(("option", "value"), [("spacing", 0.0), ("reach", -1.0), ("time_limit", 0.0)])
def test_options_out_of_range_are_refused_with_what_was_expected(option, value):
    with pytest.raises(ValueError, match=f"nlp: {option} is .*, expected"):
        Nlp(**{option: value})
