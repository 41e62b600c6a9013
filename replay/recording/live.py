"""A run in a live viewer: map and recorded path first, then iterate by iterate, at the end all of the file.

The entities are those of the recording in the file (see `replay.recording`), under an identity of their own.
"""

import contextlib
import itertools
import uuid
from collections.abc import Mapping
from typing import Final

import numpy as np
import rerun as rr
import rerun.blueprint as rrb

from optim.model.objective import objective
from optim.model.result import Iterate
from replay.base.style import RECORDED, Style
from replay.recording import ground, plan_view
from replay.recording.blueprint import everything
from replay.recording.entities import GROUND, OUTSIDE, entity, points
from replay.recording.local import localised, localised_case, moved
from replay.recording.picture import Frame, frame_around, swept_area, thinned
from replay.recording.text import plain
from replay.recording.tracks import tracks_of
from replay.recording.writing import APPLICATION, fill
from replay.run.case import Case
from replay.run.outcome import Run

_PATIENCE_S: Final = 5.0
"""Time for a viewer to receive what was sent [s]."""


class LiveRecording:
    """One case in a viewer at `url`. Raises RuntimeError or ValueError where the viewer does not take it."""

    def __init__(self, url: str, case: Case, looks: Mapping[str, Style]) -> None:
        (case, self._offset), self._looks = localised_case(case), looks
        self._steps = {name: itertools.count() for name in looks}
        self._stream = rr.RecordingStream(APPLICATION, recording_id=f"{plain(case.name)} live {uuid.uuid4().hex[:12]}")
        self._stream.connect_grpc(url)
        self._stream.set_log_time_enabled(False)
        self._stream.send_recording_name(f"{plain(case.name)} (running)")
        self._log_start(case)

    def _log_start(self, case: Case) -> None:
        problem, rec = case.problem, self._stream
        frame = frame_around(problem.scene, [swept_area(problem.vehicle, problem.recorded)])
        ground.log_ground(rec, case, frame)
        ground.log_ends(rec, problem)
        ground.log_scale(rec, frame, problem)
        entries = [(RECORDED.label, RECORDED.colour), *((look.label, look.colour) for look in self._looks.values())]
        legend = ground.log_legend(rec, frame, entries, "paths")
        plan_view.log_path(
            rec, problem.recorded, entity("scene", "recorded"), RECORDED.colour, frame, plan_view.RECORDED_LINE
        )
        before = objective(problem.recorded, problem.weights)
        rec.set_time("iteration", sequence=0)
        rec.log("/solver/objective/level", rr.Scalars(before))
        rec.log("/solver/objective/level", _line(RECORDED), static=True)
        for name, look in self._looks.items():
            style = rr.LineStrips2D.from_fields(colors=[look.colour], radii=points(1.25), draw_order=25.0)
            rec.log(entity("scene", name, "iterate"), style, static=True)
            rec.log(entity("solver", "objective", name), _line(look), static=True)
        rec.send_blueprint(_blueprint(frame, legend, list(self._looks)))

    def iterate(self, name: str, iterate: Iterate) -> None:
        """Show an iterate, unless it is a rejected trial."""
        step = next(self._steps[name])
        if not iterate.accepted:
            return
        self._stream.set_time("iteration", sequence=step)
        path = moved(iterate.path, self._offset) if np.any(self._offset) else iterate.path
        line = rr.LineStrips2D.from_fields(strips=[thinned(path.samples.states[:, :2])])
        self._stream.log(entity("scene", name, "iterate"), line)
        self._stream.log(entity("solver", "objective", name), rr.Scalars(iterate.objective))

    def finish(self, run: Run) -> None:
        """Show all that the file holds."""
        run, offset = localised(run)
        self._stream.reset_time()
        fill(self._stream, run, tracks_of(run, self._looks), offset)
        self._stream.flush(timeout_sec=_PATIENCE_S)

    def close(self) -> None:
        """Let the viewer keep what it has."""
        with contextlib.suppress(RuntimeError, ValueError):
            self._stream.flush(timeout_sec=_PATIENCE_S)
        self._stream.disconnect()


def _line(look: Style) -> rr.SeriesLines:
    return rr.SeriesLines(colors=[look.colour], names=[plain(look.label)], widths=[2.0])


def _blueprint(frame: Frame, legend: float, names: list[str]) -> rrb.Blueprint:
    """The plan with the present iterates, and J; the cursor follows."""
    shown = [*GROUND, "/scene/legend/paths/**", "/scene/recorded/**"]
    shown += [entity("scene", name, "iterate") for name in names]
    plan = rrb.Spatial2DView(
        origin="/",
        contents=[f"+ {path}" for path in shown],
        name="Iterates as they come, over the recorded path",
        visual_bounds=rrb.VisualBounds2D(x_range=[frame.x0, frame.x1], y_range=[-frame.y1 - legend, -frame.y0]),
        background=[*OUTSIDE],
    )
    cost = rrb.TimeSeriesView(origin="/solver/objective", name="Objective J [-]", axis_x=everything())
    return rrb.Blueprint(
        rrb.Horizontal(plan, cost, column_shares=[11, 9]),
        rrb.TimePanel(state="collapsed", timeline="iteration", play_state="following"),
        rrb.SelectionPanel(state="collapsed"),
        rrb.BlueprintPanel(state="collapsed"),
        auto_views=False,
        auto_layout=False,
    )
