"""One thread for every numerical library, so that the same log and options give the same bits everywhere.

With other numbers of threads sums are taken in another order, and results differ in their last bits; the arrays are
small, so threads would only cost time. Libraries read their environment variable once, when they are loaded; those that
are loaded already, as in a notebook, are limited through threadpoolctl while the work is done.
"""

import contextlib
import functools
import os
import sys
from collections.abc import Iterator
from typing import Final

VARIABLES: Final = (
    *("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS"),
    *("NUMEXPR_NUM_THREADS", "NUMBA_NUM_THREADS", "RAYON_NUM_THREADS"),
)
_NUMBA: Final = "NUMBA_NUM_THREADS"
"""Read again whenever Numba compiles: once its threads run it must not change, and no kernel of ours uses them."""


def use_one_thread() -> None:
    """Limit libraries that this process and its children load from now on, whatever the environment says."""
    _is_in_time()
    wanted = [name for name in VARIABLES if name != _NUMBA or "numba" not in sys.modules]
    os.environ.update(dict.fromkeys(wanted, "1"))


@functools.cache
def _is_in_time() -> bool:
    """Whether the variables were set before numpy was loaded; the first call decides."""
    are_set = all(os.environ.get(name) == "1" for name in VARIABLES if name != _NUMBA)
    return are_set or "numpy" not in sys.modules


@contextlib.contextmanager
def one_thread() -> Iterator[None]:
    """Limit libraries while the block runs: those loaded before too, which get their threads back afterwards."""
    use_one_thread()
    if _is_in_time():
        yield
        return
    from threadpoolctl import threadpool_limits  # a third of a second

    with threadpool_limits(1):
        yield
