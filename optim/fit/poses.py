"""From the poses of a log to a path that the kinematics can drive.

A log holds poses: no steering angle, often no hitch angle, rounded or noisy numbers. The fit finds the steering
and the step lengths whose path stays closest to the poses,

    min  sum |p_k - p_log|^2 / sigma_position^2 + (theta_k - theta_log)^2 / sigma_heading^2
         [+ sum (alpha_k - alpha_log)^2 / sigma_heading^2] + int (d2phi/ds2)^2 ds / sigma_bend^2
    s.t. every step of the path follows the kinematics (Runge-Kutta of order four, phi linear),
         first and last pose are the log's,  neighbouring segments share pose and hitch angle,

by Gauss-Newton steps on the sparse optimality system. All states are unknowns (multiple shooting), so that
reverse segments, where a roll-out amplifies errors like exp(s / l_t), are as well conditioned as forward ones.

Within `Bounds`, the vehicle's limits and obstacles are kept too: what breaks one adds the square of its break over
a small tolerance to the sum. A second fit from the end of a first one, `start`, is the way to them.
"""

from dataclasses import dataclass, field

import numpy as np

from optim.fit.system import (
    Bounds,
    FitOptions,
    FitProblem,
    Layout,
    gaps_of,
    gauss_newton,
    goal_hitch_sigma,
    step_lengths,
)
from optim.model.kinematics import roll_out
from optim.model.path import Path, resample, segment_from_states
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64, IntArray, frozen

_STEER_GUESS = 1.2  # [rad]: larger angles are not steering; keeps tan(phi) away from its pole
_ROOM = 0.9  # steps are laid out this much shorter than the spacing, since the fit may lengthen them
_LARGEST_STEP = 0.3  # [rad]: a Gauss-Newton step changes no steering angle by more
_HITCH_GUESS = 1.5  # [rad]: integrated from noisy poses in reverse, the hitch angle runs away
_WIDEST_TURN = 1.5  # [rad], half a turn between two poses: more is not an arc, and the length must stay finite
_SHRINK = 0.1  # a Gauss-Newton step leaves at least this share of each length
_CLOSED = 1e-7  # largest break of the kinematics of a fit that has converged [m or rad]
_LONGEST = 10.0  # times the arc between two poses: what diverges stays of a size that can be sampled


@dataclass(frozen=True, eq=False, kw_only=True)
class Fit:
    """A drivable path and how far it is from the log."""

    path: Path
    pose_s: Float64[Array, " n"]
    """Arc length of the path at each logged pose [m]. Shape (n,)."""
    position_error: Float64[Array, " n"]
    """Distance from each logged position [m]. Shape (n,)."""
    heading_error: Float64[Array, " n"]
    """Difference from each logged heading [rad]. Shape (n,)."""
    hitch_error: Float64[Array, " _"] = field(default_factory=lambda: frozen([]))
    """Difference from each logged hitch angle [rad]. Shape (n,), or (0,) where the log has none."""
    converged: bool
    """False when the steps ran out: the path then breaks the kinematics by `defect`."""
    defect: float
    """Largest break of the kinematics over one step [m or rad]."""
    goal_hitch_sigma: float
    """Standard deviation of the last hitch angle, from the expected errors of the poses [rad]."""
    knots: Float64[Array, "K 5"]
    """x, y, theta, alpha, phi where the fit has them; for a second fit. Shape (K, 5)."""
    lengths: Float64[Array, " _"]
    """Length of the path between neighbouring poses [m]. Shape (n - 1,)."""


def fit_path(
    vehicle: Vehicle,
    poses: Array,
    direction: IntArray,
    alpha: Array | None = None,
    initial_hitch: float = 0.0,
    options: FitOptions | None = None,
    *,
    sigma: Array | None = None,
    bounds: Bounds | None = None,
    goal_hitch: float | None = None,
    start: Fit | None = None,
) -> Fit:
    """The drivable path through logged poses.

    Args:
        poses: x [m], y [m], heading [rad, unwrapped]; neighbours differ in position. Shape (n, 3).
        direction: the gear of each interval, 1 or -1. Shape (n - 1,).
        alpha: logged hitch angles [rad], shape (n,), or None: then integrated from `initial_hitch` [rad].
        sigma: expected errors of each position [m] and heading [rad], at least those of the options; where that of
            a heading is infinite, the heading is not known, at the ends neither. Shape (n, 2).
        bounds: constraints beyond the kinematics.
        goal_hitch: the hitch angle [rad] with which it is to end, however little the poses say of it.
        start: an earlier fit of the same poses to begin with.

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
    problem = FitProblem(vehicle, poses, trust, alpha, initial_hitch, layout, options, bounds, goal_hitch)
    if start is None:
        knots = _first_guess(vehicle, poses, lengths, layout, alpha, initial_hitch)
    else:
        # hitch angles that have run away lead nowhere; the gaps that this opens are closed again
        knots, lengths = start.knots.copy(), start.lengths
        knots[:, 3] = np.clip(knots[:, 3], -vehicle.max_hitch, vehicle.max_hitch)
    knots, lengths = _descend(problem, knots, lengths)
    defect = float(np.abs(gaps_of(problem, knots, lengths)[0]).max())
    path, pose_s = _to_path(layout, knots, lengths)
    at_pose = knots[layout.pose_knot[:, 0]]
    return Fit(
        path=resample(vehicle, path, options.spacing),
        pose_s=frozen(pose_s),
        position_error=frozen(np.hypot(*(at_pose[:, :2] - poses[:, :2]).T)),
        heading_error=frozen(np.where(trust[:, 1] > 0.0, np.abs(at_pose[:, 2] - poses[:, 2]), 0.0)),
        hitch_error=frozen([] if alpha is None else np.abs(at_pose[:, 3] - alpha)),
        converged=defect <= _CLOSED,
        defect=defect,
        goal_hitch_sigma=goal_hitch_sigma(problem, knots, lengths),
        knots=frozen(knots),
        lengths=frozen(lengths),
    )


def _descend(problem: FitProblem, knots: Array, lengths: Array) -> tuple[Array, Array]:
    """Gauss-Newton steps from these knots (K, 5) and lengths (n - 1,) on."""
    size, options, longest = knots.size, problem.options, _LONGEST * _arc_lengths(problem.poses)
    for _ in range(options.max_iterations if problem.bounds is None else options.max_bounded):
        step = gauss_newton(problem, knots, lengths)
        change = step[:size].reshape(-1, 5)
        scale = min(1.0, _LARGEST_STEP / max(np.abs(change[:, 4]).max(), 1e-12))
        knots = knots + scale * change
        lengths = np.clip(lengths + scale * step[size:], _SHRINK * lengths, longest)
        if np.abs(step).max() <= options.tolerance:
            break
    return knots, lengths


def _arc_lengths(poses: Array) -> Array:
    """Length of the circular arc between neighbouring poses [m]."""
    chord = np.hypot(*np.diff(poses[:, :2], axis=0).T)
    half = np.minimum(np.abs(np.diff(poses[:, 2])) / 2.0, _WIDEST_TURN)
    return chord / np.sinc(half / np.pi)


def _layout(lengths: Array, direction: IntArray, spacing: float) -> Layout:
    pieces = np.maximum(1, np.ceil(lengths / (_ROOM * spacing) - 1e-9).astype(int))
    cusp = np.concatenate([[False], np.diff(direction) != 0, [False]])
    # a cusp has two knots: steering may differ between what is before it and what follows
    before = np.concatenate([[0], np.cumsum(pieces)]) + np.concatenate([[0], np.cumsum(cusp)[:-1]])
    pose_knot = np.stack([before, before + cusp], axis=1)
    left = np.concatenate([np.arange(k, k + n) for k, n in zip(pose_knot[:-1, 1], pieces, strict=True)])
    interval = np.repeat(np.arange(len(pieces)), pieces)
    return Layout(pose_knot, left, interval, pieces, direction[interval], int(pose_knot[-1, 1]) + 1)


def _first_guess(
    vehicle: Vehicle, poses: Array, lengths: Array, layout: Layout, alpha: Array | None, initial_hitch: float
) -> Array:
    """Knots (K, 5): poses interpolated, steering from the turn of each interval, hitch logged or integrated."""
    knots = np.empty((layout.num_knots, 5))
    gears = layout.direction[np.cumsum(layout.pieces) - 1]  # of each interval between poses
    steer = np.arctan(vehicle.wheelbase * np.diff(poses[:, 2]) / lengths * gears)
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
            s, state = share[:, 0] * lengths[k], np.array([*poses[k], hitch])
            driven = roll_out(vehicle, state, s, np.full(n + 1, steer[k]), int(gears[k]))
            knots[block, 3] = np.clip(driven[:, 3], -_HITCH_GUESS, _HITCH_GUESS)
            hitch = float(knots[first + n, 3])
    return knots


def _to_path(layout: Layout, knots: Array, lengths: Array) -> tuple[Path, Array]:
    ds = step_lengths(layout, lengths)
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
