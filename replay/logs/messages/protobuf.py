"""Protocol buffers: Foxglove messages decoded by Google's runtime; the only module that uses `protobuf`.

The message definition comes with the log and is untrusted. Each one gets a descriptor pool of its own: what one log
defines must not change what another means. Sizes are limited before anything is parsed, and parts are counted while
they are converted. To the runtime, a field with another wire type than its definition's is an unknown one; here it is
an error, since the message was written for another definition.
"""

from collections.abc import Callable, Iterable
from operator import attrgetter
from typing import Any, Final, NamedTuple

from google.protobuf.descriptor import Descriptor, FieldDescriptor
from google.protobuf.descriptor_pb2 import FileDescriptorProto, FileDescriptorSet
from google.protobuf.descriptor_pool import DescriptorPool
from google.protobuf.duration_pb2 import DESCRIPTOR as DURATION
from google.protobuf.message import DecodeError
from google.protobuf.message_factory import GetMessageClass
from google.protobuf.timestamp_pb2 import DESCRIPTOR as TIMESTAMP
from google.protobuf.unknown_fields import UnknownFieldSet

from replay.logs.messages.foxglove_definitions import MAX_PARTS, MESSAGES, VECTORS, Field, absent, nanoseconds
from replay.logs.messages.types import DefinitionError, PayloadError

MAX_SET: Final = 1 << 20
"""Largest set of descriptors [bytes]."""
MAX_FILES: Final = 64
MAX_TYPES: Final = 1024
"""Most messages of a set."""
MAX_MESSAGE: Final = 16 << 20
"""Largest message [bytes]: a grid of 4000 x 4000 cells, and no more than memory can hold of empty parts."""
MAX_UNKNOWN: Final = 1 << 16
"""Most bytes of a message in fields that its definition does not have: each costs far more time than a known one."""
_KINDS: Final = {
    FieldDescriptor.TYPE_DOUBLE: "double",
    FieldDescriptor.TYPE_FIXED32: "fixed32",
    FieldDescriptor.TYPE_BOOL: "bool",
    FieldDescriptor.TYPE_STRING: "string",
    FieldDescriptor.TYPE_MESSAGE: "message",
    FieldDescriptor.TYPE_BYTES: "bytes",
    FieldDescriptor.TYPE_ENUM: "enum",
}
"""Names of the types that occur in `foxglove_definitions.py`."""
_TIMES: Final = ("google.protobuf.Timestamp", "google.protobuf.Duration")


# ---- definitions


def descriptor_of(name: str, definition: bytes) -> Descriptor:
    """The descriptor of message `name` that a FileDescriptorSet defines, in a pool of its own.

    Raises:
        DefinitionError: it is not such a set, is over a limit, or does not define the message.
    """
    if len(definition) > MAX_SET:
        raise DefinitionError(f"the descriptors have {len(definition)} bytes, at most {MAX_SET} are read")
    try:
        files = list(FileDescriptorSet.FromString(definition).file)
    except DecodeError:
        raise DefinitionError("the descriptors are damaged") from None
    if not files:
        raise DefinitionError("the definition is not a set of descriptors")
    if len(files) > MAX_FILES:
        raise DefinitionError(f"the definition has {len(files)} files, at most {MAX_FILES} are read")
    if _num_messages(files) > MAX_TYPES:
        raise DefinitionError(f"more than {MAX_TYPES} messages")
    named = [file for file in files if name in (f"{file.package}.{each.name}" for each in file.message_type)]
    if not named:
        raise DefinitionError(f"{name} is not defined")
    pool = DescriptorPool()
    try:
        for file in _in_order(named[0], files):
            pool.Add(file)
        return pool.FindMessageTypeByName(name)
    except (TypeError, ValueError, KeyError) as error:
        raise DefinitionError(f"the descriptors cannot be used: {str(error).splitlines()[0][:200]}") from None


def _num_messages(files: Iterable[FileDescriptorProto]) -> int:
    """Number of messages that files define, also within others; counting ends above `MAX_TYPES`."""
    groups = [file.message_type for file in files]
    count = 0
    for group in groups:
        count += len(group)
        if count > MAX_TYPES:
            break
        groups += [each.nested_type for each in group]
    return count


def _in_order(first: FileDescriptorProto, files: Iterable[FileDescriptorProto]) -> list[FileDescriptorProto]:
    """A file and those that it imports, each after what it imports itself. Raises DefinitionError."""
    names = {file.name for file in files}
    known = [FileDescriptorProto.FromString(each.serialized_pb) for each in (TIMESTAMP, DURATION)]
    todo = [*files, *(each for each in known if each.name not in names)]  # some writers leave out the well-known ones
    done: dict[str, FileDescriptorProto] = {}
    while first.name not in done:
        ready = [file for file in todo if set(file.dependency) <= set(done)]
        if not ready:
            raise DefinitionError(f"file {first.name[:60]!r} imports itself, or a file that is not in the descriptors")
        done |= {file.name: file for file in ready}
        todo = [file for file in todo if file.name not in done]
    return list(done.values())


class _MessagePlan(NamedTuple):
    """Conversion of one message type."""

    name: str
    fields: tuple[tuple[Field, "_MessagePlan | None"], ...]
    """The fields that are read and defined; a plan for those that are messages."""
    missing: tuple[Field, ...]
    """The fields that are not defined: as if each message omitted them."""
    numbers: dict[int, str]
    """Names of the fields that are read, by their numbers."""
    vector: Callable[[Any], tuple[float, ...]] | None
    """Gives the numbers of a vector whose fields are all defined."""


def _plan(descriptor: Descriptor) -> _MessagePlan:
    """Plan the conversion of messages. Raises DefinitionError where a field has another type, or none is defined."""
    name = descriptor.full_name
    fields: list[tuple[Field, _MessagePlan | None]] = []
    for field in MESSAGES[name]:
        found = descriptor.fields_by_name.get(field.name)
        if found is not None:
            _check(name, field, found)
            inner = found.message_type if field.kind in MESSAGES else None
            fields.append((field, None if inner is None else _plan(inner)))
    if MESSAGES[name] and not fields:
        raise DefinitionError(f"{name} has none of the fields that are read")
    names = [field.name for field, _ in fields]
    missing = tuple(field for field in MESSAGES[name] if field.name not in names)
    numbers = {descriptor.fields_by_name[each].number: each for each in names}
    getter = attrgetter(*names) if name in VECTORS and not missing else None
    return _MessagePlan(name, tuple(fields), missing, numbers, getter)


def _check(name: str, field: Field, found: FieldDescriptor) -> None:
    """Raise DefinitionError where a field has another type than it must have."""
    kind, expected = _KINDS.get(found.type, f"type {found.type}"), field.kind
    if kind == "message" and found.message_type is not None:
        kind = found.message_type.full_name
        if kind in _TIMES and _is_time(found.message_type):
            kind = "time"
    if (kind, found.is_repeated) != (expected, field.repeated):
        have, want = f"{kind[:60]}{'[]' * found.is_repeated}", f"{expected}{'[]' * field.repeated}"
        raise DefinitionError(f"field {field.name!r} of {name} is {have!r}, expected {want!r}")


def _is_time(descriptor: Descriptor) -> bool:
    types = {field.name: (field.type, field.is_repeated) for field in descriptor.fields}
    return types == {"seconds": (FieldDescriptor.TYPE_INT64, False), "nanos": (FieldDescriptor.TYPE_INT32, False)}


# ---- messages


class Decoder:
    """Decodes messages of one type to dictionaries, and vectors of doubles to lists.

    Raises DefinitionError when it is made, PayloadError when it is called.
    """

    def __init__(self, name: str, definition: bytes) -> None:
        descriptor = descriptor_of(name, definition)
        self._plan = _plan(descriptor)
        self._class = GetMessageClass(descriptor)
        self._parts = 0

    def __call__(self, data: bytes) -> dict[str, Any]:
        """The message in these bytes."""
        name = self._plan.name
        if len(data) > MAX_MESSAGE:
            raise PayloadError(f"the message has {len(data)} bytes, at most {MAX_MESSAGE} are read")
        try:
            message = self._class.FromString(data)
            size = message.ByteSize()
            message.DiscardUnknownFields()
            unknown = size - message.ByteSize()
            if unknown > MAX_UNKNOWN:
                text = f"{unknown} bytes of it are fields that its definition does not have"
                raise PayloadError(f"{text}, at most {MAX_UNKNOWN} are read")
            if unknown:
                self._parts = 0
                self._check_wire_types(self._class.FromString(data), self._plan)
            self._parts = 0
            return self._convert(message, self._plan)
        except DecodeError:
            raise PayloadError(f"the message is damaged, or no {name} as it is defined") from None
        except UnicodeDecodeError:
            raise PayloadError(f"a text of {name} is not UTF-8") from None

    def _count(self) -> None:
        self._parts += 1
        if self._parts > MAX_PARTS:
            raise PayloadError(f"more than {MAX_PARTS} messages within it")

    def _check_wire_types(self, message: Any, plan: _MessagePlan) -> None:
        self._count()
        for unknown in UnknownFieldSet(message):
            if unknown.field_number in plan.numbers:
                name = f"{plan.name}.{plan.numbers[unknown.field_number]}"
                raise PayloadError(f"{name} has the wire type {unknown.wire_type}, or a value that is not defined")
        for field, inner in plan.fields:
            if inner is not None and (field.repeated or message.HasField(field.name)):
                value = getattr(message, field.name)
                for part in value if field.repeated else [value]:
                    self._check_wire_types(part, inner)

    def _convert(self, message: Any, plan: _MessagePlan) -> Any:
        self._count()
        if plan.vector is not None:
            return list(plan.vector(message))
        tree = {field.name: absent(field) for field in plan.missing}
        for field, inner in plan.fields:
            tree[field.name] = self._value(message, field, inner, plan)
        if plan.name in VECTORS:
            return [tree[field.name] for field in MESSAGES[plan.name]]
        return tree

    def _value(self, message: Any, field: Field, inner: _MessagePlan | None, plan: _MessagePlan) -> Any:
        value = getattr(message, field.name)
        if inner is not None and field.repeated:
            return [self._convert(part, inner) for part in value]
        if inner is not None:
            return self._convert(value, inner) if message.HasField(field.name) else None
        if field.repeated:
            return list(value)
        if field.kind == "time":
            return nanoseconds(value.seconds, value.nanos, f"{plan.name}.{field.name}")
        if field.kind == "string" and not isinstance(value, str):
            raise PayloadError(f"{plan.name}.{field.name} is not UTF-8")
        return value
