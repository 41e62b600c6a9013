"""The plots over a method's iterations: J, what decided convergence, trust region, time inside a foreign solver.

A rejected trial moves nothing: the plot of J stays at the level of the current path, with a mark.
"""

import math
from collections.abc import Callable
from typing import Final, NamedTuple

import numpy as np
import rerun as rr

from optim.model.result import IterateRecord
from optim.numerics.arrays import Array
from replay.base.style import ALARM, Colour
from replay.recording.entities import entity
from replay.recording.plan_view import iteration_columns
from replay.recording.text import plain
from replay.recording.tracks import PROGRESS, Track

_LEAST_VIOLATION: Final = 1e-6  # what is smaller is drawn as this: a logarithm has no 0
_LEAST_RESIDUAL: Final = 1e-3  # likewise: how far below its tolerance a residual lies does not matter


class _Row(NamedTuple):
    """One iterate of a history as it is plotted."""

    iterate: IterateRecord
    violation: float
    """NaN where the method never violates anything."""
    standing: float
    """J of the path that stands after the iterate."""


class Curve(NamedTuple):
    """One method's line in a plot."""

    track: Track
    iterations: list[int]
    values: Array
    turned_down: list[bool]
    """Mask of the values that belong to rejected trials."""


class Level(NamedTuple):
    """A line from end to end."""

    name: str
    value: float
    colour: Colour
    width: float


class Plot(NamedTuple):
    """One plot and what is in it."""

    parts: tuple[str, ...]
    """Parts of its entity path."""
    title: str
    curves: list[Curve]
    level: Level | None = None
    y_range: tuple[float, float] | None = None


def main_plots(tracks: list[Track]) -> list[Plot]:
    """J, and of the rest what there are data for."""
    style, before = tracks[0].style, tracks[0].metrics.objective
    solver = _plot(tracks, ("solver_ms",), "Time in the solver [ms]", lambda row: 1e3 * row.iterate.solver_s)
    found = [
        _plot(tracks, ("objective",), "Objective J [-]", lambda row: row.standing)._replace(
            level=Level(style.label, before, style.colour, 3.0)
        ),
        _residual(tracks, ("largest_residual_log10",), "Largest residual", _largest),
        _accepted(
            tracks,
            ("violation_log10",),
            "Constraint violation, log10",
            lambda row: _log10(row.violation, _LEAST_VIOLATION),
        ),
        _plot(
            tracks, ("trust_region_log10",), "Trust region / first, log10", lambda row: _log10(row.iterate.trust_region)
        ),
        solver._replace(y_range=(0.0, 1.1 * float(_values(solver).max()))),
    ]
    return [plot for plot in found if plot.curves]


def residual_plots(tracks: list[Track]) -> list[Plot]:
    """The residuals one by one, in the order in which the methods name them; none where there is only one."""
    names = dict.fromkeys(name for track in tracks for row in _history(track) for name in row.iterate.residuals)

    def plot(name: str) -> Plot:
        return _residual(
            tracks, ("residuals_log10", name), name, lambda row: row.iterate.residuals.get(name, math.nan)
        )._replace(title=name)  # the tab says what they are: titles must be short

    found = [plot(name) for name in names] if len(names) > 1 else []
    return [plot for plot in found if plot.curves]


def _residual(tracks: list[Track], parts: tuple[str, ...], title: str, value: Callable[[_Row], float]) -> Plot:
    """Relative to its tolerance, which is drawn as a level."""
    plot = _accepted(tracks, parts, f"{title}, log10", lambda row: _log10(value(row), _LEAST_RESIDUAL))
    low, high = float(_values(plot).min()), float(_values(plot).max())
    return plot._replace(level=Level("tolerance", 0.0, ALARM, 1.0), y_range=(low - 0.3, high + 0.3))


def _accepted(tracks: list[Track], parts: tuple[str, ...], title: str, value: Callable[[_Row], float]) -> Plot:
    """A plot of accepted iterates alone: rejected trials say nothing about it."""
    return _plot(tracks, parts, title, lambda row: value(row) if row.iterate.accepted else math.nan)


def _plot(tracks: list[Track], parts: tuple[str, ...], title: str, value: Callable[[_Row], float]) -> Plot:
    """The value of every iterate of every method, where it is finite."""
    curves = []
    for track in tracks:
        rows = [(row, y) for row in _history(track) if math.isfinite(y := value(row))]
        if rows:
            numbers = [row.iterate.iteration for row, _ in rows]
            values = np.array([y for _, y in rows])
            curves.append(Curve(track, numbers, values, [not row.iterate.accepted for row, _ in rows]))
    return Plot(("solver", *parts), title, curves)


def _values(plot: Plot) -> Array:
    """All that the plot shows, and 0."""
    return np.concatenate([[0.0], *(curve.values for curve in plot.curves)])


def _history(track: Track) -> list[_Row]:
    history = track.run.history if track.run is not None else ()
    violates = any(iterate.violation > 0.0 for iterate in history)
    rows, standing = [], math.nan
    for iterate in history:
        standing = iterate.objective if iterate.accepted else standing
        rows.append(_Row(iterate, iterate.violation if violates else math.nan, standing))
    return rows


def _largest(row: _Row) -> float:
    """The residual that keeps an iterate from having converged."""
    return max(row.iterate.residuals.values(), default=math.nan)


def _log10(value: float, least: float = 0.0) -> float:
    value = max(value, least)
    return math.log10(value) if math.isfinite(value) and value > 0.0 else math.nan


def log_plots(rec: rr.RecordingStream, plots: list[Plot]) -> None:
    """Lines in the methods' colours, marks at rejected trials, levels from end to end."""
    for plot in plots:
        for curve in plot.curves:
            _log_curve(rec, plot, curve)
        if plot.level is not None:
            name, value, colour, width = plot.level
            last = max(int(curve.track.steps(curve.iterations[-1:])[0]) for curve in plot.curves)
            ends = [rr.TimeColumn("iteration", sequence=[0, last]), rr.TimeColumn("progress", sequence=[0, PROGRESS])]
            path = entity(*plot.parts, "level")
            rec.send_columns(path, ends, rr.Scalars.columns(scalars=[value, value]))
            rec.log(path, rr.SeriesLines(colors=[colour], names=[plain(name)], widths=[width]), static=True)


def _log_curve(rec: rr.RecordingStream, plot: Plot, curve: Curve) -> None:
    track, values = curve.track, curve.values
    path, label = entity(*plot.parts, track.name), plain(track.style.label)
    rec.send_columns(path, iteration_columns(curve.iterations, track), rr.Scalars.columns(scalars=values))
    rec.log(path, rr.SeriesLines(colors=[track.style.colour], names=[label], widths=[2.0]), static=True)
    marked = np.flatnonzero(curve.turned_down)
    if len(marked):
        path = entity(*plot.parts, track.name, "turned_down")
        numbers = [curve.iterations[k] for k in marked]
        rec.send_columns(path, iteration_columns(numbers, track), rr.Scalars.columns(scalars=values[marked]))
        look = rr.SeriesPoints(
            colors=[track.style.colour], names=[f"{label}: rejected"], markers=["cross"], marker_sizes=[6.0]
        )
        rec.log(path, look, static=True)
