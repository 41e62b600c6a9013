"""A run as one figure of matplotlib: the map with its paths and vehicles, and their signals along the way."""

import itertools
import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any, Final

import numpy as np

from optim.model.clearance import clearance
from optim.model.path import Path
from optim.model.problem import Problem
from optim.model.vehicle import Vehicle, body_corners
from optim.numerics.arrays import Array

_MARGIN: Final = 2.0
"""Map shown beyond the vehicles [m]."""
_OBSTACLE: Final = "0.82"
_LIMIT: Final = "0.35"
_SIZE: Final = (12.5, 7.0)
"""Width and height of the figure [inch]."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Drawn:
    """A path as it is drawn."""

    label: str
    colour: tuple[float, float, float]
    """Red, green, blue, 0 to 1."""
    path: Path
    width: float = 2.0


@dataclass(frozen=True, eq=False, kw_only=True)
class _Signal:
    """A quantity along a path: the title of its axis, its values, and the limits to draw."""

    title: str
    values: Sequence[Array]
    """One array for each path, at its samples."""
    limits: tuple[float, ...]


def plot(title: str, problem: Problem, paths: Sequence[Drawn]) -> Any:
    """A `matplotlib.figure.Figure`: map on the left; steering, hitch angle and clearance over distance on the right.

    Reverse is dashed. Vehicles stand at the start, at gear changes and at the goal. Raises ImportError where
    matplotlib is not installed.
    """
    try:
        from matplotlib import get_backend, pyplot
    except ImportError:
        raise ImportError("plot needs matplotlib, and it is not installed: pip install matplotlib") from None
    figure = pyplot.figure(figsize=_SIZE, layout="constrained")
    halves: Any = figure.subfigures(1, 2, width_ratios=[1.15, 1.0])
    left, right = halves
    _draw_map(left.subplots(), title, problem, paths)
    _draw_signals(right, problem, paths)
    if "inline" in get_backend():  # a notebook shows what the cell returns; what is open it would show once more
        pyplot.close(figure)
    return figure


def _draw_map(axes: Any, title: str, problem: Problem, paths: Sequence[Drawn]) -> None:
    for polygon in problem.scene.polygons:
        axes.fill(*polygon.T, facecolor=_OBSTACLE, edgecolor="0.6", linewidth=0.5, zorder=1)
    if problem.scene.boundary is not None:
        axes.plot(*_closed(problem.scene.boundary).T, color="0.6", linewidth=0.8, zorder=1)
    for level, drawn in enumerate(paths):
        _draw_vehicles(axes, problem.vehicle, drawn, zorder=2 + level)
        _draw_path(axes, drawn, zorder=10 + level)
    axes.plot(*problem.recorded.start[:2], "o", color="black", markersize=7, zorder=30, label="start")
    axes.plot(*problem.recorded.goal[:2], "s", color="black", markersize=7, zorder=30, label="goal")
    corners = np.concatenate([body_corners(problem.vehicle, each.path.samples.states) for each in paths])
    low, high = corners.min(axis=(0, 1, 2)) - _MARGIN, corners.max(axis=(0, 1, 2)) + _MARGIN
    axes.set_xlim(low[0], high[0])
    axes.set_ylim(low[1], high[1])
    axes.set_aspect("equal", adjustable="box")
    axes.set_xlabel("x [m]")
    axes.set_ylabel("y [m]")
    axes.set_title(title)
    axes.figure.legend(loc="outside lower center", ncols=4, frameon=False, title="solid: forward, dashed: reverse")


def _draw_path(axes: Any, drawn: Drawn, zorder: int) -> None:
    for k, segment in enumerate(drawn.path.segments):
        axes.plot(
            segment.x,
            segment.y,
            color=drawn.colour,
            linewidth=drawn.width,
            linestyle="-" if segment.direction > 0 else (0, (4, 2)),
            label=drawn.label if k == 0 else None,
            zorder=zorder,
        )


def _draw_vehicles(axes: Any, vehicle: Vehicle, drawn: Drawn, zorder: int) -> None:
    """Outlines of truck and trailer where the vehicle stands still; the truck's windscreen is its thick side."""
    stops = [drawn.path.start, *(segment.states[-1] for segment in drawn.path.segments)]
    for truck, trailer in body_corners(vehicle, np.array(stops)):
        for outline in (truck, trailer):
            axes.fill(*outline.T, facecolor=(*drawn.colour, 0.08), edgecolor=drawn.colour, linewidth=0.8, zorder=zorder)
        axes.plot(*truck[1:3].T, color=drawn.colour, linewidth=2.5, zorder=zorder)


def _draw_signals(figure: Any, problem: Problem, paths: Sequence[Drawn]) -> None:
    signals = _signals(problem, paths)
    all_axes = figure.subplots(len(signals), 1, sharex=True)
    for axes, signal in zip(all_axes, signals, strict=True):
        for limit in signal.limits:
            axes.axhline(limit, color=_LIMIT, linewidth=1.0, linestyle=":")
        for drawn, values in zip(paths, signal.values, strict=True):
            _draw_signal(axes, drawn, values)
        axes.set_ylabel(signal.title)
        axes.grid(color="0.92")
    all_axes[-1].set_xlabel("distance driven s [m]")
    all_axes[0].set_title("dotted: limits and required clearance", fontsize="medium", color=_LIMIT)


def _draw_signal(axes: Any, drawn: Drawn, values: Array) -> None:
    """One line for each segment: at a gear change the steering may jump."""
    samples = drawn.path.samples
    edges = [0, *(np.flatnonzero(np.diff(samples.segment)) + 1), len(samples.s)]
    for first, last in itertools.pairwise(edges):
        style = "-" if samples.direction[first] > 0 else (0, (4, 2))
        line = samples.s[first:last], values[first:last]
        axes.plot(*line, color=drawn.colour, linewidth=drawn.width * 0.8, linestyle=style)


def _signals(problem: Problem, paths: Sequence[Drawn]) -> list[_Signal]:
    vehicle, all_samples = problem.vehicle, [drawn.path.samples for drawn in paths]
    steer, hitch = (math.degrees(limit) for limit in (vehicle.max_steer, vehicle.max_hitch))
    signals = [
        _Signal(
            title="steering angle φ [°]",
            values=[np.degrees(samples.phi) for samples in all_samples],
            limits=(-steer, steer),
        ),
        _Signal(
            title="hitch angle α [°]",
            values=[np.degrees(samples.states[:, 3]) for samples in all_samples],
            limits=(-hitch, hitch),
        ),
    ]
    if problem.scene.polygons:
        free = [clearance(problem.scene, vehicle, samples.states).min(axis=1) for samples in all_samples]
        signals.append(_Signal(title="clearance [m]", values=free, limits=(problem.required_clearance,)))
    return signals


def _closed(outline: Array) -> Array:
    return np.concatenate([outline, outline[:1]])
