import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from paths import random_path
from scenes import blocks_beside

from optim.model.clearance import clearance, first_violation, swept_clearance
from optim.model.kinematics import roll_out
from optim.model.path import Segment
from optim.model.scene import Scene, make_scene
from optim.model.vehicle import Vehicle

VEHICLES = {
    "semi": Vehicle(),
    "hitch behind the axle": Vehicle(hitch_offset=0.7),
    "hitch ahead of the axle": Vehicle(hitch_offset=-0.5),
}


def drive(vehicle: Vehicle, seed: int, spacing: float) -> tuple[Scene, list[Segment]]:
    """A random path past blocks that nearly touch what it sweeps, and a second one that runs into them."""
    path = random_path(vehicle, (12.0, 9.0, 11.0), 1 if seed % 2 else -1, seed, spacing)
    other = random_path(vehicle, (12.0, 9.0), -1 if seed % 2 else 1, seed + 1, spacing)
    return make_scene(blocks_beside(vehicle, path, 8, seed, room=0.02)), [*path.segments, *other.segments]


def true_minimum(scene: Scene, vehicle: Vehicle, segment: Segment, per_interval: int) -> np.ndarray:
    """Least signed distance on each interval over a dense roll-out of it from its stored start. Shape (N - 1, 2)."""
    count = segment.num_samples - 1
    share = np.linspace(0.0, 1.0, per_interval + 1)
    dense = []
    for i in range(count):
        ds = segment.s[i + 1] - segment.s[i]
        phi = segment.phi[i] + share * (segment.phi[i + 1] - segment.phi[i])
        dense.append(roll_out(vehicle, segment.states[i], ds * share, phi, segment.direction, 0.02))
    distances = clearance(scene, vehicle, np.concatenate(dense))
    return distances.reshape(count, per_interval + 1, 2).min(axis=1)


@pytest.mark.parametrize("name", VEHICLES)
@pytest.mark.parametrize("spacing", [0.05, 0.1, 0.4, 1.0])
def test_the_bound_is_never_above_the_clearance_between_samples(name: str, spacing: float) -> None:
    vehicle = VEHICLES[name]
    for seed in range(3):
        scene, segments = drive(vehicle, seed, spacing)
        for segment in segments:
            true = true_minimum(scene, vehicle, segment, 25)
            assert (swept_clearance(scene, vehicle, segment.s, segment.states) <= true + 1e-9).all()
            known = swept_clearance(scene, vehicle, segment.s, segment.states, segment.phi)
            assert (known <= true + 1e-9).all()


@pytest.mark.parametrize(("spacing", "mean", "worst"), [(0.05, 0.0003, 0.0015), (0.1, 0.0012, 0.006)])
def test_the_bound_is_tight_to_millimetres_at_usual_spacings(spacing: float, mean: float, worst: float) -> None:
    vehicle = Vehicle()
    losses = []
    for seed in range(5):
        scene, segments = drive(vehicle, seed, spacing)
        for segment in segments:
            true = true_minimum(scene, vehicle, segment, 10)
            bound = swept_clearance(scene, vehicle, segment.s, segment.states)
            losses.append((true - bound)[true > 0.0])
    assert np.concatenate(losses).mean() < mean
    assert np.concatenate(losses).max() < worst


def test_a_corner_beside_a_turning_trailer_is_seen_without_the_hulls_wedge() -> None:
    vehicle = Vehicle()
    # backwards round a post 5 cm from the trailer's side, level with its axle
    states = roll_out(vehicle, np.array([0.0, 0.0, 0.0, 0.7]), np.array([0.0, 0.1]), np.array([-0.3, -0.3]), -1)
    axle = states[0, :2] - 8.0 * np.array([np.cos(0.7), np.sin(0.7)])
    side = np.array([np.sin(0.7), -np.cos(0.7)])
    for sign in (1.0, -1.0):
        tip = axle + sign * side * (0.5 * vehicle.trailer_width + 0.05)
        far = tip + sign * 2.0 * side
        along = np.array([side[1], -side[0]])
        scene = make_scene([[tip, far + 0.5 * along, far - 0.5 * along]])
        true = clearance(scene, vehicle, roll_out(vehicle, states[0], np.linspace(0, 0.1, 50), np.full(50, -0.3), -1))
        bound = swept_clearance(scene, vehicle, np.array([0.0, 0.1]), states)
        assert 0.0 <= true[:, 1].min() - bound[0, 1] < 0.002


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), margin=st.floats(-0.5, 3.0), spacing=st.sampled_from([0.05, 0.1, 0.5]))
def test_the_first_violation_is_the_first_interval_whose_bound_is_below_the_margin(
    seed: int, margin: float, spacing: float
) -> None:
    vehicle = Vehicle()
    scene, segments = drive(vehicle, seed, spacing)
    for segment in segments:
        for phi in (None, segment.phi):
            low = swept_clearance(scene, vehicle, segment.s, segment.states, phi).min(axis=1) < margin
            expected = int(np.argmax(low)) if low.any() else -1
            assert first_violation(scene, vehicle, segment.s, segment.states, margin, phi) == expected


def test_without_obstacles_nothing_is_near() -> None:
    vehicle = Vehicle()
    segment = random_path(vehicle, (10.0,), seed=1).segments[0]
    empty = make_scene([])
    assert (swept_clearance(empty, vehicle, segment.s, segment.states) == np.inf).all()
    assert first_violation(empty, vehicle, segment.s, segment.states, 5.0) == -1


def test_a_cusp_written_as_two_samples_of_one_pose_loses_nothing() -> None:
    vehicle = Vehicle()
    scene = make_scene([[[8, -1], [9, -1], [9, 1], [8, 1]]])
    states = np.zeros((2, 4))
    swept = swept_clearance(scene, vehicle, np.zeros(2), states, np.array([0.3, -0.3]))
    np.testing.assert_allclose(swept, clearance(scene, vehicle, states[:1]), atol=1e-12)
    assert first_violation(scene, vehicle, np.zeros(2), states, 2.9) == -1
    assert first_violation(scene, vehicle, np.zeros(2), states, 3.1) == 0


def test_known_steering_beyond_the_limits_is_bounded_by_itself() -> None:
    vehicle = Vehicle()
    s = np.linspace(0.0, 6.0, 7)
    phi = np.array([0.0, 0.7, -0.7, 0.7, 0.0, -0.7, 0.7])
    states = roll_out(vehicle, np.zeros(4), s, phi, 1)
    fine = np.linspace(0.0, 6.0, 601)
    dense = roll_out(vehicle, np.zeros(4), fine, np.interp(fine, s, phi), 1)
    corner = np.array([[9.0, 1.6], [12.0, 1.6], [12.0, 3.0], [9.0, 3.0]])
    scene = make_scene([corner])
    true = clearance(scene, vehicle, dense)
    bound = swept_clearance(scene, vehicle, s, states, phi)
    for i in range(6):
        assert (bound[i] <= true[100 * i : 100 * i + 101].min(axis=0) + 1e-9).all()
