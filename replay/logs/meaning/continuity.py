"""Gaps and jumps of a path: which are bridged, which get a note, which are refused."""

import numpy as np

from optim.numerics.arrays import Array, IntArray
from replay.logs.meaning.noisy_motion import Noise, sideways
from replay.logs.meaning.planar import Refusal

LARGEST_STEP = 2.0
"""Distance between neighbouring poses beyond which poses are missing [m]."""
LARGEST_GAP = 5.0
"""Distance over which missing poses are bridged [m], where the headings at both ends point along it."""
LARGEST_JUMP = 0.5
"""Distance sideways from pose to pose, against their headings, beyond which nothing drives there [m]."""
NOTED_JUMP = 0.15
"""The least that gets a note [m]."""
_ALONG = 0.2  # angle between the headings beside a gap and the way over it, at most [rad]
_TURN, _TURN_RATE = 0.05, 0.17  # change of heading over a gap, at most [rad], [rad/m]: that of the tightest turn
_NOISY = 6.0  # standard deviations of the noise that do not count as a jump
_STEERED = 0.016  # [1/m^2]: steering as fast as trucks can leads aside from an arc by that times the length cubed


def check_steps(plane: Array) -> list[str]:
    """A note on each gap between the poses (m, 3) that can be bridged.

    Raises:
        Refusal: E_PATH_DISCONTINUOUS, for a jump, or a gap that is too long; E_RANGE, if all are far apart.
    """
    steps = np.hypot(*np.diff(plane[:, :2], axis=0).T)
    notes = []
    for row in np.flatnonzero(steps > LARGEST_STEP):
        median = float(np.median(steps))
        if median > LARGEST_STEP:
            text = f"neighbouring poses are {median:.4g} m apart, expected at most {LARGEST_STEP:g}: are these metres?"
            raise Refusal("E_RANGE", text)
        here, there = plane[row, :2], plane[row + 1, :2]
        between = (
            f"{steps[row]:.4g} m from pose {row} at ({here[0]:.2f}, {here[1]:.2f}) m to pose {row + 1} at "
            f"({there[0]:.2f}, {there[1]:.2f}) m"
        )
        if not _is_gap(plane, int(row), float(steps[row])):
            raise Refusal("E_PATH_DISCONTINUOUS", f"it jumps by {between}, expected at most {LARGEST_STEP:g} m")
        notes.append(f"it has no poses for {between}; the way between them is the smoothest one")
    return notes


def _is_gap(plane: Array, row: int, step: float) -> bool:
    """True if a truck may have driven from a pose to the next one, `step` [m] away, without much steering."""
    if step > LARGEST_GAP or np.ptp(plane[:, 2]) <= 1e-9:
        return False
    way = np.arctan2(*(plane[row + 1, :2] - plane[row, :2])[::-1])
    turn = abs(np.arctan2(np.sin(plane[row + 1, 2] - plane[row, 2]), np.cos(plane[row + 1, 2] - plane[row, 2])))
    # against the axis of the truck, whatever the gear; both ends of an arc differ from its chord alike
    first, second = (np.sin(way - plane[k, 2]) for k in (row, row + 1))
    return bool(abs(first + second) / 2.0 <= np.sin(_ALONG) and turn <= _TURN + _TURN_RATE * step)


def jumps(poses: Array, kept: IntArray, noise: Noise) -> list[str]:
    """A note on each jump sideways between poses (n, 3); kept: their indices in the message (n,).

    Raises:
        Refusal: E_KINEMATICS, where one is too large to be repaired.
    """
    aside, steps = sideways(poses), np.hypot(*np.diff(poses[:, :2], axis=0).T)
    s = np.concatenate([[0.0], np.cumsum(steps)])
    least = _NOISY * noise.position + 2.0 * noise.heading * steps + _STEERED * steps**3
    notes = []
    for row in np.flatnonzero(aside > NOTED_JUMP + least):
        x, y = poses[row, :2]
        text = (
            f"it jumps sideways by {aside[row]:.2f} m from pose {kept[row]} at ({x:.2f}, {y:.2f}) m, {s[row]:.2f} m "
            f"from the start, to pose {kept[row + 1]}"
        )
        if aside[row] > LARGEST_JUMP + least[row]:
            raise Refusal("E_KINEMATICS", f"{text}, expected at most {LARGEST_JUMP:g} m")
        notes.append(text)
    return notes
