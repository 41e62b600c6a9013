"""Versions of this program and of the packages that can change a number or a file."""

import importlib.metadata
from typing import Final

DISTRIBUTION: Final = "truck-trailer-replay"
PACKAGES: Final = ("numpy", "scipy", "numba", "shapely", "zstandard", "lz4", "rerun-sdk")
"""Distributions whose versions a document holds."""


def installed_version(distribution: str) -> str | None:
    """The version of a distribution; None where it is not installed."""
    try:
        return importlib.metadata.version(distribution)
    except importlib.metadata.PackageNotFoundError:
        return None
