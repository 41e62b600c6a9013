"""Protocol buffers: messages from their bytes, by the field numbers that the log's own descriptors give.

Both are untrusted: every length is compared with the bytes that are there, sizes and counts are limited, groups are
refused, and nothing recurses deeper than the messages of `foxglove_definitions.py`.
"""

import struct
from collections.abc import Iterator
from typing import Any, Final, NamedTuple

from replay.logs.messages.foxglove_definitions import MAX_PARTS, MESSAGES, VECTORS, Field, absent
from replay.logs.messages.types import DefinitionError, PayloadError

VARINT, FIXED64, BYTES, FIXED32 = 0, 1, 2, 5
MAX_SET: Final = 1 << 20
"""Largest set of descriptors [bytes]."""
MAX_FILES: Final = 64
MAX_TYPES: Final = 1024
"""Most messages of a set."""
MAX_DEPTH: Final = 16
"""Most messages that are defined within each other."""
_DOUBLE = struct.Struct("<d")
_KINDS: Final = {1: "double", 7: "fixed32", 8: "bool", 9: "string", 11: "message", 12: "bytes", 14: "enum"}
"""Names of the descriptor's types, as far as they occur in `foxglove_definitions.py`."""
_WIRE: Final = {"double": FIXED64, "fixed32": FIXED32, "bool": VARINT, "enum": VARINT}
_TIMES: Final = (".google.protobuf.Timestamp", ".google.protobuf.Duration")


def _varint(data: bytes, pos: int, end: int) -> tuple[int, int]:
    value = shift = 0
    while pos < end and shift < 70:
        byte = data[pos]
        pos += 1
        value |= (byte & 0x7F) << shift
        if byte < 0x80:
            return value & 0xFFFFFFFFFFFFFFFF, pos
        shift += 7
    raise PayloadError("a number is cut off" if shift < 70 else "a number has more than ten bytes")


def entries(data: bytes, pos: int, end: int) -> Iterator[tuple[int, int, int, int]]:
    """Field number, wire type, and start and end of the value of each entry in ``data[pos:end]``.

    For a varint, the start is its value and the end is -1. Raises PayloadError.
    """
    while pos < end:
        key, pos = _varint(data, pos, end)
        number, wire = key >> 3, key & 7
        if number == 0:
            raise PayloadError("a field has the number 0")
        if wire == VARINT:
            value, pos = _varint(data, pos, end)
            yield number, wire, value, -1
            continue
        if wire == BYTES:
            size, pos = _varint(data, pos, end)
        elif wire in (FIXED64, FIXED32):
            size = 8 if wire == FIXED64 else 4
        else:
            raise PayloadError(f"field {number} has the wire type {wire}, which is none or a group")
        if size > end - pos:
            raise PayloadError(f"field {number} claims {size} bytes, {end - pos} are left")
        yield number, wire, pos, pos + size
        pos += size


# ---- descriptors


class Described(NamedTuple):
    """A field as the log's descriptors have it."""

    number: int
    kind: str
    repeated: bool
    type_name: str


Descriptors = dict[str, dict[str, Described]]
"""Fields by name, by the full name of the message."""


def descriptors(data: bytes) -> Descriptors:
    """All messages of a FileDescriptorSet.

    Raises:
        DefinitionError: it is none, or over a limit.
    """
    if len(data) > MAX_SET:
        raise DefinitionError(f"the descriptors have {len(data)} bytes, at most {MAX_SET} are read")
    found: Descriptors = {}
    try:
        files = [
            (start, end) for number, wire, start, end in entries(data, 0, len(data)) if (number, wire) == (1, BYTES)
        ]
        if not files:
            raise DefinitionError("the definition is not a set of descriptors")
        if len(files) > MAX_FILES:
            raise DefinitionError(f"the definition has {len(files)} files, at most {MAX_FILES} are read")
        for start, end in files:
            package = _text(data, _last(data, start, end, 2))
            todo = [(*span, package, 1) for span in _all(data, start, end, 4)]
            while todo:
                at, stop, outer, depth = todo.pop()
                name = f"{outer}.{_text(data, _last(data, at, stop, 1))}".removeprefix(".")
                if depth > MAX_DEPTH or len(found) >= MAX_TYPES:
                    raise DefinitionError(f"more than {MAX_TYPES} messages, or {MAX_DEPTH} within each other")
                if name in found:
                    raise DefinitionError(f"message {name[:60]!r} is defined twice")
                found[name] = dict(_described(data, *span) for span in _all(data, at, stop, 2))
                todo += [(*span, name, depth + 1) for span in _all(data, at, stop, 3)]
    except PayloadError as error:
        raise DefinitionError(f"the descriptors are damaged: {error}") from None
    return found


def _all(data: bytes, start: int, end: int, wanted: int) -> list[tuple[int, int]]:
    return [(a, b) for number, wire, a, b in entries(data, start, end) if number == wanted and wire == BYTES]


def _last(data: bytes, start: int, end: int, wanted: int) -> tuple[int, int]:
    return (_all(data, start, end, wanted) or [(start, start)])[-1]


def _text(data: bytes, span: tuple[int, int]) -> str:
    try:
        return data[span[0] : span[1]].decode("utf-8")
    except UnicodeDecodeError:
        raise PayloadError("a name is not UTF-8") from None


def _described(data: bytes, start: int, end: int) -> tuple[str, Described]:
    numbers = {number: value for number, wire, value, _ in entries(data, start, end) if wire == VARINT}
    type_name = _text(data, _last(data, start, end, 6))
    kind = "time" if type_name in _TIMES else _KINDS.get(numbers.get(5, 0), f"type {numbers.get(5, 0)}")
    name = _text(data, _last(data, start, end, 1))
    return name, Described(numbers.get(3, 0), kind, numbers.get(4) == 3, type_name.removeprefix("."))


# ---- plans


class Step(NamedTuple):
    """What to do with the entries of one field number."""

    field: Field
    wire: int
    plan: "Plan | None"
    """Of a message."""


class Plan(NamedTuple):
    """How one message is decoded."""

    name: str
    steps: dict[int, Step]
    blank: dict[str, Any]
    """The fields that may be left out, as they are then; lists are made anew for each message."""
    lists: tuple[str, ...]


def plan_for(name: str, found: Descriptors) -> Plan:
    """How to decode message `name` as the log defines it.

    Fields of `foxglove_definitions.py` that the log's definition lacks stay as if each message left them out.

    Raises:
        DefinitionError: the message is not defined, shares no field, or has one of another type.
    """
    own = found.get(name)
    if own is None:
        raise DefinitionError(f"{name} is not defined")
    steps: dict[int, Step] = {}
    for field in MESSAGES[name]:
        described = own.get(field.name)
        if described is None:
            continue
        kind = "message" if field.kind in MESSAGES else field.kind
        if (described.kind, described.repeated) != (kind, field.repeated):
            have = f"{described.kind}{'[]' * described.repeated}"
            raise DefinitionError(
                f"field {field.name!r} of {name} is {have!r}, expected {field.kind + '[]' * field.repeated!r}"
            )
        plan = None
        if field.kind in MESSAGES:
            if described.type_name != field.kind:
                raise DefinitionError(
                    f"field {field.name!r} of {name} is {described.type_name[:60]!r}, expected {field.kind!r}"
                )
            plan = plan_for(field.kind, found)
        steps[described.number] = Step(field, _WIRE.get(field.kind, BYTES), plan)
    if MESSAGES[name] and not steps:
        raise DefinitionError(f"{name} has none of the fields that are read")
    blank = {field.name: absent(field) for field in MESSAGES[name]}
    return Plan(name, steps, blank, tuple(field.name for field in MESSAGES[name] if field.repeated))


# ---- messages


class Decoder:
    """Decodes messages of one type to dictionaries, and those of doubles alone to lists. Raises PayloadError."""

    def __init__(self, plan: Plan) -> None:
        self.plan = plan
        self._parts = 0

    def __call__(self, data: bytes) -> dict[str, Any]:
        self._parts = 0
        return self._message(data, 0, len(data), self.plan, dict(self.plan.blank))

    def _message(self, data: bytes, start: int, end: int, plan: Plan, into: dict[str, Any]) -> dict[str, Any]:
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise PayloadError(f"more than {MAX_PARTS} messages within it")
        for name in plan.lists:
            into[name] = into[name] or []
        for number, wire, a, b in entries(data, start, end):
            step = plan.steps.get(number)
            if step is None:
                continue
            name, kind, repeated = step.field
            if wire != step.wire and not (repeated and wire == BYTES and step.wire == FIXED32):
                raise PayloadError(f"{plan.name}.{name} has the wire type {wire}, expected {step.wire}")
            if step.plan is not None:
                if repeated:
                    into[name].append(self._part(data, a, b, step.plan, None))
                else:
                    into[name] = self._part(data, a, b, step.plan, into[name])
            elif repeated:
                if (b - a) % 4:
                    raise PayloadError(f"{plan.name}.{name} has {b - a} bytes of numbers with four each")
                into[name].extend(struct.unpack_from(f"<{(b - a) // 4}I", data, a))
            else:
                into[name] = self._value(data, a, b, kind, f"{plan.name}.{name}")
        return into

    def _part(self, data: bytes, start: int, end: int, plan: Plan, before: Any) -> Any:
        """A message within another; one that is there twice is merged with the first."""
        if plan.name in VECTORS:
            names = [field.name for field in MESSAGES[plan.name]]
            blank = dict.fromkeys(names, 0.0) if before is None else dict(zip(names, before, strict=True))
            return list(self._message(data, start, end, plan, blank).values())
        return self._message(data, start, end, plan, dict(plan.blank) if before is None else before)

    def _value(self, data: bytes, a: int, b: int, kind: str, where: str) -> Any:
        if kind == "double":
            return _DOUBLE.unpack_from(data, a)[0]
        if kind == "fixed32":
            return int.from_bytes(data[a:b], "little")
        if kind == "bytes":
            return data[a:b]
        if kind == "string":
            try:
                return data[a:b].decode("utf-8")
            except UnicodeDecodeError:
                raise PayloadError(f"{where} is not UTF-8") from None
        if kind == "time":
            return _time(data, a, b, where)
        return a  # a varint: bool, enum


def _time(data: bytes, start: int, end: int, where: str) -> int:
    """A Timestamp or Duration [ns]."""
    parts = {number: value for number, wire, value, _ in entries(data, start, end) if wire == VARINT}
    seconds, nanos = (value - (1 << 64) * (value >> 63) for value in (parts.get(1, 0), parts.get(2, 0)))
    return nanoseconds(seconds, nanos, where)


def nanoseconds(seconds: int, nanos: int, where: str) -> int:
    """One number of nanoseconds, which must fit into 64 bits. Raises PayloadError."""
    if not 0 <= nanos < 1_000_000_000 or abs(seconds) > 9_000_000_000:
        raise PayloadError(f"{where} is {seconds} s and {nanos} ns, which is no time")
    return seconds * 1_000_000_000 + nanos
