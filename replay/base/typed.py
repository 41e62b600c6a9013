"""Documents read as msgspec structs: strict, with errors of one line that name the field."""

import math
import os
import re
from collections.abc import Iterator
from types import UnionType
from typing import Any, TypeVar, Union, get_args, get_origin

import msgspec

from replay.base.errors import printable
from replay.base.strict_json import JsonError, read_json

_T = TypeVar("_T")
_LONGEST = 60


def read_document(path: str | os.PathLike[str], kind: type[_T], largest: int) -> _T:
    """Read a document from a JSON file of at most `largest` bytes. Raises JsonError."""
    return to_document(read_json(path, largest), kind)


def to_document(data: Any, kind: type[_T]) -> _T:
    """Convert plain data to a document. Raises JsonError, which names the field that is wrong."""
    schema = kind.__struct_config__.tag if issubclass(kind, msgspec.Struct) else None
    if schema is not None and isinstance(data, dict) and data.get("schema") != schema:
        found = data.get("schema")
        words = "it has no schema" if found is None else f"its schema is {printable(repr(found), _LONGEST)}"
        raise JsonError(f"{words}, expected {schema!r}")
    try:
        return msgspec.convert(data, kind, strict=True)
    except (msgspec.ValidationError, UnicodeEncodeError) as error:
        raise JsonError(_explained(data, kind, error)) from None


def to_plain(document: Any) -> Any:
    """Plain data of a document for JSON; what is not finite becomes None."""
    return _finite(msgspec.to_builtins(document))


def _finite(value: Any) -> Any:
    if isinstance(value, float):
        return value if math.isfinite(value) else None
    if isinstance(value, dict):
        return {key: _finite(entry) for key, entry in value.items()}
    return [_finite(entry) for entry in value] if isinstance(value, (list, tuple)) else value


def _explained(data: Any, kind: Any, error: Exception, place: str = "") -> str:
    """The field that is wrong and why, the deepest one that is."""
    for name, value, inner in _parts(data, kind):
        try:
            msgspec.convert(value, inner, strict=True)
        except (msgspec.ValidationError, UnicodeEncodeError) as deeper:
            return _explained(value, inner, deeper, place + name)
    if isinstance(error, UnicodeEncodeError):
        words = "a key is not Unicode"
    else:
        words = str(error).partition(" - at `$")[0].replace("`", "").replace(" | ", " or ")
    return f"{place.removeprefix('.')}: {words}" if place else words


def _parts(data: Any, kind: Any) -> Iterator[tuple[str, Any, Any]]:
    """The entries of an object or an array, each with its place and the type that it must have."""
    for option in get_args(kind) if get_origin(kind) in (Union, UnionType) else (kind,):
        origin, arguments = get_origin(option), get_args(option)
        if isinstance(data, dict) and isinstance(option, type) and issubclass(option, msgspec.Struct):
            for field in msgspec.structs.fields(option):
                if field.encode_name in data:
                    yield f".{field.encode_name}", data[field.encode_name], field.type
        elif isinstance(data, dict) and origin is dict:
            yield from ((_key(name), value, arguments[1]) for name, value in data.items())
        elif isinstance(data, list) and (origin is list or arguments[1:] == (...,)):
            yield from ((f"[{i}]", value, arguments[0]) for i, value in enumerate(data))
        elif isinstance(data, list) and origin is tuple and len(arguments) == len(data):
            yield from ((f"[{i}]", *pair) for i, pair in enumerate(zip(data, arguments, strict=True)))


def _key(name: str) -> str:
    return f".{name}" if re.fullmatch(r"[\w+-]{1,60}", name) else f"[{printable(repr(name), _LONGEST)}]"
