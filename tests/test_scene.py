import dataclasses

import numpy as np
import pytest
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from shapes import random_blocks, random_states, signed_distance

from optim.model.clearance import clearance, collides, witnesses
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle, body_corners

VEHICLES = [Vehicle(), Vehicle(hitch_offset=0.6, trailer_front=0.5)]
SQUARE = np.array([[10.0, -1.0], [12.0, -1.0], [12.0, 1.0], [10.0, 1.0]])


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_clearance_is_the_least_signed_distance_of_each_body_to_any_polygon(vehicle: Vehicle) -> None:
    rng = np.random.default_rng(3)
    scene = make_scene(random_blocks(rng, 25))
    states = random_states(rng, 60)
    expected = [
        [min(signed_distance(body, polygon) for polygon in scene.polygons) for body in bodies]
        for bodies in body_corners(vehicle, states)
    ]
    np.testing.assert_allclose(clearance(scene, vehicle, states), expected, atol=1e-9)


def test_clearance_far_from_the_origin_loses_no_digits() -> None:
    rng = np.random.default_rng(5)
    blocks, states = random_blocks(rng, 10), random_states(rng, 50)
    shift = np.array([512_345.0, 5_812_345.0])
    near = clearance(make_scene(blocks), Vehicle(), states)
    far = clearance(make_scene([block + shift for block in blocks]), Vehicle(), states + [*shift, 0.0, 0.0])
    np.testing.assert_allclose(far, near, atol=1e-8)


@pytest.mark.parametrize("vehicle", VEHICLES)
def test_witnesses_lie_on_body_and_obstacle_and_explain_the_distance(vehicle: Vehicle) -> None:
    rng = np.random.default_rng(6)
    scene = make_scene(random_blocks(rng, 15))
    states = random_states(rng, 200)
    near = witnesses(scene, vehicle, states)
    np.testing.assert_allclose(near.on_body - near.distance[..., None] * near.normal, near.on_obstacle, atol=1e-9)
    bodies = np.asarray(shapely.polygons(body_corners(vehicle, states)))
    obstacles = np.array([shapely.Polygon(polygon) for polygon in scene.polygons])[near.polygon]
    apart = near.distance > 0.0
    assert shapely.distance(bodies, shapely.points(near.on_body))[apart].max() < 1e-9
    assert shapely.distance(obstacles, shapely.points(near.on_obstacle))[apart].max() < 1e-9
    assert 20 < (~apart).sum() < 380


@settings(max_examples=60, deadline=None)
@given(seed=st.integers(0, 2**32 - 1), margin=st.floats(-1.0, 3.0), count=st.integers(0, 60))
def test_collides_says_what_clearance_says(seed: int, margin: float, count: int) -> None:
    rng = np.random.default_rng(seed)
    scene = make_scene(random_blocks(rng, count))
    states = random_states(rng, 40)
    expected = clearance(scene, Vehicle(), states).min(axis=1) < margin
    np.testing.assert_array_equal(collides(scene, Vehicle(), states, margin), expected)


def test_touching_is_no_collision() -> None:
    scene = make_scene([SQUARE])
    states = np.array([[5.0, 0.0, 0.0, 0.0], [5.0 + 1e-9, 0.0, 0.0, 0.0]])
    assert collides(scene, Vehicle(), states).tolist() == [False, True]


def test_a_body_inside_an_obstacle_and_an_obstacle_inside_a_body_collide() -> None:
    large = make_scene([40.0 * np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])])
    small = make_scene([np.array([[-5.1, -0.1], [-4.9, -0.1], [-4.9, 0.1], [-5.1, 0.1]])])
    state = np.zeros((1, 4))
    assert collides(large, Vehicle(), state)[0]
    assert collides(small, Vehicle(), state)[0]
    # inside a trailer of half width 1.275 the way out is sideways
    assert clearance(small, Vehicle(), state)[0, 1] == pytest.approx(-1.375)


def test_without_obstacles_the_clearance_is_infinite_and_nothing_is_near() -> None:
    empty, states = make_scene([]), np.zeros((2, 4))
    near = witnesses(empty, Vehicle(), states)
    assert (near.distance == np.inf).all()
    assert (near.polygon == -1).all()
    assert np.isnan(near.normal).all()
    assert not collides(empty, Vehicle(), states, 1.0).any()


def test_no_states_are_no_trouble() -> None:
    scene, none = make_scene([SQUARE]), np.empty((0, 4))
    assert clearance(scene, Vehicle(), none).shape == (0, 2)
    assert collides(scene, Vehicle(), none).shape == (0,)


def test_polygons_may_be_clockwise_closed_and_not_convex() -> None:
    notched = [[0, 0], [0, 4], [2, 1], [4, 4], [4, 0], [0, 0]]
    scene = make_scene([SQUARE[::-1], notched])
    assert len(scene.polygons) == 4  # the notch needs two cuts
    total = sum(shapely.Polygon(polygon).area for polygon in scene.polygons)
    assert total == pytest.approx(4.0 + shapely.Polygon(notched).area)
    assert all(shapely.is_ccw(shapely.LinearRing(polygon)) for polygon in scene.polygons)


def test_the_outline_of_a_map_becomes_walls_just_outside_it() -> None:
    turn = np.array([[np.cos(0.5), np.sin(0.5)], [-np.sin(0.5), np.cos(0.5)]])
    outline = np.array([[-20, -8], [20, -8], [20, 8], [-20, 8]]) @ turn
    scene = make_scene([], boundary=outline[::-1])
    assert len(scene.polygons) == 4
    assert scene.boundary is not None
    pose = np.array([[*(np.array([2.0, 0.0]) @ turn), 0.5, 0.0]])
    np.testing.assert_allclose(clearance(scene, Vehicle(), pose), [[8 - 1.275, 8 - 1.275]])
    assert collides(scene, Vehicle(), pose + [[*(np.array([14.0, 0.0]) @ turn), 0.0, 0.0]])[0]


@pytest.mark.parametrize(
    ("polygons", "boundary", "message"),
    [
        ([SQUARE, SQUARE[:2]], None, "obstacle 1: it has no area"),
        ([SQUARE, SQUARE, [[0, 0], [2, 2], [2, 0], [0, 3]]], None, "obstacle 2: it is not a simple polygon"),
        ([], [[0, 0], [0, 4], [2, 1], [4, 4], [4, 0]], "boundary: it is not convex"),
        ([], SQUARE[:2], "boundary: it has no area"),
    ],
)
def test_an_unusable_polygon_is_named_with_the_reason(polygons, boundary, message: str) -> None:
    with pytest.raises(ValueError, match=message):
        make_scene(polygons, boundary=boundary)


def test_a_scene_cannot_be_changed() -> None:
    scene = make_scene([SQUARE])
    with pytest.raises(dataclasses.FrozenInstanceError):
        scene.frame = "odom"  # pyright: ignore[reportAttributeAccessIssue]
    with pytest.raises(ValueError, match="read-only"):
        scene.polygons[0][0, 0] = 1.0
