"""Foxglove messages in JSON, checked against `foxglove_definitions.py`; the result is that of `protobuf.py`."""

import base64
import binascii
import math
from typing import Any, Final

from replay.base.errors import printable
from replay.base.strict_json import JsonError, parse_json
from replay.logs.messages.foxglove_definitions import MAX_PARTS, MESSAGES, VECTORS, Field, absent, nanoseconds
from replay.logs.messages.types import PayloadError

MAX_TEXT: Final = 16 << 20
"""Longest message [bytes]: a grid of 3000 x 3000 cells, and no more than memory can hold of empty lists."""
MAX_DEPTH: Final = 32
_LARGEST: Final = {"fixed32": 1 << 32, "enum": 1 << 31}


def decode_json(name: str, data: bytes) -> dict[str, Any]:
    """The fields of message `name`. Raises PayloadError."""
    if len(data) > MAX_TEXT:
        raise PayloadError(f"the message has {len(data)} bytes, at most {MAX_TEXT} are read")
    try:
        text = data.decode("utf-8")
    except UnicodeDecodeError:
        raise PayloadError("the message is not UTF-8 text") from None
    _check_depth(data)
    try:
        tree = parse_json(text)
    except JsonError as error:
        raise PayloadError(f"the message is not usable JSON: {printable(str(error), 200)}") from None
    return _JsonReader().message(tree, name, name)


def _check_depth(data: bytes) -> None:
    """Before the parser meets them: brackets that are open at once, those in texts counted too."""
    depth = 0
    for byte in data.translate(None, delete=_NO_BRACKETS):
        depth += 1 if byte in b"[{" else -1
        if depth > MAX_DEPTH:
            raise PayloadError(f"more than {MAX_DEPTH} brackets are open at once")


_NO_BRACKETS: Final = bytes(sorted(set(range(256)) - set(b"[]{}")))


class _JsonReader:
    """Goes through the data of one message."""

    def __init__(self) -> None:
        self.parts = 0

    def message(self, tree: Any, name: str, where: str) -> Any:
        self.parts += 1
        if self.parts > MAX_PARTS:
            raise PayloadError(f"more than {MAX_PARTS} messages within it")
        if not isinstance(tree, dict):
            raise PayloadError(f"{where} is {_shown(tree)}, expected an object")
        if name in VECTORS:
            return [self._double(tree.get(field.name, 0.0), f"{where}.{field.name}") for field in MESSAGES[name]]
        return {field.name: self._field(tree, field, f"{where}.{field.name}") for field in MESSAGES[name]}

    def _field(self, tree: dict[str, Any], field: Field, where: str) -> Any:
        value = tree.get(field.name)
        if value is None:
            return absent(field)
        if not field.repeated:
            return self._value(value, field.kind, where)
        if not isinstance(value, list):
            raise PayloadError(f"{where} is {_shown(value)}, expected a list")
        return [self._value(item, field.kind, f"{where}[{i}]") for i, item in enumerate(value)]

    def _value(self, value: Any, kind: str, where: str) -> Any:
        if kind in MESSAGES:
            return self.message(value, kind, where)
        if kind == "double":
            return self._double(value, where)
        if kind == "time":
            return self._time(value, where)
        if kind in _LARGEST:
            return self._integer(value, where, _LARGEST[kind])
        if kind == "bool" and isinstance(value, bool):
            return value
        if kind in ("string", "bytes") and isinstance(value, str):
            return value if kind == "string" else _bytes(value, where)
        raise PayloadError(f"{where} is {_shown(value)}, expected {'a truth value' if kind == 'bool' else 'a text'}")

    def _double(self, value: Any, where: str) -> float:
        try:
            if not isinstance(value, bool) and isinstance(value, int | float) and math.isfinite(value):
                return float(value)
        except OverflowError:
            pass
        raise PayloadError(f"{where} is {_shown(value)}, expected a number")

    def _integer(self, value: Any, where: str, limit: int) -> int:
        if type(value) is not int or not 0 <= value < limit:
            raise PayloadError(f"{where} is {_shown(value)}, expected an integer from 0 to {limit - 1}")
        return value

    def _time(self, value: Any, where: str) -> int:
        if not isinstance(value, dict):
            raise PayloadError(f"{where} is {_shown(value)}, expected an object with sec and nsec")
        parts = [value.get(key, 0) for key in ("sec", "nsec")]
        if any(type(part) is not int for part in parts):
            raise PayloadError(f"{where} is {_shown(value)}, expected integers sec and nsec")
        return nanoseconds(parts[0], parts[1], where)


def _bytes(text: str, where: str) -> bytes:
    try:
        return base64.b64decode(text, validate=True)
    except (binascii.Error, ValueError):
        raise PayloadError(f"{where} is not base64") from None


def _shown(value: Any) -> str:
    if isinstance(value, dict | list):
        return "an object" if isinstance(value, dict) else "a list"
    return repr(value)[:40] if not isinstance(value, int) or abs(value) < 1 << 64 else "a huge number"
