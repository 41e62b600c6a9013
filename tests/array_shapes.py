"""Checks of the types and shapes that fields of arrays state, `Float64[Array, "N 4"]`, by jaxtyping.

`check_from_now_on` wraps the construction of every dataclass and NamedTuple of the project that has such fields: an
object with an array of another type or shape is refused. A name of an axis stands for one size in all fields of one
object. Only what is constructed in this process is checked, and what `NamedTuple._replace` makes is not.
"""

import dataclasses
import functools
import importlib.abc
import importlib.machinery
import inspect
import sys
import types
import typing
from collections.abc import Callable, Iterator, Sequence
from typing import Annotated, Any

import jaxtyping
import numpy as np

PACKAGES = ("optim", "replay")
_KINDS: dict[Any, Any] = {
    np.float64: jaxtyping.Float64,
    np.int64: jaxtyping.Int64,
    np.int8: jaxtyping.Int8,
    np.bool_: jaxtyping.Bool,
    np.object_: jaxtyping.Shaped,
}
_Test = Callable[[Any], bool]


class WrongShape(AssertionError):
    """An object was made with an array that is not what the field states."""


def check_from_now_on() -> None:
    """Check objects of all classes of the project, those of modules that are imported later among them."""
    for name in list(sys.modules):
        if name.split(".")[0] in PACKAGES:
            wrap_classes(sys.modules[name])
    if not any(isinstance(finder, _Finder) for finder in sys.meta_path):
        sys.meta_path.insert(0, _Finder())


def wrap_classes(module: types.ModuleType) -> None:
    """Wrap the construction of the module's own classes that have fields of arrays."""
    for cls in list(vars(module).values()):
        if isinstance(cls, type) and cls.__module__ == module.__name__ and "_checks_shapes" not in vars(cls):
            if dataclasses.is_dataclass(cls) and stated(cls):
                _wrap_dataclass(cls)
            elif issubclass(cls, tuple) and hasattr(cls, "_fields") and stated(cls):
                _wrap_named_tuple(cls)


def check(instance: object) -> None:
    """Raise WrongShape where a field of an object is not what its annotation states."""
    with jaxtyping.jaxtyped("context"):
        for name, (text, test) in stated(type(instance)).items():
            value = getattr(instance, name)
            if not test(value):
                found = f"{value.dtype} {value.shape}" if isinstance(value, np.ndarray) else repr(value)[:80]
                raise WrongShape(f"{type(instance).__qualname__}.{name} is {found}, stated is {text}")


@functools.cache
def stated(cls: type) -> dict[str, tuple[str, _Test]]:
    """The fields of a class that state the shape of arrays: what they state, and the test of a value.

    Sizes that are computed from others, as in "n-1", come last.
    """
    found, hints = {}, {}
    for base in reversed(cls.__mro__):
        hints |= inspect.get_annotations(base)  # those in quotes stay in quotes: they hold no arrays
    for name, hint in hints.items():
        texts = list(_texts(hint))
        if texts:
            found[name] = (" or ".join(texts), _test_of(hint))
    return dict(sorted(found.items(), key=lambda item: any(sign in item[1][0] for sign in "+-*")))


def _texts(hint: Any) -> Iterator[str]:
    """The shapes that an annotation states."""
    if typing.get_origin(hint) is Annotated:
        array, *extras = typing.get_args(hint)
        if typing.get_origin(array) is np.ndarray and isinstance(extras[0], str):
            yield f"{_scalar(array).__name__} ({extras[0].strip()})"
        return
    for part in typing.get_args(hint):
        yield from _texts(part)


def _test_of(hint: Any) -> _Test:
    """The test of a value by an annotation: an array, a tuple of arrays, or either of several."""
    origin, parts = typing.get_origin(hint), typing.get_args(hint)
    if origin is Annotated:
        scalar = _scalar(parts[0])
        array = _KINDS[scalar][np.ndarray, parts[1].strip()]
        return lambda value: isinstance(value, array)
    if origin in (typing.Union, types.UnionType):
        tests = [_test_of(part) for part in parts]
        return lambda value: any(test(value) for test in tests)
    if origin is tuple and len(parts) == 2 and parts[1] is Ellipsis:
        test = _test_of(parts[0])
        return lambda value: isinstance(value, tuple) and all(test(each) for each in value)
    if isinstance(hint, type):
        return lambda value: isinstance(value, hint)
    raise NotImplementedError(f"no test for {hint}")


def _scalar(array: Any) -> type:
    """The scalar type of a type of arrays, `NDArray[scalar]`."""
    return typing.get_args(typing.get_args(array)[1])[0]


def _wrap_dataclass(cls: Any) -> None:
    make = cls.__init__

    @functools.wraps(make)
    def made(self: Any, *args: Any, **kwargs: Any) -> None:
        make(self, *args, **kwargs)
        if type(self) is cls:  # a subclass checks all of its fields itself
            check(self)

    cls.__init__, cls._checks_shapes = made, True


def _wrap_named_tuple(cls: Any) -> None:
    make = cls.__new__

    @functools.wraps(make)
    def made(new: Any, *args: Any, **kwargs: Any) -> Any:
        instance = make(new, *args, **kwargs)
        check(instance)
        return instance

    cls.__new__, cls._checks_shapes = made, True


class _Finder(importlib.abc.MetaPathFinder):
    """Finds the project's modules as usual, and wraps their classes once they have been executed."""

    def find_spec(
        self, fullname: str, path: Sequence[str] | None, target: types.ModuleType | None = None
    ) -> importlib.machinery.ModuleSpec | None:
        if fullname.split(".")[0] not in PACKAGES:
            return None
        spec = importlib.machinery.PathFinder.find_spec(fullname, path, target)
        if spec is not None and spec.loader is not None:
            loader: Any = spec.loader
            execute = loader.exec_module

            def execute_and_wrap(module: types.ModuleType) -> None:
                execute(module)
                wrap_classes(module)

            loader.exec_module = execute_and_wrap
        return spec
