"""Preparation of one path message for the fit: poses in the plane, distinct, with headings and gears."""

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from optim.numerics.arrays import Array, IntArray, frozen, frozen_int
from replay.logs.meaning.continuity import check_steps, jumps
from replay.logs.meaning.noisy_motion import (
    NO_NOISE,
    SURE,
    Noise,
    group_length,
    groups,
    heading_from_motion,
    headings_along,
    noise_of,
    rough_chain,
    signed_travel,
    turning_points,
)
from replay.logs.meaning.planar import Refusal, planar
from replay.logs.messages.types import PoseSeries

LARGEST_COORDINATE = 1e6
"""Poses farther than this from the map are rejected [m]."""
SMALLEST_STEP = 0.005
"""Poses nearer to the one before are repetitions of it [m]: below it, noise decides about direction and gear."""
THINNED_TO = 0.1
"""Poses nearer to each other are thinned out to about this distance [m]: that of the fitted path's samples."""
SHORTEST_GEAR = 0.02
"""Travel below which a change of gear is noise [m]."""
QUIET = Noise(position=0.0025, heading=0.0025)
"""Poses with less noise [m, rad] are used one by one: motion alone looks like that much where they are 1 m apart."""
LARGEST_NOISE = 0.15
"""Standard deviation of positions beyond which there is nothing to repair [m]."""
LARGEST_SLIP = np.radians(15.0)
"""Median angle between heading and motion beyond which the headings cannot be headings [rad]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class RecordedPoses:
    """Distinct poses of a path. n >= 2."""

    poses: Array
    """x, y [m], heading [rad, unwrapped]. Shape (n, 3)."""
    direction: IntArray
    """Gear of each interval, 1 or -1. Shape (n - 1,)."""
    kept: IntArray
    """Index of each pose in the message. Shape (n,)."""
    nearest: IntArray
    """For each pose of the message, the row of `poses` that stands for it. Shape (num_poses,)."""
    notes: tuple[str, ...]
    noise: Noise = NO_NOISE
    """Noise of the poses of the message."""
    group: IntArray | None = None
    """For each pose of the message, the row that it is averaged into, -1 for none; None: nothing is averaged."""
    has_headings: bool = True
    """False where the headings are taken from the motion."""

    @property
    def is_exact(self) -> bool:
        """True if the noise of the poses is negligible."""
        return self.noise.position <= QUIET.position and self.noise.heading <= QUIET.heading

    def averaged(self, values: Array) -> Array:
        """Values of each pose, averaged as the poses are except at the ends: from (num_poses, k) to (n, k)."""
        if self.group is None:
            return values[self.kept]
        return _averaged(values, self.group)

    @property
    def sigma(self) -> Array:
        """Expected errors of position [m] and heading [rad] of each row of `poses`, infinite if unknown; (n, 2)."""
        count = np.ones(len(self.poses))
        if self.group is not None:
            count = np.bincount(self.group[self.group >= 0]).astype(float)
            count[[0, -1]] = 1.0
        heading = self.noise.heading if self.has_headings else np.inf
        return np.array([self.noise.position, heading]) / np.sqrt(count)[:, None]


def to_plane(series: PoseSeries, centre: Array) -> tuple[Array, list[str]]:
    """x, y [m], yaw [rad] of every pose, shape (m, 3), and notes. `centre`: a point of the map [m].

    Raises:
        Refusal: no poses, not finite, not planar, too far away, or stamps that run backwards.
    """
    if len(series.poses) == 0:
        raise Refusal("E_PATH_EMPTY", "it has no poses")
    poses, notes = planar(series.poses, "pose")
    far = np.abs(poses[:, :2] - centre).max(axis=1)
    if far.max() > LARGEST_COORDINATE:
        row = int(np.argmax(far))
        text = f"pose {row} is at ({poses[row, 0]:.6g}, {poses[row, 1]:.6g}) m, {far[row]:.3g} m from the map"
        raise Refusal("E_RANGE", text)
    back = np.flatnonzero(np.diff(series.stamps) < 0)
    if len(back):
        raise Refusal("E_TIME_ORDER", f"the stamp of pose {back[0] + 1} is earlier than that of pose {back[0]}")
    return poses, notes


def recorded_poses(plane: Array, start_direction: int) -> RecordedPoses:
    """Distinct poses with unwrapped headings and gears, from the poses (m, 3) of `to_plane`.

    Raises:
        Refusal: fewer than two distinct poses, a jump, headings that do not fit the motion.
    """
    if len(plane) < 2:
        raise Refusal("E_PATH_SHORT", "it has one pose, expected a path")
    gaps = check_steps(plane)
    noise = noise_of(plane)
    if noise.position > QUIET.position or noise.heading > QUIET.heading:
        return _averaged_poses(plane, noise, start_direction, gaps)
    kept, nearest = _distinct(plane[:, :2])
    if len(kept) < 2:
        raise Refusal(
            "E_PATH_ZERO_LENGTH",
            f"its {len(plane)} poses are all at ({plane[0, 0]:.2f}, {plane[0, 1]:.2f}) m",
        )
    notes = gaps
    merged = len(plane) - len(kept)
    if merged:
        notes.append(f"{merged} of {len(plane)} poses repeat the one before and are merged with it")
    poses = plane[kept].copy()
    is_missing = headings_missing(poses)
    if is_missing:
        poses[:, 2] = heading_from_motion(poses[:, :2], start_direction)
        notes.append(_headings_note(start_direction))
    poses[:, 2] = np.unwrap(poses[:, 2])
    _check_headings(poses)
    direction, smoothed = _gears(poses)
    if smoothed:
        notes.append(f"{smoothed} changes of gear within {SHORTEST_GEAR:g} m of travel are taken for noise")
    rows = _thinned(poses, direction)
    if len(rows) < len(poses):
        notes.append(f"its {len(poses)} poses are closer than {THINNED_TO:g} m; {len(rows)} of them are used")
        nearest = nearest_row(poses, rows)[nearest]
        poses, kept, direction = poses[rows], kept[rows], direction[rows[:-1]]
    notes += [] if is_missing else jumps(poses, kept, noise)
    return RecordedPoses(
        poses=frozen(poses),
        direction=frozen_int(direction),
        kept=frozen_int(kept),
        nearest=frozen_int(nearest),
        notes=tuple(notes),
        has_headings=not is_missing,
    )


def _averaged_poses(plane: Array, noise: Noise, start_direction: int, gaps: list[str]) -> RecordedPoses:
    """`recorded_poses` where noise would decide about gears and steering: means of groups of neighbours.

    The first and the last pose stay as they are.
    """
    if noise.position > LARGEST_NOISE:
        found, most = 100.0 * noise.position, 100.0 * LARGEST_NOISE
        raise Refusal("E_KINEMATICS", f"its poses have noise of {found:.0f} cm, expected at most {most:.0f} cm")
    poses, chain = plane.copy(), rough_chain(plane[:, :2], noise.position)
    if len(chain) < 2:
        at = f"({plane[0, 0]:.2f}, {plane[0, 1]:.2f}) m"
        raise Refusal("E_PATH_ZERO_LENGTH", f"its {len(plane)} poses are all at {at} within their noise")
    is_missing = headings_missing(poses)
    if is_missing:
        rough = np.unwrap(heading_from_motion(poses[chain, :2], start_direction))
        poses[:, 2] = np.interp(np.arange(len(poses)), chain, rough)
    poses[:, 2] = np.unwrap(poses[:, 2])
    _check_headings(poses[chain])
    travel = signed_travel(poses)
    turns, gear = turning_points(travel, max(SHORTEST_GEAR, SURE * noise.position))
    length = group_length(travel, noise)
    group, direction = groups(travel, turns, gear, length, noise.position)
    used = _averaged(poses, group)
    if is_missing:
        used[:, 2] = np.unwrap(headings_along(used[:, :2], direction))
    degrees = "" if is_missing else f" and {np.degrees(noise.heading):.2f} degrees"
    text = f"its poses have noise of {100.0 * noise.position:.1f} cm{degrees}"
    if len(used) < len(poses):
        text += f"; {len(poses)} of them are averaged over up to {length:.2f} m to {len(used)}"
    members = [np.flatnonzero(group == row) for row in range(len(used))]
    kept = np.array([0, *(rows[len(rows) // 2] for rows in members[1:-1]), len(poses) - 1])
    notes = [_headings_note(start_direction)] if is_missing else jumps(used, kept, noise)
    return RecordedPoses(
        poses=frozen(used),
        direction=frozen_int(direction),
        kept=frozen_int(kept),
        nearest=frozen_int(np.searchsorted((kept[1:] + kept[:-1]) / 2.0, np.arange(len(poses)))),
        notes=(*gaps, *notes, text),
        noise=noise,
        group=frozen_int(group),
        has_headings=not is_missing,
    )


def _averaged(values: Array, group: IntArray) -> Array:
    """Means of rows by their group; of the first and the last group, the first and the last row."""
    inside = group >= 0
    count = np.bincount(group[inside])
    means = np.stack([np.bincount(group[inside], column) / count for column in values[inside].T], axis=1)
    means[0], means[-1] = values[0], values[-1]
    return means


def _headings_note(start_direction: int) -> str:
    gear = "forward" if start_direction == 1 else "in reverse"
    return f"all headings are equal; they are taken from the motion, which starts {gear} (--start-direction)"


def _distinct(xy: Array) -> tuple[IntArray, IntArray]:
    """Indices of the poses to keep, the first and the last among them, and for every pose the row that it became."""
    kept = [0]
    nearest = np.zeros(len(xy), np.int64)
    x, y = xy.T.tolist()
    for i in range(1, len(xy)):
        dx, dy = x[i] - x[kept[-1]], y[i] - y[kept[-1]]
        if dx * dx + dy * dy >= SMALLEST_STEP**2:
            kept.append(i)
        nearest[i] = len(kept) - 1
    last = len(xy) - 1
    if kept[-1] != last and len(kept) > 1:
        kept[-1] = last  # the goal is kept exactly
        if np.hypot(*(xy[last] - xy[kept[-2]])) < 1e-6:
            kept.pop(-2 if len(kept) > 2 else -1)
            nearest = np.minimum(nearest, len(kept) - 1)
    return np.array(kept), nearest


def headings_missing(poses: Array) -> bool:
    """True if all headings are equal although the path turns, or runs across them."""
    if np.ptp(poses[:, 2]) > 1e-9:
        return False
    dx, dy = np.diff(poses[:, :2], axis=0).T
    across = -np.sin(poses[0, 2]) * dx + np.cos(poses[0, 2]) * dy
    return bool((np.abs(across) > np.sin(np.radians(5.0)) * np.hypot(dx, dy)).any())


def _motion(poses: Array) -> tuple[Array, Array]:
    """Length of each interval, and the angle of its motion against the mean heading in (-pi, pi]."""
    delta = np.diff(poses[:, :2], axis=0)
    middle = (poses[1:, 2] + poses[:-1, 2]) / 2.0
    angle = np.arctan2(delta[:, 1], delta[:, 0]) - middle
    return np.hypot(*delta.T), np.arctan2(np.sin(angle), np.cos(angle))


def _check_headings(poses: Array) -> None:
    length, angle = _motion(poses)
    sure = length > 2.0 * SMALLEST_STEP
    if not sure.any():
        return
    slip = np.arctan(np.tan(angle[sure]))  # against the axis of the truck, whatever the gear
    median = float(np.median(np.abs(slip)))
    if median <= LARGEST_SLIP:
        return
    degrees = f"{np.degrees(median):.0f} degrees"
    if np.percentile(np.abs(slip), 90) - np.percentile(np.abs(slip), 10) < np.radians(10.0):
        raise Refusal("E_KINEMATICS", f"its headings are {degrees} off the direction of motion throughout")
    step = float(np.median(length[sure]))
    text = f"its headings are {degrees} off the direction of motion (median, steps of {step:.2g} m)"
    raise Refusal("E_PATH_HEADING", f"{text}: are they in radians, or do the positions jitter as much as they move?")


def _gears(poses: Array) -> tuple[IntArray, int]:
    """Gear of each interval, and how many stretches too short for one were given their neighbours'."""
    length, angle = _motion(poses)
    direction = np.where(np.abs(angle) <= np.pi / 2.0, 1, -1)
    smoothed = 0
    while True:
        edges = np.flatnonzero(np.diff(direction)) + 1
        starts, stops = np.concatenate([[0], edges]), np.concatenate([edges, [len(direction)]])
        travel = np.add.reduceat(length, starts)
        shortest = int(np.argmin(travel))
        if len(travel) == 1 or travel[shortest] >= SHORTEST_GEAR:
            return direction, smoothed
        direction[starts[shortest] : stops[shortest]] *= -1
        smoothed += 1


def _thinned(poses: Array, direction: IntArray) -> IntArray:
    """Rows to keep so that few are nearer than `THINNED_TO`; the ends and every change of gear are among them."""
    length, angle = _motion(poses)
    # less where it goes against the gear, as jitter at standstill does: such a row would lie behind the one before
    s = np.concatenate([[0.0], np.cumsum(np.where(np.abs(angle) <= np.pi / 2.0, length, -length) * direction)])
    edges = np.flatnonzero(np.diff(direction)) + 1
    rows = [0]
    for end in (*edges.tolist(), len(poses) - 1):
        start = rows[-1]
        for row in range(start + 1, end):
            # not nearer than that to the one before, and not much nearer than that to the end of the gear
            if s[row] - s[rows[-1]] >= 0.999 * THINNED_TO and s[end] - s[row] >= 0.5 * THINNED_TO:
                rows.append(row)
        rows.append(end)
    return np.array(rows)


def _travel(poses: Array) -> Array:
    return np.concatenate([[0.0], np.cumsum(np.hypot(*np.diff(poses[:, :2], axis=0).T))])


def nearest_row(poses: Array, rows: IntArray) -> IntArray:
    """For every pose, which of the kept rows is nearest along the path."""
    s = _travel(poses)
    return np.searchsorted((s[rows[1:]] + s[rows[:-1]]) / 2.0, s)


def kept_indices(recorded: RecordedPoses, indices: NDArray[np.int64]) -> IntArray:
    """Rows of `recorded.poses` for indices into the message, without repetition."""
    return np.unique(recorded.nearest[indices])
