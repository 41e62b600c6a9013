"""Checks of a recorded path: refusals, and notes."""

from collections.abc import Callable
from typing import NamedTuple

import numpy as np

from optim.fit.poses import Fit
from optim.model.clearance import swept_clearance, witnesses
from optim.model.problem import Problem
from optim.numerics.arrays import Array
from replay.logs.meaning.planar import Refusal
from replay.logs.meaning.recorded_poses import RecordedPoses

LARGEST_DEFECT = 1e-4
"""Break of the kinematics over one step beyond which the fit is not a path [m or rad]; the audit's tolerance."""
NOTED_DEVIATION = 0.05
"""Distance of the fitted path from the log's poses from which a note names the place [m]."""
NOTED_TURN = 0.02
"""The same for headings and hitch angles [rad]."""
LARGEST_DEVIATION = 0.3
"""A drivable path farther from a pose than this [m], and five standard deviations of the noise, is another path."""
_UNSURE_HITCH = 0.02
"""Least standard deviation of the last hitch angle that gets a note [rad]."""
LIMIT_SLACK = 1e-3
"""Limits may be exceeded by this factor before a note says so, as in the audit."""
_PLACES = 11  # of a path that are tried for each pose
BODIES = ("truck", "trailer")
_ASK_REFERENCE = "are the poses those of the truck's rear axle (--reference), and is the wheelbase right?"


class Deviation(NamedTuple):
    """Deviation of a drivable path from the poses of a log: largest and root mean square over all of them."""

    largest: float  # [m]
    rms: float  # [m]
    largest_turn: float  # of the headings [rad]
    rms_turn: float  # [rad]


def check_fit(recorded: RecordedPoses, fit: Fit, sign_of: str = "") -> None:
    """Raise Refusal (E_KINEMATICS) if no drivable path was found near the poses.

    sign_of: what gave the hitch angles, if their sign is a matter of convention.
    """
    row = int(np.argmax(fit.position_error))
    off, most = float(fit.position_error[row]), LARGEST_DEVIATION + 5.0 * recorded.noise.position
    where = _place(recorded, fit, float(fit.pose_s[row]))
    if not fit.defect <= LARGEST_DEFECT:
        text = (
            f"no drivable path was found near its poses: the best one jumps by {fit.defect:.2g} (in m, or in rad) "
            f"between its samples, and is up to {off:.2f} m from them ({where})"
        )
        text += f"; {_ask_sign(sign_of) if sign_of else _ASK_REFERENCE}"
        raise Refusal("E_KINEMATICS", text)
    if not off <= most:
        text = (
            f"the drivable path nearest to its poses is {off:.2f} m from them ({where}), expected at most {most:.2g} m"
            f"; {_ask_sign(sign_of) if sign_of else _ASK_REFERENCE}"
        )
        raise Refusal("E_KINEMATICS", text)


def _ask_sign(source: str) -> str:
    return f"is the sign of {source} right, the trailer's heading minus the truck's?"


def check_ends(problem: Problem, hint: Callable[[Array], str], is_reconstructed: bool) -> None:
    """Raise Refusal (E_START_COLLISION, E_GOAL_COLLISION) if an end of the recorded path overlaps an obstacle.

    hint: called with a point of the obstacle; what a user may try, or an empty text. is_reconstructed: the hitch
    angle is integrated from an assumed one.
    """
    states = np.stack([problem.recorded.start, problem.recorded.goal])
    near = witnesses(problem.scene, problem.vehicle, states)
    for row, (code, name) in enumerate([("E_START_COLLISION", "first"), ("E_GOAL_COLLISION", "last")]):
        body = int(np.argmin(near.distance[row]))
        depth = -near.distance[row, body]
        if depth > 0.0:
            x, y = states[row, :2]
            at = near.on_obstacle[row, body]
            text = (
                f"at its {name} pose ({x:.2f}, {y:.2f}) m the {BODIES[body]} overlaps obstacle "
                f"{near.polygon[row, body]} at ({at[0]:.2f}, {at[1]:.2f}) m by {depth:.3f} m"
            )
            if is_reconstructed and body == 1:
                text += "; its hitch angle is integrated from `--initial-hitch`"
            raise Refusal(code, text + hint(at))


def deviation(plane: Array, recorded: RecordedPoses, fit: Fit) -> Deviation:
    """Deviation of the fitted path from all poses (m, 3) of the log: across it, at the nearest place.

    The place is sought between those of the neighbouring poses that the fit used.
    """
    samples, row, last = fit.path.samples, recorded.nearest, len(fit.pose_s) - 1
    low, high = fit.pose_s[np.maximum(row - 1, 0)], fit.pose_s[np.minimum(row + 1, last)]
    s = low[:, None] + np.linspace(0.0, 1.0, _PLACES) * (high - low)[:, None]
    x, y, theta = (np.interp(s, samples.s, samples.states[:, column]) for column in range(3))
    dx, dy = plane[:, :1] - x, plane[:, 1:2] - y
    best = np.argmin(dx * dx + dy * dy, axis=1)[:, None]
    dx, dy, theta = (np.take_along_axis(each, best, axis=1)[:, 0] for each in (dx, dy, theta))
    across = np.abs(np.cos(theta) * dy - np.sin(theta) * dx)
    turn = np.abs(np.mod(plane[:, 2] - theta + np.pi, 2.0 * np.pi) - np.pi)
    if not recorded.has_headings:
        turn = np.zeros(len(plane))
    if recorded.group is None:  # each pose has a place of its own
        across = np.concatenate([across, fit.position_error])
        turn = np.concatenate([turn, fit.heading_error])
    rms, rms_turn = (float(np.sqrt(np.mean(each**2))) for each in (across, turn))
    return Deviation(float(across.max()), rms, float(turn.max()), rms_turn)


def hitch_notes(problem: Problem, recorded: RecordedPoses, fit: Fit) -> list[str]:
    """Notes on the accuracy of an integrated hitch angle at the goal."""
    notes = []
    if not recorded.is_exact and fit.goal_hitch_sigma > _UNSURE_HITCH:
        notes.append(
            f"the hitch angle at the goal is known to within {fit.goal_hitch_sigma:.2f} rad (one standard deviation): "
            "it is integrated from noisy poses, and only a logged trailer path helps"
        )
    growth = -sum(part.direction * part.trailer_length for part in problem.recorded.segments)
    times = float(np.exp(min(growth / problem.vehicle.hitch_to_axle, 50.0)))
    if times > 1.0:
        notes.append(f"an error of the initial hitch angle (--initial-hitch) is {times:.3g} times as large at the goal")
    return notes


def check_recorded(
    problem: Problem, recorded: RecordedPoses, fit: Fit, alpha: Array | None, hint: Callable[[Array], str]
) -> list[str]:
    """One line for each thing that is wrong with a recorded path that can be used all the same.

    alpha: logged hitch angles at the poses (n,), or None. hint: as for `check_ends`.
    """
    notes = [
        *_deviations(recorded, fit),
        *_limits(problem, recorded, fit),
        *_collisions(problem, recorded, fit, hint),
    ]
    if alpha is None and np.abs(problem.recorded.samples.states[:, 3]).max() >= np.pi / 2.0:
        asked = f"is the initial hitch angle right? {_ASK_REFERENCE}"
        notes.append(f"the hitch angle that the motion asks for reaches 90 degrees; {asked}")
    return notes


def _place(recorded: RecordedPoses, fit: Fit, s: float) -> str:
    row = int(np.argmin(np.abs(fit.pose_s - s)))
    return f"at {s:.2f} m, pose {recorded.kept[row]}"


def _deviations(recorded: RecordedPoses, fit: Fit) -> list[str]:
    notes = []
    for errors, what, unit, limit in (
        (fit.position_error, "position", "m", NOTED_DEVIATION),
        (fit.heading_error, "heading", "rad", NOTED_TURN),
        (fit.hitch_error, "hitch angle", "rad", NOTED_TURN),
    ):
        if len(errors) and errors.max() > limit:
            row = int(np.argmax(errors))
            where = _place(recorded, fit, float(fit.pose_s[row]))
            notes.append(f"the drivable path differs from the log in {what} by {errors[row]:.3f} {unit} ({where})")
    return notes


def _limits(problem: Problem, recorded: RecordedPoses, fit: Fit) -> list[str]:
    samples, vehicle = problem.recorded.samples, problem.vehicle
    ds = np.diff(samples.s)
    same = (np.diff(samples.segment) == 0) & (ds > 0.0)
    rate = np.where(same, np.abs(np.diff(samples.phi)) / np.where(same, ds, 1.0), 0.0)
    notes = []
    for values, limit, what, unit in (
        (np.abs(samples.phi), vehicle.max_steer, "the steering angle", "rad"),
        (np.abs(samples.states[:, 3]), vehicle.max_hitch, "the hitch angle", "rad"),
        (rate, vehicle.max_steer_rate, "the steering rate", "rad/m"),
    ):
        worst = int(np.argmax(values))
        if values[worst] > limit * (1.0 + LIMIT_SLACK):
            where = _place(recorded, fit, float(samples.s[worst]))
            notes.append(f"{what} reaches {values[worst]:.3f} {unit}, the limit is {limit:g} {unit} ({where})")
    return notes


def _collisions(problem: Problem, recorded: RecordedPoses, fit: Fit, hint: Callable[[Array], str]) -> list[str]:
    """Notes on obstacles in the way of the recorded path or too near to it, also between its samples."""
    if problem.recorded_clearance >= problem.margin:
        return []
    at, least, body = _least_swept(problem)
    where = _place(recorded, fit, at)
    near = witnesses(problem.scene, problem.vehicle, problem.recorded.samples.states)
    overlaps = near.distance.min(axis=1) < 0.0
    if overlaps.any():
        share = f"{100.0 * np.mean(overlaps):.0f} % of its way"
        row, worst = np.unravel_index(int(np.argmin(near.distance)), near.distance.shape)
        text = f"the recorded path overlaps obstacles on {share}, the {body} by {-least:.3f} m ({where})"
        return [text + hint(near.on_obstacle[row, worst])]
    if least < 0.0:
        text = f"between its samples the recorded path's {body} may touch an obstacle by {-least:.3f} m ({where})"
        return [text]
    close = f"comes within {least:.3f} m of an obstacle, the margin is {problem.margin:g} m"
    return [f"the recorded path's {body} {close} ({where})"]


def _least_swept(problem: Problem) -> tuple[float, float, str]:
    """Arc length [m] at which the recorded path's swept clearance is least, that clearance [m], and the body."""
    found = []
    start = 0.0
    for segment in problem.recorded.segments:
        swept = swept_clearance(problem.scene, problem.vehicle, segment.s, segment.states, segment.phi)
        row, body = np.unravel_index(int(np.argmin(swept)), swept.shape)
        found.append((float(swept[row, body]), start + float(segment.s[row]), BODIES[body]))
        start += segment.length
    least, at, body = min(found)
    return at, least, body
