"""Obstacles of one map as convex polygons."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

from numpy.typing import ArrayLike

from optim.geometry.polygons import PackedScene, convex_parts, pack, walls
from optim.numerics.arrays import Array, Float64

WALL_THICKNESS = 2.0
"""Depth of the walls round a map's outline [m]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Scene:
    """Obstacles of one map. `make_scene` builds it from any simple polygons."""

    polygons: tuple[Float64[Array, "_ 2"], ...]
    """Convex, counter-clockwise, read-only vertices [m], each of shape (n, 2)."""
    boundary: Float64[Array, "m 2"] | None = None
    """Outline of the map for drawing [m], shape (m, 2), counter-clockwise; its walls are among the polygons."""
    frame: str = "map"
    """Name of the coordinate frame."""

    def __repr__(self) -> str:
        return f"Scene({len(self.polygons)} polygons, frame {self.frame!r})"

    @cached_property
    def packed(self) -> PackedScene:
        """The polygons and their tree of boxes, as the kernels read them."""
        return pack(self.polygons)


def make_scene(polygons: Sequence[ArrayLike], *, boundary: ArrayLike | None = None, frame: str = "map") -> Scene:
    """A scene of simple polygons, clockwise or not, closed or not; non-convex ones become several convex parts.

    `boundary`, a convex outline, adds walls 2 m thick just outside it. Raises ValueError that names the polygon's
    index and what is wrong with it (no area, crosses itself, not finite, wrong shape).
    """
    parts: list[Array] = []
    for index, polygon in enumerate(polygons):
        try:
            parts.extend(convex_parts(polygon))
        except ValueError as error:
            raise ValueError(f"obstacle {index}: {error}") from None
    if boundary is None:
        return Scene(polygons=tuple(parts), frame=frame)
    try:
        outline = convex_parts(boundary)
    except ValueError as error:
        raise ValueError(f"boundary: {error}") from None
    if len(outline) > 1:
        raise ValueError("boundary: it is not convex; give the forbidden area beside it as obstacles")
    parts.extend(walls(outline[0], WALL_THICKNESS))
    return Scene(polygons=tuple(parts), boundary=outline[0], frame=frame)
