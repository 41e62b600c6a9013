"""The independent check of a path: plain data in (as in `replay.results/1`), named checks with numbers out.

It shares nothing with the methods: own integrator, own footprints, own objective, and `shapely` for distances
(`audit_motion` has the bound for what happens between samples, and its proof). It never raises for what a
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

A free roll-out over a whole segment is no check: in reverse errors grow like exp(s / l_t), 43-fold over 30 m.
"""

import math
import sys
from collections.abc import Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

import numpy as np

from optim.audit_data import (
    Array,
    Place,
    Refusal,
    Track,
    VehicleData,
    read_path,
    read_scene,
    read_vehicle,
    read_weights,
)
from optim.audit_motion import BODIES, Sweep, integrate, sweep

ROUNDING = 1e-9
"""What the spacing may exceed its limit by [m], since arc lengths are sums."""


@dataclass(frozen=True, kw_only=True)
class Tolerances:
    """How far a path may be off. The defaults are the project's contract."""

    defect_position: float = 1e-4
    """Of the end of each interval, re-integrated from its stored start [m]."""
    defect_angle: float = 1e-4
    """As above, of heading and hitch angle [rad]."""
    sum_position: float = 0.010
    """Of all position defects together [m]."""
    sum_angle: float = 0.010
    """Of all heading defects together, and of all hitch angle defects [rad]."""
    goal_position: float = 0.010
    """Distance from the recorded goal [m]."""
    goal_angle: float = math.radians(0.1)
    """Heading and hitch angle from the recorded goal's [rad]."""
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


@dataclass(frozen=True, kw_only=True)
class Check:
    """The outcome of one check. The names in `values` and `limits` end in their units."""

    passed: bool
    sentence: str
    values: Mapping[str, float]
    limits: Mapping[str, float]
    place: Mapping[str, float | int | str] | None = None
    """Where it is worst: `segment` (index), `s` (arc length in it [m]), `body`, `polygon` (index)."""

    def to_dict(self) -> dict[str, Any]:
        """Plain data; what is not finite becomes None."""
        parts = {"values": self.values, "limits": self.limits, "place": self.place}
        return {"passed": self.passed, "sentence": self.sentence, **{k: _plain(v) for k, v in parts.items()}}


@dataclass(frozen=True, kw_only=True)
class AuditReport:
    """The outcome of an audit."""

    checks: Mapping[str, Check]
    """All checks that could be made, by name."""
    complete: bool
    """False when damage left some checks without sense; the report has not passed then."""

    @property
    def passed(self) -> bool:
        """Whether every check was made, and passed."""
        return self.complete and all(check.passed for check in self.checks.values())

    @property
    def failed(self) -> tuple[str, ...]:
        """Names of the checks that did not pass."""
        return tuple(name for name, check in self.checks.items() if not check.passed)

    @property
    def failures(self) -> tuple[str, ...]:
        """What is wrong, one line for each check that did not pass."""
        return tuple(f"{name}: {self.checks[name].sentence}" for name in self.failed)

    def to_dict(self) -> dict[str, Any]:
        """Plain data, as the results file stores it."""
        checks = {name: check.to_dict() for name, check in self.checks.items()}
        return {"passed": self.passed, "complete": self.complete, "checks": checks}


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
    return _audit(vehicle, scene, path, tolerances, _Claim(recorded, weights, reported_objective))


def audit_recorded(
    vehicle: Mapping[str, Any],
    scene: Mapping[str, Any],
    path: Mapping[str, Any],
    *,
    tolerances: Tolerances = Tolerances(),
) -> AuditReport:
    """Check that a path is drivable and free: all checks but `start`, `goal` and `objective`."""
    return _audit(vehicle, scene, path, tolerances, None)


class _Claim(NamedTuple):
    """What a method's path is compared with."""

    recorded: Any
    weights: Any
    objective: Any


def _audit(vehicle: Any, scene: Any, path: Any, tolerances: Tolerances, claim: _Claim | None) -> AuditReport:
    checks: dict[str, Check] = {}
    try:
        with np.errstate(all="ignore"):  # overflow ends as inf or NaN, and neither passes a check
            _check_all(checks, vehicle, scene, path, tolerances, claim)
    except Refusal as refusal:
        checks[refusal.name] = Check(passed=False, sentence=str(refusal), values={}, limits={})
        return AuditReport(checks=checks, complete=False)
    return AuditReport(checks=checks, complete=checks["spacing"].passed)


def _check_all(
    checks: dict[str, Check], vehicle: Any, scene: Any, path: Any, tolerances: Tolerances, claim: _Claim | None
) -> None:
    """Fill in the checks as far as they make sense."""
    truck, world, track = read_vehicle(vehicle), read_scene(scene), read_path(path, "path")
    recorded = read_path(claim.recorded, "recorded") if claim else track
    weights = read_weights(claim.weights) if claim else {}
    counts = f"{len(track.directions)} segments, {len(track.segment)} samples, {len(world.polygons)} polygons"
    checks["structure"] = checks["finite"] = Check(passed=True, sentence=counts, values={}, limits={})
    checks["spacing"] = _spacing(track, tolerances)
    if not checks["spacing"].passed:
        return  # rates and defects are defined by the spacing
    ends, hitch = integrate(truck, track, tolerances.substep)
    defects = track.after[1:5] - ends
    checks["joints"] = _joints(track)
    if claim:
        checks["start"] = _start(track, recorded)
        checks["goal"] = _goal(track, recorded, tolerances)
    checks["defect"] = _largest_defects(track, defects, tolerances)
    checks["defect_sum"] = _sums_of_defects(defects, tolerances)
    checks |= _limits(truck, track, hitch, tolerances)
    swept = sweep(truck, world, track, defects)
    checks["clearance"] = _clearance(track, swept, tolerances)
    if world.boundary is not None:
        checks["boundary"] = _boundary(track, swept, tolerances)
    if claim:
        checks["objective"] = _objective(_recomputed(track, weights), claim.objective, tolerances)


def _at_most(what: str, quantities: dict[str, tuple[float, float, str]], place: Place | None = None) -> Check:
    """Every quantity, given as name: (value, limit, unit), at most its limit; NaN is not."""
    parts = [f"{name} {value:.6g} {unit} (limit {limit:.6g})" for name, (value, limit, unit) in quantities.items()]
    return Check(
        passed=all(value <= limit for value, limit, _ in quantities.values()),
        sentence=f"{what}: {', '.join(parts)}",
        values={f"{name}_{unit}": float(value) for name, (value, _, unit) in quantities.items()},
        limits={f"{name}_{unit}": float(limit) for name, (_, limit, unit) in quantities.items()},
        place=place,
    )


def _plain(part: Mapping[str, Any] | None) -> dict[str, Any] | None:
    if part is None:
        return None
    return {k: None if isinstance(v, float) and not math.isfinite(v) else v for k, v in part.items()}


def _spacing(track: Track, tolerances: Tolerances) -> Check:
    ds = track.ds
    worst = int(np.argmin(ds)) if ds.min() <= 0.0 else int(np.argmax(ds))
    quantities = {
        "largest": (ds.max(), tolerances.spacing + ROUNDING, "m"),
        "backward": (max(0.0, -ds.min()), 0.0, "m"),
        "repeated": (np.count_nonzero(ds == 0.0), 0, "samples"),
        "start": (np.abs(track.samples[0, track.firsts]).max(), 0.0, "m"),
    }
    return _at_most("distance between samples", quantities, track.place(track.left[worst]))


def _joints(track: Track) -> Check:
    later = track.firsts[1:]
    gaps = np.abs(track.samples[1:5, later] - track.samples[1:5, later - 1])
    quantities = {
        "position": (gaps[:2].max(initial=0.0), 0.0, "m"),
        "heading": (gaps[2].max(initial=0.0), 0.0, "rad"),
        "hitch": (gaps[3].max(initial=0.0), 0.0, "rad"),
    }
    place = track.place(later[int(np.argmax(gaps.max(axis=0)))]) if len(later) else None
    return _at_most("gap between segments", quantities, place)


def _start(track: Track, recorded: Track) -> Check:
    off = np.abs(track.samples[1:5, 0] - recorded.samples[1:5, 0])
    quantities = {"position": (off[:2].max(), 0.0, "m"), "heading": (off[2], 0.0, "rad"), "hitch": (off[3], 0.0, "rad")}
    return _at_most("start, from the recorded one", quantities, track.place(0))


def _goal(track: Track, recorded: Track, tolerances: Tolerances) -> Check:
    x, y, theta, alpha = track.samples[1:5, -1] - recorded.samples[1:5, -1]
    quantities = {
        "position": (math.hypot(x, y), tolerances.goal_position, "m"),
        "heading": (abs(math.remainder(theta, math.tau)), tolerances.goal_angle, "rad"),
        "hitch": (abs(alpha), tolerances.goal_angle, "rad"),
    }
    return _at_most("goal, from the recorded one", quantities, track.place(-1))


def _largest_defects(track: Track, defects: Array, tolerances: Tolerances) -> Check:
    sizes = np.stack([np.hypot(*defects[:2]), *np.abs(defects[2:])])
    limits = tolerances.defect_position, tolerances.defect_angle, tolerances.defect_angle
    worst = int(np.argmax((sizes / np.array(limits)[:, None]).max(axis=0)))
    names = zip(("position", "heading", "hitch"), sizes.max(axis=1), limits, ("m", "rad", "rad"), strict=True)
    quantities = {name: (value, limit, unit) for name, value, limit, unit in names}
    return _at_most("largest defect of an interval", quantities, track.place(track.left[worst]))


def _sums_of_defects(defects: Array, tolerances: Tolerances) -> Check:
    quantities = {
        "position": (np.hypot(*defects[:2]).sum(), tolerances.sum_position, "m"),
        "heading": (np.abs(defects[2]).sum(), tolerances.sum_angle, "rad"),
        "hitch": (np.abs(defects[3]).sum(), tolerances.sum_angle, "rad"),
    }
    return _at_most("sum of defects", quantities)


def _limits(vehicle: VehicleData, track: Track, hitch: Array, tolerances: Tolerances) -> dict[str, Check]:
    steer = np.abs(track.samples[5])
    rate = np.abs(track.after[5] - track.before[5]) / track.ds
    relaxed = 1.0 + tolerances.limits
    rows = {
        "steer": ("largest steering angle", "steer", steer, vehicle.max_steer, "rad", np.arange(len(steer))),
        "hitch": ("largest hitch angle", "hitch", hitch, vehicle.max_hitch, "rad", track.left),
        "steer_rate": ("largest steering rate", "rate", rate, vehicle.max_steer_rate, "rad/m", track.left),
    }
    return {
        check: _at_most(
            what, {name: (values.max(), limit * relaxed, unit)}, track.place(samples[int(np.argmax(values))])
        )
        for check, (what, name, values, limit, unit, samples) in rows.items()
    }


def _clearance(track: Track, swept: Sweep, tolerances: Tolerances) -> Check:
    interval, body = np.unravel_index(int(np.argmin(swept.clearance)), swept.clearance.shape)
    place = track.place(track.left[interval]) | {"body": BODIES[body], "polygon": int(swept.polygon[interval, body])}
    return _at_least("clearance", swept.clearance, tolerances.clearance, place)


def _boundary(track: Track, swept: Sweep, tolerances: Tolerances) -> Check:
    interval, body = np.unravel_index(int(np.argmin(swept.room)), swept.room.shape)
    place = track.place(track.left[interval]) | {"body": BODIES[body]}
    return _at_least("distance to the map's outline", swept.room, tolerances.clearance, place)


def _at_least(what: str, values: Array, limit: float, place: Place) -> Check:
    """The smallest value of either body at least the limit; NaN is not."""
    least = values.min(axis=0)
    parts = ", ".join(f"{body} {value:.4f} m" for body, value in zip(BODIES, least, strict=True))
    return Check(
        passed=bool((least >= limit).all()),
        sentence=f"least swept {what}: {parts} (limit {limit:g})",
        values={f"{body}_m": float(value) for body, value in zip(BODIES, least, strict=True)},
        limits={f"{body}_m": limit for body in BODIES},
        place=place,
    )


def _recomputed(track: Track, weights: Mapping[str, float]) -> float:
    """J of the samples; phi is linear between them, so the integrals are sums."""
    left, right, ds = track.before[5], track.after[5], track.ds
    later = track.firsts[1:]
    terms = {
        "length": ds.sum(),
        "steer": (ds * ((left + right) ** 2 - left * right)).sum() / 3,
        "rate": ((right - left) ** 2 / ds).sum(),
        "cusp": np.count_nonzero(np.diff(track.directions)),
        "jump": ((track.samples[5, later] - track.samples[5, later - 1]) ** 2).sum(),
    }
    return float(sum(weights[name] * value for name, value in terms.items()))


def _objective(recomputed: float, reported: Any, tolerances: Tolerances) -> Check:
    is_number = isinstance(reported, (int, float)) and not isinstance(reported, bool) and abs(reported) < 1e300
    value = float(reported) if is_number else math.nan
    relative = abs(value - recomputed) / max(abs(recomputed), sys.float_info.min)
    limit = tolerances.objective
    return Check(
        passed=relative <= limit,
        sentence=f"reported {value:.9g}, recomputed {recomputed:.9g}: off by {relative:.3g} (limit {limit:g})",
        values={"reported": value, "recomputed": recomputed, "relative": relative},
        limits={"relative": limit},
    )
