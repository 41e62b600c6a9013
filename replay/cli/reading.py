"""The options that say how a log is to be understood, shared by the commands that read logs."""

import difflib
import pathlib
from collections.abc import Mapping
from dataclasses import fields
from typing import TYPE_CHECKING, Any, Final, Literal, TypeAlias

from cyclopts import Group

from optim.model.vehicle import Vehicle
from replay.base.errors import UsageError
from replay.cli.options import Option, flag_class, given, options_of, read_toml, with_flags
from replay.logs import ReadOptions

_VEHICLE = Option(
    name="vehicle",
    flag="--vehicle",
    hint=pathlib.Path | None,
    default=None,
    doc="TOML file with the vehicle's dimensions and limits, instead of those in the log;"
    " `replay vehicle` prints one with all keys, units and meanings.",
)
_GEARS: Final = {"forward": 1, "reverse": -1}
_START_DIRECTION = Option(
    name="start_direction",
    flag="--start-direction",
    hint=Literal["forward", "reverse", 1, -1],
    default="forward",
    doc="Gear of the first metre, where the log has no headings; 1 is forward, -1 reverse.",
)
_REPLACED = {option.name: option for option in (_VEHICLE, _START_DIRECTION)}
READING = tuple(_REPLACED.get(option.name, option) for option in options_of(ReadOptions()))
"""The options of the reader, as the command line has them."""

if TYPE_CHECKING:
    Reading: TypeAlias = Any
else:
    Reading = flag_class(READING, Group("Reading the log", sort_key=5))


def read_options(values: Any) -> ReadOptions:
    """The reader's options from flags (an instance of `Reading`, or None) or from values by name. Raises UsageError.

    The vehicle may be one already, or the path of its file.
    """
    values = dict(values if isinstance(values, Mapping) else given(values))
    if isinstance(values.get("vehicle"), pathlib.Path):
        values["vehicle"] = read_vehicle(values["vehicle"])
    gear = values.get("start_direction")
    if gear in _GEARS:
        values["start_direction"] = _GEARS[gear]
    return with_flags(ReadOptions(), values, "reading")


def read_vehicle(path: pathlib.Path) -> Vehicle:
    """A vehicle from a TOML file whose keys are the fields of `Vehicle`, in SI units; absent ones have the defaults.

    Raises UsageError for a file that cannot be read, an unknown key or a value out of range.
    """
    values = read_toml(path, f"--vehicle {path}")
    known = [field.name for field in fields(Vehicle)]
    for key in values:
        if key not in known:
            nearest = difflib.get_close_matches(key, known, n=1)
            guess = f"; did you mean {nearest[0]!r}?" if nearest else f"; there are: {', '.join(known)}"
            if isinstance(values[key], dict):
                guess = ": keys stand outside of tables, as `replay vehicle` prints them"
            raise UsageError(f"--vehicle {path}: unknown key {key!r}{guess}")
    try:
        return Vehicle(**values)
    except ValueError as error:
        raise UsageError(f"--vehicle {path}: {error}") from error
