"""A vehicle as a TOML file: keys as the fields of `Vehicle`, SI units."""

import os
from typing import Final

from optim.model.vehicle import Vehicle
from replay.base.documents import DocumentError, convert, read_toml
from replay.base.errors import ReplayError

VEHICLE_ERROR: Final = "E_VEHICLE"


def read_vehicle(path: str | os.PathLike[str]) -> Vehicle:
    """Read a vehicle; keys that the file leaves out have their defaults.

    Raises ReplayError (E_VEHICLE) for a file that cannot be read, an unknown key, or a value out of range.
    """
    try:
        content = read_toml(path)
        nested = next((key for key, value in content.items() if isinstance(value, dict)), None)
        if nested is not None:
            raise DocumentError(
                f"unknown key {nested!r}: keys stand outside of tables, as `replay vehicle` prints them"
            )
        return convert(content, Vehicle, exact=True)
    except DocumentError as error:
        raise ReplayError(VEHICLE_ERROR, f"{os.fspath(path)}: {error}") from error
