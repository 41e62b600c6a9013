"""From logged poses to the drivable path that is optimised: fitted, and led within the limits and clear of obstacles.

Noise takes a fitted path some centimetres aside, and a hitch angle that is integrated in reverse much farther. Where
it breaks a limit of the vehicle or overlaps an obstacle and another path, as near to the poses within their noise,
does not, that one is taken. Where none is, the path is left where the poses are, and the checks report it.
"""

import contextlib
from typing import NamedTuple

import numpy as np

from optim.fit.poses import Fit, fit_path
from optim.fit.system import Bounds, FitOptions
from optim.model.problem import path_clearance
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle
from optim.model.vehicle_limits import within_limits
from optim.numerics.arrays import Array
from replay.logs.meaning.planar import Refusal
from replay.logs.meaning.plausibility import LARGEST_DEFECT, LIMIT_SLACK
from replay.logs.meaning.recorded_poses import RecordedPoses

GIVEN_WAY = 0.02
"""A path may be moved by this [m] plus three standard deviations of the noise to keep limits and clearance."""
_TURNED_AWAY = 0.01  # the same of headings [rad]
_DEVIATIONS = 3.0
_SURE_HITCH = 0.02  # [rad]: a last hitch angle that is known better is not tried otherwise
_ROUGHLY = FitOptions(tolerance=1e-4)
_TRIED = 7  # last hitch angles on each side of the likeliest one
_NEARLY = 0.05  # [m]: an overlap that the truck's path, moved aside, may still take away
_DEEP = 0.5  # [m]: deeper overlaps do not show on which side of an obstacle the body was


def repaired(
    vehicle: Vehicle, scene: Scene, recorded: RecordedPoses, alpha: Array | None, initial_hitch: float
) -> tuple[Fit, list[str]]:
    """The drivable path through the poses, and notes. alpha: hitch angles at the poses (n,), or None.

    Raises:
        Refusal: E_KINEMATICS, where no fit can be made at all; the fit may still be far from the poses.
    """
    task = _Task(vehicle, scene, recorded, alpha, initial_hitch)
    first = task.fit()
    if first is None:
        raise Refusal("E_KINEMATICS", "no drivable path was found near its poses")
    notes: list[str] = []
    goal_hitch = None
    if alpha is None and task.overlap(first) > 0.0 and first.goal_hitch_sigma > _SURE_HITCH:
        first, notes = _with_a_hitch_that_is_free(task, first)
        goal_hitch = float(first.path.goal[3]) if notes else None
    second, more = _within_bounds(task, first, goal_hitch)
    return second, [*notes, *more]


class _Task(NamedTuple):
    """Input of the fits."""

    vehicle: Vehicle
    scene: Scene
    recorded: RecordedPoses
    alpha: Array | None
    initial_hitch: float

    def fit(
        self,
        bounds: Bounds | None = None,
        goal_hitch: float | None = None,
        start: Fit | None = None,
        options: FitOptions | None = None,
    ) -> Fit | None:
        """The nearest path that the fit finds; None where its systems are singular, or values leave every range."""
        with contextlib.suppress(ValueError, ArithmeticError, RuntimeError), np.errstate(all="ignore"):
            return fit_path(
                self.vehicle,
                self.recorded.poses,
                self.recorded.direction,
                self.alpha,
                self.initial_hitch,
                options,
                sigma=self.recorded.sigma,
                bounds=bounds,
                goal_hitch=goal_hitch,
                start=start,
            )
        return None

    def overlap(self, fit: Fit) -> float:
        """Overlap of a path with obstacles [m]; negative: its clearance."""
        return -path_clearance(self.vehicle, self.scene, fit.path)

    def other(
        self,
        first: Fit,
        bounds: Bounds | None = None,
        goal_hitch: float | None = None,
        options: FitOptions | None = None,
    ) -> Fit | None:
        """Another fit, begun with the first; None where there is none as near to the poses within their noise."""
        fit = self.fit(bounds, goal_hitch, first, options)
        return fit if fit is not None and self._is_near(fit, first) else None

    def _is_near(self, fit: Fit, first: Fit) -> bool:
        """True if a fit is drivable and as near to the poses as the first, within their noise."""
        noise = self.recorded.noise
        aside, turned = GIVEN_WAY + _DEVIATIONS * noise.position, _TURNED_AWAY + _DEVIATIONS * noise.heading
        if first.defect > LARGEST_DEFECT:  # it is not a path: any is better
            aside = turned = np.inf
        return bool(
            fit.defect <= LARGEST_DEFECT
            and fit.position_error.max() <= first.position_error.max() + aside
            and fit.heading_error.max() <= first.heading_error.max() + turned
            and (self.alpha is None or fit.hitch_error.max() <= first.hitch_error.max() + turned)
        )


def _with_a_hitch_that_is_free(task: _Task, first: Fit) -> tuple[Fit, list[str]]:
    """The path with the expected one of those last hitch angles, likely by the poses, that do not overlap anything.

    Where the trailer's path is not logged and the truck goes in reverse for long, the poses leave open how the trailer
    ends; that it stands on nothing is known of it all the same.
    """
    before, sigma = float(first.path.goal[3]), first.goal_hitch_sigma
    most = min(_DEVIATIONS * sigma, 2.0 * task.vehicle.max_hitch)
    tried = before + np.linspace(-most, most, 2 * _TRIED + 1)
    free: list[Fit] = []
    may_break = _breaks_limits(task.vehicle, first)
    for angle in tried[np.abs(tried) <= task.vehicle.max_hitch]:
        fit = task.other(first, goal_hitch=float(angle), options=_ROUGHLY)
        if fit is None or (_breaks_limits(task.vehicle, fit) and not may_break):
            continue
        if task.overlap(fit) <= _NEARLY:
            free.append(fit)
    if not free:
        return first, []
    angles = np.array([fit.path.goal[3] for fit in free])
    likely = np.exp(-0.5 * ((angles - before) / sigma) ** 2)
    best = free[int(np.argmin(np.abs(angles - np.sum(likely * angles) / likely.sum())))]
    best = task.other(best, goal_hitch=float(best.path.goal[3])) or best
    after = float(best.path.goal[3])
    text = (
        f"integrated from the poses alone, the trailer would overlap obstacles by {task.overlap(first):.2f} m and end "
        f"at a hitch angle of {before:.2f} rad; it is taken to end at {after:.2f} rad, where it is free"
    )
    return best, [text]


def _within_bounds(task: _Task, first: Fit, goal_hitch: float | None) -> tuple[Fit, list[str]]:
    """The path moved aside, within the noise of the poses, so that it keeps the limits and clear of obstacles."""
    breaks, overlap = _breaks_limits(task.vehicle, first), task.overlap(first)
    for limits, clear in ((breaks, overlap > 0.0), (False, True), (True, False)):
        if not (limits or clear) or (limits and not breaks) or (clear and not 0.0 < overlap <= _DEEP):
            continue
        second = task.other(first, Bounds(limits=limits, scene=task.scene if clear else None), goal_hitch)
        if second is None or (limits and _breaks_limits(task.vehicle, second)):
            continue
        if not clear or task.overlap(second) <= 0.0:
            return second, [_note(limits, overlap if clear else 0.0, first, second)]
    return first, []


def _breaks_limits(vehicle: Vehicle, fit: Fit) -> bool:
    return not within_limits(vehicle, fit.path, LIMIT_SLACK)


def _note(limits: bool, overlap: float, first: Fit, second: Fit) -> str:
    """Note on the second fit: its reason, and its distance from the poses."""
    kept = [*(["within the vehicle's limits"] if limits else [])]
    kept += [f"clear of obstacles, which it would overlap by up to {overlap:.3f} m"] if overlap > 0.0 else []
    off, before = second.position_error.max(), first.position_error.max()
    text = f"within the noise of its poses, the path is kept {' and '.join(kept)}"
    return f"{text}: it is {off:.3f} m from them at most, instead of {before:.3f} m"
