"""Flags made from dataclasses.

A method is a frozen dataclass whose fields, each with a docstring under it, are its options. The flags of
`replay optimize` and the listing of `replay methods` are made from these fields, so a new method or option
needs no line here.
"""

import contextlib
import dataclasses
import math
import re
from collections.abc import Iterable, Mapping, Sequence
from functools import partial
from typing import Annotated, Any, Literal, get_args, get_origin, get_type_hints

from cyclopts import CycloptsError, Group, Parameter, Token, convert, default_name_transform
from docstring_parser import parse_from_object

from replay.base.errors import UsageError, printable

_TOO_LARGE = 2**63
_UNIT = re.compile(r"\[([^\[\]]+)\]")


def _whole(kind: Any, tokens: Sequence[Token], unit: str = "") -> Any:
    """The value of a flag that takes whole numbers; alone, cyclopts rounds fractions. Raises UsageError."""
    (token,) = tokens
    try:
        is_fraction = float(token.value) % 1.0 != 0.0
    except ValueError:  # as 0x10, or no number
        is_fraction = False
    with contextlib.suppress(CycloptsError, ValueError):
        number = None if is_fraction else convert(kind, tokens)
        if isinstance(number, int) and abs(number) < _TOO_LARGE:
            return number
    expected = "a whole number" + (f" [{unit}]" if unit.strip("-") else "")
    raise UsageError(f"{token.keyword} is {printable(token.value, 40)}, expected {expected}")


WholeNumber = Annotated[int, Parameter(converter=_whole)]
"""The type of a command's own parameter that takes whole numbers."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Option:
    """One option: a field of a dataclass, as the command line shows it."""

    name: str
    flag: str
    hint: Any
    """The field's annotated type."""
    default: Any
    doc: str

    @property
    def unit(self) -> str:
        """The unit that the docstring names in brackets; empty when it names none."""
        found = _UNIT.search(self.doc)
        return found.group(1) if found else ""

    @property
    def kind(self) -> str:
        """The type, or the choices, in the words of the help."""
        if get_origin(self.hint) is Literal:
            return "|".join(map(str, get_args(self.hint)))
        return getattr(self.hint, "__name__", str(self.hint))


def options_of(settings: object, prefix: str = "") -> tuple[Option, ...]:
    """The options of a dataclass instance, with its present values as defaults; flags read --prefix.name."""
    assert dataclasses.is_dataclass(settings), "options are the fields of a dataclass"
    hints = get_type_hints(type(settings))
    docs = _field_docs(type(settings))
    return tuple(
        Option(
            name=field.name,
            flag="--" + (f"{prefix}." if prefix else "") + default_name_transform(field.name),
            hint=hints[field.name],
            default=getattr(settings, field.name),
            doc=docs.get(field.name, ""),
        )
        for field in dataclasses.fields(settings)
        if field.init
    )


def summary_of(settings: object) -> str:
    """The first line of the docstring of an object's class."""
    return (type(settings).__doc__ or "").strip().partition("\n")[0]


def flags_of(settings: Mapping[str, object], title: str) -> type:
    """A dataclass with one field for each entry, each itself a dataclass of that entry's options.

    Given to cyclopts as a parameter named "*", it makes the flags --entry.option, in a group of the help for each
    entry; `title` is formatted with the entry's name.
    """
    fields = []
    for name, entry in settings.items():
        group = Group(title.format(name=name), sort_key=10)
        made = flag_class(options_of(entry, name), group)
        parameter = Parameter(name=name, group=group)
        fields.append((name, Annotated[made, parameter], dataclasses.field(default_factory=made)))
    return _flags_class("Flags", fields)


def flag_class(options: Iterable[Option], group: Group) -> type:
    """A dataclass of flags for options.

    A new class, rather than the one that the options come from, so that an instance's values, not its class's, are
    the defaults, and so that a value out of range is reported by `with_flags` in one line.
    """
    return _flags_class("Flags", [_flag(option, group) for option in options])


@dataclasses.dataclass(frozen=True)
class NotGiven:
    """The default of every flag, so that given flags can be distinguished from others."""

    default: Any
    """Value of the option then."""

    def __str__(self) -> str:
        return str(self.default)


def given(flags: Any) -> dict[str, Any]:
    """The flags that were given, by the option's name; none where there are no flags."""
    values = vars(flags) if flags is not None else {}
    return {name: value for name, value in values.items() if not isinstance(value, NotGiven)}


def with_flags(settings: Any, values: Any, name: str) -> Any:
    """A copy of a dataclass instance with other values, by name or as flags; UsageError when it refuses one."""
    values = values if isinstance(values, Mapping) else given(values)
    try:
        return dataclasses.replace(settings, **values)
    except (ValueError, TypeError) as error:
        message = str(error)
        raise UsageError(message if message.startswith(f"{name}:") else f"{name}: {message}") from error


def _flag(option: Option, group: Group) -> tuple[str, Any, Any]:
    shows = option.default is not None and option.default != math.inf
    parameter = Parameter(
        help=" ".join(option.doc.split()),
        group=group,
        show_default=str if shows else False,
        negative_iterable=(),
        converter=partial(_whole, unit=option.unit) if option.hint in (int, int | None) else None,
    )
    return option.name, Annotated[option.hint, parameter], dataclasses.field(default=NotGiven(option.default))


def _flags_class(name: str, fields: list[tuple[str, Any, Any]]) -> type:
    # cyclopts takes classes of the standard library, where make_dataclass puts its own, for scalars
    return dataclasses.make_dataclass(name, fields, kw_only=True, frozen=True, namespace={"__module__": __name__})


def _field_docs(settings: type) -> dict[str, str]:
    """The docstrings under the fields of a class and its bases, by field name."""
    docs: dict[str, str] = {}
    for base in reversed(settings.__mro__[:-1]):
        if dataclasses.is_dataclass(base):
            docs |= {found.arg_name: found.description or "" for found in parse_from_object(base).params}
    return docs
