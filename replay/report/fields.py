"""Taking values out of a run's files, which may be damaged or made by others: each is checked, text made harmless."""

import json
import math
from collections.abc import Mapping
from typing import Any

from replay.base.errors import printable

LONGEST_NAME = 200
LONGEST_TEXT = 500  # characters of a reason or an error
MOST_TEXT_LINES = 40
LONGEST_COMMAND = 4000  # characters: one that is cut cannot be pasted


class Malformed(Exception):
    """A document does not have the form expected; `str()` says where."""


def mapping(data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """A required object."""
    value = data.get(key)
    if not isinstance(value, Mapping):
        raise Malformed(f"{key} is {_kind(value)}, expected an object")
    return value


def optional(data: Mapping[str, Any], key: str) -> Mapping[str, Any]:
    """An object, empty where there is none."""
    value = data.get(key)
    return value if isinstance(value, Mapping) else {}


def entries(data: Mapping[str, Any], key: str) -> list[Mapping[str, Any]]:
    """A required list of objects."""
    value = data.get(key)
    if not isinstance(value, list) or not all(isinstance(entry, Mapping) for entry in value):
        raise Malformed(f"{key} is {_kind(value)}, expected a list of objects")
    return value


def text(data: Mapping[str, Any], key: str, default: str | None = None, limit: int = LONGEST_NAME) -> str:
    """A string with everything invisible escaped; required unless there is a default."""
    value = data.get(key)
    if value is None and default is not None:
        return default
    if not isinstance(value, str):
        raise Malformed(f"{key} is {_kind(value)}, expected a string")
    return printable(value, limit)


def words(data: Mapping[str, Any], key: str) -> tuple[str, ...]:
    """A list of strings, empty where there is none."""
    value = data.get(key) or []
    if not isinstance(value, list) or not all(isinstance(entry, str) for entry in value):
        raise Malformed(f"{key} is {_kind(value)}, expected a list of strings")
    return tuple(printable(entry, LONGEST_NAME) for entry in value)


def lines(data: Mapping[str, Any], key: str) -> tuple[str, ...]:
    """A text of several lines, of which the last ones are kept; empty where there is none."""
    value = data.get(key)
    found = value.splitlines()[-MOST_TEXT_LINES:] if isinstance(value, str) else []
    return tuple(printable(line, LONGEST_NAME) for line in found)


def number(data: Mapping[str, Any], key: str) -> float | None:
    """A finite number; None where there is none."""
    return _finite(data.get(key))


def numbers(data: Any, prefix: str = "") -> dict[str, float]:
    """The finite numbers of an object, at whatever depth, by their keys joined with dots."""
    found: dict[str, float] = {}
    for key, value in data.items() if isinstance(data, Mapping) else ():
        name = prefix + printable(key, LONGEST_NAME)
        if isinstance(value, Mapping):
            found |= numbers(value, f"{name}.")
        elif (finite := _finite(value)) is not None:
            found[name] = finite
    return found


def facts(data: Any, prefix: str = "") -> dict[str, str]:
    """What is said in an object, at whatever depth, by its keys joined with dots."""
    found: dict[str, str] = {}
    for key, value in data.items() if isinstance(data, Mapping) else ():
        name = prefix + printable(key, LONGEST_NAME)
        if isinstance(value, Mapping):
            found |= facts(value, f"{name}.")
        else:
            words = value if isinstance(value, str) else json.dumps(value, ensure_ascii=False)
            found[name] = printable("none" if value is None else words, LONGEST_TEXT)
    return found


def flag(data: Mapping[str, Any], key: str) -> bool | None:
    """A truth value; None where there is none."""
    value = data.get(key)
    return value if isinstance(value, bool) else None


def _finite(value: Any) -> float | None:
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return None
    try:
        converted = float(value)
    except OverflowError:
        return None
    return converted if math.isfinite(converted) else None


def _kind(value: Any) -> str:
    return "missing" if value is None else f"a {type(value).__name__}"
