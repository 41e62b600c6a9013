"""The truck as stages of DDP: derivatives, costs, clearance by features."""

import numpy as np
import pytest
from scenes import random_problem

from optim.geometry.collision import rectangle
from optim.knots.transcription import Knots, knots_of, objective_of
from optim.methods.ddp.backward import Trajectory
from optim.methods.ddp.constraints import PerConstraint
from optim.methods.ddp.features import contact_of
from optim.methods.ddp.model import TruckModel, knots_from, trajectory_of
from optim.methods.ddp.truck import STATES
from optim.model.clearance import clearance
from optim.model.problem import Problem
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle

STEP = 1e-6
ONES = PerConstraint(1.0, 1.0, 1.0)


def _case(seed: int, vehicle: Vehicle | None = None) -> tuple[TruckModel, Trajectory]:
    """A model with every kind of term active, at states and controls that do not fit each other."""
    problem = random_problem(seed, lengths=(6.0, 8.0), vehicle=vehicle)
    rng = np.random.default_rng(seed)
    knots = knots_of(problem.vehicle, problem.recorded, 0.5)
    # asking for 2 m makes many features felt; the limit on the hitch angle is felt too
    model = _model(problem, knots, required=2.0, reach=3.0, curvature=True, penalty=PerConstraint(5.0, 7.0, 3.0))
    model.lower_max_hitch(model.lagrangian.max_hitch - 0.1)
    model.lagrangian.goal_multiplier[:] = rng.standard_normal(4)
    states, controls = trajectory_of(knots, problem.vehicle.max_steer, problem.vehicle.max_steer_rate)
    states[:, :5] += 0.02 * rng.standard_normal((len(states), 5))
    controls[:, 0] += 0.02 * rng.standard_normal(len(controls))
    model.list_rows(states)
    return model, Trajectory(states, controls)


def _model(
    problem: Problem,
    knots: Knots,
    *,
    reach: float,
    required: float = 0.0,
    curvature: bool = False,
    penalty: PerConstraint = ONES,
) -> TruckModel:
    clear = np.full((len(knots.phi), 2), required)
    return TruckModel(problem, knots, clear, reach=reach, curvature=curvature, penalty=penalty)


def _shifted(model: TruckModel, now: Trajectory, k: int, j: int):
    """Cost, gaps, lz and fz with z[k, j] moved forth and back."""
    found = []
    for sign in (1.0, -1.0):
        x, u = now.states.copy(), now.controls.copy()
        if j < STATES:
            x[k, j] += sign * STEP
        else:
            u[k, j - STATES] += sign * STEP
        cost, e = model.expand(Trajectory(x, u), True)
        found.append((cost, e.gap.copy(), e.lz.copy(), e.fz.copy()))
    return found


def _variables(model: TruckModel) -> list[tuple[int, int]]:
    """Some (k, j): the start, the gear change, and steps in between; L+ counts at standing stages only."""
    gear = model.stages.gear
    cusp = int(np.flatnonzero(gear[1:] == 0.0)[0]) + 1
    picks = [0, 1, 5, cusp - 1, cusp, cusp + 1, len(gear) - 1]
    return [(k, j) for k in picks for j in range(8) if j < 7 or gear[k] == 0.0]


@pytest.mark.parametrize("seed", range(4))
def test_first_derivatives_agree_with_finite_differences(seed):
    model, now = _case(seed)
    _, e = model.expand(now, True)
    lz, fz = e.lz.copy(), e.fz.copy()
    for k, j in _variables(model):
        forth, back = _shifted(model, now, k, j)
        assert (forth[0] - back[0]) / (2 * STEP) == pytest.approx(lz[k, j], abs=2e-6 * (1 + abs(lz[k, j])))
        np.testing.assert_allclose((forth[1] - back[1])[k] / (2 * STEP), fz[k, :, j], atol=1e-8)


@pytest.mark.parametrize("seed", range(4))
def test_second_derivatives_agree_with_finite_differences(seed):
    model, now = _case(seed)
    _, e = model.expand(now, True)
    full, fzz = e.lzz.copy(), e.fzz.copy()
    full[:, :STATES, :STATES] += e.bend
    full = np.tril(full) + np.tril(full, -1).swapaxes(1, 2)
    for k, j in _variables(model):
        forth, back = _shifted(model, now, k, j)
        slope = (forth[2] - back[2])[k] / (2 * STEP)
        np.testing.assert_allclose(slope[:7], full[k, :7, j], atol=1e-5 * (1 + np.abs(full[k]).max()))
        np.testing.assert_allclose((forth[3] - back[3])[k, :4] / (2 * STEP), fzz[k, :, :, j], atol=1e-7)


def test_a_hitch_behind_the_axle_has_exact_first_derivatives_too():
    model, now = _case(1, Vehicle(hitch_offset=0.4))
    _, e = model.expand(now, True)
    lz = e.lz.copy()
    for k, j in _variables(model):
        forth, back = _shifted(model, now, k, j)
        # the trailer's reference point turns about the axle: the distances see that through theta
        tolerance = 2e-6 * (1 + abs(lz[k, j]))
        assert (forth[0] - back[0]) / (2 * STEP) == pytest.approx(lz[k, j], abs=tolerance)


def test_the_stages_cost_what_the_objective_says():
    problem = random_problem(2)
    knots = knots_of(problem.vehicle, problem.recorded, 0.4)
    model = _model(problem, knots, reach=0.5)
    now = trajectory_of(knots, problem.vehicle.max_steer, problem.vehicle.max_steer_rate)
    cost, _ = model.expand(now, False)
    assert cost + problem.weights.cusp * knots.num_cusps == pytest.approx(objective_of(knots, problem.weights))
    back = knots_from(now.states, knots)
    np.testing.assert_allclose(back.h, knots.h, atol=1e-12)
    np.testing.assert_array_equal(back.gear, knots.gear)


def test_the_steering_begun_with_keeps_its_limits():
    problem = random_problem(3)
    knots = knots_of(problem.vehicle, problem.recorded, 0.4)
    rough = Knots(knots.states, 3.0 * np.sin(7.0 * np.arange(len(knots.phi))), knots.h, knots.gear)
    _, controls = trajectory_of(rough, 0.5, 0.4)
    phi, drives = controls[:, 0], rough.gear != 0
    assert np.abs(phi).max() <= 0.5
    assert (np.abs(np.diff(phi))[drives] <= 0.4 * rough.h[drives] * (1 + 1e-6)).all()


@pytest.mark.parametrize("seed", range(6))
def test_the_least_distance_of_all_features_is_the_clearance(seed):
    problem = random_problem(seed, num_blocks=14)
    states = np.zeros((40, STATES))
    rng = np.random.default_rng(seed)
    samples = problem.recorded.samples.states
    states[:, :4] = samples[rng.integers(0, len(samples), 40)] + rng.normal(0.0, 0.5, (40, 4)) * (1, 1, 0.2, 0.2)
    knots = Knots(states[1:, :4], np.zeros(39), np.full(38, 0.3), np.ones(38, int))
    model = _model(problem, knots, reach=4.0)
    model.list_rows(states)
    packed, rows = problem.scene.packed, model.rows
    exact = clearance(problem.scene, problem.vehicle, states[:, :4])
    for k in range(1, 39):
        for body in range(2):
            rect = rectangle(packed, problem.vehicle.footprints, 0.0, states, k, body)
            mine = [r for r in range(rows.first[k], rows.first[k + 1]) if rows.body[r] == body]
            distances = (contact_of(packed, rows.polygon[r], rows.feature[r], rect).distance for r in mine)
            least = min(distances, default=9.0)
            if exact[k, body] < 4.0:
                assert least == pytest.approx(exact[k, body], abs=1e-9) or least < exact[k, body] < 0.0


def test_without_obstacles_there_are_no_rows():
    problem = random_problem(1)
    bare = Problem(vehicle=problem.vehicle, scene=make_scene([]), recorded=problem.recorded)
    knots = knots_of(bare.vehicle, bare.recorded, 0.5)
    model = _model(bare, knots, reach=1.0, curvature=True)
    model.list_rows(trajectory_of(knots, 0.55, 0.5).states)
    assert len(model.rows.body) == 0
