"""The arrangement that a recording opens with: which views there are, what each shows, where the timeline stands."""

import math
from typing import Final, NamedTuple

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from optim.model.problem import Problem
from replay.recording.convergence import Plot
from replay.recording.entities import GROUND, OUTSIDE, entity
from replay.recording.picture import Frame
from replay.recording.plots import limits_of, signals_of
from replay.recording.text import number, plain
from replay.recording.tracks import Track

_CLEARANCE_SHOWN: Final = 3.0  # [m]
_KEY: Final = "solid forward, dashed reverse"


class Content(NamedTuple):
    """Properties that the layout depends on."""

    problem: Problem
    tracks: list[Track]  # the recorded path first
    has_poses: bool  # the poses as logged are drawn beside the recorded path
    best: Track | None
    frame: Frame  # the plan views without a legend
    legend: float  # height of the overview's legend above the frame [m]
    areas_legend: float  # height of the swept area's legend [m]
    progress: list[Plot]  # over the iterations
    residuals: list[Plot]
    cost_legends: dict[str, float]  # height of the legend of each method's cost map [m]


def blueprint(content: Content) -> rrb.Blueprint:
    """Tabs; the first one is the answer, the others the reasons."""
    tabs = [_overview(content), _side_by_side(content), _signals(content)]
    if content.progress:
        tabs.append(_convergence(content))
    if content.residuals:
        tabs.append(_residuals(content))
    tabs += [_costs(content, track) for track in content.tracks if track.picture is not None]
    tabs += [_areas(content), _details()]
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0),
        rrb.TimePanel(state="collapsed", timeline="progress", fps=60.0, loop_mode="all", play_state="paused"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _plan(content: Content, name: str, shown: list[str], legend: float = 0.0) -> rrb.Spatial2DView:
    frame = content.frame
    edge = 0.02 * frame.size  # else the first row of a legend lies on the panel's rim
    seen = frame.grown(edge, edge, edge, edge + legend)
    bounds = rrb.VisualBounds2D(x_range=[seen.x0, seen.x1], y_range=[-seen.y1, -seen.y0])
    return rrb.Spatial2DView(
        origin="/",
        contents=[f"+ {path}" for path in (*GROUND, *shown)],
        name=plain(name),
        visual_bounds=bounds,
        background=[*OUTSIDE],
    )


def _of(track: Track, *parts: str) -> list[str]:
    """Entities of one path; vehicles and swept areas have children."""
    nested = {"vehicle", "audit", "cusps", "swept", "closest", "rejected", "cost"}
    return [entity("scene", track.name, part) + ("/**" if part in nested else "") for part in parts]


def everything() -> rrb.TimeAxis:
    """All of the timeline: by default, the viewer shows 1000 steps either side of the cursor."""
    whole = rr.TimeRange(start=rrb.TimeRangeBoundary.infinite(), end=rrb.TimeRangeBoundary.infinite())
    return rrb.TimeAxis(view_range=whole)


def _plot(
    origin: str, title: str, y_range: tuple[float, float] | None, *, legend: rrb.Corner2D | None
) -> rrb.TimeSeriesView:
    return rrb.TimeSeriesView(
        origin=origin,
        name=plain(title),
        axis_x=everything(),
        axis_y=rrb.ScalarAxis(range=y_range) if y_range else None,
        plot_legend=rrb.PlotLegend(legend, visible=legend is not None),
    )


def _signals_of(content: Content, *names: str, legend: bool) -> list[rrb.TimeSeriesView]:
    """Plots of those signals that there are; with a legend, which hides data, in the first one or none."""
    names = tuple(name for name in names if name in limits_of(content.problem))
    corner = rrb.Corner2D.LeftTop if legend else None
    return [_signal(content, name, corner if name == names[0] else None) for name in names]


def _signal(content: Content, name: str, legend: rrb.Corner2D | None) -> rrb.TimeSeriesView:
    limits = limits_of(content.problem)[name]
    if name == "clearance_m":
        lowest = min(float(track.distance.min()) for track in content.tracks)
        title = f"Clearance to the nearest obstacle [m], required {number(limits[0])} m"
        top = max(_CLEARANCE_SHOWN, 2.0 * lowest) if math.isfinite(lowest) else _CLEARANCE_SHOWN
        return _plot(entity("signals", name), title, (min(0.0, 1.1 * lowest), top), legend=legend)
    largest = max(float(np.abs(signals_of(content.problem, track)[name]).max()) for track in content.tracks)
    top = 1.15 * min(max(limits[-1], largest), 3.0 * limits[-1])
    title = {
        "steering_deg": f"Steering angle φ [°], limit ±{number(limits[-1], 1)}°",
        "hitch_deg": f"Hitch angle α [°], limit ±{number(limits[-1], 1)}°",
        "curvature_per_m": f"Trailer curvature κ [1/m], limit ±{number(limits[-1], 3)}",
    }[name]
    return _plot(entity("signals", name), title, (-top, top), legend=legend)


def _overview(content: Content) -> rrb.Horizontal:
    recorded, best = content.tracks[0], content.best or content.tracks[0]
    shown = ["/scene/legend/paths/**", *_of(recorded, "path", "cusps", "audit")]
    for track in content.tracks[1:]:
        if track.status == "improved":
            shown += _of(track, "path", "cusps", "audit")
    if best is not recorded:
        shown += _of(recorded, "vehicle")
    shown += _of(best, "swept", "vehicle", "whisker", "closest")
    shown += _of(recorded, "logged_poses") if content.has_poses else []
    key = f"{_KEY}, dots logged poses" if content.has_poses else _KEY
    plots = _signals_of(content, "clearance_m", "steering_deg", legend=False)  # the plan view has one
    summary = rrb.TextDocumentView(origin="/report/summary", name="Summary")
    right = rrb.Vertical(summary, *plots, row_shares=[2.95, *(1.0 for _ in plots)])
    title = f"Recorded and improved paths: {key}" if content.best else f"Recorded path: {key}"
    return rrb.Horizontal(_plan(content, title, shown, content.legend), right, column_shares=[11, 9], name="Overview")


def _side_by_side(content: Content) -> rrb.Grid:
    recorded, panels = content.tracks[0], []
    for track in content.tracks:
        shown = _of(track if track.is_own else recorded, "path", "cusps", "swept", "vehicle", "whisker")
        if track.is_own:
            shown += _of(track, "audit") + ([] if track is recorded else _of(recorded, "path"))
            shown += _of(track, "logged_poses") if track is recorded and content.has_poses else []
        else:
            shown += _of(track, "rejected")
        panels.append(_plan(content, _panel_title(track), shown))
    columns = {1: 1, 2: 2, 3: 3, 4: 2, 5: 3, 6: 3}.get(len(panels), 4)
    return rrb.Grid(*panels, grid_columns=columns, name="Side by side")


def _panel_title(track: Track) -> str:
    if track.is_own:
        metrics = track.metrics
        free = metrics.min_clearance
        clear = f"clear by {number(free)} m" if math.isfinite(free) else "no obstacles"
        return f"{track.style.label}: J {number(metrics.objective, 1)}, {number(metrics.length, 1)} m, {clear}"
    rejected = track.run is not None and track.run.rejected is not None
    return f"{track.style.label}: " + (
        "rejected by the audit" if rejected else f"{track.status}; the recorded path stands"
    )


def _signals(content: Content) -> rrb.Vertical:
    signals = _signals_of(content, "clearance_m", "steering_deg", "curvature_per_m", "hitch_deg", legend=True)
    plots = rrb.Grid(*signals, grid_columns=2)
    shown = _gears(content)
    gear = rrb.StateTimelineView(
        origin="/gear",
        contents=[f"+ {entity('gear', track.name)}" for track in shown],
        name="Gear: forward or reverse" + ("" if len(shown) == len(content.tracks) else "; where it differs"),
        time_view=everything(),
    )
    return rrb.Vertical(plots, gear, row_shares=[6.0, 0.7 + 0.5 * len(shown)], name="Signals")


def _gears(content: Content) -> list[Track]:
    """The recorded path, the best one, and others whose gears are not those of one before."""
    recorded, best = content.tracks[0], content.best
    shown = [recorded] if best is None else [recorded, best]
    gears = [_directions(track) for track in shown]
    for track in content.tracks:
        if track.is_own and track not in shown and _directions(track) not in gears:
            shown.append(track)
            gears.append(_directions(track))
    return shown


def _directions(track: Track) -> list[int]:
    return [segment.direction for segment in track.path.segments]


def _convergence(content: Content) -> rrb.Horizontal:
    shown = ["/scene/legend/paths/**", *_of(content.tracks[0], "path", "cusps")]
    shown += [path for track in content.tracks[1:] if track.iterates for path in _of(track, "iterate")]
    help_line = rrb.TextDocumentView(origin="/report/convergence", name="What this shows")
    first, *rest = (_over_iterations(plot, legend=None) for plot in content.progress)  # the plan view has one
    columns = 2 if len(rest) > 3 else 1
    others = [rrb.Grid(*rest, grid_columns=columns)] if rest else []
    shares = [1.0, *(1.4 if columns == 2 else 0.55 * len(rest) for _ in others)]
    right = rrb.Vertical(help_line, first, *others, row_shares=[0.23 * sum(shares), *shares])
    plan = _plan(content, "Iterates over the recorded path", shown, content.legend)
    return rrb.Horizontal(plan, right, column_shares=[11, 9], name="Convergence")


def _over_iterations(plot: Plot, legend: rrb.Corner2D | None) -> rrb.TimeSeriesView:
    return _plot(entity(*plot.parts), plot.title, plot.y_range, legend=legend)


def _residuals(content: Content) -> rrb.Vertical:
    """Each with its own legend: not every method has every residual. It stands above the curves."""
    plots = [_over_iterations(_with_room(plot), legend=rrb.Corner2D.RightTop) for plot in content.residuals]
    half = len(plots) if len(plots) < 4 else (len(plots) + 1) // 2
    rows = [row for row in (plots[:half], plots[half:]) if row]
    help_line = rrb.TextDocumentView(origin="/report/residuals", name="What this shows")
    shares = [0.55, *(2.0 for _ in rows)]
    return rrb.Vertical(help_line, *(rrb.Horizontal(*row) for row in rows), row_shares=shares, name="Residuals")


def _with_room(plot: Plot) -> Plot:
    """Share of the height for a legend of up to four names."""
    if plot.y_range is None:
        return plot
    low, high = plot.y_range
    return plot._replace(y_range=(low, high + 0.4 * (high - low)))


def _costs(content: Content, track: Track) -> rrb.Horizontal:
    """Views of a method that moves points: its cost map, and the result."""
    label, legend = track.style.label, max(content.legend, content.cost_legends[track.name])  # both to one scale
    dots = [entity("scene", track.name, "cost", part) for part in ("moved", "anchored")]
    seen = [entity("scene", "legend", f"cost {track.name}") + "/**", *_of(track, "cost")]
    driven = ["/scene/legend/paths/**", *_of(content.tracks[0], "path", "cusps"), *dots]
    outcome = f"the truck's path, {track.status}"
    if track.is_own:
        driven += _of(track, "path", "cusps")
    views = [
        _plan(content, f"{label}: points of the trailer's axle on the cost of obstacles", seen, legend),
        _plan(content, f"{label}: points of the trailer's axle and {outcome}", driven, legend),
    ]
    return rrb.Horizontal(*views, name=f"Cost map ({track.name})")


def _areas(content: Content) -> rrb.Spatial2DView:
    shown = ["/scene/legend/areas/**"]
    for track in content.tracks:
        if track.is_own:
            shown += [entity("scene", track.name, "swept", "outline"), *_of(track, "path")]
    best = content.best or content.tracks[0]
    shown.append(entity("scene", best.name, "swept", "filling"))
    return _plan(content, "Swept area", shown, content.areas_legend)


def _details() -> rrb.Horizontal:
    sheets = ("vehicle", "Vehicle and objective"), ("run", "Log and options"), ("audit", "Audit")
    views = [rrb.TextDocumentView(origin=f"/report/{name}", name=title) for name, title in sheets]
    return rrb.Horizontal(*views, column_shares=[0.75, 1.05, 1.6], name="Vehicle, options, audit")
