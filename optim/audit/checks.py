"""The independent check of a path: plain data in (as in `replay.results/1`), named checks with numbers out.

It shares nothing with the methods: own integrator, own footprints, own objective, and `shapely` for distances
(`optim.audit.motion` has the bound for what happens between samples, and its proof). It never raises for what a
document holds: what is missing, of the wrong type or not a number is rejected by a check that says so. Where
that leaves other checks without sense they are absent, and the report is not complete and has not passed.

structure   everything is there, of the right type and shape; gears are 1 or -1; polygons simple, with area
finite      every number is one
spacing     s starts at 0 in each segment and increases, in steps of at most 0.1 m
joints      neighbouring segments share position, heading and hitch angle exactly; the steering may jump there
start       equals the recorded start exactly
goal        within 1 cm and 0.1 deg of the recorded one; heading modulo full turns, hitch angle never modulo
defect      each interval, re-integrated from its stored start, ends within 1e-4 m and rad of its stored end
defect_sum  these defects sum up to at most 10 mm, 10 mrad of heading and 10 mrad of hitch angle
steer, hitch, steer_rate   within the limits relaxed by 0.1 %; the hitch angle between samples too
clearance   the area swept by each body, between samples too, keeps off every polygon
boundary    and lies within the map's outline, where there is one
objective   J recomputed from the samples agrees with the reported one to 1e-6 relative

A free roll-out over a whole segment is not a check: in reverse errors grow like exp(s / l_t), 43-fold over 30 m.
"""

import math
import sys
from collections.abc import Callable, Container, Mapping
from dataclasses import dataclass, replace
from types import MappingProxyType
from typing import Any, NamedTuple

import numpy as np

from optim.audit.data import (
    WEIGHTS,
    Array,
    Float64,
    PathData,
    Unreadable,
    VehicleData,
    read_path,
    read_scene,
    read_vehicle,
    read_weights,
)
from optim.audit.motion import BODIES, Sweep, integrate, sweep
from optim.audit.report import AuditReport, Check, at_least, at_most

ROUNDING = 1e-9
"""Tolerance of the limit on spacing [m], since arc lengths are sums."""


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """Tolerances of the checks; the defaults are the project's contract."""

    defect_position: float = 1e-4
    """Position defect at the end of each interval, re-integrated from its stored start [m]."""
    defect_angle: float = 1e-4
    """Defect of heading and of hitch angle there [rad]."""
    sum_position: float = 0.010
    """Sum of all position defects [m]."""
    sum_angle: float = 0.010
    """Sum of all heading defects, and of all hitch angle defects [rad]."""
    goal_position: float = 0.010
    """Distance from the recorded goal [m]."""
    goal_angle: float = math.radians(0.1)
    """Difference in heading and in hitch angle from the recorded goal [rad]."""
    limits: float = 1e-3
    """Relative excess over the limits on steering, hitch angle and steering rate [-]."""
    spacing: float = 0.1
    """Largest distance between neighbouring samples [m]."""
    clearance: float = 0.0
    """Least swept clearance, and least distance from the map's outline [m]."""
    objective: float = 1e-6
    """Relative difference of the reported and the recomputed objective [-]."""
    substep: float = 0.01
    """Longest step of the re-integration [m]."""


def audit_path(
    vehicle: Mapping[str, Any],
    scene: Mapping[str, Any],
    recorded: Mapping[str, Any],
    path: Mapping[str, Any],
    weights: Mapping[str, Any],
    reported_objective: float | None,
    *,
    tolerances: Tolerances = Tolerances(),
) -> AuditReport:
    """Check a method's path, all checks.

    The arguments are parts of a results document: `vehicle`, `scene` (`polygons`, and `boundary` or null),
    the `recorded` path, the method's `path`, the `weights`, and `objective` of the method's metrics.
    """
    return _audit(_Document(vehicle, scene, path, _Claim(recorded, weights, reported_objective)), tolerances, ALL)


def audit_recorded(vehicle: Mapping[str, Any], scene: Mapping[str, Any], path: Mapping[str, Any]) -> AuditReport:
    """Check that a path is drivable and free: all checks but `start`, `goal` and `objective`."""
    return _audit(_Document(vehicle, scene, path, None), Tolerances(), ALL)


class _Claim(NamedTuple):
    """References that a method's path is compared with."""

    recorded: Any
    weights: Any
    objective: Any


class _Document(NamedTuple):
    """Parts of a results document, as they are."""

    vehicle: Any
    scene: Any
    path: Any
    claim: _Claim | None


class _Subject(NamedTuple):
    """Input of the checks: a document as read, and quantities derived from it."""

    vehicle: VehicleData
    path: PathData
    recorded: PathData
    recomputed: float
    """J of the path [-]."""
    reported: Any
    defects: Float64[Array, "4 M"]
    """Defects of x, y, theta, alpha in each interval [m, rad]. Shape (4, M)."""
    hitch: Float64[Array, " M"]
    """Largest |alpha| in each interval [rad]. Shape (M,)."""
    swept: Sweep
    tolerances: Tolerances


def _audit(document: _Document, tolerances: Tolerances, wanted: Container[str]) -> AuditReport:
    """`wanted`: those of `ALL` to make. Fewer than all only show what the others are for."""
    checks: dict[str, Check] = {}
    try:
        with np.errstate(all="ignore"):  # overflow ends as inf or NaN, and neither passes a check
            complete = _check_all(checks, document, tolerances, wanted)
    except Unreadable as error:
        checks[error.name] = Check(passed=False, sentence=str(error), values={}, limits={})
        complete = False
    return AuditReport(checks=checks, complete=complete)


def _check_all(checks: dict[str, Check], document: _Document, tolerances: Tolerances, wanted: Container[str]) -> bool:
    """Fill in the checks that make sense; whether all of them did."""
    vehicle, scene = read_vehicle(document.vehicle), read_scene(document.scene)
    path, claim = read_path(document.path, "path"), document.claim
    recorded = read_path(claim.recorded, "recorded") if claim else path
    weights: Mapping[str, float] = read_weights(claim.weights) if claim else dict.fromkeys(map(str, WEIGHTS), 0.0)
    counts = f"{len(path.directions)} segments, {len(path.segment)} samples, {len(scene.polygons)} polygons"
    checks["structure"] = checks["finite"] = Check(passed=True, sentence=counts, values={}, limits={})
    if "spacing" in wanted:
        checks["spacing"] = _spacing(path, tolerances)
        if not checks["spacing"].passed:
            return False  # rates and defects are defined by the spacing
    ends, hitch = integrate(vehicle, path, tolerances.substep)
    defects = path.after[1:5] - ends
    subject = _Subject(
        vehicle=vehicle,
        path=path,
        recorded=recorded,
        recomputed=_recomputed(path, weights),
        reported=claim.objective if claim else None,
        defects=defects,
        hitch=hitch,
        swept=sweep(vehicle, scene, path, defects),
        tolerances=tolerances,
    )
    without = () if claim else OF_A_CLAIM
    without = without if scene.boundary is not None else (*without, "boundary")
    checks |= {name: check(subject) for name, check in CHECKS.items() if name in wanted and name not in without}
    return True


def _spacing(path: PathData, tolerances: Tolerances) -> Check:
    ds = path.ds
    worst = int(np.argmin(ds)) if ds.min() <= 0.0 else int(np.argmax(ds))
    quantities = {
        "largest": (ds.max(), tolerances.spacing + ROUNDING, "m"),
        "backward": (max(0.0, -ds.min()), 0.0, "m"),
        "repeated": (np.count_nonzero(ds == 0.0), 0, "samples"),
        "start": (np.abs(path.samples[0, path.firsts]).max(), 0.0, "m"),
    }
    return at_most("distance between samples", quantities, path.place(path.left[worst]))


def _joints(subject: _Subject) -> Check:
    path = subject.path
    later = path.firsts[1:]
    gaps = np.abs(path.samples[1:5, later] - path.samples[1:5, later - 1])
    quantities = {
        "position": (gaps[:2].max(initial=0.0), 0.0, "m"),
        "heading": (gaps[2].max(initial=0.0), 0.0, "rad"),
        "hitch": (gaps[3].max(initial=0.0), 0.0, "rad"),
    }
    place = path.place(later[int(np.argmax(gaps.max(axis=0)))]) if len(later) else None
    return at_most("gap between segments", quantities, place)


def _start(subject: _Subject) -> Check:
    off = np.abs(subject.path.samples[1:5, 0] - subject.recorded.samples[1:5, 0])
    quantities = {"position": (off[:2].max(), 0.0, "m"), "heading": (off[2], 0.0, "rad"), "hitch": (off[3], 0.0, "rad")}
    return at_most("start, from the recorded one", quantities, subject.path.place(0))


def _goal(subject: _Subject) -> Check:
    x, y, theta, alpha = subject.path.samples[1:5, -1] - subject.recorded.samples[1:5, -1]
    tolerances = subject.tolerances
    quantities = {
        "position": (math.hypot(x, y), tolerances.goal_position, "m"),
        "heading": (abs(math.remainder(theta, math.tau)), tolerances.goal_angle, "rad"),
        "hitch": (abs(alpha), tolerances.goal_angle, "rad"),
    }
    return at_most("goal, from the recorded one", quantities, subject.path.place(-1))


def _largest_defects(subject: _Subject) -> Check:
    path, defects, tolerances = subject.path, subject.defects, subject.tolerances
    sizes = np.stack([np.hypot(*defects[:2]), *np.abs(defects[2:])])
    limits = tolerances.defect_position, tolerances.defect_angle, tolerances.defect_angle
    worst = int(np.argmax((sizes / np.array(limits)[:, None]).max(axis=0)))
    names = zip(("position", "heading", "hitch"), sizes.max(axis=1), limits, ("m", "rad", "rad"), strict=True)
    quantities = {name: (value, limit, unit) for name, value, limit, unit in names}
    return at_most("largest defect of an interval", quantities, path.place(path.left[worst]))


def _sums_of_defects(subject: _Subject) -> Check:
    defects, tolerances = subject.defects, subject.tolerances
    quantities = {
        "position": (np.hypot(*defects[:2]).sum(), tolerances.sum_position, "m"),
        "heading": (np.abs(defects[2]).sum(), tolerances.sum_angle, "rad"),
        "hitch": (np.abs(defects[3]).sum(), tolerances.sum_angle, "rad"),
    }
    return at_most("sum of defects", quantities)


def _steer(subject: _Subject) -> Check:
    steer, path = np.abs(subject.path.samples[5]), subject.path
    quantities = {"steer": (steer.max(), _relaxed(subject, "max_steer"), "rad")}
    return at_most("largest steering angle", quantities, path.place(int(np.argmax(steer))))


def _hitch(subject: _Subject) -> Check:
    quantities = {"hitch": (subject.hitch.max(), _relaxed(subject, "max_hitch"), "rad")}
    place = subject.path.place(subject.path.left[int(np.argmax(subject.hitch))])
    return at_most("largest hitch angle", quantities, place)


def _steer_rate(subject: _Subject) -> Check:
    path = subject.path
    rate = np.abs(path.after[5] - path.before[5]) / path.ds
    quantities = {"rate": (rate.max(), _relaxed(subject, "max_steer_rate"), "rad/m")}
    return at_most("largest steering rate", quantities, path.place(path.left[int(np.argmax(rate))]))


def _relaxed(subject: _Subject, limit: str) -> float:
    return getattr(subject.vehicle, limit) * (1.0 + subject.tolerances.limits)


def _clearance(subject: _Subject) -> Check:
    path, swept = subject.path, subject.swept
    interval, body = np.unravel_index(int(np.argmin(swept.clearance)), swept.clearance.shape)
    polygon = int(swept.polygon[interval, body])
    place = replace(path.place(path.left[interval]), body=BODIES[body], polygon=polygon)
    return at_least("clearance", swept.clearance, subject.tolerances.clearance, place)


def _boundary(subject: _Subject) -> Check:
    path, swept = subject.path, subject.swept
    interval, body = np.unravel_index(int(np.argmin(swept.room)), swept.room.shape)
    place = replace(path.place(path.left[interval]), body=BODIES[body])
    return at_least("distance to the map's outline", swept.room, subject.tolerances.clearance, place)


def _recomputed(path: PathData, weights: Mapping[str, float]) -> float:
    """J of the samples; phi is linear between them, so the integrals are sums."""
    left, right, ds = path.before[5], path.after[5], path.ds
    later = path.firsts[1:]
    terms = {
        "length": ds.sum(),
        "steer": (ds * ((left + right) ** 2 - left * right)).sum() / 3,
        "rate": ((right - left) ** 2 / ds).sum(),
        "cusp": np.count_nonzero(np.diff(path.directions)),
        "jump": ((path.samples[5, later] - path.samples[5, later - 1]) ** 2).sum(),
    }
    return float(sum(weights[name] * value for name, value in terms.items()))


def _objective(subject: _Subject) -> Check:
    recomputed, reported = subject.recomputed, subject.reported
    is_number = isinstance(reported, (int, float)) and not isinstance(reported, bool) and abs(reported) < 1e300
    value = float(reported) if is_number else math.nan
    relative = abs(value - recomputed) / max(abs(recomputed), sys.float_info.min)
    limit = subject.tolerances.objective
    return Check(
        passed=relative <= limit,
        sentence=f"reported {value:.9g}, recomputed {recomputed:.9g}: off by {relative:.3g} (limit {limit:g})",
        values={"reported": value, "recomputed": recomputed, "relative": relative},
        limits={"relative": limit},
    )


CHECKS: Mapping[str, Callable[[_Subject], Check]] = MappingProxyType(
    {
        "joints": _joints,
        "start": _start,
        "goal": _goal,
        "defect": _largest_defects,
        "defect_sum": _sums_of_defects,
        "steer": _steer,
        "hitch": _hitch,
        "steer_rate": _steer_rate,
        "clearance": _clearance,
        "boundary": _boundary,
        "objective": _objective,
    }
)
"""Checks that need a readable document with the right spacing."""
ALL = ("spacing", *CHECKS)
"""Names of all checks but `structure` and `finite`, which are part of reading."""
OF_A_CLAIM = ("start", "goal", "objective")
"""Checks that need a claim; others are made of a recorded path too."""
