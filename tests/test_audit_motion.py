"""Between samples: the inflated hulls contain the motion, and distances from them are exact."""

import dataclasses
import math

import numpy as np
import pytest
import shapely
from audit_cases import SOUND, SOUND_PATH, VEHICLE, plain
from paths import random_path
from scenes import blocks_beside

from optim.audit.checks import audit_recorded
from optim.audit.data import read_path, read_scene, read_vehicle
from optim.audit.motion import footprints, inflation, integrate, sweep
from optim.model.kinematics import roll_out
from optim.model.path import Path, roll_out_segment
from optim.model.vehicle import Vehicle, body_corners


def random_motion(rng: np.random.Generator, vehicle: Vehicle, ds: float) -> Path:
    """One hard interval: any hitch angle, steering from anywhere to anywhere."""
    state = np.array([*rng.uniform(-1, 1, 2), rng.uniform(-3, 3), rng.uniform(-1, 1) * vehicle.max_hitch])
    phi = rng.uniform(-vehicle.max_steer, vehicle.max_steer, 2)
    return Path((roll_out_segment(vehicle, state, int(rng.choice([-1, 1])), np.array([0.0, ds]), phi),))


def dense_corners(vehicle: Vehicle, path: Path, count: int = 60) -> np.ndarray:
    """Corners at many instants of a path of one interval. Shape (count, 2, 4, 2)."""
    part = path.segments[0]
    s = np.linspace(0.0, part.length, count)
    return body_corners(vehicle, roll_out(vehicle, part.states[0], s, np.interp(s, part.s, part.phi), part.direction))


def test_the_inflated_hull_contains_the_motion_and_is_not_much_larger() -> None:
    rng = np.random.default_rng(11)
    ratios = []
    for k in range(300):
        offset = 0.0 if k % 2 else float(rng.uniform(-1, 1))
        to_axle, overhang = rng.uniform(3, 9), rng.uniform(0, 5)
        vehicle = Vehicle(hitch_to_axle=to_axle, trailer_rear=to_axle + overhang, hitch_offset=offset)
        path = random_motion(rng, vehicle, ds=float(rng.uniform(0.02, 0.5)))
        truck, track = read_vehicle(dataclasses.asdict(vehicle)), read_path(plain(path), "path")
        spread = inflation(truck, track, np.zeros((4, 1)))[0]
        ends = footprints(truck, track.samples)
        moved = dense_corners(vehicle, path)
        for body in range(2):
            hull = shapely.MultiPoint(ends[:, body].reshape(-1, 2)).convex_hull
            escape = shapely.distance(shapely.points(moved[:, body].reshape(-1, 2)), hull).max()
            assert escape <= spread[body] * (1 + 1e-9)
            ratios.append(escape / spread[body])
    assert max(ratios) > 0.5, "a bound that is never half used up would be needlessly wide"


def test_a_defect_widens_the_hull_by_what_it_moves_the_farthest_corner() -> None:
    truck, track = read_vehicle(SOUND["vehicle"]), read_path(SOUND["path"], "path")
    none = np.zeros((4, len(track.left)))
    turned = none.copy()
    turned[2] = 1e-4
    wider = inflation(truck, track, turned) - inflation(truck, track, none)
    assert wider.max() == pytest.approx(1e-4 * math.hypot(12.0, 1.275), rel=1e-9)


def test_a_thin_post_that_dense_sampling_hits_is_never_missed() -> None:
    rng = np.random.default_rng(4)
    triangle = 1e-3 * np.array([[1.0, 0.0], [-0.5, 0.9], [-0.5, -0.9]])
    between = 0
    for _ in range(150):
        path = random_motion(rng, VEHICLE, ds=0.1)
        moved = dense_corners(VEHICLE, path)
        body, instant, corner = rng.integers(2), rng.integers(len(moved)), rng.integers(4)
        post = moved[instant, body, corner] + triangle * rng.uniform(0.1, 1.0)
        area = shapely.Polygon(post)
        hit = [any(area.intersects(shapely.Polygon(corners)) for corners in bodies) for bodies in moved]
        assert any(hit)
        between += not (hit[0] or hit[-1])
        report = audit_recorded(dataclasses.asdict(VEHICLE), {"polygons": [post.tolist()]}, plain(path))
        assert not report.checks["clearance"].passed
    assert between > 20, "the test needs posts that no sample touches"


def test_the_reported_minimum_is_exact() -> None:
    polygons = blocks_beside(VEHICLE, SOUND_PATH, 6, seed=3)
    scene = {"polygons": [p.tolist() for p in polygons]}
    truck, track = read_vehicle(SOUND["vehicle"]), read_path(SOUND["path"], "path")
    none = np.zeros((4, len(track.left)))
    swept = sweep(truck, read_scene(scene), track, none)
    corners = footprints(truck, track.samples)
    rng = np.random.default_rng(0)
    for k in rng.integers(0, len(track.left), 25):
        for body in range(2):
            points = np.concatenate([corners[track.left[k], body], corners[track.left[k] + 1, body]])
            hull = shapely.MultiPoint(points).convex_hull
            exact = min(hull.distance(shapely.Polygon(p)) for p in polygons) - swept.inflation[k, body]
            assert swept.clearance[k, body] == pytest.approx(exact, abs=1e-12)


def test_overlap_is_reported_as_the_depth_of_penetration() -> None:
    """A straight drive along the x axis; the truck is 2.55 m wide, the block reaches 0.3 m into its lane."""
    s = np.linspace(0.0, 2.0, 21)
    path = Path((roll_out_segment(VEHICLE, np.zeros(4), 1, s, np.zeros(21)),))
    block = [[1.0, 0.975], [3.0, 0.975], [3.0, 9.0], [1.0, 9.0]]
    check = audit_recorded(dataclasses.asdict(VEHICLE), {"polygons": [block]}, plain(path)).checks["clearance"]
    assert check.values["truck_m"] == pytest.approx(-0.3, abs=1e-9)
    assert check.sentence.startswith("least swept clearance: truck -0.3000 m")


def test_distance_to_the_boundary_is_signed() -> None:
    s = np.linspace(0.0, 2.0, 21)
    path = plain(Path((roll_out_segment(VEHICLE, np.zeros(4), 1, s, np.zeros(21)),)))
    for top, room in ((1.5, 0.225), (1.0, -0.275)):
        outline = [[-20.0, -5.0], [20.0, -5.0], [20.0, top], [-20.0, top]]
        scene = {"polygons": [], "boundary": outline}
        check = audit_recorded(dataclasses.asdict(VEHICLE), scene, path).checks["boundary"]
        assert check.values == pytest.approx({"truck_m": room, "trailer_m": room}, abs=1e-5)
        assert check.passed == (room > 0)


def test_the_integrator_agrees_with_the_model() -> None:
    for offset in (0.0, 0.6):
        vehicle = Vehicle(hitch_offset=offset)
        path = random_path(vehicle, (6.0, 5.0), seed=1, spacing=0.1)
        track = read_path(plain(path), "path")
        ends, _ = integrate(read_vehicle(dataclasses.asdict(vehicle)), track, 0.01)
        assert np.abs(ends - track.after[1:5]).max() < 1e-9


def test_a_finer_substep_of_the_integration_changes_nothing() -> None:
    truck, track = read_vehicle(SOUND["vehicle"]), read_path(SOUND["path"], "path")
    coarse, fine = (integrate(truck, track, step)[0] for step in (0.01, 0.001))
    assert np.abs(coarse - fine).max() < 1e-10
