"""Building crocoddyl_model.cpp against the headers and the library in crocoddyl's wheel, and calling it."""

import ctypes
import hashlib
import importlib
import importlib.metadata
import pathlib
import shutil
import subprocess
from typing import Any

import numpy as np

from optim.numerics.arrays import Array, IntArray
from tools.bench.peers.stage_pointers import slopes_pointer, value_pointer

SOURCE = pathlib.Path(__file__).with_name("crocoddyl_model.cpp")
FOLDER = pathlib.Path(__file__).resolve().parents[3] / "out" / "bench"
FLAGS = ("-std=c++17", "-O3", "-DNDEBUG", "-shared", "-fPIC", "-DPINOCCHIO_ENABLE_COMPATIBILITY_WITH_VERSION_2")
"""No instructions beyond the wheel's: Eigen's arrays are aligned by them, on both sides of the interface."""


def why_not() -> str:
    """What is missing to build it; empty where nothing is."""
    missing = [name for name in ("crocoddyl", "cmeel-eigen") if not _is_installed(name)]
    return ", ".join([*missing, *([] if shutil.which("g++") else ["g++"])])


def _is_installed(name: str) -> bool:
    try:
        importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return False
    return True


def _prefix(name: str) -> pathlib.Path:
    """Where a wheel keeps its headers and libraries."""
    return pathlib.Path(str(importlib.metadata.distribution(name).locate_file("cmeel.prefix")))


def library() -> Any:
    """The built library, from disk where source, flags and crocoddyl are still the same."""
    told = "\n".join([SOURCE.read_text(encoding="utf-8"), *FLAGS, importlib.metadata.version("crocoddyl")])
    built = FOLDER / f"crocoddyl_model-{hashlib.sha256(told.encode()).hexdigest()[:12]}.so"
    if not built.exists():
        prefix, eigen = _prefix("libcrocoddyl"), _prefix("cmeel-eigen")
        command = ["g++", *FLAGS, str(SOURCE), "-o", str(built)]
        for folder in (prefix / "include", eigen / "include" / "eigen3"):
            command += ["-isystem", str(folder)]
        command += [f"-L{prefix / 'lib'}", "-lcrocoddyl", f"-Wl,-rpath,{prefix / 'lib'}"]
        FOLDER.mkdir(parents=True, exist_ok=True)
        subprocess.run(command, check=True)
    importlib.import_module("crocoddyl")  # its wheel knows best where what its library needs is
    loaded = ctypes.CDLL(str(built))
    address, whole, number = ctypes.c_void_p, ctypes.c_int64, ctypes.c_double
    loaded.shooting_new.restype = address
    loaded.shooting_new.argtypes = [address, address, address, whole, *[address] * 4]
    loaded.shooting_solve.restype = whole
    loaded.shooting_solve.argtypes = [address, address, address, number, whole, number, address]
    loaded.shooting_drop.restype = None
    loaded.shooting_drop.argtypes = [address]
    return loaded


class Shooting:
    """crocoddyl's shooting problem and SolverBoxFDDP, model and all compiled."""

    def __init__(self, table: IntArray, start: Array, idle: IntArray, low: Array, high: Array) -> None:
        """Of each stage, whether its second control does nothing, shape (N,), and bounds of the controls (N, 2)."""
        self._library, self._table = library(), table  # the table is read at every call
        start, low, high = (np.ascontiguousarray(one, float) for one in (start, low, high))
        idle = np.ascontiguousarray(idle, np.int64)
        self._handle = self._library.shooting_new(
            value_pointer.address,
            slopes_pointer.address,
            table.ctypes.data,
            len(low),
            *(one.ctypes.data for one in (start, idle, low, high)),
        )

    def solve(
        self, states: Array, controls: Array, tolerance: float, iterations: int, regularisation: float
    ) -> tuple[Array, Array, int, float]:
        """From states (N + 1, 6) and controls (N, 2): the same of the solution, iterations, stopping value."""
        states, controls, stop = (np.array(one, float, order="C") for one in (states, controls, [0.0]))
        place = (states.ctypes.data, controls.ctypes.data)
        count = self._library.shooting_solve(
            self._handle, *place, tolerance, iterations, regularisation, stop.ctypes.data
        )
        return states, controls, int(count), float(stop[0])

    def close(self) -> None:
        """Give its memory back."""
        self._library.shooting_drop(self._handle)
        self._handle = None
