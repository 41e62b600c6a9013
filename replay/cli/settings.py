"""Settings of `replay optimize`, from three places: its flags, a configuration file, an earlier run.

Each place gives a layer: group -> option -> value, for those options alone that it names. The groups are the methods
by name, `weights`, `reading`, and the empty name for what concerns the whole run. Layers are merged once, the more
particular one on top; what none of them names has its default.
"""

import math
import pathlib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from types import UnionType
from typing import TYPE_CHECKING, Annotated, Any, Final, TypeAlias, Union, get_args, get_origin

import msgspec

from optim.methods import METHODS
from optim.model.method import Method
from optim.model.objective import Weights
from optim.model.vehicle import Vehicle
from replay.base.documents import DocumentError, Whole, convert, read_toml
from replay.base.errors import UsageError, unknown
from replay.base.schemas.results import ResultsDocument
from replay.cli.options import Option, flags_of, given, options_of, with_flags
from replay.cli.reading import READING, read_options
from replay.logs import ReadOptions
from replay.pipeline import method_named
from replay.run.limits import Limits

RUN: Final = ""
WEIGHTS: Final = "weights"
READ: Final = "reading"
Layer = Mapping[str, Mapping[str, Any]]
LEAST_MEMORY: Final = 512
"""Memory below which loading the kernels alone may fail [MiB]."""
MOST_JOBS: Final = 1024


@dataclass(frozen=True, kw_only=True)
class RunOptions:
    """Options of the whole run."""

    method: tuple[str, ...] | None = None
    """A method to run, by name; several with commas between, or by giving this several times. Names joined by +, as in
    A+B, run one after the other, each from where the one before ended. All methods, each by itself, by default, and
    where it is `all`."""
    seed: int = 0
    """Seed for every method that has one."""
    recording: bool = True
    """Write the Rerun recording."""
    time_limit: float = math.inf
    """Time that each method has for a case [s], compiling not counted; then its best iterate so far that passes the
    audit is its result. No limit by default."""
    memory_limit: int = 4096
    """Memory that the process of a method may use [MiB]; a method that needs more fails."""
    jobs: int = 2
    """Methods of a case that run at the same time; of more than this computer has cores, as many as it has."""

    def __post_init__(self) -> None:
        if not self.time_limit > 0.0:
            raise ValueError(f"--time-limit is {self.time_limit:g}, expected more than 0 s")
        if self.memory_limit < LEAST_MEMORY:
            raise ValueError(f"--memory-limit is {self.memory_limit}, expected {LEAST_MEMORY} MiB or more")
        if not 1 <= self.jobs <= MOST_JOBS:
            raise ValueError(f"--jobs is {self.jobs}, expected 1 to {MOST_JOBS}")

    @property
    def limits(self) -> Limits:
        """Limits of one method."""
        return Limits(time_s=self.time_limit, memory_mib=self.memory_limit)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """All options of a run, each with its value."""

    run: RunOptions
    methods: Mapping[str, Method]
    """Methods and chains of methods to run, in this order."""
    read: ReadOptions
    weights: Weights


@cache
def groups() -> Mapping[str, Mapping[str, Option]]:
    """All options by group and name."""
    found = {RUN: options_of(RunOptions()), READ: READING, WEIGHTS: options_of(Weights(), WEIGHTS)}
    found |= {name: options_of(method, name) for name, method in METHODS.items()}
    return {group: {option.name: option for option in options} for group, options in found.items()}


def settled(layers: Iterable[Layer]) -> Settings:
    """The settings that layers give, the lowest layer first. Raises UsageError for a value out of range.

    A method's own seed stands above the seed of the run, unless that one was given in a higher layer.
    """
    values: dict[str, dict[str, Any]] = {group: {} for group in groups()}
    for layer in layers:
        if "seed" in layer.get(RUN, {}):
            for name in METHODS:
                values[name].pop("seed", None)
        for group, options in layer.items():
            values[group] |= options
    if named_methods := values[RUN].get("method"):
        values[RUN]["method"] = tuple(method_names(named_methods))
    try:
        run = RunOptions(**values[RUN])
    except ValueError as error:
        raise UsageError(str(error)) from error
    methods = {name: _method(name, plain, values[name], run.seed) for name, plain in METHODS.items()}
    return Settings(
        run=run,
        methods={name: method_named(name, methods) for name in run.method or methods},
        read=read_options(values[READ]),
        weights=with_flags(Weights(), values[WEIGHTS], WEIGHTS),
    )


def method_names(given: Iterable[str]) -> Iterable[str]:
    """The names of methods and chains in texts of several, in small letters as they are; `all` stands for all."""
    for name in (name.strip().lower() for text in given for name in text.split(",")):
        yield from METHODS if name == "all" else (name,)


def _method(name: str, plain: Method, values: Mapping[str, Any], seed: int) -> Method:
    common = {"seed": seed} if "seed" in groups()[name] else {}
    return with_flags(plain, {**common, **values}, name)


def layer_of_flags(run: Any, reading: Any, weights: Any, methods: Any) -> Layer:
    """Layer of the flags that were given; each argument is an instance of the class of its flags, or None."""
    layer = {RUN: given(run), READ: given(reading)}
    layer[WEIGHTS] = given(getattr(weights, WEIGHTS, None))
    layer |= {name: given(getattr(methods, name, None)) for name in METHODS}
    if "method" in layer[RUN]:
        layer[RUN]["method"] = tuple(layer[RUN]["method"])
    return layer


# Configuration files.


@cache
def schema(group: str) -> type[msgspec.Struct]:
    """The table of a group's options in a configuration file; of RUN, the whole file. All of it may be left out."""
    fields: list[tuple[str, Any, Any]] = [
        (option.name, _in_toml(option) | msgspec.UnsetType, msgspec.UNSET) for option in groups()[group].values()
    ]
    if group == RUN:
        tables = [name for name in groups() if name != RUN]
        fields += [(name, schema(name) | msgspec.UnsetType, msgspec.UNSET) for name in tables]
    name = group.capitalize() or "Configuration"
    return msgspec.defstruct(name, fields, frozen=True, kw_only=True, forbid_unknown_fields=True)


def _in_toml(option: Option) -> Any:
    """The type of an option's value in TOML and JSON."""
    hint = option.hint
    if get_origin(hint) in (Union, UnionType):
        hint = next(kind for kind in get_args(hint) if kind is not type(None))
    if get_origin(hint) is tuple:
        return str | Annotated[tuple[str, ...], msgspec.Meta(min_length=1)]
    return {int: Whole, pathlib.Path: str}.get(hint, hint)


def layer_of_file(path: pathlib.Path) -> Layer:
    """A configuration file: TOML, a table for each group; what concerns the whole run stands outside of tables.

    Paths in it are relative to its folder. Raises UsageError for a file that cannot be read, for what is unknown, and
    for a value of a wrong type.
    """
    try:
        content = {key.replace("-", "_"): _undashed(value) for key, value in read_toml(path).items()}
        found = _given(convert(content, schema(RUN)))
    except DocumentError as error:
        raise UsageError(f"--config {path}: {str(error).replace('an object', 'a table')}") from error
    tables = {name: _given(table) for name, table in found.items() if name in groups()}
    layer = tables | {RUN: {name: value for name, value in found.items() if name not in tables}}
    method = layer[RUN].get("method")
    if isinstance(method, str):
        layer[RUN]["method"] = (method,)
    vehicle = layer.get(READ, {}).get("vehicle")
    if vehicle is not None:
        layer[READ]["vehicle"] = path.parent / vehicle
    return layer


def _undashed(value: Any) -> Any:
    """A table with _ for each - in its keys: both are alike."""
    return {key.replace("-", "_"): entry for key, entry in value.items()} if isinstance(value, dict) else value


def _given(table: msgspec.Struct) -> dict[str, Any]:
    return {name: value for name, value in msgspec.structs.asdict(table).items() if value is not msgspec.UNSET}


# An earlier run.


def layer_of_results(document: ResultsDocument, source: str) -> Layer:
    """All options that a results file was made with. Raises UsageError where it does not hold them.

    Options that the file does not know yet have their defaults.
    """
    tool, where = document.tool, f"--from {source}"
    if tool.reading is msgspec.UNSET or tool.limits is msgspec.UNSET:
        raise UsageError(f"{where}: it does not hold the options of its run (tool.reading and tool.limits)")
    ran = [method.name for method in document.methods]
    run = {"method": (*ran, *(name for name in tool.options if name not in ran)), "seed": tool.seed}
    limits = {"time_limit": tool.limits.time_s, "memory_limit": tool.limits.memory_mib}
    layer = {RUN: run | {name: value for name, value in limits.items() if value is not None}}
    try:
        reading = {name: value for name, value in tool.reading.items() if name != "vehicle"}
        layer[READ] = _stored(READ, reading, "tool.reading")
        if tool.reading.get("vehicle") is not None:
            layer[READ]["vehicle"] = convert(tool.reading["vehicle"], Vehicle, "tool.reading.vehicle", exact=True)
        layer[WEIGHTS] = _stored(WEIGHTS, document.weights, WEIGHTS)
        for name, values in _by_method(tool.options):
            found = _stored(name, values, f"tool.options.{name}")
            if layer.setdefault(name, found) != found:
                raise DocumentError(f"it holds two sets of options for {name}, one alone and one in a chain")
    except DocumentError as error:
        raise UsageError(f"{where}: {error}") from error
    return layer


def _stored(group: str, values: Any, at: str) -> dict[str, Any]:
    """The options of a group as a results file has them: null where one is not set. Raises DocumentError."""
    if not isinstance(values, Mapping):
        raise DocumentError(f"{at} is {values!r}, expected an object")
    return _given(convert({name: value for name, value in values.items() if value is not None}, schema(group), at))


def _by_method(options: Mapping[str, Mapping[str, Any]]) -> Iterable[tuple[str, Any]]:
    """The options of each method, those of a chain's parts too. Raises DocumentError."""
    for name, values in options.items():
        for part, own in ({name: values} if name in METHODS else values).items():
            if part not in METHODS:
                raise DocumentError(unknown("method", part, METHODS, f"in tool.options.{name}"))
            yield part, own


# Flags of methods and weights, which `replay optimize` and `replay regress` share.

if TYPE_CHECKING:
    MethodFlags: TypeAlias = Any
    WeightFlags: TypeAlias = Any
else:
    MethodFlags = flags_of(METHODS, "Options of {name}")
    WeightFlags = flags_of({WEIGHTS: Weights()}, "Weights of the objective J")
