"""Tables for notebooks: columns of numbers as a data frame of whichever library is installed."""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

LIBRARIES = ("pandas", "polars")


def data_frame(columns: Mapping[str, Any]) -> Any:
    """Columns as a pandas DataFrame, else as a polars one. Raises ImportError, one line, where neither is installed."""
    for library in LIBRARIES:
        try:
            return import_module(library).DataFrame(dict(columns))
        except ModuleNotFoundError as error:
            if error.name != library:
                raise
    raise ImportError("to_dataframe() needs pandas or polars: pip install pandas")
