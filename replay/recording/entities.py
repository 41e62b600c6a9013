"""Entity paths, colours and small shapes that the parts of a recording share."""

from typing import Final

import numpy as np
import rerun as rr

from optim.methods.chain import JOINT
from replay.base.style import Colour
from replay.recording.text import plain

BODIES: Final = ("truck", "trailer")
GROUND: Final = ("/scene/map", "/scene/obstacles", "/scene/ends/**", "/scene/scale/**")
"""Entities that every plan view shows."""
OUTSIDE: Final[Colour] = (17, 18, 21)
"""Behind everything."""
BRIGHT: Final[Colour] = (235, 235, 235)
LABEL: Final[Colour] = (255, 255, 255)
"""Colour of every text in a plan view: the background is dark in a dark viewer and grey in a light one, and no other
colour can be read on both."""
points = rr.Radius.ui_points
"""Widths and radii that do not grow when one zooms in."""


def entity(*parts: str) -> str:
    """An entity path from parts of which some come from outside; a chain's + would be shown escaped."""
    return "/" + "/".join(rr.escape_entity_path_part(plain(part).replace(JOINT, "-")) for part in parts)


def image(pixels: np.ndarray, draw_order: float) -> rr.Image:
    """Grey (H, W) or RGBA (H, W, 4), uint8, row 0 at the bottom; as bytes, since small arrays' shapes are ambiguous."""
    return rr.Image(
        bytes=pixels.tobytes(),
        width=pixels.shape[1],
        height=pixels.shape[0],
        color_model="L" if pixels.ndim == 2 else "RGBA",
        datatype="U8",
        draw_order=draw_order,
    )


def label(at: np.ndarray, text: str) -> rr.Points2D:
    """A text at a place (x, y), on hardly a dot.

    Texts are over everything, whatever their order. It is between the map's and the obstacles', since the viewer was
    seen to draw lines behind a picture that comes right before them in the order: which ones, their number decides.
    """
    return rr.Points2D(
        [at], colors=[LABEL], radii=points(0.5), labels=[plain(text)], show_labels=True, draw_order=-75.0
    )
