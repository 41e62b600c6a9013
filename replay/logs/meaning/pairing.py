"""Pairing of the trailer's path with the truck's: the trailer's pose at each pose of the truck."""

import numpy as np

from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, IntArray
from replay.logs.meaning.planar import Refusal
from replay.logs.messages.types import PoseSeries

TOLERANCE = 0.2
"""Largest median distance of the trailer's axle from where the hitch puts it [m]."""
_DENSITY = 4  # points per recorded trailer pose in the search by arc length
_MAX_TABLE = 20_000_000  # entries of the table of that search


def trailer_at_poses(
    truck: Array, truck_series: PoseSeries, trailer: Array, trailer_series: PoseSeries, vehicle: Vehicle
) -> Array:
    """The trailer's axle (x, y, heading) at each of n truck poses (n, 3), from m trailer poses (m, 3). Shape (n, 3).

    By stamp where stamps differ, else by index where the counts agree, else by the arrangement along both paths
    that fits the hitch best.

    Raises:
        Refusal: the trailer's path ends before the truck's does.
    """
    trailer = np.column_stack([trailer[:, :2], np.unwrap(trailer[:, 2])])
    if np.ptp(truck_series.stamps) > 0 and np.ptp(trailer_series.stamps) > 0:
        return at_stamps(truck_series.stamps, trailer_series.stamps, trailer, "the trailer's path")
    if len(truck) == len(trailer):
        return trailer
    return _by_arrangement(_hitch(truck, vehicle), trailer, vehicle.hitch_to_axle)


def hitch_misfit(truck: Array, trailer: Array, vehicle: Vehicle) -> Array:
    """Distance of each trailer axle from the place behind the hitch that its heading asks for [m]. Shape (n,)."""
    behind = vehicle.hitch_to_axle * _along(trailer[:, 2])
    return np.hypot(*(_hitch(truck, vehicle) - behind - trailer[:, :2]).T)


def _hitch(truck: Array, vehicle: Vehicle) -> Array:
    """Hitch position at the truck's poses [m]. Shape (n, 2)."""
    return truck[:, :2] - vehicle.hitch_offset * _along(truck[:, 2])


def _along(heading: Array) -> Array:
    """Unit vectors. Shape (n, 2)."""
    return np.stack([np.cos(heading), np.sin(heading)], axis=1)


def hitch_angles(angle: Array, *, of_poses: bool = True) -> Array:
    """Angles between trailer and truck at the kept poses (n,), made continuous [rad]. Shape (n,).

    `of_poses`: whether the error is to name the pose.

    Raises:
        Refusal: a right angle or more somewhere; no trailer is towed like that.
    """
    alpha = np.unwrap(np.arctan2(np.sin(angle), np.cos(angle)))
    row = int(np.argmax(np.abs(alpha)))
    if abs(alpha[row]) >= np.pi / 2.0:
        where = f"pose {row}: " if of_poses else ""
        raise Refusal("E_HITCH", f"{where}the hitch angle is {np.degrees(alpha[row]):.0f} degrees, expected below 90")
    return alpha


def at_stamps(stamps: IntArray, known_stamps: IntArray, known: Array, what: str) -> Array:
    """Rows known at m stamps, (m, k), interpolated at n stamps of the truck's poses [ns]; both rise. Shape (n, k).

    `what`: whose rows they are, for the error.

    Raises:
        Refusal: E_PATH_PAIR, where the rows end before the poses do, by more than their own median interval.
    """
    start = min(stamps[0], known_stamps[0])
    t, t_known = (stamps - start) * 1e-9, (known_stamps - start) * 1e-9  # differences: exact below 104 days
    slack = 1e-3 + (float(np.median(np.diff(t_known))) if len(t_known) > 1 else 0.0)
    covered = (t >= t_known[0] - slack) & (t <= t_known[-1] + slack)
    if not covered.all():
        share = f"{np.count_nonzero(covered)} of {len(t)} truck poses"
        raise Refusal("E_PATH_PAIR", f"{what} has stamps for {share}; pose {int(np.argmin(covered))} has none")
    return np.stack([np.interp(t, t_known, column) for column in known.T], axis=1)


def _by_arrangement(hitch: Array, trailer: Array, hitch_to_axle: float) -> Array:
    """Both paths are run through once, monotonically, so that the sum of squared misfits is least.

    Dynamic programming over (hitch by the truck, point of the densified trailer path):
    D[i, j] = misfit[i, j]^2 + min over k <= j of D[i - 1, k].
    """
    count = len(hitch)
    if len(trailer) < 2:
        raise Refusal("E_PATH_PAIR", f"the trailer's path has {len(trailer)} poses, the truck's {count}")
    density = min(_DENSITY, max(1, _MAX_TABLE // (count * len(trailer))))
    if count * len(trailer) > _MAX_TABLE:
        raise Refusal("E_PATH_PAIR", f"{count} and {len(trailer)} poses without stamps are too many to pair")
    place = np.arange((len(trailer) - 1) * density + 1) / density
    dense = np.stack([np.interp(place, np.arange(len(trailer)), column) for column in trailer.T], axis=1)
    ahead = dense[:, :2] + hitch_to_axle * _along(dense[:, 2])
    best = np.zeros(len(dense))
    choice = np.empty((count, len(dense)), np.int32)
    for i, point in enumerate(hitch):
        running = np.minimum.accumulate(best)
        is_new = np.concatenate([[True], best[1:] < running[:-1]])
        choice[i] = np.maximum.accumulate(np.where(is_new, np.arange(len(best)), 0))
        best = running + np.sum((ahead - point) ** 2, axis=1)
    rows = np.empty(count, np.int64)
    rows[-1] = int(np.argmin(best))
    for i in range(count - 1, 0, -1):
        rows[i - 1] = choice[i, rows[i]]
    return dense[rows]
