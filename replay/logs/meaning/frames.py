"""Coordinate frames: the static transforms between them that the log holds."""

import dataclasses
from collections import deque
from collections.abc import Iterable, Sequence
from functools import cached_property

import numpy as np

from optim.numerics.arrays import Array, frozen
from replay.base.errors import printable
from replay.logs.meaning.planar import NORM_REFUSED, Refusal, rotation
from replay.logs.meaning.topics import Topic
from replay.logs.messages.types import PoseSeries, Transform

STILL = 1e-6
"""Transforms between two frames that differ by less are the same [m, or of a quaternion's parts]."""
MOST_FRAMES = 10_000
"""Largest number of pairs of frames."""


def frame_name(frame: str) -> str:
    """A frame without the leading slash of ROS 1."""
    return frame.removeprefix("/")


class Frames:
    """The transforms of a log. They are decoded only when two frames differ."""

    def __init__(self, topics: Sequence[Topic]) -> None:
        self._moves: dict[tuple[str, str], Array] = {}
        """Largest distance [m] and angle [rad] of a moving frame from its first pose. Shape (2,)."""
        self._topics = [topic for topic in topics if topic.message_type.role == "transforms"]

    @cached_property
    def _links(self) -> dict[tuple[str, str], Array | None]:
        """Pose of the second frame in the first, shape (7,), by pairs; None where it changes in the log."""
        links: dict[tuple[str, str], Array | None] = {}
        first: dict[tuple[str, str], Array] = {}
        for transform in self.every():
            pair = frame_name(transform.header.frame), frame_name(transform.child)
            known = first.setdefault(pair, transform.pose)
            links.setdefault(pair, known)
            if known is not transform.pose and not _is_same(known, transform.pose):
                links[pair] = None
                self._moves[pair] = np.maximum(self._moves.get(pair, 0.0), _moved_by(known, transform.pose))
            if len(links) > MOST_FRAMES:
                raise Refusal("E_FRAME", f"its transforms name more than {MOST_FRAMES} pairs of frames")
        return links

    def every(self) -> Iterable[Transform]:
        """All transforms of the log, topic by topic. Raises LogError."""
        for topic in self._topics:
            for index in range(len(topic.messages)):
                yield from topic.decode(index)

    def moved(self, poses: Array, source: str, target: str) -> Array:
        """Poses (n, 7) that are given in frame `source`, in frame `target`.

        Raises:
            Refusal: the log does not say how the frames lie to each other, or they move.
        """
        for link, is_forward in self._way(source, target):
            turn, shift = _checked(link)
            if is_forward:  # from the frame that is described to the one in which it is
                place = poses[:, :3] @ rotation(turn).T + shift
            else:
                place = (poses[:, :3] - shift) @ rotation(turn)
                turn = turn * [-1.0, -1.0, -1.0, 1.0]
            poses = np.column_stack([place, _product(turn, poses[:, 3:])])
        return poses

    def _way(self, source: str, target: str) -> list[tuple[Array, bool]]:
        """Links to follow from a frame to another, and for each whether it leads from child to parent."""
        beside: dict[str, list[tuple[str, Array | None, bool]]] = {}
        for (parent, child), pose in self._links.items():
            beside.setdefault(child, []).append((parent, pose, True))
            beside.setdefault(parent, []).append((child, pose, False))
        from_where: dict[str, tuple[str, Array, bool] | None] = {source: None}
        todo, moving = deque([source]), ""
        while todo and target not in from_where:
            here = todo.popleft()
            for there, pose, is_forward in beside.get(here, []):
                if pose is None:
                    moving = self._movement(here, there) if target in (here, there) else moving
                elif there not in from_where:
                    from_where[there] = here, pose, is_forward
                    todo.append(there)
        if target not in from_where:
            why = moving or "no static transform between them is in the log"
            raise Refusal("E_FRAME", f"frames {printable(source, 60)!r} and {printable(target, 60)!r}: {why}")
        way: list[tuple[Array, bool]] = []
        last = from_where[target]
        while last is not None:
            here, pose, is_forward = last
            way.append((pose, is_forward))
            last = from_where[here]
        return way[::-1]

    def _movement(self, frame: str, other: str) -> str:
        shift, turn = self._moves[(frame, other) if (frame, other) in self._moves else (other, frame)]
        if not np.isfinite(shift + turn):
            return "they move against each other"
        return f"they move against each other, by up to {shift:.3g} m and {np.degrees(turn):.2f} degrees"


def in_frame(series: PoseSeries, target: str, where: str, frames: Frames) -> tuple[PoseSeries, list[str]]:
    """A path in another frame, and notes. `where`: what is in that frame, for errors.

    Raises:
        Refusal: it names several frames, or none, or one that the log does not relate to `target`.
    """
    named = sorted({frame_name(frame) for frame in (series.header.frame, *(series.frames - {""}))})
    if not target and named == [""]:
        raise Refusal("E_FRAME", f"neither it nor {where} names its frame (frame_id is empty)")
    others = [frame for frame in named if frame != target]
    if not others:
        return series, []
    text = f"it is in frame {printable(others[0], 60)!r} and {where} in {printable(target, 60)!r}"
    if len(named) > 1 or not others[0] or not target:
        raise Refusal("E_FRAME", f"{text}, expected one frame for both")
    try:
        poses = frozen(frames.moved(series.poses, others[0], target))
    except Refusal as error:
        raise Refusal(error.code, f"{text}, expected one frame for both, or a static transform ({error})") from None
    note = f"it is in frame {printable(others[0], 60)!r}; a transform of the log puts it into {printable(target, 60)!r}"
    header = series.header._replace(frame=target)
    return dataclasses.replace(series, header=header, frames=frozenset(), poses=poses), [note]


def _is_same(pose: Array, other: Array) -> bool:
    """True if two transforms (7,) differ by less than `STILL`; a quaternion and its negative are the same rotation."""
    with np.errstate(over="ignore", invalid="ignore"):  # nothing has checked these values yet
        sign = 1.0 if pose[3:] @ other[3:] >= 0.0 else -1.0
        return bool(np.abs(pose - other * [1.0, 1.0, 1.0, sign, sign, sign, sign]).max() <= STILL)


def _moved_by(pose: Array, other: Array) -> Array:
    """Distance [m] and angle [rad] between two transforms (7,). Shape (2,)."""
    with np.errstate(over="ignore", invalid="ignore"):  # nothing has checked these values yet
        half = np.arccos(np.clip(np.abs(pose[3:] @ other[3:]), 0.0, 1.0))
        return np.array([float(np.linalg.norm(pose[:3] - other[:3])), 2.0 * float(half)])


def _checked(pose: Array) -> tuple[Array, Array]:
    """Unit quaternion and position of a transform. Raises Refusal."""
    if not np.isfinite(pose).all():
        raise Refusal("E_NONFINITE", "a transform holds a value that is not finite")
    norm = float(np.linalg.norm(pose[3:]))
    if abs(norm - 1.0) > NORM_REFUSED:
        raise Refusal("E_QUATERNION", f"a transform's quaternion has the norm {norm:.6g}, expected 1")
    return pose[3:] / norm, pose[:3]


def _product(left: Array, right: Array) -> Array:
    """Quaternion products of one with each of several, x, y, z, w. right: (n, 4). Shape (n, 4)."""
    x, y, z, w = left
    a, b, c, d = right.T
    return np.stack(
        [
            w * a + x * d + y * c - z * b,
            w * b - x * c + y * d + z * a,
            w * c + x * b - y * a + z * d,
            w * d - x * a - y * b - z * c,
        ],
        axis=1,
    )
