"""Two runs of one request, or two methods of one run, side by side."""

import dataclasses
import difflib
import math
import os
import pathlib
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from optim.model.metrics import UNITS
from optim.model.objective import objective
from replay.base.errors import ReplayError
from replay.base.style import Style, lighter, styles
from replay.run.outcome import MethodRun, Run
from replay.run.results import read_results
from replay.run.stored import run_of

COMPARE_ERROR: Final = "E_COMPARE"
RECORDED: Final = "recorded"
QUANTITIES: Final = ("objective", "length", "cusps", "steering_variation", "min_clearance", "wall_s")
"""Quantities compared, in this order: names of `optim.model.metrics.UNITS`, and the method's time [s]."""
_SAME: Final = 1e-6
"""Coordinates and dimensions that differ by less are the same [m, rad]: a file keeps every digit, a log may not."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Side:
    """One of the two things that are compared."""

    file: pathlib.Path
    method: str | None
    """None: every method of the file."""
    run: Run

    @property
    def names(self) -> list[str]:
        """Names of its paths."""
        return [RECORDED, *(method.name for method in self.run.methods)]


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One path as it is compared."""

    method: str
    status: str
    values: Mapping[str, float]
    """Value of each of `QUANTITIES`; NaN where there is none."""


@dataclass(frozen=True, kw_only=True)
class Pair:
    """Two paths that are compared."""

    a: Entry
    b: Entry

    @property
    def name(self) -> str:
        """One name where both have the same."""
        return self.a.method if self.a.method == self.b.method else f"{self.a.method}, {self.b.method}"

    def difference(self, quantity: str) -> float:
        """B less A."""
        return self.b.values[quantity] - self.a.values[quantity]

    def relative(self, quantity: str) -> float:
        """The difference relative to A; nan where A has none."""
        before = self.a.values[quantity]
        return self.difference(quantity) / abs(before) if before else math.nan


@dataclass(frozen=True, eq=False, kw_only=True)
class SideBySide:
    """Result of the comparison: both sides, pairs of methods, notes."""

    a: Side
    b: Side
    pairs: tuple[Pair, ...]
    notes: tuple[str, ...]
    """One line each: what only one of the two has, and what makes numbers other than those in the files."""


def compare(a: str, b: str) -> SideBySide:
    """Compare `FILE[:METHOD]` with `FILE[:METHOD]`; of the second one, `:METHOD` alone is of the first one's file.

    A file alone stands for all of its methods, or, beside a method, for the same method. Raises ReplayError: E_COMPARE
    where scenes, vehicles or requests differ or a method is not there, E_RESULTS for anything but a results file.
    """
    first = _side(a, None)
    second = _side(b, first)
    if first.method is None or second.method is None:
        method = first.method or second.method
        first, second = (dataclasses.replace(side, method=method) for side in (first, second))
    for side in (first, second):
        if side.method is not None and side.method not in side.names:
            nearest = difflib.get_close_matches(side.method, side.names, n=1)
            guess = f" (did you mean {nearest[0]!r}?)" if nearest else ""
            there = ", ".join(side.names)
            raise ReplayError(COMPARE_ERROR, f"{side.file}: no method {side.method!r}{guess}; there are {there}")
    _require_comparable(first, second)
    notes, both = [], [name for name in first.names if name in second.names]
    if first.run.case.problem.weights != second.run.case.problem.weights:
        notes.append(f"the weights of J differ; J of both is by those of {first.file}")
    if first.method is None:
        for one, other in ((first, second), (second, first)):
            alone = [name for name in one.names if name not in other.names]
            notes += [f"only {one.file} has {', '.join(alone)}"] if alone else []
        pairs = [_pair(first, second, name, name) for name in both]
    else:
        pairs = [_pair(first, second, first.method, second.method or first.method)]
    return SideBySide(a=first, b=second, pairs=tuple(pairs), notes=tuple(notes))


def _side(text: str, first: Side | None) -> Side:
    """The run that `FILE[:METHOD]` names; a file whose own name has a colon counts as a file."""
    path, method = text, ""
    if not os.path.exists(text):  # noqa: PTH110 - a name with a zero byte is not a path
        path, _, method = text.rpartition(":")
        path, method = (path, method) if ":" in text else (text, "")
    if not path and first is not None:
        return dataclasses.replace(first, method=method)
    file = pathlib.Path(path)
    return Side(file=file, method=method or None, run=run_of(read_results(file), str(file)))


def _require_comparable(a: Side, b: Side) -> None:
    """ReplayError (E_COMPARE) unless both are of one request."""
    one, other = a.run.case.problem, b.run.case.problem
    where = f"{a.file} and {b.file} cannot be compared: "
    vehicles = [dataclasses.asdict(problem.vehicle) for problem in (one, other)]
    for name, value in vehicles[0].items():
        if abs(value - vehicles[1][name]) > _SAME:
            raise ReplayError(COMPARE_ERROR, f"{where}different vehicles ({name} {value:g} and {vehicles[1][name]:g})")
    shapes = [(*p.scene.polygons, *([] if p.scene.boundary is None else [p.scene.boundary])) for p in (one, other)]
    if not _same(*shapes):
        counts = " and ".join(str(len(problem.scene.polygons)) for problem in (one, other))
        raise ReplayError(COMPARE_ERROR, f"{where}different scenes ({counts} obstacles, not all in the same places)")
    for what in ("start", "goal"):
        ends = [getattr(problem.recorded, what) for problem in (one, other)]
        if np.abs(ends[0] - ends[1]).max() > _SAME:
            places = " and ".join(f"({end[0]:.2f}, {end[1]:.2f}) m" for end in ends)
            raise ReplayError(COMPARE_ERROR, f"{where}different requests (the {what} is at {places})")


def _same(one: Sequence[np.ndarray], other: Sequence[np.ndarray]) -> bool:
    if len(one) != len(other):
        return False
    return all(p.shape == q.shape and np.abs(p - q).max(initial=0.0) <= _SAME for p, q in zip(one, other, strict=True))


def _pair(a: Side, b: Side, first: str, second: str) -> Pair:
    same = a.run.case.problem.weights == b.run.case.problem.weights
    entries = []
    for side, name in ((a, first), (b, second)):
        run, method = side.run, _method(side.run, name)
        metrics = run.recorded_metrics if method is None else method.metrics
        values = {quantity: float(getattr(metrics, quantity)) for quantity in QUANTITIES if quantity in UNITS}
        values["wall_s"] = math.nan if method is None else method.wall_s
        if not same:
            path = run.case.problem.recorded if method is None else method.path
            values["objective"] = objective(path, a.run.case.problem.weights)
        entries.append(Entry(method=name, status=RECORDED if method is None else method.status, values=values))
    return Pair(a=entries[0], b=entries[1])


def _method(run: Run, name: str) -> MethodRun | None:
    return next((method for method in run.methods if method.name == name), None)


def overlay(comparison: SideBySide) -> tuple[Run, dict[str, Style]]:
    """Both sides as one run, for drawing, and how each path looks.

    Of two files, the paths of the first have the colours of their methods, those of the second the same ones lighter.
    """
    a, b = comparison.a, comparison.b
    chosen = [
        (method, which)
        for pair in comparison.pairs
        for side, entry, which in ((a, pair.a, "A"), (b, pair.b, "B"))
        if (method := _method(side.run, entry.method)) is not None
    ]
    names = [method.name for method, _ in chosen]
    known = styles(dict.fromkeys(names))
    looks: dict[str, Style] = {}
    methods: list[MethodRun] = []
    for method, which in chosen:
        style = known[method.name]
        name = method.name
        if names.count(name) > 1:
            name = f"{method.name}-{which}"
            colour = style.colour if which == "A" else lighter(style.colour)
            style = Style(label=f"{style.label} {which}", colour=colour)
        looks[name] = style
        methods.append(dataclasses.replace(method, name=name))
    return dataclasses.replace(a.run, methods=tuple(methods)), looks


def to_document(comparison: SideBySide) -> dict[str, Any]:
    """The comparison as plain data, SI units."""

    def entry(one: Entry) -> dict[str, Any]:
        return {"method": one.method, "status": one.status, "values": dict(one.values)}

    return {
        "schema": "replay.compare/1",
        "a": str(comparison.a.file),
        "b": str(comparison.b.file),
        "pairs": [
            {
                "name": pair.name,
                "a": entry(pair.a),
                "b": entry(pair.b),
                "difference": {quantity: pair.difference(quantity) for quantity in QUANTITIES},
                "relative": {quantity: pair.relative(quantity) for quantity in QUANTITIES},
            }
            for pair in comparison.pairs
        ],
        "notes": list(comparison.notes),
    }
