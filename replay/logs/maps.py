"""The map at a moment of the log, as a scene; each distinct map is built once."""

import hashlib
from bisect import bisect_right
from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from optim.arrays import Array
from optim.scene import Scene, make_scene
from optim.vehicle import Vehicle
from replay.case import MapImage
from replay.logs.grid import cells_at, check_under_path, grid_polygons, map_image, outline
from replay.logs.markers import Markers, apply_markers, marker_polygons
from replay.logs.options import ReadOptions
from replay.logs.planar import Refusal
from replay.logs.ros2 import Grid
from replay.logs.topics import Topic, refused


@dataclass(frozen=True, eq=False, kw_only=True)
class LogMap:
    """A map that was recorded, understood."""

    scene: Scene
    image: MapImage | None
    centre: Array
    """A point in the middle of it [m]. Shape (2,)."""
    notes: tuple[str, ...]
    options: ReadOptions

    def check_under(self, vehicle: Vehicle, states: Array) -> None:
        """Raise Refusal if states (N, 4) of the recorded path leave the map, or stand on unknown cells."""
        if self.image is not None:
            check_under_path(self.image, vehicle, states, self.options)

    def hint(self, point: Array) -> str:
        """What a user may try about an obstacle at a point."""
        if self.image is not None and cells_at(self.image, point) == -1:
            return "; the cell there is unknown: `--unknown free` takes unknown cells for free"
        return ""


class Maps:
    """The messages of the map's topic."""

    def __init__(self, topic: Topic, options: ReadOptions) -> None:
        self.topic = topic
        self.options = options
        self._times = [message.log_time for message in topic.messages]
        self._built: dict[object, LogMap] = {}
        self._key_of: dict[int, object] = {}

    def index_at(self, log_time: int) -> int:
        """The newest message up to a time, else the first one after it."""
        return max(0, bisect_right(self._times, log_time) - 1)

    def at(self, log_time: int) -> tuple[LogMap, list[str]]:
        """The map at a time [ns], and notes. Raises LogError."""
        index = self.index_at(log_time)
        notes = ["the map was logged after the path"] if self._times[index] > log_time else []
        try:
            build = self._grid if self.topic.family.role == "grid" else self._markers
            return build(index), notes
        except Refusal as error:
            refused(self.topic, index, error)
        except ValueError as error:  # from the scene: shapes that are no obstacles, grids too wide
            self.topic.fail("E_MAP", str(error), index)

    def _once(self, index: int, key: object, build: Callable[[], LogMap]) -> LogMap:
        self._key_of[index] = key
        if key not in self._built:
            self._built[key] = build()
        return self._built[key]

    def _grid(self, index: int) -> LogMap:
        if index in self._key_of:
            return self._built[self._key_of[index]]
        grid: Grid = self.topic.decode(index)
        content = hashlib.sha256(grid.data.tobytes() + grid.origin.tobytes()).digest()
        key = grid.header.frame, grid.width, grid.resolution, content
        return self._once(index, key, lambda: self._build_grid(grid))

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
        if index in self._key_of:
            return self._built[self._key_of[index]]
        state: Markers = {}
        for i in range(index + 1):
            apply_markers(state, self.topic.decode(i))
        return self._once(index, index, lambda: self._build_markers(state))

    def _build_markers(self, state: Markers) -> LogMap:
        frames = sorted({frame_name(marker.header.frame) for marker in state.values()})
        if len(frames) > 1:
            raise Refusal("E_FRAME", f"its markers are in several frames: {', '.join(map(repr, frames[:5]))}")
        if not state:
            raise Refusal("E_NO_MAP", "all its markers are deleted at that time")
        polygons, notes = marker_polygons(state.values(), self.options.height)
        points = np.concatenate(polygons) if polygons else np.zeros((1, 2))
        return LogMap(
            scene=make_scene(polygons, frame=frames[0]),
            image=None,
            centre=(points.min(axis=0) + points.max(axis=0)) / 2.0,
            notes=tuple(notes if polygons else [*notes, "the map has no obstacles"]),
            options=self.options,
        )


def frame_name(frame: str) -> str:
    """A frame without the leading slash of ROS 1."""
    return frame.removeprefix("/")
