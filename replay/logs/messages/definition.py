"""Comparison of the message definition in a log with the standard one of the same type.

A definition has one type and one name on each line (`ros2msg`), or is IDL (`ros2idl`, see `idl.py`). Only the types and
names of fields are compared; comments, blanks, constants, default values and bounds of strings are ignored. The text is
untrusted: the work is linear in its length, nothing recurses, and sizes are limited.
"""

from functools import cache

from replay.logs.messages.idl import MAX_FIELDS, MAX_TYPES, MessageDefinition, parse_idl
from replay.logs.messages.types import DefinitionError

MAX_TEXT = 256 * 1024
"""Longest definition [bytes]."""
MAX_LINE = 4096
_PRIMITIVES = {"bool", "float32", "float64", "string", "wstring"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
_SAME_TYPE = {"byte": "uint8", "char": "uint8"}


def parse_ros2msg(root: str, text: str) -> MessageDefinition:
    """Fields of each type in a `ros2msg` definition: the root first, then sections headed ``MSG: pkg/Type``.

    Raises:
        DefinitionError: over a limit, or a line that is not a field.
    """
    layout: MessageDefinition = {}
    package, fields = root.split("/")[0], layout.setdefault(_short(root), [])
    for number, line in enumerate(text.split("\n"), 1):
        if len(line) > MAX_LINE:
            raise DefinitionError(f"line {number} has {len(line)} characters, at most {MAX_LINE} are read")
        words = line.split("#", 1)[0].split(None, 2)
        if not words or not words[0].strip("="):
            continue
        if len(words) == 1:
            raise DefinitionError(f"line {number} is {words[0][:40]!r}, expected a type and a name")
        if words[0] == "MSG:":
            package, fields = words[1].split("/")[0], layout.setdefault(_short(words[1]), [])
        elif "=" not in words[1] and not (len(words) == 3 and words[2].startswith("=")):
            fields.append((_full_type(words[0], package), words[1]))
        if len(layout) > MAX_TYPES or len(fields) > MAX_FIELDS:
            raise DefinitionError(f"more than {MAX_TYPES} types, or {MAX_FIELDS} fields in one")
    return layout


_standard = cache(parse_ros2msg)
"""Cached for the standard definitions only: a log's may be of any size, and is parsed once."""


def _short(name: str) -> str:
    return name.replace("/msg/", "/", 1)


def _full_type(written: str, package: str) -> str:
    base, bracket, rest = written.partition("[")
    base = base.split("<=", 1)[0]
    base = _SAME_TYPE.get(base, base)
    if base not in _PRIMITIVES:
        base = _short(base) if "/" in base else f"{package}/{base}"
    return base + bracket + rest


def matching_definition(name: str, definition: bytes, standards: tuple[str, ...], encoding: str = "ros2msg") -> int:
    """Number of the standard definition of type `name` that a log's definition (`ros2msg` or `ros2idl`) equals.

    Raises:
        DefinitionError: none of them; the text says what differs from the first.
    """
    if len(definition) > MAX_TEXT:
        raise DefinitionError(f"the definition has {len(definition)} bytes, at most {MAX_TEXT} are read")
    try:
        text = definition.decode("utf-8")
    except UnicodeDecodeError:
        raise DefinitionError("the definition is not UTF-8 text") from None
    found = parse_idl(text) if encoding == "ros2idl" else parse_ros2msg(name, text)
    for number, standard in enumerate(standards):
        if all(found.get(kind) == fields for kind, fields in _standard(name, standard).items()):
            return number
    raise DefinitionError(_difference(found, _standard(name, standards[0])))


def _difference(found: MessageDefinition, standard: MessageDefinition) -> str:
    """The first one of two layouts that differ."""
    kind, fields = next((kind, fields) for kind, fields in standard.items() if found.get(kind) != fields)
    mine = found.get(kind)
    if mine is None:
        return f"{kind} is not defined"
    for number, expected in enumerate(fields):
        if number >= len(mine) or mine[number] != expected:
            have = " ".join(mine[number])[:60] if number < len(mine) else "nothing"
            return f"field {number + 1} of {kind} is {have!r}, expected {' '.join(expected)!r}"
    return f"{kind} has the unknown field {mine[len(fields)][1][:40]!r}"
