"""Types of single values that several documents share."""

from typing import Annotated

from msgspec import Meta

Count = Annotated[int, Meta(ge=-(2**63), le=2**63 - 1)]
"""A whole number of 64 bits: what a column of a table can hold."""
Number = Count | float
"""A number as a document holds it: written back as it was read, whole or not."""
Scalar = bool | Count | float | str | None
"""A value of an option."""
