"""The arrangement for recordings of different logs: nothing in it depends on a map, a limit or a result."""

from collections.abc import Collection, Iterable
from typing import Final

import rerun.blueprint as rrb

from replay.recording.blueprint import everything
from replay.recording.entities import GROUND

_NO_PATHS: Final = frozenset({"map", "obstacles", "ends", "scale", "legend"})
_SIGNALS: Final = {
    "clearance_m": "Clearance to the nearest obstacle [m]",
    "steering_deg": "Steering angle φ [°]",
    "curvature_per_m": "Trailer curvature κ [1/m]",
    "hitch_deg": "Hitch angle α [°]",
}


def common_blueprint(entities: Collection[str]) -> rrb.Blueprint:
    """Tabs for recordings that hold, some of them or all, these entities. The plan views fit themselves to the data."""
    names = sorted({path.split("/")[2] for path in entities if path.startswith("/scene/") and path.count("/") > 2})
    paths = [name for name in names if name not in _NO_PATHS]
    tabs = [_overview(paths), _swept(paths), _signals(entities)]
    if solver := _under("/solver/", entities):
        tabs.append(rrb.Grid(*(_plot(origin, title) for origin, title in solver), name="Convergence"))
    tabs.append(_details())
    return rrb.Blueprint(
        rrb.Tabs(*tabs, active_tab=0),
        rrb.TimePanel(state="collapsed", timeline="progress", fps=60.0, loop_mode="all", play_state="paused"),
        rrb.SelectionPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )


def _under(root: str, entities: Iterable[str]) -> list[tuple[str, str]]:
    """Origins of plots below `root`, and their titles."""
    names = sorted({path.removeprefix(root).split("/")[0] for path in entities if path.startswith(root)})
    return [(root + name, name.replace("_", " ")) for name in names if name != "residuals_log10"]


def _plan(name: str, shown: list[str]) -> rrb.Spatial2DView:
    return rrb.Spatial2DView(origin="/", contents=[f"+ {path}" for path in (*GROUND, *shown)], name=name)


def _overview(paths: list[str]) -> rrb.Horizontal:
    shown = [f"/scene/{name}/{part}" for name in paths for part in ("path", "cusps/**", "vehicle/**")]
    ground = ["/scene/legend/paths/**", "/scene/recorded/logged_poses"]
    plan = _plan("All paths: solid forward, dashed reverse", [*ground, *shown])
    summary = rrb.TextDocumentView(origin="/report/summary", name="Summary")
    plots = [_plot(f"/signals/{name}", _SIGNALS[name]) for name in ("clearance_m", "steering_deg")]
    right = rrb.Vertical(summary, *plots, row_shares=[2.0, 1.0, 1.0])
    return rrb.Horizontal(plan, right, column_shares=[11, 9], name="Overview")


def _swept(paths: list[str]) -> rrb.Spatial2DView:
    shown = [f"/scene/{name}/{part}" for name in paths for part in ("path", "swept/outline")]
    return _plan("Swept area", ["/scene/legend/areas/**", *shown])


def _signals(entities: Iterable[str]) -> rrb.Vertical:
    there = {path.split("/")[2] for path in entities if path.startswith("/signals/")}
    plots = [_plot(f"/signals/{name}", title) for name, title in _SIGNALS.items() if name in there]
    gear = rrb.StateTimelineView(origin="/gear", name="Gear: forward or reverse", time_view=everything())
    return rrb.Vertical(rrb.Grid(*plots, grid_columns=2), gear, row_shares=[6.0, 2.0], name="Signals")


def _details() -> rrb.Horizontal:
    sheets = ("vehicle", "Vehicle and objective"), ("run", "Log and options"), ("audit", "Audit")
    views = [rrb.TextDocumentView(origin=f"/report/{name}", name=title) for name, title in sheets]
    return rrb.Horizontal(*views, name="Vehicle, options, audit")


def _plot(origin: str, title: str) -> rrb.TimeSeriesView:
    legend = rrb.PlotLegend(rrb.Corner2D.LeftTop)
    return rrb.TimeSeriesView(origin=origin, name=title, axis_x=everything(), plot_legend=legend)
