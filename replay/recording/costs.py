"""Cost map and points of a method that moves points; points held in place are drawn separately."""

import math
from typing import Any, Final

import numpy as np
import rerun as rr

from optim.model.result import Picture
from optim.model.scene import Scene
from optim.numerics.arrays import Array
from replay.base.style import Colour
from replay.recording.entities import BRIGHT, entity, image, points
from replay.recording.ground import log_legend
from replay.recording.picture import Frame
from replay.recording.text import number
from replay.recording.tracks import Track

_COST: Final[Colour] = (236, 132, 44)
_MOST_PIXELS: Final = 1200  # along a side
_OPAQUE: Final = 170  # of 255: obstacles below show through


def log_costs(rec: rr.RecordingStream, scene: Scene, tracks: list[Track], frame: Frame) -> dict[str, float]:
    """The pictures of those methods that have one; heights of their legends above the frame by method's name [m].

    Of the cost, what lies on the map is shown: a method may look beyond it.
    """
    shown = [frame.x0, frame.y0], [frame.x1, frame.y1]
    if scene.boundary is not None:
        shown = scene.boundary.min(axis=0), scene.boundary.max(axis=0)
    return {track.name: _log(rec, track, track.picture, frame, shown) for track in tracks if track.picture is not None}


def _log(rec: rr.RecordingStream, track: Track, picture: Picture, frame: Frame, shown: tuple[Any, Any]) -> float:
    base = entity("scene", track.name, "cost")
    step = math.ceil(max(picture.cost_map.shape) / _MOST_PIXELS)
    values, (x, y) = _within(picture, *shown)
    values = values[::step, ::step]
    largest = float(picture.cost_map.max())
    pixels = np.zeros((*values.shape, 4), np.uint8)
    pixels[..., :3] = _COST
    pixels[..., 3] = np.round(_OPAQUE * np.clip(values / max(largest, 1e-300), 0.0, 1.0))
    cell = step * picture.resolution
    corner = [x - 0.5 * cell, y - 0.5 * cell, 0.0]  # nodes are the pixels' centres
    rec.log(f"{base}/map", rr.Transform3D(translation=corner, scale=[cell] * 3), image(pixels, -30.0), static=True)
    kinds = [
        ("moved", ~picture.anchored, track.style.colour, 2.0),
        ("anchored", picture.anchored, BRIGHT, 3.5),
    ]
    for k, (name, chosen, colour, size) in enumerate(kinds):
        dots = rr.Points2D(picture.points[chosen], colors=[colour], radii=points(size), draw_order=32.0 + k)
        rec.log(f"{base}/{name}", dots, static=True)
    entries = [
        (f"cost of a place, 0 to {number(largest, 0)}", _COST),
        (f"{int((~picture.anchored).sum())} points moved", track.style.colour),
        (f"{int(picture.anchored.sum())} points held in place", BRIGHT),
    ]
    return log_legend(rec, frame, entries, f"cost {track.name}")


def _within(picture: Picture, low: Any, high: Any) -> tuple[Array, tuple[float, float]]:
    """The part of the cost map between two corners [m], and its first node [m]."""
    columns, rows = (
        _between(picture.origin[axis], picture.resolution, picture.cost_map.shape[1 - axis], low[axis], high[axis])
        for axis in (0, 1)
    )
    x, y = (picture.origin[axis] + picture.resolution * part.start for axis, part in ((0, columns), (1, rows)))
    return picture.cost_map[rows, columns], (x, y)


def _between(origin: float, resolution: float, count: int, low: float, high: float) -> slice:
    """The nodes from low to high; all nodes where none lies there."""
    inside = np.flatnonzero(np.abs(origin + resolution * np.arange(count) - 0.5 * (low + high)) <= 0.5 * (high - low))
    return slice(int(inside[0]), int(inside[-1]) + 1) if len(inside) else slice(0, count)
