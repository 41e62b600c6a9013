import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from optim.model.flat_map import flat_from_state, state_from_flat
from optim.model.kinematics import derivative, jacobians, rk4_step, rk4_step_jacobian, roll_out
from optim.model.vehicle import Vehicle, body_corners

VEHICLES = [
    Vehicle(),
    Vehicle(hitch_to_axle=12.036, trailer_rear=14.6),
    Vehicle(wheelbase=2.8, hitch_to_axle=5.0, hitch_offset=0.7),
]
angles = st.floats(-0.9, 0.9)


def _random_inputs(count: int = 200):
    rng = np.random.default_rng(0)
    states = rng.uniform(-1, 1, (count, 4)) * [20, 20, math.pi, 0.9]
    return states, rng.uniform(-0.5, 0.5, count), rng.choice([-1, 1], count)


def _differences(function, values: np.ndarray, column: int, step: float = 1e-6):
    ahead, behind = values.copy(), values.copy()
    ahead[..., column] += step
    behind[..., column] -= step
    return (function(ahead) - function(behind)) / (2 * step)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_jacobians_agree_with_finite_differences(vehicle):
    states, phi, direction = _random_inputs()
    a, b = jacobians(vehicle, states, phi, direction)
    for column in range(4):
        numeric = _differences(lambda q: derivative(vehicle, q, phi, direction), states, column)
        np.testing.assert_allclose(a[:, :, column], numeric, atol=1e-8)
    numeric = _differences(lambda p: derivative(vehicle, states, p[:, 0], direction), phi[:, None], 0)
    np.testing.assert_allclose(b, numeric, atol=1e-8)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_step_jacobian_agrees_with_finite_differences(vehicle):
    states, phi, direction = _random_inputs()
    rng = np.random.default_rng(1)
    inputs = np.column_stack([states, phi, phi + rng.uniform(-0.1, 0.1, len(phi)), rng.uniform(0.05, 0.8, len(phi))])

    def step(v):
        return rk4_step_jacobian(vehicle, v[:, :4], v[:, 4], v[:, 5], v[:, 6], direction)[0]

    _, jacobian = rk4_step_jacobian(vehicle, states, inputs[:, 4], inputs[:, 5], inputs[:, 6], direction)
    for column in range(7):
        np.testing.assert_allclose(jacobian[:, :, column], _differences(step, inputs, column), atol=1e-7)


def test_the_vectorised_step_equals_the_compiled_one():
    vehicle = VEHICLES[2]
    states, phi, direction = _random_inputs(20)
    many, _ = rk4_step_jacobian(vehicle, states, phi, phi + 0.05, np.full(20, 0.3), direction)
    one = [rk4_step(vehicle, q, p, p + 0.05, 0.3, int(d)) for q, p, d in zip(states, phi, direction, strict=True)]
    np.testing.assert_allclose(many, one, rtol=0, atol=1e-13)


def test_runge_kutta_is_of_order_four():
    vehicle, start = Vehicle(), np.array([0.0, 0.0, 0.2, 0.4])
    s, phi = np.array([0.0, 4.0]), np.array([-0.3, 0.5])
    exact = roll_out(vehicle, start, s, phi, 1, max_step=0.01)[-1]
    errors = [np.abs(roll_out(vehicle, start, s, phi, 1, max_step=h)[-1] - exact).max() for h in (1.0, 0.5)]
    assert 10 < errors[0] / errors[1] < 30


def test_constant_steering_drives_the_circle_of_the_wheelbase():
    vehicle, phi = Vehicle(), 0.3
    radius = vehicle.wheelbase / math.tan(phi)
    alpha = -math.asin(vehicle.hitch_to_axle / radius)  # the trailer's steady fold
    quarter = np.array([0.0, radius * math.pi / 2])
    end = roll_out(vehicle, np.array([0, 0, 0, alpha]), quarter, np.full(2, phi), 1)[-1]
    np.testing.assert_allclose(end, [radius, radius, math.pi / 2, alpha], atol=1e-8)


def test_the_trailer_turns_left_when_the_truck_reverses_with_the_wheel_to_the_right():
    end = roll_out(Vehicle(), np.zeros(4), np.array([0.0, 3.0]), np.full(2, -0.3), -1)[-1]
    assert end[2] > 0  # truck heading
    assert end[3] < 0  # trailer heading minus truck heading
    assert end[2] + end[3] < 0.0  # the trailer's heading falls behind: it is pushed the other way


def test_a_hitch_angle_grows_in_reverse_by_the_exponential_of_distance_over_trailer_length():
    vehicle = Vehicle()
    end = roll_out(vehicle, np.array([0, 0, 0, 1e-6]), np.array([0.0, 16.0]), np.zeros(2), -1)[-1]
    assert end[3] / 1e-6 == pytest.approx(math.exp(16.0 / vehicle.hitch_to_axle), rel=1e-4)


@settings(max_examples=200)
@given(angles, angles, st.floats(-0.54, 0.54), st.floats(-1e3, 1e3))
def test_the_flat_map_and_its_inverse_are_inverse(theta, alpha, phi, x):
    vehicle = Vehicle()
    state = np.array([x, -x, theta, alpha])
    back, steer = state_from_flat(vehicle, flat_from_state(vehicle, state, np.array(phi)))
    np.testing.assert_allclose(back, state, atol=1e-9)
    assert steer == pytest.approx(phi, abs=1e-12)


def test_flat_curvature_and_sharpness_are_the_derivatives_along_the_trailers_own_path():
    vehicle = Vehicle()
    s = np.linspace(0, 6, 4001)  # short: a reverse roll-out folds up
    phi = 0.3 * np.sin(s / 2)
    for direction in (1, -1):
        states = roll_out(vehicle, np.array([1.0, 2.0, 0.5, 0.1]), s, phi, direction)
        flat = flat_from_state(vehicle, states, phi)
        along = np.cos(flat[:, 2]) * np.gradient(flat[:, 0], s) + np.sin(flat[:, 2]) * np.gradient(flat[:, 1], s)
        across = -np.sin(flat[:, 2]) * np.gradient(flat[:, 0], s) + np.cos(flat[:, 2]) * np.gradient(flat[:, 1], s)
        np.testing.assert_allclose(along[5:-5], direction * np.cos(states[5:-5, 3]), atol=1e-5)
        np.testing.assert_allclose(across[5:-5], 0.0, atol=1e-5)
        np.testing.assert_allclose((np.gradient(flat[:, 2], s) / along)[5:-5], flat[5:-5, 3], atol=1e-5)
        np.testing.assert_allclose((np.gradient(flat[:, 3], s) / along)[5:-5], flat[5:-5, 4], atol=1e-4)


def test_the_flat_map_refuses_an_off_axle_hitch_in_one_sentence():
    vehicle = Vehicle(hitch_offset=0.5)
    with pytest.raises(ValueError, match=r"hitch_offset is 0\.5 m"):
        flat_from_state(vehicle, np.zeros(4), np.array(0.0))
    with pytest.raises(ValueError, match="hitch_offset"):
        state_from_flat(vehicle, np.zeros(5))


def test_an_off_axle_trailer_axle_does_not_slip_sideways():
    vehicle = VEHICLES[2]
    s = np.linspace(0, 10, 5001)
    states = roll_out(vehicle, np.array([0, 0, 0, 0.2]), s, 0.3 * np.cos(s), 1)
    heading = states[:, 2] + states[:, 3]
    hitch = states[:, :2] - vehicle.hitch_offset * np.stack([np.cos(states[:, 2]), np.sin(states[:, 2])], 1)
    axle = hitch - vehicle.hitch_to_axle * np.stack([np.cos(heading), np.sin(heading)], 1)
    velocity = np.gradient(axle, s, axis=0)
    slip = -np.sin(heading) * velocity[:, 0] + np.cos(heading) * velocity[:, 1]
    assert np.abs(slip[5:-5]).max() < 1e-5


def test_corners_are_counter_clockwise_and_have_the_stated_extents():
    vehicle = Vehicle()
    corners = body_corners(vehicle, np.array([[3.0, 4.0, 0.0, 0.0]]))[0] - [3.0, 4.0]
    np.testing.assert_allclose(corners[0], [[-1, -1.275], [5, -1.275], [5, 1.275], [-1, 1.275]])
    np.testing.assert_allclose(corners[1], [[-12, -1.275], [1.6, -1.275], [1.6, 1.275], [-12, 1.275]])
    turned = body_corners(vehicle, np.array([[0.0, 0.0, math.pi / 2, 0.3]]))[0]
    np.testing.assert_allclose(turned[0, 1], [1.275, 5.0], atol=1e-12)
    edges = np.roll(turned, -1, axis=1) - turned
    assert (edges[:, 0, 0] * edges[:, 1, 1] - edges[:, 0, 1] * edges[:, 1, 0] > 0).all()


@pytest.mark.parametrize(
    ("field", "value"),
    [
        ("wheelbase", 0.0),
        ("wheelbase", 3600.0),
        ("max_hitch", 1.6),
        ("max_steer", float("nan")),
        ("truck_front", "5"),
    ],
)
def test_a_vehicle_that_cannot_be_is_refused_with_field_value_and_range(field, value):
    with pytest.raises(ValueError, match=rf"vehicle: {field} is .*expected a number from"):
        Vehicle(**{field: value})
