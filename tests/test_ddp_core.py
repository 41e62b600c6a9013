"""The core of differential dynamic programming on arrays of derivatives: backward pass, box bounds, iteration."""

import itertools

import numpy as np
import pytest
from car_parking import LIMITS, START, STEPS, CarParking, advance

from optim.methods.ddp.algorithm import InnerOptions, minimise
from optim.methods.ddp.backward import Expansion, Policy, Trajectory, backward_pass, new_expansion, new_policy
from optim.methods.ddp.boxqp import AT_HIGH, AT_LOW, FREE, box_qp
from optim.model.result import Stop


def _linear_quadratic(stages: int, n: int, m: int, seed: int) -> Expansion:
    rng = np.random.default_rng(seed)
    e = new_expansion(stages, n, m)
    e.fz[:] = 0.5 * rng.standard_normal(e.fz.shape)
    root = rng.standard_normal((stages + 1, n + m, n + m))
    e.lzz[:] = np.eye(n + m) + 0.1 * root @ root.swapaxes(1, 2)
    e.lz[:] = rng.standard_normal(e.lz.shape)
    e.lz[-1, n:], e.lzz[-1, n:], e.lzz[-1, :, n:] = 0.0, 0.0, 0.0
    return e


def _riccati(e: Expansion, n: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """Gains and feedforward of each stage, last first."""
    v, vv, found = e.lz[-1, :n], e.lzz[-1, :n, :n], []
    for k in range(len(e.fz) - 1, -1, -1):
        q = e.lz[k] + e.fz[k].T @ v
        qq = e.lzz[k] + e.fz[k].T @ vv @ e.fz[k]
        gain, step = -np.linalg.solve(qq[n:, n:], qq[n:, :n]), -np.linalg.solve(qq[n:, n:], q[n:])
        v, vv = q[:n] + qq[:n, n:] @ step, qq[:n, :n] + qq[:n, n:] @ gain
        found.append((gain, step))
    return found


@pytest.mark.parametrize(("n", "m"), [(6, 2), (5, 2), (4, 3), (1, 1)])
def test_one_sweep_over_a_linear_quadratic_problem_is_the_riccati_solution(n, m):
    e, policy = _linear_quadratic(60, n, m, seed=n), new_policy(60, n, m)
    assert backward_pass(e, 0.0, False, policy).failed_stage == -1
    for k, (gain, step) in zip(range(59, -1, -1), _riccati(e, n), strict=True):
        np.testing.assert_allclose(policy.gain[k], gain, rtol=0, atol=1e-10)
        np.testing.assert_allclose(policy.k[k], step, rtol=0, atol=1e-10)


class _Linear:
    """A linear-quadratic problem as a Model: x+ = f_z z + gap at z = 0."""

    def __init__(self, e: Expansion, offset: np.ndarray) -> None:
        self.e, self.offset = e, offset
        self.lz, self.lzz = e.lz.copy(), e.lzz.copy()

    def _cost(self, states: np.ndarray, controls: np.ndarray) -> float:
        z = np.concatenate([states, np.append(controls, np.zeros((1, controls.shape[1])), axis=0)], axis=1)
        return float((self.lz * z).sum() + 0.5 * np.einsum("ki,kij,kj", z, self.lzz, z))

    def expand(self, now: Trajectory, curvature: bool) -> tuple[float, Expansion]:
        states, controls = now
        z = np.concatenate([states, np.append(controls, np.zeros((1, controls.shape[1])), axis=0)], axis=1)
        self.e.lz[:] = self.lz + np.einsum("kij,kj->ki", self.lzz, z)
        miss = np.einsum("kij,kj->ki", self.e.fz, z[:-1]) + self.offset - states[1:]
        self.e.gap[:] = np.where(np.abs(miss) > 1e-12, miss, 0.0)
        return self._cost(states, controls), self.e

    def roll_out(self, now: Trajectory, policy: Policy, step: float, into: Trajectory) -> float:
        (states, controls), (x, u) = now, into
        x[0] = states[0]
        for k in range(len(controls)):
            u[k] = controls[k] + step * policy.k[k] + policy.gain[k] @ (x[k] - states[k])
            x[k + 1] = self.e.fz[k] @ np.append(x[k], u[k]) + self.offset[k] - (1.0 - step) * self.e.gap[k]
        return self._cost(x, u)


def test_a_linear_quadratic_problem_with_gaps_is_solved_by_one_full_step():
    rng = np.random.default_rng(5)
    model = _Linear(_linear_quadratic(40, 4, 2, seed=3), rng.standard_normal((40, 4)))
    start = Trajectory(rng.standard_normal((41, 4)), rng.standard_normal((40, 2)))
    found = minimise(model, start, InnerOptions(gradient=1e-8))
    assert (found.stop, found.iterations) == (Stop.CONVERGED, 1)
    assert found.gap == 0.0


def _enumerated(h, g, low, high) -> np.ndarray:
    """The minimum over a box by trying every set of held variables."""
    best, at = np.inf, low
    for state in itertools.product((FREE, AT_LOW, AT_HIGH), repeat=len(g)):
        state = np.array(state)
        x = np.where(state == AT_LOW, low, high).astype(float)
        free = state == FREE
        if free.any():
            x[free] = np.linalg.solve(h[np.ix_(free, free)], -(g + h[:, ~free] @ x[~free])[free])
        value = 0.5 * x @ h @ x + g @ x
        if (x >= low - 1e-12).all() and (x <= high + 1e-12).all() and value < best:
            best, at = value, x
    return at


@pytest.mark.parametrize("seed", range(40))
def test_a_box_constrained_quadratic_is_minimised_exactly(seed):
    rng = np.random.default_rng(seed)
    m = 1 + seed % 4
    root = rng.standard_normal((m, m))
    h, g = root @ root.T + 0.1 * np.eye(m), 3.0 * rng.standard_normal(m)
    low, high = -rng.uniform(0.0, 1.0, m), rng.uniform(0.0, 1.0, m)
    x, held = np.zeros(m), np.zeros(m, np.int64)
    assert box_qp(h, g, low, high, x, held, np.zeros((m, m)), np.empty(m), np.empty(m), np.empty(m), (0,) * m)
    np.testing.assert_allclose(x, _enumerated(h, g, low, high), atol=1e-7)


def test_a_quadratic_that_is_not_convex_is_refused():
    space = np.empty(2), np.empty(2), np.empty(2)
    low, high = np.full(2, -1.0), np.ones(2)
    assert not box_qp(-np.eye(2), np.ones(2), low, high, np.zeros(2), np.zeros(2, np.int64), np.eye(2), *space, (0, 0))


def test_a_control_held_by_a_bound_follows_it_when_the_state_moves():
    e = new_expansion(1, 2, 1, moving_bounds=True)
    e.fz[0, 0, 2], e.lzz[:, range(3), range(3)] = 1.0, 1.0
    e.lz[0, 2] = -10.0  # pushes up
    e.high[0, 0], e.high_x[0, 0] = 0.5, (0.3, -0.2)
    policy = new_policy(1, 2, 1)
    assert backward_pass(e, 0.0, False, policy).failed_stage == -1
    assert policy.k[0, 0] == 0.5
    np.testing.assert_array_equal(policy.gain[0, 0], [0.3, -0.2])


def test_a_stage_without_curvature_is_named_and_helped_by_regularisation():
    e = new_expansion(3, 1, 1)
    e.fz[:, 0, :], e.lz[1, 1] = 1.0, 1.0
    policy = new_policy(3, 1, 1)
    assert backward_pass(e, 0.0, False, policy).failed_stage == 2
    assert backward_pass(e, 1.0, False, policy).failed_stage == -1


@pytest.mark.parametrize("curvature", [False, True])
def test_the_cars_derivatives_agree_with_finite_differences(curvature):
    model, rng = CarParking(curvature), np.random.default_rng(2)
    states, controls = model.initial()
    states = states + rng.uniform(-0.5, 0.5, states.shape)
    states[:, 3] += 3.0 * rng.standard_normal(len(states))
    _, e = model.expand(Trajectory(states, controls), curvature)
    fz, fzz, gap = e.fz.copy(), e.fzz.copy(), np.empty((STEPS, 4))
    step = 1e-6
    out = np.empty(4)
    for j in range(6):
        ends = []
        for sign in (1.0, -1.0):
            x, u = states.copy(), controls.copy()
            (x if j < 4 else u)[:, j % 4 if j < 4 else j - 4] += sign * step
            for k in range(STEPS):
                advance(x[k], u[k, 0], u[k, 1], out)
                gap[k] = out
            ends.append((gap.copy(), model.expand(Trajectory(x, u), curvature)[1].fz.copy()))
        np.testing.assert_allclose((ends[0][0] - ends[1][0]) / (2 * step), fz[:, :, j], atol=1e-8)
        if curvature:
            np.testing.assert_allclose((ends[0][1] - ends[1][1])[:, :3] / (2 * step), fzz[:, :, :, j], atol=1e-7)


@pytest.mark.parametrize("curvature", [False, True])
def test_tassas_car_is_parked_within_its_limits(curvature):
    model = CarParking(curvature)
    options = InnerOptions(iterations=500, curvature=curvature, gradient=1e-5, first_regularisation=1.0)
    found = minimise(model, model.initial(), options)
    assert found.stop is Stop.CONVERGED
    # 1.905167 from this start; pycddp's interior point solvers end at 1.9052 and 1.9067 (tools/bench/ddp.py)
    assert found.cost == pytest.approx(1.90517, abs=1e-4)
    np.testing.assert_array_equal(found.trajectory.states[0], START)
    assert (np.abs(found.trajectory.controls) <= LIMITS).all()
    assert np.abs(found.trajectory.states[-1]).max() <= 0.03
