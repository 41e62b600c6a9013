"""Statements of a path message beside its poses, and the reference point of its poses on the truck.

Stated are the gear, by the sign of the speed, and the angle of the front wheel.
"""

import dataclasses
from typing import TypeGuard

import numpy as np

from optim.fit.poses import Fit
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, IntArray, frozen, frozen_int
from replay.logs.meaning.planar import Refusal
from replay.logs.meaning.read_options import ReadOptions
from replay.logs.meaning.recorded_poses import RecordedPoses, headings_missing, nearest_row
from replay.logs.messages.types import PoseSeries

CONTRADICTED = 0.5
"""Travel from which a motion against the stated gear is not noise [m]."""
NOTED_STEER = 0.05
"""Least difference between stated and fitted steering angles that gets a note [rad]."""


def reference_offset(vehicle: Vehicle, options: ReadOptions) -> float:
    """Distance of a path's reference point ahead of the rear axle [m]."""
    return references(vehicle)[options.reference] + options.reference_offset


def references(vehicle: Vehicle) -> dict[str, float]:
    """The points of a truck that --reference names, and how far ahead of the rear axle each is [m]."""
    centre = (vehicle.truck_front - vehicle.truck_rear) / 2.0
    return {"rear-axle": 0.0, "centre": centre, "front-axle": vehicle.wheelbase}


def at_rear_axle(plane: Array, offset: float) -> Array:
    """Poses (m, 3) of a point that lies `offset` [m] ahead of the rear axle, moved back to the axle.

    Raises:
        Refusal: the poses have no headings to move them along.
    """
    if offset == 0.0:
        return plane
    if headings_missing(plane):
        raise Refusal(
            "E_PATH_HEADING",
            "all its headings are equal: where its poses are not at the rear axle, headings must say where that is",
        )
    back = offset * np.stack([np.cos(plane[:, 2]), np.sin(plane[:, 2])], axis=1)
    return np.column_stack([plane[:, :2] - back, plane[:, 2]])


def start_direction(series: PoseSeries, options: ReadOptions) -> int:
    """Gear of the first metre: the first that the message states, else the option."""
    speed = series.speed
    return int(np.sign(speed[np.flatnonzero(speed)[0]])) if _says(speed) else options.start_direction


def _says(values: Array | None) -> TypeGuard[Array]:
    """True if a message has these values: types have fields that few programs fill."""
    return values is not None and bool(np.isfinite(values).all() and values.any())


def with_stated_gears(recorded: RecordedPoses, series: PoseSeries) -> RecordedPoses:
    """The gears that the speeds of a message state, but for long stretches on which the motion says otherwise."""
    if not _says(series.speed):
        return recorded
    stated = _stated_gears(series.speed, recorded.kept)
    differs = (stated != 0) & (stated != recorded.direction)
    if not differs.any():
        return recorded
    step = np.hypot(*np.diff(recorded.poses[:, :2], axis=0).T)
    edges = np.flatnonzero(np.diff(np.concatenate([[False], differs, [False]]).astype(np.int8)))
    direction, notes = recorded.direction.copy(), list(recorded.notes)
    rows = np.ones(len(recorded.poses), bool)
    for start, stop in edges.reshape(-1, 2).tolist():
        travel = float(step[start:stop].sum())
        where = f"over {travel:.2f} m from pose {recorded.kept[start]} on"
        if travel < CONTRADICTED:
            direction[start:stop] = stated[start:stop]
            rows[max(start, 1) : stop + 1] = False  # these poses are where the truck was not yet, or no more
            notes.append(f"its speeds state another gear than its motion {where}: taken for noise in the poses")
        else:
            notes.append(f"its speeds state another gear than its motion {where}: the motion counts")
    rows[-1] = True
    return _only(dataclasses.replace(recorded, notes=tuple(notes)), np.flatnonzero(rows), direction)


def _only(recorded: RecordedPoses, rows: IntArray, direction: IntArray) -> RecordedPoses:
    """The poses of some rows, the first and the last among them; an interval has the gear with which it is left."""
    group = recorded.group
    if group is not None:
        row_now = np.full(len(recorded.poses) + 1, -1)  # the last one is for poses in no group, whose row is -1
        row_now[rows] = np.arange(len(rows))
        group = frozen_int(row_now[group])
    return dataclasses.replace(
        recorded,
        poses=frozen(recorded.poses[rows]),
        direction=frozen_int(direction[rows[:-1]]),
        kept=frozen_int(recorded.kept[rows]),
        nearest=frozen_int(nearest_row(recorded.poses, rows)[recorded.nearest]),
        group=group,
    )


def _stated_gears(speed: Array, kept: IntArray) -> IntArray:
    """Gear of each interval between kept poses: 1, -1, or 0 where the speeds are zero or of both signs."""
    signs = np.sign(speed)
    total = np.concatenate([[0.0], np.cumsum(signs)])
    moving = np.concatenate([[0.0], np.cumsum(np.abs(signs))])
    # a pose's speed is that with which it is left; the speed at the end of an interval is the next interval's
    sums, counts = np.diff(total[kept]), np.diff(moving[kept])
    return np.where((counts > 0) & (np.abs(sums) == counts), np.sign(sums), 0).astype(np.int64)


def steer_notes(recorded: RecordedPoses, fit: Fit, series: PoseSeries) -> list[str]:
    """Notes on the difference between the steering angles of a message and of the drivable path."""
    steer = series.steer
    if not _says(steer):
        return []
    samples = fit.path.samples
    at = frozen(np.interp(fit.pose_s, samples.s, samples.phi))
    off = np.abs(at - steer[recorded.kept])
    worst = int(np.argmax(off))
    if off[worst] <= NOTED_STEER:
        return []
    where = f"at {fit.pose_s[worst]:.2f} m, pose {recorded.kept[worst]}"
    return [f"the steering angles that it states differ by up to {off[worst]:.3f} rad from the path's ({where})"]
