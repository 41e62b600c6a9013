"""Colours and labels of the paths: the same in every picture, plot, table and report.

The recorded path is neutral grey. Methods take the colours of Okabe and Ito (Color Universal Design, 2008), which
stay apart for colour-blind eyes, in an order that is fixed by name: a method keeps its colour whatever else ran.
"""

from collections.abc import Iterable
from dataclasses import dataclass
from typing import Final

Colour = tuple[int, int, int]


@dataclass(frozen=True, kw_only=True)
class Style:
    """How one path looks."""

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
_SPARE: Final[tuple[Colour, ...]] = ((240, 228, 66), (213, 94, 0), (160, 130, 255))


def styles(names: Iterable[str]) -> dict[str, Style]:
    """The style of each method by name, in the order given; methods unknown here share the spare colours in turn."""
    chosen: dict[str, Style] = {}
    spare = 0
    for name in names:
        if name in _METHODS:
            chosen[name] = _METHODS[name]
        else:
            chosen[name] = Style(label=name, colour=_SPARE[spare % len(_SPARE)])
            spare += 1
    return chosen


def as_uint32(colour: Colour, alpha: int = 255) -> int:
    """0xRRGGBBAA, the form that columns of colours take."""
    red, green, blue = colour
    return red << 24 | green << 16 | blue << 8 | alpha
