"""The options that say how a log is to be understood, shared by the commands that read logs."""

import pathlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Any, Literal, TypeAlias

from cyclopts import Group

from replay import pipeline
from replay.cli.options import Option, flag_class, given, options_of
from replay.logs import ReadOptions

_VEHICLE = Option(
    name="vehicle",
    flag="--vehicle",
    hint=pathlib.Path | None,
    default=None,
    doc="TOML file with the vehicle's dimensions and limits, instead of those in the log;"
    " `replay vehicle` prints one with all keys, units and meanings.",
)
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
    return pipeline.read_options(ReadOptions(), values if isinstance(values, Mapping) else given(values))
