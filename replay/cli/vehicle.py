"""`replay vehicle`: a vehicle as the file that --vehicle reads."""

import dataclasses
import pathlib
from typing import Annotated

from cyclopts import Parameter

from optim.model.vehicle import Vehicle
from replay.base.errors import UsageError, printable
from replay.cli.console import Common, Voice
from replay.cli.options import options_of
from replay.cli.usage import ExitStatus, reflowed
from replay.logs.container.folder import open_log
from replay.logs.meaning.topics import is_wanted
from replay.logs.meaning.vehicle import vehicle_in
from replay.run.vehicle_file import read_vehicle

_DEFAULT = "default"
_KEYS = options_of(Vehicle())
"""Each with its unit, its default, and in words from where to where it is measured."""


@reflowed
def vehicle(
    log: pathlib.Path | None = None,
    /,
    *,
    vehicle: Annotated[pathlib.Path | None, Parameter(name="--vehicle")] = None,
    common: Annotated[Common | None, Parameter(name="*")] = None,
) -> int:
    """Print a vehicle as TOML, each line with its unit and meaning: to be changed, and read again by --vehicle.

    Without a log and a file it is the default vehicle, as in `replay vehicle > truck.toml`.

    Parameters
    ----------
    log
        MCAP file, or folder that rosbag2 recorded: print the vehicle that it names.
    vehicle
        TOML file: print its vehicle, with the defaults for what the file leaves out.
    """
    voice = Voice(common or Common())
    if log is not None and vehicle is not None:
        raise UsageError("expected a log or --vehicle, and both are given")
    status, source, found = ExitStatus.OK, _DEFAULT, Vehicle()
    if log is not None:
        status, source, found = _of_log(log, voice)
    elif vehicle is not None:
        source, found = str(vehicle), read_vehicle(vehicle)
    voice.show(f"# Vehicle: {printable(source)}. SI units; what is left out has its default.", *_lines(found))
    keys = [{"name": key.name, "unit": key.unit, "default": key.default, "doc": key.doc} for key in _KEYS]
    content = {"source": source, "vehicle": dataclasses.asdict(found), "keys": keys}
    voice.document({"schema": "replay.vehicle/1", "exit_status": int(status), **content})
    return status


def _of_log(path: pathlib.Path, voice: Voice) -> tuple[ExitStatus, str, Vehicle]:
    """The vehicle that a log names, else the default one with a note. Raises LogError."""
    log = open_log(path, is_wanted)
    found, notes = vehicle_in(log)
    is_named = any(record.name == "vehicle" for record in log.metadata)
    for note in (*log.warnings, *notes):
        voice.note(f"{path}: {note}")
    return ExitStatus.PARTIAL if log.lost else ExitStatus.OK, str(path) if is_named else _DEFAULT, found


def _lines(vehicle: Vehicle) -> list[str]:
    """A line of TOML for each field, its meaning in a comment."""
    values = {key.name: f"{key.name} = {getattr(vehicle, key.name)!r}" for key in _KEYS}
    width = max(map(len, values.values()))
    return [f"{values[key.name]:{width}}  # {key.doc} Default {key.default:g}." for key in _KEYS]
