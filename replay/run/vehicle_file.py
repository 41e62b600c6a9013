"""A vehicle as a TOML file: keys as the fields of `Vehicle`, SI units."""

import os

from optim.model.vehicle import Vehicle
from replay.base.documents import DocumentError, convert, read_toml
from replay.base.errors import UsageError


def read_vehicle(path: str | os.PathLike[str]) -> Vehicle:
    """Read a vehicle; keys that the file leaves out have their defaults.

    Raises UsageError for a file that cannot be read, an unknown key, or a value out of range.
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
        said = str(error).removeprefix("vehicle: ")  # how `Vehicle` begins
        raise UsageError(f"vehicle {os.fspath(path)}: {said}") from error
