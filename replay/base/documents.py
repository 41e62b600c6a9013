"""Documents: JSON and TOML files read strictly into typed structs, and written alike everywhere.

A schema is a `msgspec.Struct` in `replay.base.schemas`, frozen and with keywords only. Structs ignore fields that they
do not know, so that documents can grow; what people write by hand says `forbid_unknown_fields=True`. Reading goes in
two steps: strict JSON or TOML, then `msgspec`, which takes no text for a number, no fraction for an integer and no
number beyond a float64. Whatever is wrong ends as one line that names the field:
`methods[2].metrics.length is 'long', expected a number or null`.
"""

import dataclasses
import enum
import functools
import json
import math
import os
import re
import tomllib
from collections.abc import Mapping
from types import UnionType
from typing import Annotated, Any, Literal, NamedTuple, TypeVar, Union, get_args, get_origin, get_type_hints

import msgspec
import numpy as np

from replay.base import strict_json
from replay.base.errors import unknown

Kind = TypeVar("Kind")
Whole = Annotated[int, msgspec.Meta(ge=-(2**63), le=2**63 - 1)]
"""An integer of 64 bits; a plain `int` would let a number of any size pass."""
Count = Annotated[int, msgspec.Meta(ge=0, le=2**63 - 1)]
Number = float | None
"""A number, or null where it is not finite: JSON has no NaN and no infinity."""
_LONGEST = 60
"""Characters of a value shown in a message."""


class DocumentError(Exception):
    """A file or data that are not the document expected; `str()` is one line without the file's name."""


def read_json(path: str | os.PathLike[str], kind: type[Kind], largest: int) -> Kind:
    """The document in a JSON file of at most `largest` bytes. Raises DocumentError."""
    try:
        data = strict_json.read_json(path, largest)
    except strict_json.JsonError as error:
        raise DocumentError(str(error)) from None
    return convert(data, kind)


def parse_json(text: str, kind: type[Kind]) -> Kind:
    """The document in a text. Raises DocumentError."""
    try:
        data = strict_json.parse_json(text)
    except strict_json.JsonError as error:
        raise DocumentError(str(error)) from None
    return convert(data, kind)


def read_toml(path: str | os.PathLike[str], largest: int = 2**20) -> dict[str, Any]:
    """The data of a TOML file of at most `largest` bytes, for `convert`. Raises DocumentError."""
    try:
        text = strict_json.read_text(path, largest)
    except strict_json.JsonError as error:
        raise DocumentError(str(error).replace("not JSON", "not TOML")) from None
    return parse_toml(text)


def parse_toml(text: str) -> dict[str, Any]:
    """The data of TOML. Raises DocumentError."""
    try:
        return tomllib.loads(text, parse_float=_toml_float)
    except tomllib.TOMLDecodeError as error:
        raise DocumentError(f"not TOML: {error}") from None
    except RecursionError:
        raise DocumentError("nested too deeply") from None
    except ValueError as error:  # an integer of thousands of digits
        raise DocumentError(" ".join(str(error).split())) from None


def _toml_float(digits: str) -> float | int:
    """A number beyond a float64 stays one, which `convert` refuses with the name of its field."""
    value = float(digits)
    return 10**400 if math.isinf(value) and "inf" not in digits else value


def convert(data: object, kind: type[Kind], at: str = "", *, exact: bool = False) -> Kind:
    """Data as a struct, a dataclass or any other type that `msgspec` knows; `at` names their place in a document.

    With `exact`, keys that a dataclass lacks are refused; a struct says so itself. Raises DocumentError.
    """
    extra = next((key for key in data if key not in _hints(kind)), None) if exact and isinstance(data, dict) else None
    if extra is not None:
        raise DocumentError(unknown("key", str(extra)[:_LONGEST], _hints(kind), f"in {at}" if at else ""))
    try:
        return msgspec.convert(data, kind, strict=True)
    except msgspec.ValidationError as error:
        raise DocumentError(_line(str(error), data, kind, at)) from None
    except UnicodeEncodeError:  # a key with half a surrogate pair
        raise DocumentError(f"{at or 'the document'}: a key is not valid text") from None


def plain(value: Any) -> Any:
    """Data as JSON can hold them.

    Structs and dataclasses become objects, NumPy's numbers and arrays Python's, what is not finite null.
    Raises TypeError for a type that documents cannot hold.
    """
    if isinstance(value, msgspec.Struct):
        fields = ((field.encode_name, getattr(value, field.name)) for field in msgspec.structs.fields(value))
        return {name: plain(entry) for name, entry in fields if entry is not msgspec.UNSET}
    if dataclasses.is_dataclass(value) and not isinstance(value, type):
        return {field.name: plain(getattr(value, field.name)) for field in dataclasses.fields(value)}
    if isinstance(value, Mapping):
        return {str(key): plain(entry) for key, entry in value.items()}
    if isinstance(value, (np.ndarray, np.generic)):
        return plain(value.tolist())
    if isinstance(value, (list, tuple)):
        return [plain(entry) for entry in value]
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, enum.Enum):
        return plain(value.value)
    if value is None or isinstance(value, (bool, int, str)):
        return value
    if isinstance(value, os.PathLike):
        return os.fspath(value)
    raise TypeError(f"{type(value).__name__} cannot be written to a document")


def to_bytes(value: Any) -> bytes:
    """A document as UTF-8 JSON of one line: sorted keys, floats so that they come back bit for bit."""
    text = json.dumps(plain(value), sort_keys=True, ensure_ascii=False, allow_nan=False, separators=(",", ":"))
    # A file name that is not valid UTF-8 arrives with lone surrogates; in JSON these are escapes.
    return text.encode("utf-8", errors="backslashreplace") + b"\n"


# What is wrong, where.


class _Part(NamedTuple):
    """The part of a document that an error is about."""

    place: str
    value: Any
    kind: Any
    """Type expected there."""


_MESSAGE = re.compile(r"(?P<what>.*?)(?: - at `\$(?P<at>.*)`)?", re.DOTALL)
_STEP = re.compile(r"\.(?P<name>[^.\[]+)|\[(?P<index>\d+)\]|(?P<any>\[\.\.\.\])")
_WORDS = {
    "float": "a number",
    "int": "a whole number",
    "str": "a text",
    "bool": "true or false",
    "object": "an object",
    "array": "a list",
    "null": "null",
}


def _line(message: str, data: object, kind: Any, at: str) -> str:
    """The message of msgspec as one line, with the place and the value that it is about."""
    match = _MESSAGE.fullmatch(message)
    assert match is not None
    what, found = match["what"], _Part(at, data, kind)
    for step in _STEP.finditer(match["at"] or ""):
        found = _entered(found, step)
    if missing := re.fullmatch(r"Object missing required field `(.*)`", what):
        return f"{_joined(found.place, missing[1])} is missing"
    if extra := re.fullmatch(r"Object contains unknown field `(.*)`", what):
        return unknown("key", extra[1], _hints(_concrete(found)), f"in {found.place}" if found.place else "")
    place = found.place or "the document"
    if what.startswith("Invalid enum value"):
        return f"{place} is {_shown(found.value)}, expected {' or '.join(map(repr, _choices(found.kind)))}"
    if expected := re.fullmatch(r"Expected `([a-z |]+)`, got `.*`", what):
        words = [_WORDS.get(word, word) for word in expected[1].split(" | ")]
        return f"{place} is {_shown(found.value)}, expected {' or '.join(words)}"
    if what == "Number out of range" or what.startswith("Expected `int` "):
        whole = "whole " if "int" in what else ""
        return f"{place} is {_shown(found.value)}, expected a {whole}number within range"
    return f"{found.place}: {what}" if found.place else what  # what a struct says of its own values


def _entered(found: _Part, step: re.Match[str]) -> _Part:
    """One step deeper: into a field, an item of a list, or the value of an object that does not fit."""
    kind = _concrete(found)
    arguments = get_args(kind)
    if step["name"] is not None:
        return _Part(_joined(found.place, step["name"]), _item(found.value, step["name"]), _hints(kind)[step["name"]])
    if step["index"] is not None:
        index = int(step["index"])
        inner = arguments[0] if get_origin(kind) is not tuple or arguments[-1] is ... else arguments[index]
        return _Part(f"{found.place}[{index}]", _item(found.value, index), inner)
    for key, value in found.value.items():
        try:
            msgspec.convert(value, arguments[1], strict=True)
        except msgspec.ValidationError:
            return _Part(_joined(found.place, str(key)[:_LONGEST]), value, arguments[1])
    return found


def _item(value: Any, key: str | int) -> Any:
    return value.get(key) if isinstance(value, Mapping) and isinstance(key, str) else value[key]


def _joined(place: str, name: str) -> str:
    return f"{place}.{name}" if place else name


def _concrete(found: _Part) -> Any:
    """The member of a union that the value is meant to be: that for an object, for a list, or the first."""
    kind = found.kind
    if get_origin(kind) is Annotated:
        kind = get_args(kind)[0]
    if get_origin(kind) not in (Union, UnionType):
        return kind
    members = [member for member in get_args(kind) if member is not type(None)]
    is_list = isinstance(found.value, list)
    fitting = (member for member in members if (get_origin(member) in (list, tuple)) == is_list)
    return next((member for member in fitting if (not is_list and _is_object(member)) or is_list), members[0])


def _is_object(kind: Any) -> bool:
    return get_origin(kind) in (dict, Mapping) or bool(_hints(kind))


@functools.cache
def _hints(kind: Any) -> dict[str, Any]:
    """The fields of a struct or dataclass by the name that a document has for them; none of other types."""
    if isinstance(kind, type) and issubclass(kind, msgspec.Struct):
        hints = get_type_hints(kind, include_extras=True)
        return {field.encode_name: hints[field.name] for field in msgspec.structs.fields(kind)}
    if dataclasses.is_dataclass(kind):
        hints = get_type_hints(kind, include_extras=True)
        return {field.name: hints[field.name] for field in dataclasses.fields(kind)}
    return {}


def _choices(kind: Any) -> list[Any]:
    if get_origin(kind) is Literal:
        return list(get_args(kind))
    return [choice for member in get_args(kind) for choice in _choices(member)]


def _shown(value: Any) -> str:
    if isinstance(value, (Mapping, list)):
        return "a list" if isinstance(value, list) else "an object"
    if isinstance(value, int) and not isinstance(value, bool) and abs(value) >= 10**20:
        return f"a number of {len(str(abs(value)))} digits"
    if value is None or isinstance(value, bool):
        return json.dumps(value)
    text = repr(value)
    return text if len(text) <= _LONGEST else text[: _LONGEST - 1] + "…"
