"""The yardstick: every metric of paths whose figures are known by hand."""

import dataclasses
import math

import numpy as np
import pytest

from optim.model.metrics import UNITS, Metrics, metrics
from optim.model.objective import Weights
from optim.model.path import Path, roll_out_segment
from optim.model.scene import Scene, make_scene
from optim.model.vehicle import Vehicle

VEHICLE = Vehicle()
ONES = Weights(length=1.0, steer=1.0, rate=1.0, cusp=1.0, jump=1.0)


def measured(path: Path, scene: Scene | None = None) -> Metrics:
    return metrics(VEHICLE, make_scene([]) if scene is None else scene, path, ONES)


def driven(*parts: tuple[float, float, float], start: tuple[float, ...] = (0.0, 0.0, 0.0, 0.0)) -> Path:
    """Segments of signed lengths [m], the steering going linearly from one angle to another in each [rad]."""
    state, segments = np.array(start), []
    for length, first, last in parts:
        s = np.linspace(0.0, abs(length), 401)
        phi = np.linspace(first, last, len(s))
        segments.append(roll_out_segment(VEHICLE, state, 1 if length > 0.0 else -1, s, phi))
        state = segments[-1].states[-1]
    return Path(tuple(segments))


def test_every_metric_has_a_unit_and_every_unit_a_metric() -> None:
    assert [field.name for field in dataclasses.fields(Metrics)] == list(UNITS)


def test_straight_ahead_and_back_costs_its_length_and_its_gear_change() -> None:
    found = measured(driven((10.0, 0.0, 0.0), (-4.0, 0.0, 0.0)))
    lengths = {"length": 14.0, "trailer_length": 14.0, "reverse_length": 4.0, "cusps": 1.0, "objective": 15.0}
    for name, value in dataclasses.asdict(found).items():
        if name != "min_clearance":
            assert value == pytest.approx(lengths.get(name, 0.0), abs=1e-9), name
    assert found.min_clearance == math.inf


def test_on_a_circle_the_trailer_drives_a_smaller_one() -> None:
    phi, hitch_to_axle = 0.3, VEHICLE.hitch_to_axle
    radius = VEHICLE.wheelbase / math.tan(phi)
    alpha = -math.asin(hitch_to_axle / radius)  # the hitch, over the rear axle, is hitch_to_axle ahead of the axle
    found = measured(driven((12.0, phi, phi), start=(0.0, 0.0, 0.0, alpha)))
    assert found.max_abs_alpha == pytest.approx(abs(alpha), abs=1e-6)
    assert found.max_abs_kappa == pytest.approx(math.tan(abs(alpha)) / hitch_to_axle, rel=1e-6)
    assert found.trailer_length == pytest.approx(12.0 * math.cos(alpha), rel=1e-6)
    assert found.max_abs_phi == phi
    assert found.steering_effort == pytest.approx(12.0 * phi**2)
    assert found.steering_variation == pytest.approx(0.0, abs=1e-12)


def test_steering_counts_while_driving_and_at_standstill() -> None:
    found = measured(driven((8.0, 0.0, 0.4), (-5.0, -0.1, 0.2)))
    assert found.max_abs_dphi_ds == pytest.approx(0.06)
    assert found.steering_variation == pytest.approx(0.4 + 0.3 + 0.5)
    effort = 8.0 * 0.4**2 / 3 + 5.0 * (0.2**3 + 0.1**3) / (3 * 0.3)
    assert found.steering_effort == pytest.approx(effort, rel=1e-6)
    rate = 8.0 * 0.05**2 + 5.0 * 0.06**2
    assert found.objective == pytest.approx(13.0 + effort + rate + 1.0 + 0.5**2, rel=1e-6)


def test_clearance_is_that_of_the_nearer_body_on_its_way() -> None:
    ahead = 20.0 + VEHICLE.truck_front
    wall = np.array([[ahead + 0.7, -5.0], [ahead + 2.0, -5.0], [ahead + 2.0, 5.0], [ahead + 0.7, 5.0]])
    side = VEHICLE.trailer_width / 2
    post = np.array([[3.0, side + 0.4], [4.0, side + 0.4], [4.0, side + 2.0], [3.0, side + 2.0]])
    path = driven((20.0, 0.0, 0.0), (-10.0, 0.0, 0.0))
    assert measured(path, make_scene([wall])).min_clearance == pytest.approx(0.7, abs=1e-3)
    assert measured(path, make_scene([wall, post])).min_clearance == pytest.approx(0.4, abs=1e-3)
