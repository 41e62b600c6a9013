"""From the poses of a log to a path that the kinematics can drive.

A log holds poses: no steering angle, often no hitch angle, rounded or noisy numbers. The fit finds the steering
and the step lengths whose path stays closest to the poses,

    min  sum |p_k - p_log|^2 / sigma_position^2 + (theta_k - theta_log)^2 / sigma_heading^2
         [+ sum (alpha_k - alpha_log)^2 / sigma_heading^2] + int (d2phi/ds2)^2 ds / sigma_bend^2
    s.t. every step of the path follows the kinematics (Runge-Kutta of order four, phi linear),
         first and last pose are the log's,  neighbouring segments share pose and hitch angle,

by Gauss-Newton steps on the sparse optimality system. All states are unknowns (multiple shooting), so that
reverse segments, where a roll-out amplifies errors like exp(s / l_t), are as well conditioned as forward ones.
"""

from dataclasses import dataclass, field
from typing import NamedTuple

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from optim.arrays import Array, IntArray, frozen
from optim.path import Path, resample, segment_from_states
from optim.vehicle import Vehicle, rk4_step_jacobian, roll_out

_STEER_GUESS = 1.2  # [rad]: larger angles are no steering; keeps tan(phi) away from its pole
_ROOM = 0.9  # steps are laid out this much shorter than the spacing, since the fit may lengthen them
_LARGEST_STEP = 0.3  # [rad]: a Gauss-Newton step changes no steering angle by more


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
    """Expected size of d2phi/ds2 per square root of a metre [rad/m^2.5]."""
    max_iterations: int = 25
    """Gauss-Newton steps."""
    tolerance: float = 1e-9
    """The fit has converged when no unknown changes by more than this [m or rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """A drivable path and how far it is from the log."""

    path: Path
    pose_s: Array
    """Arc length of the path at each logged pose [m]. Shape (n,)."""
    position_error: Array
    """Distance from each logged position [m]. Shape (n,)."""
    heading_error: Array
    """Difference from each logged heading [rad]. Shape (n,)."""
    hitch_error: Array = field(default_factory=lambda: frozen([]))
    """Difference from each logged hitch angle [rad]. Shape (n,), or (0,) where the log has none."""
    converged: bool
    """False when the steps ran out: the path then breaks the kinematics by `defect`."""
    defect: float
    """Largest break of the kinematics over one step [m or rad]."""


class _Layout(NamedTuple):
    """Where the unknowns are: K knots with (x, y, theta, alpha, phi), then a length per logged interval."""

    pose_knot: IntArray  # (n, 2) knot of each logged pose: as end of what is before it, as start of what follows
    left: IntArray  # (M,) first knot of each step
    interval: IntArray  # (M,) logged interval of each step
    pieces: IntArray  # (n - 1,) steps of each logged interval
    direction: IntArray  # (M,)
    num_knots: int


def fit_path(
    vehicle: Vehicle,
    poses: Array,
    direction: IntArray,
    alpha: Array | None = None,
    initial_hitch: float = 0.0,
    options: FitOptions | None = None,
    sigma: Array | None = None,
) -> Fit:
    """The drivable path through logged poses.

    poses: (n, 3) x [m], y [m], heading [rad, unwrapped]; neighbours differ in position. direction: (n - 1,), the
    gear of each interval. alpha: (n,) logged hitch angles, or None; then the hitch angle is integrated from
    `initial_hitch`. sigma: (n, 2), expected errors of each position [m] and heading [rad], at least those of the
    options; where that of a heading is infinite, the heading is not known, at the ends neither.
    Raises ValueError for fewer than two poses or unequal lengths.
    """
    options = options or FitOptions()
    poses, direction = np.asarray(poses, float), np.asarray(direction, int)
    if len(poses) < 2 or direction.shape != (len(poses) - 1,):
        raise ValueError(f"fit: {len(poses)} poses and {len(direction)} gears, expected n >= 2 and n - 1")
    least = np.array([options.sigma_position, options.sigma_heading])
    trust = 1.0 / np.maximum(least, np.zeros((len(poses), 2)) if sigma is None else sigma)
    lengths = _arc_lengths(poses)
    layout = _layout(lengths, direction, options.spacing)
    knots = _first_guess(vehicle, poses, lengths, layout, alpha, initial_hitch)
    for _ in range(options.max_iterations):
        gaps, step = _gauss_newton(vehicle, poses, trust, alpha, initial_hitch, layout, knots, lengths, options)
        scale = min(1.0, _LARGEST_STEP / max(np.abs(step[: knots.size].reshape(-1, 5)[:, 4]).max(), 1e-12))
        knots = knots + scale * step[: knots.size].reshape(-1, 5)
        lengths = np.maximum(lengths + scale * step[knots.size :], 0.1 * lengths)
        if np.abs(step).max() <= options.tolerance:
            break
    gaps = _gaps(vehicle, layout, knots, lengths)[0]
    path, pose_s = _to_path(layout, knots, lengths)
    at_pose = knots[layout.pose_knot[:, 0]]
    return Fit(
        path=resample(vehicle, path, options.spacing),
        pose_s=frozen(pose_s),
        position_error=frozen(np.hypot(*(at_pose[:, :2] - poses[:, :2]).T)),
        heading_error=frozen(np.abs(at_pose[:, 2] - poses[:, 2])),
        hitch_error=frozen([] if alpha is None else np.abs(at_pose[:, 3] - alpha)),
        converged=bool(np.abs(gaps).max() <= 1e-7),
        defect=float(np.abs(gaps).max()),
    )


def _arc_lengths(poses: Array) -> Array:
    """Length of the circular arc between neighbouring poses [m]."""
    chord = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    half = np.minimum(np.abs(np.diff(poses[:, 2])) / 2.0, 1.5)
    return chord / np.sinc(half / np.pi)


def _layout(lengths: Array, direction: IntArray, spacing: float) -> _Layout:
    pieces = np.maximum(1, np.ceil(lengths / (_ROOM * spacing) - 1e-9).astype(int))
    cusp = np.concatenate([[False], np.diff(direction) != 0, [False]])
    # a cusp has two knots: steering may differ between what is before it and what follows
    before = np.concatenate([[0], np.cumsum(pieces)]) + np.concatenate([[0], np.cumsum(cusp)[:-1]])
    pose_knot = np.stack([before, before + cusp], axis=1)
    left = np.concatenate([np.arange(k, k + n) for k, n in zip(pose_knot[:-1, 1], pieces, strict=True)])
    interval = np.repeat(np.arange(len(pieces)), pieces)
    return _Layout(pose_knot, left, interval, pieces, direction[interval], int(pose_knot[-1, 1]) + 1)


def _first_guess(
    vehicle: Vehicle, poses: Array, lengths: Array, layout: _Layout, alpha: Array | None, initial_hitch: float
) -> Array:
    """Knots (K, 5): poses interpolated, steering from the turn of each interval, hitch logged or integrated."""
    knots = np.empty((layout.num_knots, 5))
    steer = np.arctan(
        vehicle.wheelbase * np.diff(poses[:, 2]) / lengths * layout.direction[np.cumsum(layout.pieces) - 1]
    )
    steer = np.clip(steer, -_STEER_GUESS, _STEER_GUESS)
    logged = poses if alpha is None else np.column_stack([poses, alpha])
    hitch = initial_hitch
    for k, n in enumerate(layout.pieces):
        first = layout.pose_knot[k, 1]
        share = np.linspace(0.0, 1.0, n + 1)[:, None]
        block = slice(first, first + n + 1)
        knots[block, : logged.shape[1]] = logged[k] + share * (logged[k + 1] - logged[k])
        knots[block, 4] = steer[k]
        if alpha is None:
            s, gear = share[:, 0] * lengths[k], int(layout.direction[layout.interval == k][0])
            state = np.array([*poses[k], hitch])
            knots[block, 3] = np.clip(roll_out(vehicle, state, s, np.full(n + 1, steer[k]), gear)[:, 3], -1.5, 1.5)
            hitch = float(knots[first + n, 3])
    return knots


def _gaps(vehicle: Vehicle, layout: _Layout, knots: Array, lengths: Array) -> tuple[Array, Array]:
    """Breaks of the kinematics over each step (M, 4), and the step's derivatives (M, 4, 7)."""
    ds = lengths[layout.interval] / layout.pieces[layout.interval]
    start, end = knots[layout.left], knots[layout.left + 1]
    reached, jacobian = rk4_step_jacobian(vehicle, start[:, :4], start[:, 4], end[:, 4], ds, layout.direction)
    return end[:, :4] - reached, jacobian


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
        where = (np.concatenate(self.rows), np.concatenate(self.cols))
        data = np.concatenate(self.values)
        return sparse.csc_matrix((data, where), shape=(self.count, width)), np.concatenate(self.right)


def _gauss_newton(
    vehicle: Vehicle,
    poses: Array,
    trust: Array,
    alpha: Array | None,
    initial_hitch: float,
    layout: _Layout,
    knots: Array,
    lengths: Array,
    options: FitOptions,
) -> tuple[Array, Array]:
    """Breaks of the kinematics now, and the step of all unknowns: knots (5 K), then lengths (n - 1)."""
    width = knots.size + len(lengths)
    gaps, jacobian = _gaps(vehicle, layout, knots, lengths)
    free, right = _residuals(poses, trust, alpha, layout, knots, lengths, options).matrix(width)
    hard, gap = _constraints(poses, trust, alpha, initial_hitch, layout, knots, gaps, jacobian).matrix(width)
    # the small diagonal blocks keep the factorisation sound where a direction carries no information
    normal = (free.T @ free + 1e-9 * sparse.identity(width)).tocsc()
    system = sparse.bmat([[normal, hard.T], [hard, -1e-12 * sparse.identity(len(gap))]], format="csc")
    step = splu(system).solve(np.concatenate([free.T @ right, gap]))[:width]
    return gaps, step


def _residuals(
    poses: Array, trust: Array, alpha: Array | None, layout: _Layout, knots: Array, lengths: Array, options: FitOptions
) -> _Triplets:
    """What is to become small: distance from the log, bend of the steering."""
    rows = _Triplets()
    at = layout.pose_knot[:, 0]
    logged = poses if alpha is None else np.column_stack([poses, alpha])
    for column in range(logged.shape[1]):
        weight = trust[:, 0] if column < 2 else trust[:, 1]
        misfit = weight * (logged[:, column] - knots[at, column])
        rows.add((5 * at + column)[:, None], weight[:, None], misfit)
    ds = lengths[layout.interval] / layout.pieces[layout.interval]
    inner = np.flatnonzero(np.diff(layout.left) == 1)  # pairs of steps within one segment
    h0, h1 = ds[inner], ds[inner + 1]
    weight = 1.0 / (options.sigma_bend * np.sqrt((h0 + h1) / 2.0))
    values = weight[:, None] * np.stack([1.0 / h0, -1.0 / h0 - 1.0 / h1, 1.0 / h1], axis=1)
    first = layout.left[inner]
    cols = 5 * (first[:, None] + np.arange(3)) + 4
    rows.add(cols, values, -np.sum(values * knots[first[:, None] + np.arange(3), 4], axis=1))
    return rows


def _constraints(
    poses: Array,
    trust: Array,
    alpha: Array | None,
    initial_hitch: float,
    layout: _Layout,
    knots: Array,
    gaps: Array,
    jacobian: Array,
) -> _Triplets:
    """What must hold: the kinematics, the ends, the shared poses at cusps."""
    rows = _Triplets()
    left, size = layout.left, knots.size
    share = 1.0 / layout.pieces[layout.interval]
    inputs = np.column_stack([5 * left[:, None] + np.arange(5), 5 * left + 9, size + layout.interval])
    for column in range(4):
        derivative = jacobian[:, column, :].copy()
        derivative[:, 6] *= share
        cols = np.column_stack([5 * (left + 1) + column, inputs])
        rows.add(cols, np.column_stack([np.ones(len(left)), -derivative]), -gaps[:, column])
    for pose, knot, known in ((0, 0, trust[0, 1]), (-1, layout.num_knots - 1, trust[-1, 1])):
        fixed = np.arange(3 if known > 0.0 else 2)
        rows.add(5 * knot + fixed[:, None], np.ones((len(fixed), 1)), poses[pose, fixed] - knots[knot, fixed])
    if alpha is None:
        rows.add(np.array([[3]]), np.ones((1, 1)), np.array([initial_hitch - knots[0, 3]]))
    for before, after in layout.pose_knot[layout.pose_knot[:, 0] != layout.pose_knot[:, 1]]:
        cols = np.stack([5 * after + np.arange(4), 5 * before + np.arange(4)], axis=1)
        rows.add(cols, np.array([[1.0, -1.0]]), knots[before, :4] - knots[after, :4])
    return rows


def _to_path(layout: _Layout, knots: Array, lengths: Array) -> tuple[Path, Array]:
    ds = lengths[layout.interval] / layout.pieces[layout.interval]
    breaks = np.flatnonzero(np.diff(layout.left) > 1) + 1
    segments = []
    for steps in np.split(np.arange(len(layout.left)), breaks):
        block = slice(layout.left[steps[0]], layout.left[steps[-1]] + 2)
        states = knots[block, :4].copy()
        if segments:
            states[0] = segments[-1].states[-1]  # equal up to rounding; shared exactly
        s = np.concatenate([[0.0], np.cumsum(ds[steps])])
        segments.append(segment_from_states(int(layout.direction[steps[0]]), s, states, knots[block, 4]))
    return Path(tuple(segments)), np.concatenate([[0.0], np.cumsum(lengths)])
