"""The kernels of a stage as C functions, for a library that is compiled itself and knows nothing of numpy.

A C function gets numbers and addresses only, so everything that the kernels read is listed in a table: address and
shape of each array, one row each, in the order of `_arrays`. The table is read at every call; after the rows of the
model have been listed anew, `write` brings it up to date.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numba import cfunc, njit, types
from numba.extending import intrinsic
from numba.np.numpy_support import carray

from optim.geometry.polygons import PackedScene
from optim.methods.ddp.backward import Expansion
from optim.methods.ddp.constraints import Lagrangian, Rows
from optim.methods.ddp.truck import Stages
from optim.numerics.arrays import Array, IntArray
from tools.bench.peers.stage_kernels import stage_slopes, stage_value

COLUMNS = 5  # address, and up to four sizes
_X, _BOTH = 6, 8
_SIZES = ((0,) * 6, (0,) * 2, (0,) * 3)  # Expansion.sizes of 6 states and 2 controls


def _arrays(place: tuple[Any, ...]) -> Iterator[Array | IntArray]:
    """The arrays of (stages, scene, footprints, rows, lagrangian, expansion, steer, states), in the table's order."""
    for part in place:
        if isinstance(part, tuple):
            yield from (array for array in part if isinstance(array, np.ndarray))
        else:
            yield part


def write(place: tuple[Any, ...], table: IntArray) -> None:
    """Addresses and shapes into the table; whoever passes it on keeps the arrays alive."""
    for row, array in zip(table, _arrays(place), strict=True):
        if not array.flags.c_contiguous:
            raise ValueError("stage pointers: an array is not contiguous")
        row[0], row[1:] = array.ctypes.data, 1
        row[1 : 1 + array.ndim] = array.shape


def new_table(place: tuple[Any, ...]) -> IntArray:
    """A table for these arrays, filled. Shape (number of arrays, `COLUMNS`)."""
    table = np.zeros((sum(1 for _ in _arrays(place)), COLUMNS), np.int64)
    write(place, table)
    return table


def _as_pointer(typing: Any, address: Any) -> Any:
    """An address as a pointer: signature, and what generates the code."""

    def generate(context: Any, builder: Any, signature: Any, arguments: Any) -> Any:
        return builder.inttoptr(arguments[0], context.get_value_type(signature.return_type))

    return types.voidptr(types.int64), generate


_pointer: Any = intrinsic(_as_pointer)


@njit
def _ints(table, i):
    return carray(_pointer(table[i, 0]), (table[i, 1],), np.int64)


@njit
def _line(table, i):
    return carray(_pointer(table[i, 0]), (table[i, 1],), np.float64)


@njit
def _plane(table, i):
    return carray(_pointer(table[i, 0]), (table[i, 1], table[i, 2]), np.float64)


@njit
def _block(table, i):
    return carray(_pointer(table[i, 0]), (table[i, 1], table[i, 2], table[i, 3]), np.float64)


@njit
def _curvature(table, i):
    return carray(_pointer(table[i, 0]), (table[i, 1], table[i, 2], table[i, 3], table[i, 4]), np.float64)


@njit
def _read(t):
    """The arguments that the kernels of a stage share, from the table."""
    stages = Stages(
        _line(t, 0),
        _line(t, 1),
        _line(t, 2),
        _line(t, 3),
        _line(t, 4),
        _line(t, 5),
        _line(t, 6),
        _line(t, 7),
        _line(t, 8),
    )
    scene = PackedScene(
        _line(t, 9), _ints(t, 10), _plane(t, 11), _plane(t, 12), _plane(t, 13), _ints(t, 14), _ints(t, 15)
    )
    footprints = _plane(t, 16)
    rows = Rows(_ints(t, 17), _ints(t, 18), _ints(t, 19), _ints(t, 20), _line(t, 21))
    lagrangian = Lagrangian(_line(t, 22), _line(t, 23), _plane(t, 24), _plane(t, 25), _line(t, 26))
    expansion = Expansion(
        _block(t, 27),
        _curvature(t, 28),
        _plane(t, 29),
        _plane(t, 30),
        _block(t, 31),
        _block(t, 32),
        _block(t, 33),
        _line(t, 34),
        _plane(t, 35),
        _plane(t, 36),
        _block(t, 37),
        _block(t, 38),
        _SIZES,
    )
    return stages, scene, footprints, rows, lagrangian, expansion, _plane(t, 39), _plane(t, 40)


ARRAYS = 41

_TABLE, _VECTOR = types.CPointer(types.int64), types.CPointer(types.float64)


@cfunc(types.float64(_TABLE, types.int64, _VECTOR, _VECTOR, _VECTOR), cache=True)
def value_pointer(table, k, x, w, out):
    """`stage_value` at state x (6,) and control w (2,), the next state into out (6,)."""
    st, scene, footprints, rows, lagrangian, e, steer, states = _read(carray(table, (ARRAYS, COLUMNS)))
    for i in range(_X):
        states[k, i] = x[i]
    return stage_value(
        st, scene, footprints, rows, lagrangian, e, steer, states, k, carray(w, (2,)), carray(out, (_X,))
    )


@cfunc(types.void(_TABLE, types.int64, _VECTOR, _VECTOR, _VECTOR, _VECTOR, _VECTOR), cache=True)
def slopes_pointer(table, k, x, w, fz, lz, lzz):
    """`stage_slopes` there, into fz (6, 8), lz (8,), lzz (8, 8), by rows."""
    st, scene, footprints, rows, lagrangian, e, steer, states = _read(carray(table, (ARRAYS, COLUMNS)))
    for i in range(_X):
        states[k, i] = x[i]
    stage_slopes(
        st,
        scene,
        footprints,
        rows,
        lagrangian,
        e,
        steer,
        states,
        k,
        carray(w, (2,)),
        carray(fz, (_X, _BOTH)),
        carray(lz, (_BOTH,)),
        carray(lzz, (_BOTH, _BOTH)),
    )
