"""The source's own formulation, kept for comparison (Esteban Cabezos 2020, section 4.3, figure 4.7).

Four states, weights instead of constraints, single shooting with feedback, iLQR. The source names its weights and gives
their values, W_a = diag(1, 0.3), W_b = W_c = I, W_d = 1e-5, but the pages with the cost are not at hand. Here it is

    sum_k  u_k' W_a u_k + (x_k - r_k)' W_b (x_k - r_k) + W_d sum_points min(0, d - D)^2
    + (x_N - goal)' W_c (x_N - goal)

with u = (step length, steering angle), constant over a step, r the recorded states, d the distance field at points
round both bodies, D = 1 m. Nothing makes the last state the goal, nothing bounds the hitch angle or how fast the wheels
turn, and obstacles hardly count: whether a result keeps the contract is found out afterwards, and said in numbers.
"""

import math
from dataclasses import dataclass

import numpy as np

from optim.geometry.field import DistanceField
from optim.knots.between import CLEARANCE_TOLERANCE
from optim.knots.transcription import knots_of
from optim.methods.ddp.algorithm import InnerOptions, Solution, minimise
from optim.methods.ddp.backward import Expansion, Policy, Trajectory, new_expansion
from optim.model.clearance import distance_field
from optim.model.iterates import IterateStream
from optim.model.kinematics import rk4_step, rk4_step_jacobian
from optim.model.objective import objective
from optim.model.path import Path, Segment, roll_out_segment
from optim.model.problem import Problem, path_clearance
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from optim.model.vehicle import body_corners, body_poses
from optim.numerics.arrays import Array, Float64, Int64, IntArray

W_A, W_B, W_C, W_D = np.array([1.0, 0.3]), np.ones(4), np.ones(4), 1e-5
DISTANCE = 1.0
"""Points nearer than this to an obstacle are penalised, D [m]."""
GOAL_TOLERANCE = 1e-6
"""A result must end that near to the goal [m, rad]; it is not bent to fit."""
_ALONG = np.linspace(0.0, 1.0, 5)  # points on each side of a body, as shares of its length
_SHORTEST, _LONGEST = 1e-3, 1.0  # [m] of a step
_GRADIENT = 1e-4  # largest projected gradient that counts as converged
_CELL, _BESIDE = 0.25, 20.0  # [m] of the distance field, and how far it reaches beyond the path: a body's length
_DENSE = 0.05  # [m] between samples of the path
_FREE = 1e6  # [m, rad]: a roll-out that deviates this far has failed


@dataclass(frozen=True, eq=False)
class SourceModel:
    """A `Model` of `optim.methods.ddp.algorithm`: the source's formulation, N steps."""

    problem: Problem
    gear: Int64[IntArray, " N"]
    """Shape (N,)."""
    reference: Float64[Array, "N+1 4"]
    """Shape (N + 1, 4)."""
    field: DistanceField
    expansion: Expansion

    def roll_out(self, now: Trajectory, policy: Policy, step: float, into: Trajectory) -> float:
        """Implement `Model.roll_out`; infinite where the states leave every map."""
        (states, controls), (x, u) = now, into
        x[0] = states[0]
        for k in range(len(self.gear)):
            wish = controls[k] + step * policy.k[k] + policy.gain[k] @ (x[k] - states[k])
            u[k] = np.clip(wish, *self._limits())
            x[k + 1] = rk4_step(self.problem.vehicle, x[k], u[k, 1], u[k, 1], u[k, 0], int(self.gear[k]))
            if not np.abs(x[k + 1]).max() < _FREE:
                return math.inf
        return self._cost(x, u)

    def expand(self, now: Trajectory, curvature: bool) -> tuple[float, Expansion]:
        """Implement `Model.expand`, without second derivatives."""
        states, controls = now
        e, (h, phi) = self.expansion, controls.T
        reached, jacobian = rk4_step_jacobian(self.problem.vehicle, states[:-1], phi, phi, h, self.gear)
        e.gap[:] = np.where(np.abs(reached - states[1:]) > 1e-12, reached - states[1:], 0.0)
        e.fz[:, :, :4] = jacobian[:, :, :4]
        e.fz[:, :, 4], e.fz[:, :, 5] = jacobian[:, :, 6], jacobian[:, :, 4] + jacobian[:, :, 5]
        weight = np.append(np.tile(W_B, (len(h), 1)), W_C[None], axis=0)
        e.lz[:, :4] = 2.0 * weight * (states - self.reference)
        e.lz[:-1, 4:] = 2.0 * W_A * controls
        e.lzz[:] = 0.0
        e.lzz[:, range(4), range(4)] = 2.0 * weight
        e.lzz[:-1, [4, 5], [4, 5]] = 2.0 * W_A
        near, slope = self._nearness(states)
        e.lz[:, :4] += 2.0 * W_D * np.einsum("np,npi->ni", near, slope)
        e.lzz[:, :4, :4] += 2.0 * W_D * np.einsum("npi,npj->nij", slope * (near < 0.0)[..., None], slope)
        low, high = self._limits()
        e.low[:], e.high[:] = low - controls, high - controls
        return self._cost(states, controls), e

    def _limits(self) -> tuple[Array, Array]:
        """Least and largest (step length, steering angle)."""
        steer = self.problem.vehicle.max_steer
        return np.array([_SHORTEST, -steer]), np.array([_LONGEST, steer])

    def _cost(self, states: Array, controls: Array) -> float:
        tracking = (W_B * (states[:-1] - self.reference[:-1]) ** 2).sum()
        goal = (W_C * (states[-1] - self.reference[-1]) ** 2).sum()
        near, _ = self._nearness(states)
        return float((W_A * controls**2).sum() + tracking + goal + W_D * (near**2).sum())

    def _nearness(self, states: Array) -> tuple[Array, Array]:
        """min(0, d - D) of P points round both bodies, shape (N, P), and d's derivative by the state, (N, P, 4)."""
        corners = body_corners(self.problem.vehicle, states)
        sides = [
            corners[:, :, i, None] + _ALONG[:, None] * (corners[:, :, j] - corners[:, :, i])[:, :, None]
            for i, j in ((0, 1), (3, 2))
        ]
        points = np.concatenate(sides, axis=2)  # (N, 2, 10, 2)
        distance, gradient = self.field.evaluate(points)
        pose = body_poses(self.problem.vehicle, states)
        slope = np.zeros((*points.shape[:3], 4))
        slope[..., :2] = gradient
        arm = points - states[:, None, None, :2]
        slope[..., 2] = gradient[..., 1] * arm[..., 0] - gradient[..., 0] * arm[..., 1]
        arm = (points - pose[:, :, None, :2])[:, 1]
        slope[:, 1, :, 3] = gradient[:, 1, :, 1] * arm[..., 0] - gradient[:, 1, :, 0] * arm[..., 1]
        near = np.minimum(distance - DISTANCE, 0.0)
        return near.reshape(len(states), -1), slope.reshape(len(states), -1, 4)


def solve_source(problem: Problem, spacing: float, iterations: int, on_iterate: OnIterate = ignore) -> Result:
    """Minimise the source's cost from the recorded states; its path if it keeps everything, else the initial one."""
    model, start = source_model(problem, spacing)
    iterates = IterateStream.begin(problem, on_iterate)

    def stepped(now: Trajectory, step: float, gradient: float) -> None:
        iterates.emit(lambda number: _iterate(number, model, now.controls, step))

    options = InnerOptions(iterations=iterations, curvature=False, gradient=_GRADIENT, first_regularisation=1.0)
    found = minimise(model, start, options, stepped)
    path = _path(model, found.trajectory.controls)
    miss = np.abs(path.goal - problem.initial.goal)
    clear = path_clearance(problem.vehicle, problem.scene, path) - problem.required_clearance
    checks = (
        (max(miss[:2]) <= GOAL_TOLERANCE, f"misses the goal by {max(miss[:2]):.3g} m"),
        (max(miss[2:]) <= GOAL_TOLERANCE, f"by {max(miss[2:]):.3g} rad"),
        (clear >= -CLEARANCE_TOLERANCE, f"lacks {-clear:.3g} m of clearance"),
        *_limits_kept(problem, path),
    )
    wrong = [words for is_kept, words in checks if not is_kept]
    gain = objective(problem.initial, problem.weights) - objective(path, problem.weights)
    if wrong or gain <= 0.0:
        path = problem.initial
    steps, stop = iterates.number, Stop.INFEASIBLE if wrong else found.stop
    iterates.emit_path(problem, path)
    return Result(path=path, stop=stop, reason=_reason(found, wrong, gain), iterations=steps)


def _iterate(number: int, model: SourceModel, controls: Array, step: float) -> Iterate:
    """The path that the vehicle drives with the controls of a step."""
    path, problem = _path(model, controls), model.problem
    miss = float(np.abs(path.goal - problem.initial.goal).max())
    value = objective(path, problem.weights)
    return Iterate(iteration=number, path=path, objective=value, violation=miss, step=step)


def _reason(found: Solution, wrong: list[str], gain: float) -> str:
    ended = f"{found.stop.value} with a projected gradient of {found.gradient:.1e}"
    if wrong:
        return f"the source's weights, {ended}: the path {', '.join(wrong)}"
    return f"the source's weights, {ended}; J is {abs(gain):.3g} {'less' if gain > 0.0 else 'more'} than before"


def _limits_kept(problem: Problem, path: Path) -> tuple[tuple[bool, str], ...]:
    vehicle = problem.vehicle
    hitch = max(float(np.abs(segment.alpha).max()) for segment in path.segments) - vehicle.max_hitch
    rates = (np.abs(np.diff(segment.phi)) / np.diff(segment.s) for segment in path.segments)
    rate = max(float(values.max()) for values in rates) - vehicle.max_steer_rate
    return (
        (hitch <= 1e-9, f"bends the hitch {hitch:.3g} rad too far"),
        (rate <= 1e-9, f"steers {rate:.3g} rad/m too fast"),
    )


def source_model(problem: Problem, spacing: float) -> tuple[SourceModel, Trajectory]:
    """The model, and the recorded states and controls to begin with."""
    knots = knots_of(problem.vehicle, problem.initial, spacing)
    drives = knots.gear != 0
    keep = np.append(drives, True)  # of both knots at a gear change the second
    reference = np.array(knots.states[keep])
    steer = 0.5 * (knots.phi[:-1] + knots.phi[1:])
    low, high = reference[:, :2].min(axis=0) - _BESIDE, reference[:, :2].max(axis=0) + _BESIDE
    field = distance_field(problem.scene, _CELL, (low[0], low[1], high[0], high[1]))
    count = int(drives.sum())
    model = SourceModel(problem, knots.gear[drives], reference, field, new_expansion(count, 4, 2))
    return model, Trajectory(reference, np.stack([knots.h[drives], steer[drives]], axis=1))


def _path(model: SourceModel, controls: Array) -> Path:
    """What the vehicle drives with these controls: phi is made linear in between, since wheels do not jump."""
    segments: list[Segment] = []
    state = model.problem.initial.start
    ends = np.flatnonzero(np.diff(model.gear)) + 1
    for block in np.split(np.arange(len(model.gear)), ends):
        h, steer = controls[block, 0], controls[block, 1]
        s = np.concatenate([[0.0], np.cumsum(h)])
        phi = np.concatenate([steer[:1], 0.5 * (steer[1:] + steer[:-1]), steer[-1:]])
        dense = np.union1d(s, np.linspace(0.0, s[-1], max(2, math.ceil(s[-1] / _DENSE)) + 1))
        dense = dense[np.append(True, np.diff(dense) > 1e-6)]
        gear = int(model.gear[block[0]])
        segments.append(roll_out_segment(model.problem.vehicle, state, gear, dense, np.interp(dense, s, phi)))
        state = segments[-1].states[-1]
    return Path(tuple(segments))
