"""Colours and labels of the paths: the same in every picture, plot, table and report.

The recorded path is neutral grey. Methods take the colours of Okabe and Ito (Color Universal Design, 2008), which
stay apart for colour-blind eyes, each fixed by name: a method keeps its colour whatever else ran.
"""

import zlib
from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

from optim.methods.chain import JOINT

Colour = tuple[int, int, int]


@dataclass(frozen=True, kw_only=True)
class Style:
    """Look of one path."""

    label: str
    colour: Colour
    """Red, green, blue, 0 to 255."""


RECORDED: Final = Style(label="Recorded", colour=(160, 160, 160))
ALARM: Final[Colour] = (255, 84, 84)
"""Limits, collisions, failed checks; no method has a colour near it."""

_METHODS: Final = {
    "shortcut": Style(label="Shortcut", colour=(230, 159, 0)),
    "cpo": Style(label="CPO", colour=(86, 180, 233)),
    "ddp": Style(label="DDP", colour=(0, 158, 115)),
    "nlp": Style(label="NLP", colour=(204, 121, 167)),
    "scp": Style(label="SCP", colour=(0, 114, 178)),
}
_SPARE: Final[tuple[Colour, ...]] = (
    (240, 228, 66),
    (150, 110, 255),
    (60, 235, 215),
    (150, 90, 50),
    (235, 60, 235),
    (150, 240, 60),
)
"""Colours of names without one of their own; 30 apart in CIE Lab, from each other and from all others, at least."""


def styles(names: Iterable[str]) -> dict[str, Style]:
    """The style of each method or chain of methods by name, in the order given.

    What is not among the methods known here takes a spare colour that its name decides; where that is taken, the
    next free one.
    """
    chosen: dict[str, Style] = {}
    for name in names:
        chosen[name] = _METHODS.get(name) or Style(
            label=_label(name), colour=_spare(name, {style.colour for style in chosen.values()})
        )
    return chosen


def _label(name: str) -> str:
    """A chain's parts by their labels."""
    parts = name.split(JOINT)
    return f" {JOINT} ".join(_METHODS[part].label if part in _METHODS else part for part in parts)


def _spare(name: str, taken: set[Colour]) -> Colour:
    first = zlib.crc32(name.encode("utf-8", "surrogatepass"))
    turns = [_SPARE[(first + k) % len(_SPARE)] for k in range(len(_SPARE))]
    return next((colour for colour in turns if colour not in taken), turns[0])


def as_uint32(colour: Colour) -> int:
    """0xRRGGBBAA, opaque: the form that columns of colours take."""
    red, green, blue = colour
    return red << 24 | green << 16 | blue << 8 | 255


def lighter(colour: Colour) -> Colour:
    """The same hue half way to white."""
    red, green, blue = ((part + 255) // 2 for part in colour)
    return red, green, blue
