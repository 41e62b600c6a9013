"""Arrays: their types with shapes, read-only views that enter compiled kernels, and tables of columns.

Fields that hold arrays state type and shape, `states: Float64[Array, "N 4"]`, in the notation of jaxtyping: an axis
is a size, a name that stands for one size in all fields of one object, or `_` for any size; a single axis has a space
before it, " N", since linters take a lone word in quotes for a type. Nothing is checked at run time, and jaxtyping is
not imported: the tests check every object that they make.

Numba compiles a kernel again for each combination of layout and mutability. One form for all of them
(C-contiguous, float64 or int64, read-only) means that each kernel is compiled exactly once.
"""

import importlib
from collections.abc import Mapping
from typing import Annotated as Bool
from typing import Annotated as Float64
from typing import Annotated as Int8
from typing import Annotated as Int64
from typing import Any

import numpy as np
from numpy.typing import ArrayLike, NDArray

__all__ = ["Array", "Bool", "BoolArray", "Float64", "Int8", "Int64", "IntArray", "data_frame", "frozen", "frozen_int"]

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def frozen(values: ArrayLike) -> Array:
    """A C-contiguous read-only float64 view (or copy, where the layout or type asks for one)."""
    view = np.ascontiguousarray(values, dtype=np.float64).view()
    view.flags.writeable = False
    return view


def frozen_int(values: ArrayLike) -> IntArray:
    """A C-contiguous read-only int64 view or copy; see `frozen`."""
    view = np.ascontiguousarray(values, dtype=np.int64).view()
    view.flags.writeable = False
    return view


def data_frame(columns: Mapping[str, Any]) -> Any:
    """A DataFrame of pandas, else of polars, from columns of one length. Raises ImportError where neither is there."""
    for name in ("pandas", "polars"):
        try:
            library = importlib.import_module(name)
        except ImportError:
            continue
        return library.DataFrame(dict(columns))
    raise ImportError("to_dataframe needs pandas or polars, and neither is installed: pip install pandas")
