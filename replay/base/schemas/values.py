"""Single values that several documents share."""

from typing import TypeVar

from msgspec import UNSET, UnsetType

from replay.base.documents import Whole

Exact = Whole | float
"""A number that is written back as it was read, whole or not."""
Scalar = bool | Whole | float | str | None
"""A value of an option or a figure."""
_T = TypeVar("_T")


def known(value: _T | UnsetType) -> _T | None:
    """A value, or None where the document does not have it."""
    return None if value is UNSET else value
