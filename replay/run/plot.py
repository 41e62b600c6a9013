"""Drawing of a run for notebooks: the manoeuvres in their map, and their signals. Needs matplotlib."""

from collections.abc import Mapping
from typing import Any, Final

import numpy as np

from optim.model.clearance import clearance
from optim.model.path import Path
from optim.model.problem import Problem
from optim.model.vehicle import body_corners
from replay.base.style import ALARM, RECORDED, Colour, styles

_OBSTACLE, _OUTLINE = "#d7d7d7", "#8a8a8a"
_BESIDE: Final = 6.0  # [m] of the map shown round the swept area of all paths
_NO_MATPLOTLIB: Final = "run.plot() needs matplotlib: pip install matplotlib"
RECORDED_NAME: Final = "recorded"


def plot_paths(problem: Problem, paths: Mapping[str, Path], title: str) -> Any:
    """A matplotlib Figure: the map with paths and vehicles, and steering, hitch angle and clearance over arc length.

    Args:
        problem: vehicle, scene and required clearance.
        paths: by the name of their method, or `RECORDED_NAME`; the last one is drawn on top, with its vehicles.
        title: above the figure.

    Raises ImportError, one line, where matplotlib is not installed.
    """
    try:
        from matplotlib.figure import Figure  # optional, and slow to import
    except ModuleNotFoundError:
        raise ImportError(_NO_MATPLOTLIB) from None
    figure = Figure(figsize=(13.0, 6.4), layout="constrained")
    halves: Any = figure.subfigures(1, 2, width_ratios=(1.15, 1.0))
    left, right = halves
    figure.suptitle(title)
    looks = {name: style.colour for name, style in styles(paths).items()} | {RECORDED_NAME: RECORDED.colour}
    _draw_map(left.subplots(), problem, paths, looks)
    _draw_signals(right.subplots(3, 1, sharex=True), problem, paths, looks)
    return figure


def _draw_map(axes: Any, problem: Problem, paths: Mapping[str, Path], looks: Mapping[str, Colour]) -> None:
    """Obstacles, every path, and the vehicle at the ends and gear changes of the last path."""
    for polygon in problem.scene.polygons:
        axes.fill(polygon[:, 0], polygon[:, 1], facecolor=_OBSTACLE, edgecolor="none")
    if problem.scene.boundary is not None:
        outline = np.concatenate([problem.scene.boundary, problem.scene.boundary[:1]])
        axes.plot(outline[:, 0], outline[:, 1], color=_OUTLINE, linewidth=0.8)
    for name, path in paths.items():
        axes.plot(path.x, path.y, color=_rgb(looks[name]), linewidth=2.0, label=_label(name, path))
    last = list(paths)[-1]
    _draw_vehicles(axes, problem, paths[last], _rgb(looks[last]))
    corners = np.concatenate(
        [body_corners(problem.vehicle, path.samples.states).reshape(-1, 2) for path in paths.values()]
    )
    low, high = corners.min(axis=0) - _BESIDE, corners.max(axis=0) + _BESIDE
    axes.set(xlim=(low[0], high[0]), ylim=(low[1], high[1]), xlabel="x [m]", ylabel="y [m]", aspect="equal")
    axes.legend(loc="lower center", bbox_to_anchor=(0.5, 1.0), ncols=min(3, len(paths)), frameon=False)


def _draw_vehicles(axes: Any, problem: Problem, path: Path, colour: tuple[float, float, float]) -> None:
    """Outlines of both bodies at start and goal, faint at gear changes."""
    changes = [segment.states[-1] for segment in path.segments[:-1]]
    for state, name in ((path.start, "start"), (path.goal, "goal"), *((state, "") for state in changes)):
        for body in body_corners(problem.vehicle, state[None])[0]:
            faint = 0.35 if not name else 0.9
            axes.fill(body[:, 0], body[:, 1], facecolor=(*colour, 0.08), edgecolor=(*colour, faint), linewidth=1.2)
        if name:
            axes.annotate(
                name,
                state[:2],
                textcoords="offset points",
                xytext=(5, 5),
                fontweight="bold",
                zorder=5,
                bbox={"facecolor": "white", "edgecolor": "none", "alpha": 0.75, "pad": 1.0},
            )


def _draw_signals(axes: Any, problem: Problem, paths: Mapping[str, Path], looks: Mapping[str, Colour]) -> None:
    """Steering, hitch angle and clearance at the samples, over the distance driven, with their limits."""
    vehicle, alarm = problem.vehicle, _rgb(ALARM)
    for name, path in paths.items():
        near = clearance(problem.scene, vehicle, path.samples.states).min(axis=1)
        for plot, values in zip(axes, (np.degrees(path.phi), np.degrees(path.alpha), near), strict=True):
            plot.plot(path.s, values, color=_rgb(looks[name]), linewidth=1.6)
    for plot, limit in zip(axes, (vehicle.max_steer, vehicle.max_hitch), strict=False):
        for sign in (-1.0, 1.0):
            plot.axhline(sign * np.degrees(limit), color=alarm, linewidth=1.0, linestyle="--")
    axes[2].axhline(problem.required_clearance, color=alarm, linewidth=1.0, linestyle="--")
    axes[2].set_ylim(bottom=min(0.0, axes[2].get_ylim()[0]))
    labels = ("steering angle [°]", "hitch angle [°]", "clearance [m]")
    for plot, label in zip(axes, labels, strict=True):
        plot.set_ylabel(label)
        plot.grid(alpha=0.25)
    axes[2].set_xlabel("distance driven [m]; dashed: limits")


def _label(name: str, path: Path) -> str:
    shown = RECORDED.label if name == RECORDED_NAME else styles([name])[name].label
    return f"{shown}, {path.length:.1f} m"


def _rgb(colour: Colour) -> tuple[float, float, float]:
    red, green, blue = colour
    return red / 255.0, green / 255.0, blue / 255.0
