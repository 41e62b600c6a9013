"""The map at a moment of the log, as a scene; each distinct map is built once."""

import dataclasses
import hashlib
from bisect import bisect_right
from dataclasses import dataclass

import numpy as np

from optim.model.scene import Scene, make_scene
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array
from replay.logs.meaning.frames import Frames, frame_name
from replay.logs.meaning.grid import cells_at, check_under_path, grid_polygons, map_image, outline
from replay.logs.meaning.markers import MAX_POLYGONS, Markers, apply_markers, marker_polygons
from replay.logs.meaning.planar import Refusal
from replay.logs.meaning.read_options import ReadOptions
from replay.logs.meaning.topics import Topic, refused
from replay.logs.messages.types import Grid, Marker, Ring
from replay.run.case import MapImage

_BESIDE = 1e-3 * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
"""Offsets from a point on the edge of cells into all cells that may have it on their edge [m]."""
MAX_CORNERS = 10_000
"""Most corners of one polygon."""


@dataclass(frozen=True, eq=False, kw_only=True)
class LogMap:
    """A map that was recorded, understood."""

    scene: Scene
    image: MapImage | None
    centre: Array
    """A point in the middle of it [m]. Shape (2,)."""
    notes: tuple[str, ...]
    options: ReadOptions
    headless: bool = False
    """True if the messages of this map name no frame: the path's is assumed."""

    def check_under(self, vehicle: Vehicle, states: Array) -> None:
        """Raise Refusal if states (N, 4) of the recorded path leave the map, or stand on unknown cells."""
        if self.image is not None:
            check_under_path(self.image, vehicle, states, self.options)

    def hint(self, point: Array) -> str:
        """Advice about an obstacle, given a point on its edge; empty if there is none."""
        if self.image is None or self.options.unknown == "free":
            return ""
        if (cells_at(self.image, point + _BESIDE) == -1).any():
            return "; the cell there is unknown: `--unknown free` takes unknown cells for free"
        return ""


class Maps:
    """The messages of the map's topic."""

    def __init__(self, topic: Topic, options: ReadOptions, frames: Frames) -> None:
        self.topic = topic
        self.frames = frames
        self.options = options
        self._times = [message.log_time for message in topic.messages]
        self._understood: dict[int, LogMap] = {}
        self._grids: dict[tuple[object, ...], LogMap] = {}
        """Maps by the content of their messages: a latched map repeats itself."""
        self._markers_then: tuple[int, Markers] = 0, {}
        """The markers that are there after the first `count` messages."""

    def index_at(self, log_time: int) -> int:
        """The newest message up to a time, else the first one after it."""
        return max(0, bisect_right(self._times, log_time) - 1)

    def at(self, log_time: int) -> tuple[LogMap, list[str]]:
        """The map at a time [ns], and notes. Raises LogError."""
        index = self.index_at(log_time)
        notes = ["the map was logged after the path"] if self._times[index] > log_time else []
        try:
            if index not in self._understood:
                builders = {"grid": self._grid, "markers": self._markers, "polygon": self._polygons}
                self._understood[index] = builders[self.topic.message_type.role](index)
            return self._understood[index], notes
        except Refusal as error:
            refused(self.topic, index, error)
        except ValueError as error:  # from the scene: shapes that are not obstacles, grids too wide
            self.topic.fail("E_MAP", str(error), index)

    def _grid(self, index: int) -> LogMap:
        grid: Grid = self.topic.decode(index)
        content = hashlib.sha256(grid.data.tobytes() + grid.origin.tobytes()).digest()
        key = grid.header.frame, grid.width, grid.resolution, content
        if key not in self._grids:
            self._grids[key] = self._build_grid(grid)
        return self._grids[key]

    def _build_grid(self, grid: Grid) -> LogMap:
        image, notes = map_image(grid)
        boundary = outline(image)
        polygons = grid_polygons(image, self.options)
        walled = boundary if self.options.unknown == "obstacle" else None
        return LogMap(
            scene=make_scene(polygons, boundary=walled, frame=frame_name(grid.header.frame)),
            image=image,
            centre=boundary.mean(axis=0),
            notes=tuple(notes),
            options=self.options,
        )

    def _markers(self, index: int) -> LogMap:
        done, state = self._markers_then  # requests come in order of time: each message is applied once
        for i in range(done, index + 1):
            apply_markers(state, self.topic.decode(i))
        self._markers_then = index + 1, state
        return self._build_markers(state)

    def _build_markers(self, state: Markers) -> LogMap:
        if not state:
            raise Refusal("E_NO_MAP", "all its markers are deleted at that time")
        frame, every = self._markers_in_one_frame(list(state.values()))
        polygons, notes = marker_polygons(every, self.options.height)
        return self._map_of_shapes(polygons, notes, frame)

    def _map_of_shapes(self, polygons: list[Array], notes: list[str], frame: str | None) -> LogMap:
        """A map of polygons alone; `frame` is None where its messages name none."""
        points = np.concatenate(polygons) if polygons else np.zeros((1, 2))
        return LogMap(
            scene=make_scene(polygons, frame=frame or ""),
            image=None,
            centre=(points.min(axis=0) + points.max(axis=0)) / 2.0,
            notes=tuple(notes if polygons else [*notes, "the map has no obstacles"]),
            options=self.options,
            headless=frame is None,
        )

    def _markers_in_one_frame(self, markers: list[Marker]) -> tuple[str, list[Marker]]:
        """The frame of most markers, and all of them in it."""
        named = [frame_name(marker.header.frame) for marker in markers]
        frame = max(sorted(set(named)), key=named.count)
        if len(set(named)) == 1:
            return frame, markers
        try:
            moved = [
                self.frames.moved(_unit(each.pose)[None], name, frame)[0]
                for each, name in zip(markers, named, strict=True)
            ]
        except Refusal as error:
            listed = ", ".join(map(repr, sorted(set(named))[:5]))
            raise Refusal("E_FRAME", f"its markers are in several frames, {listed}: {error}") from None
        return frame, [dataclasses.replace(each, pose=pose) for each, pose in zip(markers, moved, strict=True)]

    def _polygons(self, index: int) -> LogMap:
        messages: list[tuple[Ring, ...]] = []
        moment = None
        for i in range(index, -1, -1):  # one message for each polygon: those of one moment are one map
            each: tuple[Ring, ...] = self.topic.decode(i)
            stamps = {ring.header.stamp if ring.header else self._times[i] for ring in each}
            moment = stamps if moment is None else moment
            if stamps != moment:
                break
            messages.append(each)
        return self._build_polygons([ring for each in reversed(messages) for ring in each])

    def _build_polygons(self, rings: list[Ring]) -> LogMap:
        frames = sorted({frame_name(ring.header.frame) for ring in rings if ring.header})
        if len(frames) > 1:
            raise Refusal("E_FRAME", f"its polygons are in several frames: {', '.join(map(repr, frames[:5]))}")
        polygons, notes = ring_polygons(rings)
        return self._map_of_shapes(polygons, notes, frames[0] if frames else None)


def _unit(pose: Array) -> Array:
    """A marker's pose; one that was never turned has a quaternion of zeros."""
    return pose if pose[3:].any() else np.array([*pose[:3], 0.0, 0.0, 0.0, 1.0])


def ring_polygons(rings: list[Ring]) -> tuple[list[Array], list[str]]:
    """Outlines (n, 2) of the polygons that have a corner, and notes. Raises Refusal."""
    polygons = []
    for number, ring in enumerate(rings):
        if not np.isfinite(ring.points).all() or np.abs(ring.points).max(initial=0.0) > 1e8:
            raise Refusal("E_NONFINITE", f"polygon {number} holds a value that is not a finite place")
        if len(ring.points) > MAX_CORNERS:
            text = f"polygon {number} has {len(ring.points)} corners, expected at most {MAX_CORNERS}"
            raise Refusal("E_TOO_MANY_SHAPES", text)
        if len(ring.points):
            polygons.append(ring.points[:, :2])
    if len(polygons) > MAX_POLYGONS:
        raise Refusal("E_TOO_MANY_SHAPES", f"the map has more than {MAX_POLYGONS} polygons")
    empty = len(rings) - len(polygons)
    return polygons, [f"polygons that are not obstacles: {empty}, they are empty"] if empty else []
