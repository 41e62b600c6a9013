"""Text that every viewer can draw, and numbers as people read them.

The viewer has one font; headless it stops at the first character that the font lacks. Everything that comes from
a log, a method or the command line therefore goes through `plain` before it is shown.
"""

import math
from typing import Final

from optim.audit.report import Check

_RANGES: Final = (
    (0x20, 0x7E),  # ASCII
    (0xA1, 0x148),  # Latin
    (0x14A, 0x17F),
    (0x391, 0x3A1),  # Greek
    (0x3A3, 0x3C9),
    (0x400, 0x45F),  # Cyrillic
)
_SINGLES: Final = frozenset("–—…‰−≈≤≥→←↑↓√∫Σ∞✓✗●★⚠\n")
"""With the ranges, what version 0.41 was seen to draw."""

_MARKDOWN: Final = str.maketrans({c: "\\" + c for c in "\\`*_|<>[]#"})


def is_safe(character: str) -> bool:
    """Whether every viewer can draw the character."""
    return character in _SINGLES or any(low <= ord(character) <= high for low, high in _RANGES)


def plain(text: object) -> str:
    """The text with everything replaced by '?' that a viewer may be unable to draw."""
    return "".join(character if is_safe(character) else "?" for character in str(text))


def cell(text: object) -> str:
    """The text as one cell of a markdown table or part of a sentence: nothing in it acts as markup."""
    return plain(" ".join(str(text).split())).translate(_MARKDOWN)


def number(value: float | None, digits: int = 2) -> str:
    """A number with a true minus sign; a dash where there is none."""
    if value is None or not math.isfinite(value):
        return "–"
    text = f"{value:.{digits}f}"
    if float(text) == 0.0:
        text = text.lstrip("-")
    return text.replace("-", "−")


def change(before: float, after: float) -> str:
    """Relative change in per cent, signed: '−20 %', '−0.4 %'."""
    percent = 100.0 * (after - before) / abs(before) if before else math.nan
    if not math.isfinite(percent):
        return "–"
    shown = f"{percent:+.0f}" if abs(percent) >= 0.95 else f"{percent:+.1f}"
    return f"{shown} %".replace("-", "−") if float(shown) else "±0 %"


def table(rows: list[list[str]]) -> str:
    """A markdown table; the first row is the head."""
    lines = ["| " + " | ".join(row) + " |" for row in rows]
    lines.insert(1, "|" + "---|" * len(rows[0]))
    return "\n".join(lines)


def count(value: float, what: str) -> str:
    """A number of things: '1 gear change', '3 gear changes'."""
    return f"{value:g} {what}{'' if value == 1 else 's'}"


def measured(check: Check) -> str:
    """The deciding value of an audit's check in people's units; empty for a check without a limit."""
    key, value = check.deciding, check.value
    if key is None:
        return ""
    name, _, unit = key.rpartition("_")
    if unit.startswith("rad"):
        value, unit = math.degrees(value), unit.replace("rad", "°")
    shown = f"{value:.3g}" if abs(value) >= 1e-3 or value == 0.0 else f"{value:.0e}"
    return f"{shown} {unit if name else key}".replace("-", "−").replace(" °", "°").removesuffix(" relative")
