"""The sparse system of one Gauss-Newton step of the fit in `optim.fit.poses`: residuals, hard constraints, bounds."""

from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from optim.model.clearance import separations
from optim.model.kinematics import rk4_step_jacobian
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64, Int64, IntArray

_SIGMA_BOUND = 1e-4  # allowed violation of a limit [rad or rad/m]; weighs it against the other residuals
_SIGMA_CLEAR = 1e-3  # the same of the clearance [m]
_INSIDE = 1e-3  # relative; limits are tightened by this share to make up for that
_SIGMA_HITCH = 0.05  # of a logged hitch angle at a pose whose heading is not known [rad]
_SIGMA_GOAL = 2e-3  # of a requested last hitch angle [rad]
_MOST_NEAR = 4  # polygons that push one body at one knot


@dataclass(frozen=True, kw_only=True)
class FitOptions:
    """Trust in the log against smoothness, and the sampling of the result."""

    spacing: float = 0.1
    """Samples of the path are at most this far apart [m]."""
    sigma_position: float = 0.01
    """Expected error of a logged position [m]."""
    sigma_heading: float = 0.005
    """Expected error of a logged heading or hitch angle [rad]."""
    sigma_bend: float = 0.3
    """Expected change of dphi/ds over a metre; it grows with the square root of the length [rad/m^1.5]."""
    max_iterations: int = 25
    """Gauss-Newton steps."""
    max_bounded: int = 40
    """Gauss-Newton steps of a fit within bounds."""
    tolerance: float = 1e-9
    """The fit has converged when no unknown changes by more than this [m or rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Bounds:
    """Constraints of a fit beyond the kinematics."""

    limits: bool = True
    """Whether to keep the vehicle's limits: steering, its rate, hitch angle."""
    scene: Scene | None = None
    """Obstacles to keep clear of, if any."""
    clearance: float = 0.02
    """Distance to keep from them at samples [m]; between samples it is some millimetres less."""


class Layout(NamedTuple):
    """Layout of the unknowns: K knots with (x, y, theta, alpha, phi), then a length per logged interval."""

    pose_knot: Int64[IntArray, "n 2"]
    """Knot of each logged pose: as end of what is before it, as start of what follows. Shape (n, 2)."""
    left: Int64[IntArray, " M"]
    """First knot of each step. Shape (M,)."""
    interval: Int64[IntArray, " M"]
    """Logged interval of each step. Shape (M,)."""
    pieces: Int64[IntArray, " n-1"]
    """Number of steps of each logged interval. Shape (n - 1,)."""
    direction: Int64[IntArray, " M"]
    """Gear of each step. Shape (M,)."""
    num_knots: int
    """Number of knots, K."""


class FitProblem(NamedTuple):
    """Fit a path to poses; see `optim.fit.poses.fit_path`."""

    vehicle: Vehicle
    poses: Float64[Array, "n 3"]
    """x [m], y [m], heading [rad]. Shape (n, 3)."""
    trust: Float64[Array, "n 2"]
    """1 / expected error of position [1/m] and heading [1/rad]; 0 where nothing is known. Shape (n, 2)."""
    alpha: Float64[Array, " n"] | None
    """Logged hitch angles [rad]. Shape (n,)."""
    initial_hitch: float
    """First hitch angle where none are logged [rad]."""
    layout: Layout
    options: FitOptions
    bounds: Bounds | None = None
    goal_hitch: float | None = None
    """Requested last hitch angle [rad]."""


def gaps_of(problem: FitProblem, knots: Array, lengths: Array) -> tuple[Array, Array]:
    """Breaks of the kinematics over each step (M, 4), and the step's derivatives (M, 4, 7)."""
    layout = problem.layout
    start, end = knots[layout.left], knots[layout.left + 1]
    ds = step_lengths(layout, lengths)
    reached, jacobian = rk4_step_jacobian(problem.vehicle, start[:, :4], start[:, 4], end[:, 4], ds, layout.direction)
    return end[:, :4] - reached, jacobian


def gauss_newton(problem: FitProblem, knots: Array, lengths: Array) -> Array:
    """The step of all unknowns: knots (5 K), then lengths (n - 1)."""
    width = knots.size + len(lengths)
    rows = _residuals(problem, knots, lengths)
    if problem.bounds is not None:
        _add_bounds(rows, problem, problem.bounds, knots, lengths)
    free, right = rows.matrix(width)
    hard, gap = _constraints(problem, knots, *gaps_of(problem, knots, lengths)).matrix(width)
    return _factors(free, hard).solve(np.concatenate([free.T @ right, gap]))[:width]


def goal_hitch_sigma(problem: FitProblem, knots: Array, lengths: Array) -> float:
    """Standard deviation of the last hitch angle [rad], from the expected errors of all poses, the ends among them.

    Bounds and a requested last hitch angle do not count.
    """
    width = knots.size + len(lengths)
    free, _ = _residuals(problem._replace(goal_hitch=None), knots, lengths).matrix(width)
    hard, gap = _constraints(problem, knots, *gaps_of(problem, knots, lengths), has_ends=False).matrix(width)
    unit = np.zeros(width + len(gap))
    unit[knots.size - 2] = 1.0
    return float(np.sqrt(max(0.0, _factors(free, hard).solve(unit)[knots.size - 2])))


def _factors(free: Any, hard: Any) -> Any:
    """Factors of the optimality system of: |free step - right|^2 least, hard step = gap."""
    # the small diagonal blocks keep the factorisation sound where a direction carries no information
    normal = (free.T @ free + 1e-9 * sparse.identity(free.shape[1])).tocsc()
    return splu(sparse.bmat([[normal, hard.T], [hard, -1e-12 * sparse.identity(hard.shape[0])]], format="csc"))


def step_lengths(layout: Layout, lengths: Array) -> Array:
    """Length of each step [m], from those between neighbouring poses (n - 1,). Shape (M,)."""
    return lengths[layout.interval] / layout.pieces[layout.interval]


class _Triplets:
    """Rows of a sparse matrix with right-hand sides, collected block by block."""

    def __init__(self) -> None:
        self.rows: list[IntArray] = []
        self.cols: list[IntArray] = []
        self.values: list[Array] = []
        self.right: list[Array] = []
        self.count = 0

    def add(self, cols: IntArray, values: Array, right: Array) -> None:
        """Rows sum_j values[i, j] * step[cols[i, j]] = right[i]; cols, values (m, j), right (m,)."""
        rows = np.broadcast_to(self.count + np.arange(len(right))[:, None], cols.shape)
        self.rows.append(rows.ravel())
        self.cols.append(cols.ravel())
        self.values.append(np.broadcast_to(values, cols.shape).ravel())
        self.right.append(np.asarray(right, float))
        self.count += len(right)

    def matrix(self, width: int) -> tuple[sparse.csc_matrix, Array]:
        """The rows with `width` columns, and their right-hand sides."""
        where = (np.concatenate(self.rows), np.concatenate(self.cols))
        data = np.concatenate(self.values)
        return sparse.csc_matrix((data, where), shape=(self.count, width)), np.concatenate(self.right)


def _residuals(problem: FitProblem, knots: Array, lengths: Array) -> _Triplets:
    """Residuals to minimise: distance from the log, bend of the steering."""
    rows, layout, poses = _Triplets(), problem.layout, problem.poses
    at = layout.pose_knot[:, 0]
    logged = poses if problem.alpha is None else np.column_stack([poses, problem.alpha])
    for column in range(logged.shape[1]):
        weight = problem.trust[:, 0] if column < 2 else problem.trust[:, 1]
        if column == 3:  # known less well, but known, where headings are taken from the motion
            weight = np.where(weight > 0.0, weight, 1.0 / _SIGMA_HITCH)
        misfit = weight * (logged[:, column] - knots[at, column])
        rows.add((5 * at + column)[:, None], weight[:, None], misfit)
    if problem.goal_hitch is not None:
        off = np.array([(problem.goal_hitch - knots[-1, 3]) / _SIGMA_GOAL])
        rows.add(np.array([[knots.size - 2]]), np.array([[1.0 / _SIGMA_GOAL]]), off)
    ds = step_lengths(layout, lengths)
    inner = np.flatnonzero(np.diff(layout.left) == 1)  # pairs of steps within one segment
    h0, h1 = ds[inner], ds[inner + 1]
    weight = 1.0 / (problem.options.sigma_bend * np.sqrt((h0 + h1) / 2.0))
    values = weight[:, None] * np.stack([1.0 / h0, -1.0 / h0 - 1.0 / h1, 1.0 / h1], axis=1)
    first = layout.left[inner]
    cols = 5 * (first[:, None] + np.arange(3)) + 4
    rows.add(cols, values, -np.sum(values * knots[first[:, None] + np.arange(3), 4], axis=1))
    return rows


def _constraints(
    problem: FitProblem, knots: Array, gaps: Array, jacobian: Array, *, has_ends: bool = True
) -> _Triplets:
    """Equality constraints: the kinematics, the ends, the shared poses at cusps."""
    rows, layout, poses = _Triplets(), problem.layout, problem.poses
    left, size = layout.left, knots.size
    share = 1.0 / layout.pieces[layout.interval]
    inputs = np.column_stack([5 * left[:, None] + np.arange(5), 5 * left + 9, size + layout.interval])
    for column in range(4):
        derivative = jacobian[:, column, :].copy()
        derivative[:, 6] *= share
        cols = np.column_stack([5 * (left + 1) + column, inputs])
        rows.add(cols, np.column_stack([np.ones(len(left)), -derivative]), -gaps[:, column])
    for pose, knot in ((0, 0), (-1, layout.num_knots - 1)) if has_ends else ():
        fixed = np.arange(3 if problem.trust[pose, 1] > 0.0 else 2)
        rows.add(5 * knot + fixed[:, None], np.ones((len(fixed), 1)), poses[pose, fixed] - knots[knot, fixed])
    if problem.alpha is None:
        rows.add(np.array([[3]]), np.ones((1, 1)), np.array([problem.initial_hitch - knots[0, 3]]))
    for before, after in layout.pose_knot[layout.pose_knot[:, 0] != layout.pose_knot[:, 1]]:
        cols = np.stack([5 * after + np.arange(4), 5 * before + np.arange(4)], axis=1)
        rows.add(cols, np.array([[1.0, -1.0]]), knots[before, :4] - knots[after, :4])
    return rows


def _add_bounds(rows: _Triplets, problem: FitProblem, bounds: Bounds, knots: Array, lengths: Array) -> None:
    """Rows that lead back to a bound, for each one that is broken now."""
    if bounds.limits:
        vehicle, left = problem.vehicle, problem.layout.left
        for column, limit in ((4, vehicle.max_steer), (3, vehicle.max_hitch)):
            excess = _excess(knots[:, column], limit)
            at = np.flatnonzero(excess)
            rows.add((5 * at + column)[:, None], np.full((len(at), 1), 1.0 / _SIGMA_BOUND), -excess[at] / _SIGMA_BOUND)
        ds = step_lengths(problem.layout, lengths)
        excess = _excess((knots[left + 1, 4] - knots[left, 4]) / ds, vehicle.max_steer_rate)
        at = np.flatnonzero(excess)
        cols = 5 * (left[at][:, None] + np.array([1, 0])) + 4
        rows.add(cols, np.array([1.0, -1.0]) / (ds[at] * _SIGMA_BOUND)[:, None], -excess[at] / _SIGMA_BOUND)
    if bounds.scene is not None:
        near = separations(bounds.scene, problem.vehicle, knots[:, :4], bounds.clearance, _MOST_NEAR)
        broken = near.distance < bounds.clearance
        cols = 5 * near.knot[broken][:, None] + np.arange(4)
        missing = bounds.clearance - near.distance[broken]
        rows.add(cols, near.gradient[broken] / _SIGMA_CLEAR, missing / _SIGMA_CLEAR)


def _excess(values: Array, limit: float) -> Array:
    """Excess of values over +-limit, with their sign; 0 within."""
    return values - np.clip(values, -limit * (1.0 - _INSIDE), limit * (1.0 - _INSIDE))
