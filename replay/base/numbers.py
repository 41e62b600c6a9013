"""Numbers as people read them, in words and tables."""

import math

NO_VALUE = "–"


def shown(value: float | str | None, digits: int = 6) -> str:
    """A value to `digits` significant digits, with a true minus sign; a dash where there is none."""
    if value is None or value == "":
        return NO_VALUE
    if isinstance(value, str):
        return value
    if not math.isfinite(value):
        return NO_VALUE
    if float(value).is_integer() and abs(value) < 1e9:
        return f"{value:.0f}".replace("-", "−")
    return f"{value:.{digits}g}".replace("-", "−")


def fixed(value: float | None, digits: int) -> str:
    """A value with `digits` decimals."""
    if value is None or not math.isfinite(value):
        return NO_VALUE
    return f"{value:.{digits}f}".replace("-", "−")


def percent(share: float | None) -> str:
    """A relative change, signed: '+0.52 %'."""
    if share is None or not math.isfinite(share):
        return ""
    digits = 2 if abs(share) < 0.1 else 0
    text = f"{100.0 * share:+.{digits}f} %"
    if share and not float(text[:-2]):
        text = f"{100.0 * share:+.1e} %"
    return text.replace("-", "−")


def count(number: int, noun: str) -> str:
    """'1 log', '2 logs'."""
    return f"{number} {noun}{'s' * (number != 1)}"
