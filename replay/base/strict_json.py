"""Reading JSON from anywhere: bounded, and strict where Python's parser is lenient.

Python accepts NaN and Infinity, turns 1e999 into inf, keeps the last of repeated keys, and raises RecursionError
for deep nesting. Here each of these is an error, of one line.
"""

import json
import math
import os
import pathlib
import stat
from typing import Any

_OTHER_FILES = {b"\x89MCAP": "an MCAP log", b"RRF2": "a Rerun recording"}
"""First bytes of other kinds of files that may be given by mistake."""


class JsonError(Exception):
    """A file that holds no acceptable JSON; `str()` says why, without the file's name."""


def read_json(path: str | os.PathLike[str], largest: int) -> Any:
    """The data of a JSON file of at most `largest` bytes. Raises JsonError."""
    return parse_json(read_text(path, largest))


def parse_json(text: str) -> Any:
    """The data of strict JSON. Raises JsonError."""
    try:
        return json.loads(text, object_pairs_hook=_object, parse_constant=_constant, parse_float=_float)
    except json.JSONDecodeError as error:
        raise JsonError(f"not JSON: {error}") from None
    except RecursionError:
        raise JsonError("nested too deeply") from None
    except _Beyond as error:
        tree = json.loads(text, parse_float=_beyond_or_float)
        raise JsonError(f"{_place_of(tree) or 'the document'}: {error}") from None
    except ValueError as error:  # an integer of thousands of digits
        raise JsonError(str(error)) from None


def read_text(path: str | os.PathLike[str], largest: int) -> str:
    """The content of a text file in UTF-8 of at most `largest` bytes. Raises JsonError."""
    path = pathlib.Path(path)
    try:
        status = path.stat()
        if not stat.S_ISREG(status.st_mode):  # a pipe would block
            raise JsonError("not a file")
        with path.open("rb") as file:
            content = file.read(largest + 1) if status.st_size <= largest else b""
    except OSError as error:
        raise JsonError(error.strerror or str(error)) from None
    except ValueError as error:  # a null character in the name
        raise JsonError(str(error)) from None
    if max(len(content), status.st_size) > largest:
        raise JsonError(f"larger than {largest} bytes")
    try:
        return content.decode("utf-8")
    except UnicodeDecodeError as error:
        kind = next((kind for start, kind in _OTHER_FILES.items() if content.startswith(start)), None)
        raise JsonError(f"not JSON: it is {kind}" if kind else f"not UTF-8 at byte {error.start}") from None


def _object(pairs: list[tuple[str, Any]]) -> dict[str, Any]:
    entries = dict(pairs)
    if len(entries) < len(pairs):
        seen: set[str] = set()
        repeated = next(key for key, _ in pairs if key in seen or seen.add(key))
        raise JsonError(f"the key {repeated[:40]!r} appears twice")
    return entries


def _constant(name: str) -> float:
    raise JsonError(f"{name} is not JSON, expected a number or null")


class _Beyond(Exception):
    """A number that no float64 can hold; as a value, it marks its place in the data."""


def _float(digits: str) -> float:
    value = float(digits)
    if math.isinf(value):
        raise _Beyond(f"{digits[:40]} is beyond the range of a float64")
    return value


def _beyond_or_float(digits: str) -> "float | _Beyond":
    value = float(digits)
    return _Beyond() if math.isinf(value) else value


def _place_of(tree: Any, place: str = "") -> str | None:
    """The place of the first such number, as `methods[2].metrics.length`; None where there is none."""
    if isinstance(tree, _Beyond):
        return place
    if isinstance(tree, dict):
        parts = ((f"{place}.{key[:40]}" if place else key[:40], value) for key, value in tree.items())
    else:
        parts = ((f"{place}[{index}]", value) for index, value in enumerate(tree if isinstance(tree, list) else ()))
    return next((found for part, value in parts if (found := _place_of(value, part)) is not None), None)
