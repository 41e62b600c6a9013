"""The kernels of a stage as C functions, for a library that is compiled itself and knows nothing of numpy.

A C function gets numbers and addresses only, so everything that the kernels read is listed in a table: address and
shape of each array, one row each, in the order of `_leaves`; the numbers share the last row. The table is read at every
call; after the model has changed its rows or penalties, `write` brings it up to date.
"""

from collections.abc import Iterator
from typing import Any

import numpy as np
from numba import cfunc, njit, types
from numba.extending import intrinsic
from numba.np.numpy_support import carray

from optim.geometry.polygons import PackedScene
from optim.methods.ddp.backward import Expansion
from optim.methods.ddp.constraints import Bodies, ClearanceRows, Constraints, Lagrangian, PerConstraint
from optim.methods.ddp.truck import Stages, StageWeights
from optim.numerics.arrays import Array, IntArray
from tools.bench.peers.stage_kernels import stage_slopes, stage_value

COLUMNS = 5  # address, and up to four sizes
_X, _BOTH = 6, 8
_SIZES = ((0,) * 6, (0,) * 2, (0,) * 3)  # Expansion.sizes of 6 states and 2 controls


def _leaves(part: Any) -> Iterator[Any]:
    """Arrays and numbers in nested tuples, depth first."""
    if isinstance(part, tuple):
        for piece in part:
            yield from _leaves(piece)
    else:
        yield part


def write(place: tuple[Any, ...], table: IntArray, numbers: Array) -> None:
    """Fill the table with addresses and shapes, `numbers` with the numbers; keep all of them alive while it is used."""
    leaves = list(_leaves(place))
    numbers[:] = [leaf for leaf in leaves if isinstance(leaf, float)]
    arrays = [leaf for leaf in leaves if isinstance(leaf, np.ndarray)]
    for row, array in zip(table, [*arrays, numbers], strict=True):
        if not array.flags.c_contiguous:
            raise ValueError("stage pointers: an array is not contiguous")
        row[0], row[1:] = array.ctypes.data, 1
        row[1 : 1 + array.ndim] = array.shape


def new_table() -> tuple[IntArray, Array]:
    """A table to fill, shape (ARRAYS, COLUMNS), and the array of the numbers."""
    return np.zeros((ARRAYS, COLUMNS), np.int64), np.zeros(NUMBERS)


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
    n = _line(t, 37)
    weights, kinematics = StageWeights(n[0], n[1], n[2]), (n[5], n[6], n[7])
    gear, share, jump = _line(t, 0), _line(t, 1), _line(t, 2)
    shortest, longest, toll = _line(t, 3), _line(t, 4), _line(t, 5)
    stages = Stages(gear, share, jump, shortest, longest, toll, weights, n[3], n[4], kinematics)
    scene = PackedScene(_line(t, 6), _ints(t, 7), _plane(t, 8), _plane(t, 9), _plane(t, 10), _ints(t, 11), _ints(t, 12))
    bodies = Bodies(_plane(t, 13), n[8])
    rows = ClearanceRows(_ints(t, 14), _ints(t, 15), _ints(t, 16), _ints(t, 17), _line(t, 18))
    penalty = PerConstraint(n[9], n[10], n[11])
    lagrangian = Lagrangian(penalty, _line(t, 19), _line(t, 20), n[12], _plane(t, 21), _plane(t, 22))
    expansion = Expansion(
        _block(t, 23),
        _curvature(t, 24),
        _plane(t, 25),
        _plane(t, 26),
        _block(t, 27),
        _block(t, 28),
        _block(t, 29),
        _line(t, 30),
        _plane(t, 31),
        _plane(t, 32),
        _block(t, 33),
        _block(t, 34),
        _SIZES,
    )
    return stages, Constraints(scene, bodies, rows, lagrangian), expansion, _plane(t, 35), _plane(t, 36)


ARRAYS, NUMBERS = 38, 13

_TABLE, _VECTOR = types.CPointer(types.int64), types.CPointer(types.float64)


@cfunc(types.float64(_TABLE, types.int64, _VECTOR, _VECTOR, _VECTOR), cache=True)
def value_pointer(table, k, x, w, out):
    """`stage_value` at state x (6,) and control w (2,), the next state into out (6,)."""
    st, constraints, e, steer, states = _read(carray(table, (ARRAYS, COLUMNS)))
    for i in range(_X):
        states[k, i] = x[i]
    return stage_value(st, constraints, e, steer, states, k, carray(w, (2,)), carray(out, (_X,)))


@cfunc(types.void(_TABLE, types.int64, _VECTOR, _VECTOR, _VECTOR, _VECTOR, _VECTOR), cache=True)
def slopes_pointer(table, k, x, w, fz, lz, lzz):
    """`stage_slopes` there, into fz (6, 8), lz (8,), lzz (8, 8), by rows."""
    st, constraints, e, steer, states = _read(carray(table, (ARRAYS, COLUMNS)))
    for i in range(_X):
        states[k, i] = x[i]
    fz, lz, lzz = carray(fz, (_X, _BOTH)), carray(lz, (_BOTH,)), carray(lzz, (_BOTH, _BOTH))
    stage_slopes(st, constraints, e, steer, states, k, carray(w, (2,)), fz, lz, lzz)
