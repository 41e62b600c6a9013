"""Is a message laid out as its type's name promises? The definition in the log is compared with the standard one.

Definitions are lines of a type and a name (`ros2msg`), or IDL (`ros2idl`, see `idl.py`). Only types and names of fields
decide; comments, blanks, constants, default values and bounds of the text do not. The work is linear in the text,
nothing recurses, and sizes are limited, whatever the text says.
"""

from functools import cache

from replay.logs.messages.idl import MAX_FIELDS, MAX_TYPES, Layout, LayoutError, parse_idl

MAX_TEXT = 256 * 1024
"""Longest definition [bytes]."""
MAX_LINE = 4096
_PRIMITIVES = {"bool", "float32", "float64", "string", "wstring"} | {
    f"{sign}int{bits}" for sign in ("", "u") for bits in (8, 16, 32, 64)
}
_SAME_TYPE = {"byte": "uint8", "char": "uint8"}


def parse_layout(root: str, text: str) -> Layout:
    """Fields of each type in a `ros2msg` definition: the root first, then sections headed ``MSG: pkg/Type``.

    Raises:
        LayoutError: over a limit, or a line that is no field.
    """
    layout: Layout = {}
    package, fields = root.split("/")[0], layout.setdefault(_short(root), [])
    for number, line in enumerate(text.split("\n"), 1):
        if len(line) > MAX_LINE:
            raise LayoutError(f"line {number} has {len(line)} characters, at most {MAX_LINE} are read")
        words = line.split("#", 1)[0].split(None, 2)
        if not words or not words[0].strip("="):
            continue
        if len(words) == 1:
            raise LayoutError(f"line {number} is {words[0][:40]!r}, expected a type and a name")
        if words[0] == "MSG:":
            package, fields = words[1].split("/")[0], layout.setdefault(_short(words[1]), [])
        elif "=" not in words[1] and not (len(words) == 3 and words[2].startswith("=")):
            fields.append((_full_type(words[0], package), words[1]))
        if len(layout) > MAX_TYPES or len(fields) > MAX_FIELDS:
            raise LayoutError(f"more than {MAX_TYPES} types, or {MAX_FIELDS} fields in one")
    return layout


_standard = cache(parse_layout)
"""What a log defines is not kept: it may be of any size, and comes once."""


def _short(name: str) -> str:
    return name.replace("/msg/", "/", 1)


def _full_type(written: str, package: str) -> str:
    base, bracket, rest = written.partition("[")
    base = base.split("<=", 1)[0]
    base = _SAME_TYPE.get(base, base)
    if base not in _PRIMITIVES:
        base = _short(base) if "/" in base else f"{package}/{base}"
    return base + bracket + rest


def matching_layout(name: str, definition: bytes, standards: tuple[str, ...], encoding: str = "ros2msg") -> int:
    """Which of the standard definitions of type `name` a log's definition (`ros2msg` or `ros2idl`) equals.

    Raises:
        LayoutError: none of them; the text says what differs from the first.
    """
    if len(definition) > MAX_TEXT:
        raise LayoutError(f"the definition has {len(definition)} bytes, at most {MAX_TEXT} are read")
    try:
        text = definition.decode("utf-8")
    except UnicodeDecodeError:
        raise LayoutError("the definition is not UTF-8 text") from None
    found = parse_idl(text) if encoding == "ros2idl" else parse_layout(name, text)
    for number, standard in enumerate(standards):
        if all(found.get(kind) == fields for kind, fields in _standard(name, standard).items()):
            return number
    raise LayoutError(_difference(found, _standard(name, standards[0])))


def _difference(found: Layout, standard: Layout) -> str:
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
