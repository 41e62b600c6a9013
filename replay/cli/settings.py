"""What `replay optimize` is to do, from four places: its flags, `--set`, a configuration file, an earlier run.

Each place gives a layer: group -> option -> value, for those options alone that it names. The groups are the methods
by name, `weights`, `reading`, and the empty name for what concerns the whole run. Layers are merged, the more
particular one on top; what none of them names has its default.
"""

import math
import pathlib
import tomllib
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from functools import cache
from types import UnionType
from typing import Any, Final, Literal, Union, get_args, get_origin

from msgspec import UNSET

from optim.methods import METHODS
from optim.methods.chain import named
from optim.model.method import Method
from optim.model.objective import Weights
from optim.model.vehicle import Vehicle
from replay.base.documents import DocumentError, convert
from replay.base.schemas.results import ResultsDocument
from replay.cli.options import Option, UsageError, given, options_of, read_toml, with_flags
from replay.cli.reading import READING, read_options
from replay.cli.usage import unknown
from replay.logs import ReadOptions
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
    """What concerns the whole run."""

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
        """Of one method."""
        return Limits(time_s=self.time_limit, memory_mib=self.memory_limit)


@dataclass(frozen=True, kw_only=True)
class Settings:
    """All options of a run, each with its value."""

    run: RunOptions
    methods: Mapping[str, Method]
    """Those to run, in this order: methods and chains of methods."""
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
        methods=_chosen(run.method, methods),
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


def _chosen(names: Iterable[str] | None, methods: Mapping[str, Method]) -> dict[str, Method]:
    """The named methods and chains of methods, in the order given, each once; all methods when none is named."""
    return {name: _named(name, methods) for name in names or methods}


def _named(name: str, methods: Mapping[str, Method]) -> Method:
    try:
        return named(name, methods)
    except KeyError as error:
        part = error.args[0]
        where = "" if part == name else f"in {name!r}"
        raise UsageError(unknown("method", part, methods, where)) from error


def layer_of_flags(run: Any, reading: Any, weights: Any, methods: Any) -> Layer:
    """What was given as flags; each argument is an instance of the class of its flags, or None."""
    layer = {RUN: given(run), READ: given(reading)}
    layer[WEIGHTS] = given(getattr(weights, WEIGHTS, None))
    layer |= {name: given(getattr(methods, name, None)) for name in METHODS}
    if "method" in layer[RUN]:
        layer[RUN]["method"] = tuple(layer[RUN]["method"])
    return layer


def layer_of_file(path: pathlib.Path) -> Layer:
    """A configuration file: TOML, a table for each group; what concerns the whole run stands outside of tables.

    Paths in it are relative to its folder. Raises UsageError for a file that cannot be read, for what is unknown, and
    for a value of a wrong type.
    """
    where = f"--config {path}"
    return _layer(read_toml(path, where), where, path.parent)


def layer_of_assignments(assignments: Iterable[str]) -> Layer:
    """What `--set GROUP.OPTION=VALUE` gives; a value is read as in TOML, else as text. Raises UsageError."""
    layer: dict[str, dict[str, Any]] = {}
    for assignment in assignments:
        place, sign, text = (part.strip() for part in assignment.partition("="))
        group, _, name = place.rpartition(".")
        if not sign or not name:
            example = "as in --set shortcut.tries=500 or --set weights.cusp=7"
            raise UsageError(f"--set {assignment}: expected GROUP.OPTION=VALUE, {example}")
        try:
            value = tomllib.loads(f"value = {text}")["value"]
        except tomllib.TOMLDecodeError:
            value = text
        one = _layer({group: {name: value}} if group else {name: value}, f"--set {assignment}", pathlib.Path())
        for key, options in one.items():
            layer[key] = {**layer.get(key, {}), **options}
    return layer


def _layer(content: Mapping[str, Any], where: str, folder: pathlib.Path) -> Layer:
    """A layer from nested tables, every name known and every value of its option's type."""
    layer: dict[str, dict[str, Any]] = {RUN: {}}
    tables = [name for name in groups() if name != RUN]
    for key, value in content.items():
        if isinstance(value, Mapping):
            if key not in tables:
                raise UsageError(f"{where}: {unknown('table', key, tables)}")
            layer[key] = dict(_option(key, *item, where) for item in value.items())
        elif key in tables:
            raise UsageError(f"{where}: {key} is {value!r}, expected a table of its options, as in [{key}]")
        else:
            name, checked = _option(RUN, key, value, where)
            layer[RUN][name] = checked
    vehicle = layer.get(READ, {}).get("vehicle")
    if vehicle is not None:
        layer[READ]["vehicle"] = folder / vehicle
    return layer


def _option(group: str, key: str, value: Any, where: str) -> tuple[str, Any]:
    """An option's name and value, with `-` and `_` alike in the name. Raises UsageError."""
    known = groups()[group]
    name = key.replace("-", "_")
    if name not in known:
        choices = list(known) if group else [*known, *(table for table in groups() if table)]
        raise UsageError(f"{where}: {unknown('option', key, choices, f'of {group}' if group else '')}")
    try:
        return name, _as_type(value, known[name].hint)
    except ValueError as error:
        place = f"{group}.{key}" if group else key
        raise UsageError(f"{where}: {place} is {value!r}, expected {error}") from None


_EXPECTED: Final = {
    float: "a number",
    int: "a whole number",
    bool: "true or false",
    str: "a text",
    pathlib.Path: "the name of a file",
}


def _as_type(value: Any, hint: Any) -> Any:
    """A value of TOML or JSON as one of an option's type. ValueError with what was expected."""
    if get_origin(hint) in (Union, UnionType):
        hint = next(kind for kind in get_args(hint) if kind is not type(None))
    if get_origin(hint) is Literal:
        if value not in get_args(hint) or isinstance(value, bool):
            raise ValueError(" or ".join(map(repr, get_args(hint))))
        return value
    if get_origin(hint) is tuple:
        names = [value] if isinstance(value, str) else value
        if not isinstance(names, (list, tuple)) or not names or not all(isinstance(name, str) for name in names):
            raise ValueError("a name or a list of names")
        return tuple(names)
    if hint is float and isinstance(value, int) and not isinstance(value, bool):
        try:
            return float(value)
        except OverflowError:  # of more than 308 digits
            raise ValueError(_EXPECTED[float]) from None
    if hint is pathlib.Path and isinstance(value, str):
        return pathlib.Path(value)
    if not isinstance(value, hint) or (isinstance(value, bool) and hint is not bool):
        raise ValueError(_EXPECTED[hint])
    return value


def layer_of_results(document: ResultsDocument, source: str) -> Layer:
    """All options that a results file was made with. Raises UsageError where it does not hold them.

    Options that the file does not know yet have their defaults.
    """
    tool = document.tool
    where = f"--from {source}"
    reading, limits = tool.reading, tool.limits
    if reading is UNSET or limits is UNSET:
        raise UsageError(f"{where}: it does not hold the options of its run (tool.reading and tool.limits)")
    ran = [method.name for method in document.methods]
    layer: dict[str, dict[str, Any]] = {RUN: {"method": (*ran, *(name for name in tool.options if name not in ran))}}
    layer[RUN]["seed"] = tool.seed
    for limit, stored in (("time_limit", limits.time_s), ("memory_limit", limits.memory_mib)):
        if stored is not None:
            layer[RUN][limit] = stored
    known = {name: value for name, value in reading.items() if name != "vehicle" and value is not None}
    layer[READ] = {name: _option(READ, name, value, where)[1] for name, value in known.items()}
    if reading.get("vehicle") is not None:
        layer[READ]["vehicle"] = _vehicle(reading["vehicle"], where)
    layer[WEIGHTS] = {name: _option(WEIGHTS, name, value, where)[1] for name, value in document.weights.items()}
    for name, values in _by_method(tool.options, where):
        found = {key: _option(name, key, value, where)[1] for key, value in values.items() if value is not None}
        if layer.setdefault(name, found) != found:
            raise UsageError(f"{where}: it holds two sets of options for {name}, one alone and one in a chain")
    return layer


def _by_method(options: Mapping[str, Mapping[str, Any]], where: str) -> Iterable[tuple[str, Mapping[str, Any]]]:
    """The options of each method, those of a chain's parts too."""
    for name, values in options.items():
        parts = {name: values} if name in METHODS else values
        for part, own in parts.items():
            if not isinstance(own, Mapping):
                raise UsageError(f"{where}: the options of {name!r} are no table")
            if part not in METHODS:
                raise UsageError(f"{where}: {unknown('method', part, METHODS)}")
            yield part, own


def _vehicle(values: Any, where: str) -> Vehicle:
    try:
        return convert(values, Vehicle, "its vehicle", exact=True)
    except DocumentError as error:
        raise UsageError(f"{where}: {error}") from error
