"""Paths as knots and step lengths, and back."""

import dataclasses

import numpy as np
import pytest
from paths import random_path
from scenes import random_problem

from optim.knots.transcription import (
    Knots,
    defects,
    dynamics_curvature,
    knots_of,
    merge_vanished,
    objective_gradient,
    objective_of,
    path_of,
    without_segment,
)
from optim.model.kinematics import rk4_step
from optim.model.objective import objective
from optim.model.path import Path, segment_from_states
from optim.model.vehicle import Vehicle

SPACING = 0.35


def _knots(seed: int = 2, vehicle: Vehicle | None = None):
    problem = random_problem(seed, vehicle=vehicle)
    return problem, knots_of(problem.vehicle, problem.recorded, SPACING)


def _moved(knots: Knots, name: str, index, step: float) -> Knots:
    values = getattr(knots, name).copy()
    values[index] += step
    return dataclasses.replace(knots, **{name: values})


@pytest.mark.parametrize("seed", range(4))
def test_a_path_of_knots_follows_the_recorded_one_and_has_the_objective_of_its_knots(seed):
    problem, knots = _knots(seed)
    path = path_of(problem.vehicle, knots, problem.recorded)
    assert objective(path, problem.weights) == pytest.approx(objective_of(knots, problem.weights), rel=1e-9)
    assert path.num_cusps == problem.recorded.num_cusps
    assert max(np.diff(segment.s).max() for segment in path.segments) <= 0.1 + 1e-9
    np.testing.assert_array_equal(path.start, problem.recorded.start)
    np.testing.assert_array_equal(path.goal, problem.recorded.goal)
    gaps, _ = defects(problem.vehicle, knots)
    assert np.abs(gaps).max() < 0.02  # steering is taken at the knots only


@pytest.mark.parametrize("vehicle", [Vehicle(), Vehicle(hitch_offset=0.7)])
def test_defects_and_their_derivatives_are_those_of_the_integration_step(vehicle):
    _, knots = _knots(1)
    gaps, jacobian = defects(vehicle, knots)
    for k in (0, 5, int(np.flatnonzero(knots.gear == 0)[0]), len(knots.h) - 1):
        start = knots.states[k]
        if knots.gear[k]:
            end = rk4_step(vehicle, start, knots.phi[k], knots.phi[k + 1], knots.h[k], int(knots.gear[k]))
            np.testing.assert_allclose(gaps[k], end - knots.states[k + 1], atol=1e-12)
        inputs = [("states", (k, c)) for c in range(4)] + [("phi", k), ("phi", k + 1), ("h", k)]
        for column, (name, index) in enumerate(inputs):
            high, low = (defects(vehicle, _moved(knots, name, index, step))[0][k] for step in (1e-6, -1e-6))
            np.testing.assert_allclose(jacobian[k][:, column], (high - low) / 2e-6, atol=1e-6)


def test_the_curvature_of_the_dynamics_agrees_with_differences_of_the_gradient():
    problem, knots = _knots(3)
    multipliers = np.random.default_rng(0).normal(size=(len(knots.h), 4))
    curvature = dynamics_curvature(problem.vehicle, knots, multipliers)
    k, step = 7, 1e-5
    inputs = [("states", (k, 2)), ("states", (k, 3)), ("phi", k), ("phi", k + 1), ("h", k)]
    for column, (name, index) in enumerate(inputs):
        gradients = [
            multipliers[k] @ defects(problem.vehicle, _moved(knots, name, index, sign * step))[1][k][:, 2:]
            for sign in (1, -1)
        ]
        np.testing.assert_allclose(curvature[k][:, column], (gradients[0] - gradients[1]) / (2 * step), atol=1e-6)
    assert not curvature[knots.gear == 0].any()


def test_the_gradient_of_the_objective_agrees_with_finite_differences():
    problem, knots = _knots(4)
    _, (by_phi, by_h) = objective_gradient(knots, problem.weights)
    cusp = int(np.flatnonzero(knots.gear == 0)[0])
    for k in (0, 3, cusp, cusp + 1):
        values = [objective_of(_moved(knots, "phi", k, step), problem.weights) for step in (1e-6, -1e-6)]
        assert by_phi[k] == pytest.approx((values[0] - values[1]) / 2e-6, abs=1e-6)
    values = [objective_of(_moved(knots, "h", 3, step), problem.weights) for step in (1e-6, -1e-6)]
    assert by_h[3] == pytest.approx((values[0] - values[1]) / 2e-6, abs=1e-6)
    assert by_h[cusp] == 0.0


def test_a_segment_that_goes_takes_its_gear_changes_with_it():
    _, knots = _knots()
    assert knots.num_cusps == 2
    inner = without_segment(knots, 1)
    assert inner.num_cusps == 0
    assert set(inner.gear.tolist()) == {int(knots.gear[0])}
    first, last = without_segment(knots, 0), without_segment(knots, 2)
    assert first.num_cusps == last.num_cusps == 1
    with pytest.raises(ValueError, match="only segment"):
        without_segment(inner, 0)


def test_what_is_left_without_a_segment_stays_and_the_seam_takes_the_mean():
    _, knots = _knots()
    before, middle, after = knots.runs
    first, inner, last = (without_segment(knots, index) for index in range(3))
    for name in ("states", "phi"):
        values = getattr(knots, name)
        np.testing.assert_array_equal(getattr(first, name), values[middle.start :])
        np.testing.assert_array_equal(getattr(last, name), values[: middle.stop + 1])
        seam = 0.5 * (values[before.stop] + values[after.start])
        left, right = values[: before.stop], values[after.start + 1 :]
        np.testing.assert_array_equal(getattr(inner, name), np.concatenate([left, seam[None], right]))
    for name in ("h", "gear"):
        values = getattr(knots, name)
        np.testing.assert_array_equal(getattr(first, name), values[middle.start :])
        np.testing.assert_array_equal(getattr(last, name), values[: middle.stop])
        np.testing.assert_array_equal(getattr(inner, name), np.concatenate([values[before], values[after]]))


def test_segments_of_one_gear_become_one_with_the_mean_of_both_steering_angles_at_the_seam():
    problem, _ = _knots()
    (segment,) = random_path(problem.vehicle, (6.0,), seed=3, spacing=0.1).segments
    steered = segment_from_states(1, segment.s[30:], segment.states[30:], segment.phi[30:] + 0.1)
    first = segment_from_states(1, segment.s[:31], segment.states[:31], segment.phi[:31])
    knots = knots_of(problem.vehicle, Path((first, steered)), 0.5)
    assert knots.num_cusps == 0
    assert len(knots.h) == 12
    np.testing.assert_array_equal(knots.phi[:6], segment.phi[:30:5])
    np.testing.assert_allclose(knots.phi[6], segment.phi[30] + 0.05, atol=1e-12)
    np.testing.assert_allclose(knots.phi[7:], segment.phi[35::5] + 0.1, atol=1e-12)


def test_only_vanished_segments_are_merged_away():
    _, knots = _knots()
    assert merge_vanished(knots, 0.5) is knots
    h = knots.h.copy()
    h[knots.runs[1]] = 0.001
    assert merge_vanished(dataclasses.replace(knots, h=h), 0.5).num_cusps == 0
