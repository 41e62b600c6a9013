"""Columns as a table of pandas or polars, whichever is installed."""

import importlib
from collections.abc import Mapping
from typing import Any


def data_frame(columns: Mapping[str, Any]) -> Any:
    """A DataFrame of pandas, else of polars, from columns of one length. Raises ImportError where neither is there."""
    for name in ("pandas", "polars"):
        try:
            library = importlib.import_module(name)
        except ImportError:
            continue
        return library.DataFrame(dict(columns))
    raise ImportError("to_dataframe needs pandas or polars, and neither is installed: pip install pandas")
