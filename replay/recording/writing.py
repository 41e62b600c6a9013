"""Fill a recording and verify that the file holds what was logged."""

import contextlib
import hashlib
import importlib.metadata
import json
import pathlib
import warnings
from collections import Counter
from collections.abc import Iterator, Mapping
from typing import Final

import rerun as rr
from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning

from optim.numerics.arrays import Array
from replay.base.style import Colour, Style
from replay.base.versions import DISTRIBUTION
from replay.recording import convergence, costs, ground, overview, plan_view, plots
from replay.recording.blueprint import Content, blueprint
from replay.recording.entities import BODIES, entity
from replay.recording.local import localised
from replay.recording.picture import frame_around
from replay.recording.text import change, number, plain
from replay.recording.tracks import Track, best_of, tracks_of
from replay.run.outcome import Run

APPLICATION: Final = "replay"


class Unwritable(Exception):
    """The file does not hold what was written to it."""


def warm_up() -> None:
    """Make one archetype, so that pyarrow loads what it needs (pandas too, where it is installed)."""
    rr.Transform3D(mat3x3=[[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]])


@contextlib.contextmanager
def _strict() -> Iterator[None]:
    """Mistakes in calls of Rerun are errors within the block, as they were outside of it."""
    before = rr.strict_mode()
    rr.set_strict_mode(True)
    try:
        yield
    finally:
        rr.set_strict_mode(before)


def write(run: Run, path: pathlib.Path, looks: Mapping[str, Style] | None = None) -> None:
    """Write the recording to a file and read it back. Raises OSError, and Unwritable if the file is not whole.

    The recording is collected in memory first, a few megabytes: Rerun's own file sink was seen to wait for ever on
    a disk that is full from the first byte on.
    """
    identity = recording_id(run)
    run, offset = localised(run)
    tracks = tracks_of(run, looks)
    with _strict():
        stream = rr.RecordingStream(APPLICATION, recording_id=identity)
        try:
            memory = stream.memory_recording()
            stream.set_log_time_enabled(False)
            fill(stream, run, tracks, offset)
            content = memory.drain_as_bytes()
        finally:
            stream.disconnect()
    path.write_bytes(content)
    verify(path, tracks)


def recording_id(run: Run) -> str:
    """The same for the same log, options and results: viewers merge recordings of the same identity."""
    results = [(method.name, method.status, method.metrics.objective) for method in run.methods]
    parts = [run.case.name, run.case.sha256, _version(), run.options, results]
    digest = hashlib.sha256(json.dumps(parts, sort_keys=True, default=str).encode()).hexdigest()
    return f"{plain(run.case.name)} {digest[:12]}"


def _version() -> str:
    return importlib.metadata.version(DISTRIBUTION)


def fill(rec: rr.RecordingStream, run: Run, tracks: list[Track], offset: Array) -> None:
    """Log all of a run that `localised` has moved by `offset` [m], and the arrangement for it."""
    problem, best = run.case.problem, best_of(run, tracks)
    frame = frame_around(problem.scene, [track.area for track in tracks])
    ground.log_ground(rec, run.case, frame)
    ground.log_ends(rec, problem)
    ground.log_scale(rec, frame, problem)
    plan_view.log_logged_poses(rec, run.case)
    legend = ground.log_legend(rec, frame, [_legend_entry(tracks[0], track) for track in tracks], "paths")
    own = [track for track in tracks if track.is_own]
    areas = [(f"{track.style.label} {number(track.area.area, 0)} m²", track.style.colour) for track in own]
    areas_legend = ground.log_legend(rec, frame, areas, "areas")
    for track in own:
        plan_view.log_track(rec, problem, track, frame, is_best=track is best)
    for track in tracks:
        plan_view.log_iterates(rec, track)
        plan_view.log_rejected(rec, track, frame)
    cost_legends = costs.log_costs(rec, problem.scene, tracks, frame)
    plots.log_signals(rec, problem, tracks, best)
    progress, residuals = convergence.main_plots(tracks), convergence.residual_plots(tracks)
    convergence.log_plots(rec, progress + residuals)
    _log_reports(rec, run, tracks, best, offset)
    _send_properties(rec, run, tracks, best)
    content = Content(
        problem=problem,
        tracks=tracks,
        has_poses=plan_view.strays(run.case),
        best=best,
        frame=frame,
        legend=legend,
        areas_legend=areas_legend,
        progress=progress,
        residuals=residuals,
        cost_legends=cost_legends,
    )
    rec.send_blueprint(blueprint(content))


def _legend_entry(recorded: Track, track: Track) -> tuple[str, Colour]:
    before, after = recorded.metrics.objective, track.metrics.objective
    text = {"recorded": f"J {number(before, 1)}", "improved": f"J {number(after, 1)} ({change(before, after)})"}
    rejected = track.run is not None and track.run.rejected is not None
    result = "rejected" if rejected else text.get(track.status, track.status)
    return f"{track.style.label}: {result}", track.style.colour


def _log_reports(rec: rr.RecordingStream, run: Run, tracks: list[Track], best: Track | None, offset: Array) -> None:
    sheets = {
        "summary": overview.summary(run, tracks, best),
        "convergence": overview.convergence_help(tracks),
        "residuals": overview.residuals_help(),
        "vehicle": overview.vehicle_sheet(run),
        "run": overview.run_sheet(run, _version(), offset),
        "audit": overview.audit_sheet(tracks),
    }
    for name, text in sheets.items():
        rec.log(f"/report/{name}", rr.TextDocument(plain(text), media_type=rr.MediaType.MARKDOWN), static=True)


def _send_properties(rec: rr.RecordingStream, run: Run, tracks: list[Track], best: Track | None) -> None:
    """Columns that a table of many recordings sorts by."""
    before, after = run.recorded_metrics, (best or tracks[0]).metrics
    rec.send_recording_name(plain(run.case.name))
    properties = rr.AnyValues(
        best_method=plain(best.name) if best else "none",
        status="improved" if best else ("failed" if any(m.status == "failed" for m in run.methods) else "kept"),
        objective_before=float(before.objective),
        objective_after=float(after.objective),
        length_before_m=float(before.length),
        length_after_m=float(after.length),
        cusps_before=int(before.cusps),
        cusps_after=int(after.cusps),
        clearance_after_m=float(after.min_clearance),
        log_sha256=run.case.sha256,
        tool_version=_version(),
    )
    rec.send_property("replay", properties)


def verify(path: pathlib.Path, tracks: list[Track]) -> None:
    """Read the file back. Raises Unwritable unless it holds one recording, its blueprint, and every path's rows."""
    rows: Counter[str] = Counter()
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("error", RerunWarning)  # of a file without its end there is only a warning
            reader = RrdReader(path)
            recordings, blueprints = reader.recordings(), reader.blueprints()
            for chunk in reader.stream():
                rows[chunk.entity_path] += chunk.num_rows
    except (RuntimeError, ValueError, OSError, RerunWarning) as error:
        raise Unwritable(f"the recording cannot be read back: {' '.join(str(error).split())}") from error
    if len(recordings) != 1 or not blueprints:
        raise Unwritable(f"{len(recordings)} recordings and {len(blueprints)} blueprints, expected 1 and at least 1")
    for path_in_file, least in expected_rows(tracks).items():
        if rows[path_in_file] < least:
            raise Unwritable(f"{path_in_file} has {rows[path_in_file]} rows, expected {least}")


def expected_rows(tracks: list[Track]) -> dict[str, int]:
    """Entities that a whole recording holds, with their least numbers of rows."""
    least = {f"/report/{name}": 1 for name in ("summary", "convergence", "vehicle", "run", "audit")}
    least |= {"/scene": 1, "/scene/map": 1, "/scene/legend/paths": 1}
    for track in tracks:
        if track.is_own:
            driven = [("scene", track.name, "vehicle", body) for body in BODIES]
            driven += [("signals", name, track.name) for name in ("steering_deg", "hitch_deg", "curvature_per_m")]
            least |= {entity(*parts): len(track.progress) for parts in driven}
            least |= {entity("scene", track.name, "path"): 1, entity("gear", track.name): len(track.starts)}
        if track.picture is not None:
            least |= {entity("scene", track.name, "cost", part): 1 for part in ("map", "moved", "anchored")}
        if track.iterates:
            least[entity("scene", track.name, "iterate")] = len(track.iterates)
    return least
