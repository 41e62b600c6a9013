"""A run in coordinates near 0. The viewer computes in single precision: far from the origin, paths would jitter."""

import dataclasses
from typing import Final

import numpy as np

from optim.model.path import Path
from optim.model.result import Picture
from optim.model.scene import Scene
from optim.numerics.arrays import Array, frozen
from replay.run.case import Case
from replay.run.outcome import MethodRun, Run

FAR: Final = 4096.0
"""Distance from the origin [m] beyond which coordinates are shifted: single precision resolves half a millimetre."""
_STEP: Final = 100.0  # [m]: offsets that people can add in their heads


def localised(run: Run) -> tuple[Run, Array]:
    """The run with all coordinates relative to an offset near its start, and that offset [m]; (0, 0) if near enough."""
    case, offset = localised_case(run.case)
    if case is run.case:
        return run, offset
    return dataclasses.replace(run, case=case, methods=tuple(_method(m, offset) for m in run.methods)), offset


def localised_case(case: Case) -> tuple[Case, Array]:
    """The case likewise: the same object, and (0, 0), if near enough."""
    problem, start = case.problem, case.problem.recorded.start[:2]
    if np.abs(start).max() < FAR:
        return case, np.zeros(2)
    offset = np.round(start / _STEP) * _STEP
    problem = dataclasses.replace(
        problem, scene=_moved_scene(problem.scene, offset), recorded=moved(problem.recorded, offset)
    )
    grid = case.map
    if grid is not None:
        x, y, yaw = grid.origin
        grid = dataclasses.replace(grid, origin=(x - float(offset[0]), y - float(offset[1]), yaw))
    logged = None if case.logged is None else frozen(case.logged - [*offset, 0.0])
    return dataclasses.replace(case, problem=problem, map=grid, logged=logged), offset


def _method(run: MethodRun, offset: Array) -> MethodRun:
    iterates = tuple(dataclasses.replace(iterate, path=moved(iterate.path, offset)) for iterate in run.iterates)
    rejected = None if run.rejected_path is None else moved(run.rejected_path, offset)
    picture = None if run.picture is None else _moved_picture(run.picture, offset)
    return dataclasses.replace(
        run, path=moved(run.path, offset), iterates=iterates, rejected_path=rejected, picture=picture
    )


def _moved_picture(picture: Picture, offset: Array) -> Picture:
    x, y = picture.origin
    origin = (x - float(offset[0]), y - float(offset[1]))
    return dataclasses.replace(picture, points=frozen(picture.points - offset), origin=origin)


def moved(path: Path, offset: Array) -> Path:
    """The path relative to another origin. `offset` is that origin [m], shape (2,)."""
    x, y = offset
    return Path(tuple(dataclasses.replace(seg, x=seg.x - x, y=seg.y - y) for seg in path.segments))


def _moved_scene(scene: Scene, offset: Array) -> Scene:
    boundary = None if scene.boundary is None else frozen(scene.boundary - offset)
    return Scene(polygons=tuple(frozen(p - offset) for p in scene.polygons), boundary=boundary, frame=scene.frame)
