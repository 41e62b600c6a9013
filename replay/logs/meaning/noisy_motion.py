"""Motion from noisy poses: the size of the noise, the gears, the groups of poses that stand for one place.

Noise is white: independent from pose to pose. Slow drift cannot be distinguished from motion and stays in the path.
"""

from dataclasses import dataclass
from itertools import pairwise

import numpy as np

from optim.numerics.arrays import Array, IntArray

_TRIMMED_SHARE, _TRIMMED_VARIANCE = 0.8, 0.4377  # the least 80 % of normal deviates have that variance
_FOURTH_VARIANCE = 70.0  # of fourth differences of white noise
_FEWEST = 12  # poses from which noise is estimated
SURE = 7.0
"""Motion against the gear counts from this many standard deviations on: of 100 poses at standstill, the two farthest
apart reach six once in some hundred times, and seven once in some thousand."""
_STANDS = 2.0  # standard deviations within which poses at a change of gear are taken for one place
_POSITION_SHARE = 0.03  # noise of grouped positions over the length of a group: that of the direction of motion [rad]
_HEADING_SHARE = 0.1  # noise of the steering angle that the headings of neighbouring groups ask for [rad]
_WHEELBASE = 3.6  # a typical one is enough for how long groups are to be [m]
_LONGEST_GROUP = 1.0  # over which poses are averaged [m]: an arc of 6 m radius differs by 2 cm from its mean there
_SHORTEST_CHORD = 0.1  # [m]
_CHORD = 12.0  # standard deviations over which a direction of motion is taken: it is known to about 7 degrees then


@dataclass(frozen=True, kw_only=True)
class Noise:
    """Standard deviations of white noise."""

    position: float
    """Standard deviation of the noise in x, and in y [m]."""
    heading: float
    """[rad]."""


NO_NOISE = Noise(position=0.0, heading=0.0)


def noise_of(poses: Array) -> Noise:
    """The noise of poses (n, 3), from the fourth differences across the motion and of the headings.

    The largest fifth of them does not count: gear changes, jumps and single wild poses. Of poses up to 0.5 m apart,
    the motion itself adds less than 0.2 mm; 1 m apart, up to 2 mm. No noise for fewer than 12 distinct poses.
    """
    distinct = np.concatenate([[True], (np.diff(poses[:, :2], axis=0) != 0.0).any(axis=1)])
    poses = poses[distinct]
    if len(poses) < _FEWEST:
        return NO_NOISE
    along = poses[4:, :2] - poses[:-4, :2]
    length = np.hypot(*along.T)
    across = np.stack([-along[:, 1], along[:, 0]], axis=1) / np.maximum(length, 1e-12)[:, None]
    position = np.sum(np.diff(poses[:, :2], n=4, axis=0) * across, axis=1)
    heading = np.diff(np.unwrap(poses[:, 2]), n=4)
    return Noise(position=_trimmed_sigma(position), heading=_trimmed_sigma(heading))


def _trimmed_sigma(fourth: Array) -> float:
    """Standard deviation of white noise from its fourth differences (n,)."""
    least = np.sort(np.abs(fourth))[: max(1, round(_TRIMMED_SHARE * len(fourth)))]
    return float(np.sqrt(np.mean(least**2) / (_TRIMMED_VARIANCE * _FOURTH_VARIANCE)))


def signed_travel(poses: Array) -> Array:
    """Distance driven along the headings up to each pose, less where in reverse [m]. Shape (n,).

    Noise of a pose shows at that pose alone, it does not add up.
    """
    middle = (poses[1:, 2] + poses[:-1, 2]) / 2.0
    delta = np.diff(poses[:, :2], axis=0)
    return np.concatenate([[0.0], np.cumsum(np.cos(middle) * delta[:, 0] + np.sin(middle) * delta[:, 1])])


def turning_points(travel: Array, least: float) -> tuple[IntArray, int]:
    """Poses at which the gear changes, and the first gear, from the signed travel (n,).

    Travel back by less than `least` [m] is noise; longer travel is kept.
    """
    low = high = 0  # poses of least and most travel since the last change
    gear = first = 0
    turns = []
    for k, here in enumerate(travel.tolist()):
        low = k if here < travel[low] else low
        high = k if here > travel[high] else high
        is_back, is_ahead = travel[high] - here >= least, here - travel[low] >= least
        if gear == 0 and (is_back or is_ahead):
            gear = first = 1 if is_ahead else -1
            low = high = k
        elif gear == 1 and is_back:
            turns.append(high)
            gear, low, high = -1, k, k
        elif gear == -1 and is_ahead:
            turns.append(low)
            gear, low, high = 1, k, k
    return np.array(turns, np.int64), first or (1 if travel[-1] >= travel[0] else -1)


def rough_chain(xy: Array, noise: float) -> IntArray:
    """Poses so far apart that noise [m] hardly turns the direction from each to the next; the last pose among them."""
    reach = max(_SHORTEST_CHORD, _CHORD * noise)
    chain = [0]
    x, y = xy.T.tolist()
    for k in range(1, len(xy)):
        if np.hypot(x[k] - x[chain[-1]], y[k] - y[chain[-1]]) >= reach:
            chain.append(k)
    if len(chain) > 1:
        chain[-1] = len(xy) - 1
    return np.array(chain, np.int64)


def group_length(travel: Array, noise: Noise) -> float:
    """Length over which poses are averaged [m], so that noise does not decide about direction and steering."""
    step = float(np.abs(np.diff(travel)).sum()) / (len(travel) - 1)  # with the noise in it: on the safe side
    wanted = (
        noise.position / _POSITION_SHARE,
        np.sqrt(2.0) * _WHEELBASE * noise.heading / _HEADING_SHARE,
    )
    return min(_LONGEST_GROUP, max((each * np.sqrt(step)) ** (2.0 / 3.0) for each in wanted))


def groups(travel: Array, turns: IntArray, gear: int, length: float, noise: float) -> tuple[IntArray, IntArray]:
    """Groups of poses: a number for each pose (n,), rising along the path, and the gear between two numbers.

    The first and the last group are those of the ends, and each change of gear has one: the poses that stand there
    within the noise [m]. Between them a group is `length` [m] long, or one pose where poses are farther apart. -1 is
    the number of poses that belong nowhere: too near to a stop to say more than it does.
    """
    label = np.full(len(travel), -1, np.int64)
    gears: list[int] = []
    stops = [0, *turns.tolist(), len(travel) - 1]
    near = _STANDS * noise
    number, begin = 0, _last_within(travel, 0, stops[1], near)  # the last pose that stands at the stop before
    label[: begin + 1] = 0
    for start, stop, following in zip(stops, stops[1:], [*stops[2:], stops[-1]], strict=False):
        end = max(begin + 1, _last_within(travel, stop, begin, near))  # the first that stands at the one to come
        along = gear * (travel[begin + 1 : end] - travel[start])
        which = _in_groups(along, gear * float(travel[stop] - travel[start]), length)
        label[begin + 1 : end] = np.where(which > 0, number + which, -1)
        inside = int(which.max()) if len(which) else 0
        gears += [gear] * (inside + 1)
        number += inside + 1
        begin = _last_within(travel, stop, following, near)
        label[end : begin + 1] = number
        gear = -gear
    return label, np.array(gears, np.int64)


def _last_within(travel: Array, start: int, stop: int, near: float) -> int:
    """The last pose, going from `start` halfway to `stop`, up to which all are as near to `start` as that [m]."""
    step = 1 if stop >= start else -1
    k = start
    while abs(k + step - start) <= abs(stop - start) // 2 and abs(travel[k + step] - travel[start]) <= near:
        k += step
    return k


def _in_groups(along: Array, total: float, length: float) -> IntArray:
    """Groups 1, 2, ... of poses by their travel (n,) from one stop to the next, `total` [m] away; 0: of none.

    Means of neighbouring groups, and of the first and the last one and the stops, are not much nearer than `length`.
    """
    which = np.zeros(len(along), np.int64)
    if not len(along):
        return which
    number, first, count, mean, before = 1, along[0], 0, 0.0, 0.0
    for k, here in enumerate(along.tolist()):
        if here >= first + length and mean - before >= 0.5 * length:
            before, number, first, count, mean = mean, number + 1, here, 0, 0.0
        count += 1
        mean += (here - mean) / count
        which[k] = number
    while number and total - along[which == number].mean() < 0.5 * length:  # too near to the stop
        number -= 1
        which[which > number] = number
    return which


def heading_from_motion(xy: Array, start_direction: int) -> Array:
    """Tangents of the polyline through points (n, 2), turned round at cusps. Shape (n,), unwrapped.

    A turn by more than a right angle between neighbouring pieces is a change of gear. Within a gear, the heading at
    a point is the mean of its two pieces, weighted by the other's length, and at its ends it goes on as it turned:
    exact for points on a circle, but for the chords. At a cusp it is the mean of what both gears say.
    """
    delta = np.diff(xy, axis=0)
    chord = np.arctan2(delta[:, 1], delta[:, 0])
    turns = np.cos(np.diff(chord)) < 0.0
    return headings_along(xy, start_direction * np.concatenate([[1], np.cumprod(np.where(turns, -1, 1))]))


def headings_along(xy: Array, direction: IntArray) -> Array:
    """`heading_from_motion` for pieces whose gears (n - 1,) are known."""
    delta = np.diff(xy, axis=0)
    length = np.hypot(*delta.T)
    chord = np.arctan2(delta[:, 1], delta[:, 0])
    piece = np.unwrap(np.where(direction > 0, chord, chord + np.pi))
    total, count = np.zeros(len(xy)), np.zeros(len(xy))
    edges = [0, *(np.flatnonzero(np.diff(direction)) + 1).tolist(), len(piece)]
    for start, stop in pairwise(edges):
        total[start : stop + 1] += _tangents(piece[start:stop], length[start:stop])
        count[start : stop + 1] += 1.0
    return total / count


def _tangents(piece: Array, length: Array) -> Array:
    """Headings at the n + 1 ends of n pieces of one gear, from the headings and lengths of the pieces."""
    if len(piece) == 1:
        return np.repeat(piece, 2)
    share = length[:-1] / (length[:-1] + length[1:])
    inner = piece[:-1] + share * np.diff(piece)
    return np.concatenate([[2.0 * piece[0] - inner[0]], inner, [2.0 * piece[-1] - inner[-1]]])


def sideways(poses: Array) -> Array:
    """Lateral distance of each of n poses from where its heading and that of the one before lead [m]. Shape (n - 1,).

    On an arc it is zero; a truck that steers as fast as it can adds 2 cm over 1 m.
    """
    middle = (poses[1:, 2] + poses[:-1, 2]) / 2.0
    delta = np.diff(poses[:, :2], axis=0)
    return np.abs(np.cos(middle) * delta[:, 1] - np.sin(middle) * delta[:, 0])
