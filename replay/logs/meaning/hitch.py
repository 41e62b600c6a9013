"""Hitch angles from what a log holds beside the trailer's path: a joint's state, or a transform of the trailer."""

from collections.abc import Sequence
from typing import NamedTuple

import numpy as np

from optim.numerics.arrays import Array, IntArray
from replay.base.errors import LogError, printable
from replay.logs.meaning.frames import Frames, frame_name
from replay.logs.meaning.pairing import at_stamps, hitch_angles
from replay.logs.meaning.planar import Refusal, planar
from replay.logs.meaning.read_options import ReadOptions
from replay.logs.meaning.recorded_poses import RecordedPoses
from replay.logs.meaning.topics import Topic
from replay.logs.messages.types import Joints, PoseSeries, Transform
from replay.run.case import HitchSource

DISAGREE = 0.02
"""Least difference between two sources of the hitch angle that gets a note [rad]."""
JOINT_WORDS = ("hitch", "trailer", "articulation", "kingpin", "fifth_wheel", "fifthwheel")
"""A joint whose name holds one of these is the hitch, unless it is a wheel."""
FRAME_WORD = "trailer"
"""A frame whose name holds this is the trailer's."""


class Angles(NamedTuple):
    """One source of hitch angles, k samples."""

    kind: HitchSource
    name: str
    """Description for messages."""
    times: IntArray
    """[ns], shape (k,)."""
    values: Array
    """[rad], shape (k,)."""
    is_heading: bool
    """The values are headings of the trailer, not angles between trailer and truck."""


class Hitch(NamedTuple):
    """Hitch angle of a request."""

    source: HitchSource
    alpha: Array | None
    """Hitch angle at each kept pose [rad], shape (n,); None: it is integrated from `initial`."""
    initial: float
    notes: list[str]
    sign_of: str = ""
    """Source of `alpha`, where its sign is a matter of convention."""


def sources(
    topics: Sequence[Topic], frames: Frames, path_frame: str, options: ReadOptions
) -> tuple[list[Angles], list[str]]:
    """Sources of hitch angles beside paths, best first, and notes about those that cannot be used.

    Raises:
        LogError, Refusal: an option asks for one that cannot be used.
    """
    found, notes = [], []
    for read, is_asked_for in (
        (lambda: _joint(topics, options), options.hitch_joint is not None),
        (lambda: _transform(frames, path_frame, options), options.trailer_frame is not None),
    ):
        try:
            angles = read()
            found += [angles] if angles else []
        except (LogError, Refusal) as error:
            if is_asked_for:
                raise
            text = error.message if isinstance(error, LogError) else str(error)
            notes.append(f"hitch angles beside the trailer's path are not used: {text}")
    return found, notes


def _joint(topics: Sequence[Topic], options: ReadOptions) -> Angles | None:
    samples: dict[str, list[tuple[int, float]]] = {}
    for topic in topics:
        for index, message in enumerate(topic.messages if topic.message_type.role == "joints" else ()):
            state: Joints
            for state in topic.decode(index):
                time = state.stamp or message.log_time
                for name, position in zip(state.names, state.positions.tolist(), strict=False):
                    samples.setdefault(name, []).append((time, position))
    if options.hitch_joint is not None:
        if options.hitch_joint not in samples:
            raise Refusal(
                "E_NO_TOPIC", f"--hitch-joint {options.hitch_joint!r} is none of its joints: {_listed(samples)}"
            )
        names = [options.hitch_joint]
    else:
        names = [name for name in samples if _is_hitch(name.lower())]
    if len(names) > 1:
        raise Refusal("E_AMBIGUOUS", f"several joints may be the hitch: {_listed(names)}; choose with --hitch-joint")
    return _angles("joint", f"joint {printable(names[0], 60)!r}", samples[names[0]], False) if names else None


def _is_hitch(name: str) -> bool:
    fifth = "fifth" in name
    return any(word in name for word in JOINT_WORDS) and (fifth or "wheel" not in name)


def _transform(frames: Frames, path_frame: str, options: ReadOptions) -> Angles | None:
    found: dict[tuple[str, str], list[tuple[int, Transform]]] = {}
    for each in frames.every():
        pair = frame_name(each.header.frame), frame_name(each.child)
        if pair[1] == options.trailer_frame or (options.trailer_frame is None and FRAME_WORD in pair[1].lower()):
            found.setdefault(pair, []).append((each.header.stamp, each))
    # a frame that hangs on another of the trailer's says nothing about the hitch
    pairs = [pair for pair in found if FRAME_WORD not in pair[0].lower()]
    if not pairs:
        if options.trailer_frame is not None:
            raise Refusal("E_NO_TOPIC", f"--trailer-frame {options.trailer_frame!r}: no transform of such a frame")
        return None
    if len(pairs) > 1:
        listed = _listed([child for _, child in pairs])
        raise Refusal("E_AMBIGUOUS", f"several frames may be the trailer's: {listed}; choose with --trailer-frame")
    parent, child = pairs[0]
    samples = found[pairs[0]]
    poses = np.array([transform.pose for _, transform in samples])
    is_heading = True
    try:
        poses = frames.moved(poses, parent, path_frame)
    except Refusal:  # it hangs on something that moves: on the truck
        is_heading = False
    yaw = planar(poses, f"the transform of {printable(child, 60)!r}")[0][:, 2]
    times = [stamp for stamp, _ in samples]
    name = f"the transform from {printable(parent, 60)!r} to {printable(child, 60)!r}"
    return _angles("transform", name, list(zip(times, yaw.tolist(), strict=True)), is_heading)


def _listed(names: Sequence[str] | dict[str, list[tuple[int, float]]]) -> str:
    shown = [printable(name, 40) for name in names]
    return ", ".join(shown[:8]) + (f" and {len(shown) - 8} more" if len(shown) > 8 else "") if shown else "it has none"


def _angles(kind: HitchSource, name: str, samples: list[tuple[int, float]], is_heading: bool) -> Angles:
    samples = sorted(samples)
    values = np.array([value for _, value in samples])
    if not np.isfinite(values).all():
        raise Refusal("E_NONFINITE", f"{name} holds an angle that is not finite")
    return Angles(kind, name, np.array([time for time, _ in samples], np.int64), values, is_heading)


def at_poses(angles: Angles, recorded: RecordedPoses, series: PoseSeries, log_time: int) -> Array | float:
    """Hitch angles at the kept poses (n,), or only the one at the time of a path that was planned as a whole.

    Raises:
        Refusal: the samples end before the path does, or an angle is not a hitch angle.
    """
    values = np.unwrap(angles.values)
    count = len(series.poses)
    if count > 1 and np.ptp(series.stamps) > 0:
        alpha = recorded.averaged(at_stamps(series.stamps, angles.times, values[:, None], angles.name))[:, 0]
    elif len(values) == count > 1:
        alpha = recorded.averaged(values[:, None])[:, 0]
    else:
        time = series.header.stamp or log_time
        alpha = values[max(0, int(np.searchsorted(angles.times, time, side="right")) - 1)][None]
    if angles.is_heading:
        alpha = alpha - recorded.poses[: len(alpha), 2]
    try:
        alpha = hitch_angles(alpha, of_poses=False)
    except Refusal:
        if not angles.is_heading:
            _refuse_degrees(angles)
        raise
    return alpha if len(alpha) > 1 else float(alpha[0])


def _refuse_degrees(angles: Angles) -> None:
    """E_HITCH for a largest angle that no hitch has in radians, and many have in degrees."""
    largest = float(angles.values[np.argmax(np.abs(angles.values))])
    if np.pi < abs(largest) < 180.0:
        raise Refusal("E_HITCH", f"it holds an angle of {largest:.1f} rad, expected below 1.57: is it in degrees?")


def combined(
    trailer: Array | None,
    others: Sequence[Angles],
    recorded: RecordedPoses,
    series: PoseSeries,
    log_time: int,
    initial: float,
) -> Hitch:
    """The hitch angle from the best source; a note for each of the others that says something else.

    trailer: hitch angles from the trailer's path (n,), or None. initial: where nothing in the log says it [rad].
    """
    found: list[tuple[HitchSource, str, Array | float]] = []
    if trailer is not None:
        found.append(("trailer path", "the trailer's path", trailer))
    notes: list[str] = []
    for angles in others:
        try:
            found.append((angles.kind, angles.name, at_poses(angles, recorded, series, log_time)))
        except Refusal as error:
            notes.append(f"hitch angles are not taken from {angles.name}: {error}")
    found.sort(key=lambda each: isinstance(each[2], float))  # whole series first
    if not found:
        return Hitch("reconstructed", None, initial, notes)
    kind, name, best = found[0]
    for _, other, alpha in found[1:]:
        off = np.abs(np.atleast_1d(alpha) - (best if isinstance(alpha, np.ndarray) else np.atleast_1d(best)[0]))
        row = int(np.argmax(off))
        if off[row] > DISAGREE:
            text = f"hitch angles from {other} differ from those of {name} by up to {off[row]:.3f} rad"
            notes.append(f"{text} (pose {recorded.kept[row]})")
    if not isinstance(best, np.ndarray):
        notes.append(f"the hitch angle at the first pose, {best:.3f} rad, is that of {name}")
        return Hitch("reconstructed", None, best, notes)
    return Hitch(kind, best, initial, notes, name if kind == "joint" else "")
