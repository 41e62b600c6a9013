"""The audit's bound on what is swept between samples, compared with poses every 0.1 mm."""

import dataclasses
import math

import numpy as np
import shapely
from audit_cases import plain

from optim.audit.data import read_path, read_vehicle
from optim.audit.motion import excess, footprints
from optim.model.path import Path, roll_out_segment
from optim.model.vehicle import Vehicle
from tools.attacks.brute_collision import compare, dense_states, random_drive, random_vehicle


def test_random_scenes_agree_with_brute_force_within_the_bound() -> None:
    found = [compare(seed) for seed in range(1000, 1040)]
    assert [each.wrong for each in found] == [""] * len(found)
    assert sum(each.collides for each in found) >= 8
    assert sum(not each.collides and each.accepted for each in found) >= 8
    assert any(not each.collides and not each.accepted for each in found), "the bound is never put to the test"


def test_a_wrong_verdict_would_be_called_wrong() -> None:
    sound = compare(1000)
    hit = dataclasses.replace(sound, collides=True, accepted=True, brute=0.0)
    assert "brute force finds a collision" in hit.wrong
    free = dataclasses.replace(sound, collides=False, accepted=False, brute=0.2, audited=-0.1, bound=0.05)
    assert "the bound is" in free.wrong
    assert "told" in dataclasses.replace(free, accepted=True, audited=0.3).wrong


def test_no_point_of_a_hull_is_farther_from_linear_interpolation_than_the_excess() -> None:
    """Corners and sides of the hull, against the footprints of poses interpolated in a hundred steps."""
    rng = np.random.default_rng(5)
    used = []
    for _ in range(60):
        vehicle = random_vehicle(rng)
        part = random_drive(vehicle, rng).segments[0]
        track = read_path(plain(Path((part,))), "path")
        truck = read_vehicle(dataclasses.asdict(vehicle))
        corners = footprints(truck, track.samples)[:2]
        for body in range(2):
            hull = shapely.MultiPoint(corners[:, body].reshape(-1, 2)).convex_hull
            at = np.linspace(0.0, 1.0, 101)[:, None, None]
            between = shapely.union_all(shapely.polygons((1 - at) * corners[0, body] + at * corners[1, body]))
            points = hull.boundary.interpolate(np.linspace(0.0, 1.0, 200), normalized=True)
            farthest = shapely.distance(points, between).max()
            bound = excess(truck, track)[0, body]
            assert farthest <= bound + 1e-3 * bound + 1e-9
            used.append(farthest / bound if bound > 1e-6 else 0.0)
    assert max(used) > 0.3, "a bound that is never used would be needlessly wide"


def test_dense_states_pass_through_the_samples() -> None:
    s = np.array([0.0, 0.1, 0.17])
    part = roll_out_segment(Vehicle(), np.array([0.0, 0.0, 0.3, 0.2]), -1, s, np.array([0.1, 0.12, 0.1]))
    states = dense_states(Vehicle(), part, 1e-3)
    assert len(states) == 1 + 100 + 70
    assert np.abs(states[[0, 100, 170]] - part.states).max() < 1e-9
    assert math.isclose(np.hypot(*np.diff(states[:, :2], axis=0).T).max(), 1e-3, rel_tol=1e-3)
