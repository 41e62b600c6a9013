"""`replay optimize`: read logs, run methods, write recordings and results, show the comparison."""

import dataclasses
import math
import pathlib
from collections.abc import Mapping
from typing import TYPE_CHECKING, Annotated, Any, TypeAlias

from cyclopts import Parameter

from optim.methods import METHODS, Method
from optim.methods.chain import named
from optim.objective import Weights
from replay.cli.console import Common, Voice
from replay.cli.options import UsageError, flags_of, with_flags
from replay.cli.outputs import Outputs
from replay.cli.reading import Reading, read_options
from replay.cli.session import Session
from replay.cli.usage import unknown
from replay.worker import Limits

if TYPE_CHECKING:
    MethodFlags: TypeAlias = Any
    WeightFlags: TypeAlias = Any
else:
    MethodFlags = flags_of(METHODS, "Options of {name}")
    WeightFlags = flags_of({"weights": Weights()}, "Weights of the objective J")

LEAST_MEMORY = 512
"""Memory below which loading the kernels alone may fail [MiB]."""
_FLAT = Parameter(name="*")


def optimize(
    logs: list[pathlib.Path],
    /,
    *,
    method: Annotated[list[str] | None, Parameter(negative=())] = None,
    out: pathlib.Path = pathlib.Path(),
    seed: int | None = None,
    recording: bool = True,
    time_limit: float | None = None,
    memory_limit: int = 4096,
    common: Annotated[Common | None, _FLAT] = None,
    reading: Annotated[Reading | None, _FLAT] = None,
    weights: Annotated[WeightFlags | None, _FLAT] = None,
    options: Annotated[MethodFlags | None, _FLAT] = None,
) -> int:
    """Improve the recorded paths of logs; write a Rerun recording and a results file for each.

    Parameters
    ----------
    logs
        MCAP files.
    method
        A method to run, by name; may be given several times. Names joined by +, as in A+B, run one after the other,
        each from where the one before ended. All methods, each by itself, by default.
    out
        Folder for the files, made if it is missing: STEM.rrd and STEM.results.json for each log. STEM is the log's
        name; where a log holds several requests, their numbers follow it (STEM-0, STEM-1).
    seed
        Seed for every method that has one.
    recording
        Write the Rerun recording.
    time_limit
        Time that each method has for a case [s], compiling not counted; then its best iterate so far that passes the
        audit is its result. No limit by default.
    memory_limit
        Memory that the process of the methods may use [MiB]; a method that needs more fails.
    """
    _check_limits(time_limit, memory_limit)
    session = Session(
        voice=Voice(common or Common()),
        methods=chosen(method, with_options(options, seed)),
        read=read_options(reading),
        weights=with_flags(Weights(), weights.weights, "weights") if weights else Weights(),
        seed=seed or 0,
        outputs=Outputs(out, logs),
        recording=recording,
        limits=Limits(time_s=math.inf if time_limit is None else time_limit, memory_mib=memory_limit),
    )
    return session.run(logs)


def _check_limits(time_limit: float | None, memory_limit: int) -> None:
    if time_limit is not None and not 0.0 < time_limit < math.inf:
        raise UsageError(f"--time-limit is {time_limit:g}, expected more than 0 s")
    if memory_limit < LEAST_MEMORY:
        raise UsageError(f"--memory-limit is {memory_limit}, expected {LEAST_MEMORY} MiB or more")


def with_options(options: Any, seed: int | None) -> dict[str, Method]:
    """The methods with the options and the seed that were given; a method's own --METHOD.seed wins."""
    methods = dict(METHODS)
    for name, plain in METHODS.items():
        method = with_flags(plain, getattr(options, name), name) if options else plain
        if seed is not None and getattr(method, "seed", None) == getattr(plain, "seed", object()):
            method = dataclasses.replace(method, seed=seed)  # pyright: ignore[reportArgumentType]
        methods[name] = method
    return methods


def chosen(names: list[str] | None, methods: Mapping[str, Method]) -> dict[str, Method]:
    """The named methods and chains of methods, in the order given, each once; all methods when none is named."""
    return {name: _named(name, methods) for name in names or methods}


def _named(name: str, methods: Mapping[str, Method]) -> Method:
    try:
        return named(name, methods)
    except KeyError as error:
        part = error.args[0]
        where = "" if part == name else f"in {name!r}"
        raise UsageError(unknown("method", part, methods, where)) from error
