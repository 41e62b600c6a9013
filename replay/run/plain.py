"""Paths and scenes as plain data, as the results file holds them and as the audit takes them; and back."""

from typing import Any, Final

import numpy as np

from optim.model.path import Path, Segment
from optim.model.scene import Scene
from optim.numerics.arrays import frozen
from replay.base.documents import DocumentError, convert
from replay.base.errors import ReplayError
from replay.base.schemas.results import PathDocument, SceneDocument

RESULTS_ERROR: Final = "E_RESULTS"
COLUMNS: Final = ("s", "x", "y", "theta", "alpha", "phi")


def scene_to_document(scene: Scene, margin: float | None = None) -> dict[str, Any]:
    """A scene as plain data: polygons and boundary as lists of [x, y] in metres."""
    return {
        "polygons": [np.asarray(polygon).tolist() for polygon in scene.polygons],
        "boundary": None if scene.boundary is None else np.asarray(scene.boundary).tolist(),
        "frame": scene.frame,
        "margin": margin,
    }


def scene_from_document(document: object) -> tuple[Scene, float]:
    """The scene and its margin [m]. Raises DocumentError."""
    stored = convert(document, SceneDocument, "scene")
    scene = Scene(
        polygons=tuple(frozen(np.array(polygon, float)) for polygon in stored.polygons),
        boundary=None if stored.boundary is None else frozen(np.array(stored.boundary, float)),
        frame=stored.frame or "",
    )
    return scene, stored.margin or 0.0


def path_to_document(path: Path) -> dict[str, Any]:
    """A path as plain data; every float exactly."""
    segments = [
        {"direction": int(segment.direction)} | {key: getattr(segment, key).tolist() for key in COLUMNS}
        for segment in path.segments
    ]
    return {"segments": segments}


def path_from_document(document: object) -> Path:
    """The inverse of `path_to_document`. Raises ReplayError (E_RESULTS) where the data are not a path."""
    try:
        stored = convert(document, PathDocument)
        return Path(
            tuple(
                Segment(direction=segment.direction, **{key: np.array(getattr(segment, key), float) for key in COLUMNS})
                for segment in stored.segments
            )
        )
    except (DocumentError, ValueError, IndexError) as error:
        raise ReplayError(RESULTS_ERROR, f"not a path: {error}") from error
