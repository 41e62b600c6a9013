"""Parts of the plan view that all paths share: map, obstacles, start and goal, legend.

Everything lies under /scene, which mirrors y: the viewer's plan views point y down, maps point it up.
"""

import math
from typing import Final

import numpy as np
import rerun as rr
import shapely
from shapely.geometry.base import BaseGeometry

from optim.model.problem import Problem
from optim.model.scene import Scene
from optim.model.vehicle import body_corners
from optim.numerics.arrays import Array
from replay.base.style import Colour
from replay.recording.entities import LABEL, OUTSIDE, entity, image, label, points
from replay.recording.picture import Frame, closed, fill, obstacle_area, rings
from replay.recording.text import plain
from replay.run.case import Case, MapImage

_DRAWN_CELLS: Final = 1600  # along the longer side of a map drawn from shapes
_MOST_PIXELS: Final = 8192  # along a side; some browsers draw no larger textures
_FREE, _UNKNOWN, _OCCUPIED = 33, 58, 104  # grey levels
_SCALE_SHARE: Final = 0.2  # of the frame's width, at most
_OUTLINE: Final[Colour] = (150, 156, 166)


def log_ground(rec: rr.RecordingStream, case: Case, frame: Frame) -> None:
    """The map as it was recorded, or one drawn from the obstacles; outlines of what methods had to respect."""
    scene = case.problem.scene
    area = obstacle_area(scene)
    rec.log("/scene", rr.Transform3D(mat3x3=np.diag([1.0, -1.0, 1.0])), static=True)
    if case.map is not None:
        pixels, x, y, yaw, cell = _grid_pixels(case.map, frame)
    else:
        pixels, x, y, yaw, cell = _drawn_pixels(scene, area, frame), frame.x0, frame.y0, 0.0, frame.size / _DRAWN_CELLS
    placed = rr.Transform3D(
        translation=[x, y, 0.0],
        quaternion=rr.Quaternion(xyzw=[0.0, 0.0, math.sin(yaw / 2), math.cos(yaw / 2)]),
        scale=[cell, cell, 1.0],
    )
    rec.log("/scene/map", placed, image(pixels, -100.0), static=True)
    outlines = rings(area) + ([closed(scene.boundary)] if scene.boundary is not None else [])
    strips = _within(outlines, frame)
    rec.log(
        "/scene/obstacles",
        rr.LineStrips2D(strips, colors=[_OUTLINE], radii=points(0.75), draw_order=-50.0),
        static=True,
    )


def _within(lines: list[Array], frame: Frame) -> list[Array]:
    """Polylines clipped to the frame, as the map is: the legend lies above it. Each (n, 2)."""
    cut = shapely.intersection(shapely.MultiLineString(lines), shapely.box(*frame))
    return [shapely.get_coordinates(part) for part in shapely.get_parts(cut) if part.geom_type == "LineString"]


def _drawn_pixels(scene: Scene, area: BaseGeometry, frame: Frame) -> np.ndarray:
    """A map from shapes, grey levels of the whole frame."""
    cell = frame.size / _DRAWN_CELLS
    occupied = fill(area, frame, cell)
    pixels = np.full(occupied.shape, OUTSIDE[0], np.uint8)
    if scene.boundary is not None:
        pixels[fill(shapely.Polygon(scene.boundary), frame, cell)] = _FREE
    pixels[occupied] = _OCCUPIED
    return pixels


def _grid_pixels(grid: MapImage, frame: Frame) -> tuple[np.ndarray, float, float, float, float]:
    """The part of a grid that is in the frame: grey levels, position and yaw of its corner, side of a pixel [m]."""
    x, y, yaw = grid.origin
    c, s = math.cos(yaw), math.sin(yaw)
    corners = shapely.get_coordinates(frame.box)[:4] - [x, y]
    cells = corners @ np.array([[c, -s], [s, c]]) / grid.resolution
    low = np.clip(np.floor(cells.min(axis=0)), 0, None).astype(int)
    high = np.ceil(cells.max(axis=0)).astype(int)
    step = max(1, math.ceil((high - low).max() / _MOST_PIXELS))
    part = grid.cells[low[1] : high[1] : step, low[0] : high[0] : step]
    if part.size == 0:
        part = np.full((1, 1), -1, np.int8)
    grey = np.select([part < 0, part >= 65], [_UNKNOWN, _OCCUPIED], _FREE).astype(np.uint8)
    dx, dy = low * grid.resolution
    return grey, x + c * dx - s * dy, y + s * dx + c * dy, yaw, step * grid.resolution


def log_ends(rec: rr.RecordingStream, problem: Problem) -> None:
    """Outlines of the combination at start and goal, which every path shares."""
    for name, state, level in (("start", problem.recorded.start, 190), ("goal", problem.recorded.goal, 255)):
        corners = body_corners(problem.vehicle, state[None])[0]
        outlines = rr.LineStrips2D(
            [closed(body) for body in corners],
            colors=[(level, level, level)],
            radii=points(1.0),
            draw_order=5.0,
        )
        rec.log(f"/scene/ends/{name}", outlines, static=True)
        middle = corners[1].mean(axis=0)  # of the trailer: near the truck there are other labels
        rec.log(f"/scene/ends/{name}/label", label(middle, name), static=True)


def log_scale(rec: rr.RecordingStream, frame: Frame, problem: Problem) -> None:
    """A bar of a round length, with room below it for its label: a plan view has no axes.

    It is in the lower corner that is farther from the vehicle at start and goal, which have labels too.
    """
    most = _SCALE_SHARE * frame.width
    decade = 10.0 ** math.floor(math.log10(most))
    length = next(step * decade for step in (5.0, 2.0, 1.0) if step * decade <= most)
    edge, y, tick = 0.04 * frame.size, frame.y0 + 0.08 * frame.size, 0.008 * frame.size
    bodies = body_corners(problem.vehicle, np.stack([problem.recorded.start, problem.recorded.goal])).reshape(-1, 2)
    corners = [frame.x0 + edge, frame.x1 - edge - length]
    x = max(corners, key=lambda left: float(np.hypot(*(bodies - [left + length / 2, y]).T).min()))
    bar = [[x, y + tick], [x, y], [x + length, y], [x + length, y + tick]]
    rec.log("/scene/scale", rr.LineStrips2D([bar], colors=[LABEL], radii=points(1.0), draw_order=44.0), static=True)
    rec.log("/scene/scale/label", label(np.array([x + length / 2, y]), f"{length:g} m"), static=True)


def log_legend(rec: rr.RecordingStream, frame: Frame, entries: list[tuple[str, Colour]], name: str) -> float:
    """Swatches with labels in rows of three above the frame; the height they take [m]."""
    column, row = frame.width / 3, 0.05 * frame.size
    rows = math.ceil(len(entries) / 3)
    swatches = []
    for k in range(len(entries)):
        x = frame.x0 + (k % 3 + 0.5) * column
        y = frame.y1 + (rows - k // 3) * row - 0.2 * row
        swatches.append([[x - 0.2 * column, y], [x + 0.2 * column, y]])
    shown = rr.LineStrips2D(swatches, colors=[colour for _, colour in entries], radii=points(3.0), draw_order=61.0)
    rec.log(entity("scene", "legend", name, "swatches"), shown, static=True)
    legend = rr.LineStrips2D(
        swatches,
        colors=[LABEL],
        labels=[plain(text) for text, _ in entries],
        radii=points(0.5),
        show_labels=True,
        draw_order=60.0,
    )
    rec.log(entity("scene", "legend", name), legend, static=True)
    return rows * row
