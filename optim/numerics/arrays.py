"""Read-only views: every array that enters a compiled kernel goes through here.

Numba compiles a kernel anew for each combination of layout and mutability. One form for all of them
(C-contiguous, float64 or int64, read-only) means that each kernel is compiled exactly once.
"""

import numpy as np
from numpy.typing import ArrayLike, NDArray

Array = NDArray[np.float64]
IntArray = NDArray[np.int64]
BoolArray = NDArray[np.bool_]


def frozen(values: ArrayLike) -> Array:
    """A C-contiguous read-only float64 view (or copy, where the layout or type asks for one)."""
    view = np.ascontiguousarray(values, dtype=np.float64).view()
    view.flags.writeable = False
    return view


def frozen_int(values: ArrayLike) -> IntArray:
    """As `frozen`, in int64."""
    view = np.ascontiguousarray(values, dtype=np.int64).view()
    view.flags.writeable = False
    return view
