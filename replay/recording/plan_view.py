"""Parts of each path in the plan view: the path, the swept ground, the moving vehicle, distances, failures."""

import math
from collections.abc import Iterable
from typing import Final, NamedTuple

import numpy as np
import rerun as rr
import shapely
from numpy.typing import NDArray

from optim.audit.report import AuditReport
from optim.model.path import Path
from optim.model.problem import Problem
from optim.model.vehicle import Vehicle, body_poses
from optim.numerics.arrays import Array
from replay.base.style import ALARM, Colour, as_uint32
from replay.recording.entities import BODIES, BRIGHT, LABEL, OUTSIDE, entity, image, points
from replay.recording.picture import Frame, closed, fill, rings, strips, thinned
from replay.recording.text import measured, number, plain
from replay.recording.tracks import PROGRESS, Track
from replay.run.case import Case

WHISKER_FROM: Final = 3.0  # [m]: farther obstacles do not matter
STRAY_FROM: Final = 0.01  # [m]: logged poses nearer to the path than this lie on its line
_LABEL_SIZE: Final = 0.15  # of a frame: labels nearer to each other may overlap in a small panel
_MOST_POSES: Final = 5000  # as dots; a log of hours must not grow the file


class Stroke(NamedTuple):
    """Width and draw order of a path's line."""

    width: float  # in the viewer's points
    order: float  # what is drawn over what


RECORDED_LINE: Final = Stroke(3.5, 0.0)
_LINE: Final = Stroke(2.0, 10.0)
_BEST_LINE: Final = Stroke(2.0, 12.0)


def log_track(rec: rr.RecordingStream, problem: Problem, track: Track, frame: Frame, *, is_best: bool) -> None:
    """All that belongs to one path in the plan view; the best one is drawn over the others."""
    line = RECORDED_LINE if track.status == "recorded" else _BEST_LINE if is_best else _LINE
    log_path(rec, track.path, entity("scene", track.name), track.style.colour, frame, line)
    _log_swept(rec, track, frame)
    _log_vehicle(rec, problem.vehicle, track)
    _log_distance(rec, problem, track, frame)
    log_failures(rec, entity("scene", track.name, "audit"), track.path, track.audit, frame)


def log_path(rec: rr.RecordingStream, path: Path, base: str, colour: Colour, frame: Frame, line: Stroke) -> None:
    """The truck's path, forward solid, reverse dashed, and a ring at each gear change."""
    forward, reverse = strips(path.segments, dash=frame.size / 70)
    lines = rr.LineStrips2D(forward + reverse, colors=[colour], radii=points(line.width / 2), draw_order=line.order)
    rec.log(f"{base}/path", lines, static=True)
    cusps = [segment.states[0, :2] for segment in path.segments[1:]]
    if cusps:
        labels = [f"gear change {k + 1}" for k in range(len(cusps))]
        ring = rr.Points2D(cusps, colors=[colour], radii=points(6.0), labels=labels, show_labels=False, draw_order=30.0)
        hole = rr.Points2D(cusps, colors=[OUTSIDE], radii=points(3.0), draw_order=31.0)
        rec.log(f"{base}/cusps", ring, static=True)
        rec.log(f"{base}/cusps/hole", hole, static=True)


def strays(case: Case) -> bool:
    """Whether the recorded path is off the log's poses by more than its line hides."""
    return case.logged is not None and case.read.max_deviation_m >= STRAY_FROM


def log_logged_poses(rec: rr.RecordingStream, case: Case) -> None:
    """The poses as the log holds them, where the recorded path is a repaired one: dots on its line and beside it."""
    if case.logged is None or not strays(case):
        return
    step = math.ceil(len(case.logged) / _MOST_POSES)
    shown = rr.Points2D(case.logged[::step, :2], colors=[BRIGHT], radii=points(1.25), draw_order=1.0)
    rec.log(entity("scene", "recorded", "logged_poses"), shown, static=True)


def _log_swept(rec: rr.RecordingStream, track: Track, frame: Frame) -> None:
    """Outline of the swept ground, and a translucent filling of it: lines have none, images do."""
    base, colour = entity("scene", track.name, "swept"), track.style.colour
    outlines = rr.LineStrips2D(rings(track.area), colors=[(*colour, 150)], radii=points(0.75), draw_order=-10.0)
    rec.log(f"{base}/outline", outlines, static=True)
    resolution = frame.size / 900
    bounds = Frame(*track.area.bounds)
    inside = fill(track.area, bounds, resolution)
    pixels = np.zeros((*inside.shape, 4), np.uint8)
    pixels[inside] = (*colour, 22)
    placed = rr.Transform3D(translation=[bounds.x0, bounds.y0, 0.0], scale=[resolution, resolution, 1.0])
    rec.log(f"{base}/filling", placed, image(pixels, -20.0), static=True)


def columns_of(track: Track) -> list[rr.TimeColumn]:
    """The timelines on which a path is driven."""
    return [rr.TimeColumn("progress", sequence=track.progress), rr.TimeColumn("arc_cm", sequence=track.arc_cm)]


def _quaternions(yaw: Array) -> NDArray[np.float32]:
    """Rotations about z, x y z w. Shape (n, 4)."""
    zero = np.zeros_like(yaw)
    return np.stack([zero, zero, np.sin(yaw / 2), np.cos(yaw / 2)], axis=1).astype(np.float32)


def _log_vehicle(rec: rr.RecordingStream, vehicle: Vehicle, track: Track) -> None:
    """Static outlines and fillings that transforms move along the path; the front wheel turns with the steering."""
    base, colour = entity("scene", track.name, "vehicle"), track.style.colour
    poses = body_poses(vehicle, track.states)
    for k, body in enumerate(BODIES):
        front, rear, half = vehicle.footprints[k]
        lines = [closed(vehicle.outlines[k])]
        if body == "truck":
            screen = 0.75 * front
            lines.append(np.array([[screen, -half], [screen, half]]))
        shape = rr.LineStrips2D(lines, colors=[colour], radii=points(1.25), draw_order=20.0)
        rec.log(f"{base}/{body}", shape, static=True)
        pixel = np.full((1, 1, 4), (*colour, 70), np.uint8)
        placed = rr.Transform3D(translation=[-rear, -half, 0.0], scale=[front + rear, 2 * half, 1.0])
        rec.log(f"{base}/{body}/filling", placed, image(pixel, 15.0), static=True)
        _send_poses(rec, f"{base}/{body}", track, poses[:, k, :2], poses[:, k, 2])
    wheel = rr.LineStrips2D([[[-0.5, 0.0], [0.5, 0.0]]], colors=[BRIGHT], radii=points(2.0), draw_order=21.0)
    rec.log(f"{base}/truck/wheel", wheel, static=True)
    axle = np.tile([vehicle.wheelbase, 0.0], (len(track.phi), 1))
    _send_poses(rec, f"{base}/truck/wheel", track, axle, track.phi)


def _send_poses(rec: rr.RecordingStream, path: str, track: Track, xy: Array, yaw: Array) -> None:
    """Transforms along the path, and the first one on `iteration`, where nothing drives."""
    translation = np.concatenate([xy, np.zeros((len(xy), 1))], axis=1).astype(np.float32)
    columns = rr.Transform3D.columns(translation=translation, quaternion=_quaternions(yaw))
    rec.send_columns(path, columns_of(track), columns)
    at_start = rr.Transform3D.columns(translation=translation[:1], quaternion=_quaternions(yaw[:1]))
    rec.send_columns(path, [rr.TimeColumn("iteration", sequence=[0])], at_start)


def _log_distance(rec: rr.RecordingStream, problem: Problem, track: Track, frame: Frame) -> None:
    """A line to the nearest obstacle where that is near, moving; and one, fixed, where the path comes closest."""
    if not np.isfinite(track.distance).all():
        return
    near = track.distance < WHISKER_FROM
    required = problem.required_clearance
    colours = np.where(track.distance[near] < required, as_uint32(ALARM), as_uint32(BRIGHT)).astype(np.uint32)
    columns = rr.LineStrips2D.columns(
        strips=list(track.nearest[near].astype(np.float32)),
        labels=[f"{number(value)} m" for value in track.distance[near]],
        colors=colours,
    )
    path = entity("scene", track.name, "whisker")
    rec.send_columns(path, columns_of(track), [*columns.partition(near.astype(np.uint32))])
    style = rr.LineStrips2D.from_fields(radii=points(1.25), draw_order=40.0, show_labels=True)
    rec.log(path, style, static=True)
    if track.metrics.min_clearance < 0.0:
        return  # the audit's mark says so
    worst = int(np.argmin(track.distance))
    colour = BRIGHT if track.distance[worst] >= required else ALARM
    body, obstacle = track.nearest[worst]
    away = (obstacle - body) / max(float(np.hypot(*(obstacle - body))), 1e-9)
    label_at = obstacle + 0.05 * frame.size * away  # over the obstacle, off the way
    margin = -0.06 * frame.size
    if not shapely.contains_xy(frame.grown(margin, margin, margin, margin).box, *label_at):
        label_at = (body + obstacle) / 2
    leader = rr.LineStrips2D([[body, obstacle, label_at]], colors=[colour], radii=points(0.75), draw_order=41.0)
    closest = rr.Points2D(
        [body, label_at],
        colors=[colour],
        radii=points([4.0, 0.5]),
        labels=["", f"closest {number(track.metrics.min_clearance)} m"],
        show_labels=True,
        draw_order=42.0,
    )
    rec.log(entity("scene", track.name, "closest"), closest, static=True)
    rec.log(entity("scene", track.name, "closest", "leader"), leader, static=True)


def log_failures(rec: rr.RecordingStream, path: str, driven: Path, audit: AuditReport, frame: Frame) -> None:
    """A mark at the place of each failed check of an audit, and one label for those whose own would overlap."""
    marks = list(failures(driven, audit))
    if not marks:
        return
    shown = rr.Points2D([place for place, _ in marks], colors=[ALARM], radii=points(7.0), draw_order=50.0)
    rec.log(f"{path}/marks", shown, static=True)
    labels: list[tuple[Array, list[str]]] = []
    for place, text in marks:
        near = (lines for at, lines in labels if np.abs(place - at).max() < _LABEL_SIZE * frame.size)
        lines = next(near, None)
        if lines is None:
            labels.append((place, [text]))
        else:
            lines.append(text)
    texts = rr.Points2D(
        [place for place, _ in labels],
        colors=[LABEL],
        radii=points(0.5),
        labels=["\n".join(lines) for _, lines in labels],
        show_labels=True,
        draw_order=51.0,
    )
    rec.log(path, texts, static=True)


def log_rejected(rec: rr.RecordingStream, track: Track, frame: Frame) -> None:
    """The path that the audit rejected, in the alarm colour, with the places where it fails."""
    if track.run is None or track.run.rejected is None or track.run.rejected_path is None:
        return
    path = track.run.rejected_path
    base = entity("scene", track.name, "rejected")
    log_path(rec, path, base, ALARM, frame, _LINE)
    log_failures(rec, f"{base}/audit", path, track.run.rejected, frame)


def failures(driven: Path, audit: AuditReport) -> Iterable[tuple[Array, str]]:
    """Position and label of each failed check that has a place."""
    for name, check in audit.checks.items():
        place = check.place
        if check.passed or place is None or not 0 <= place.segment < len(driven.segments):
            continue
        segment = driven.segments[place.segment]
        row = int(np.argmin(np.abs(segment.s - place.s)))
        yield segment.states[row, :2], plain(f"✗ {name}: {measured(check)}")


def log_iterates(rec: rr.RecordingStream, track: Track) -> None:
    """The method's iterates, one polyline each, on `iteration` and on `progress`."""
    if not track.iterates:
        return
    path = entity("scene", track.name, "iterate")
    lines = [thinned(iterate.path.samples.states[:, :2]) for iterate in track.iterates]
    columns = iteration_columns([iterate.iteration for iterate in track.iterates], track)
    rec.send_columns(path, columns, rr.LineStrips2D.columns(strips=lines))
    style = rr.LineStrips2D.from_fields(colors=[track.style.colour], radii=points(1.25), draw_order=25.0)
    rec.log(path, style, static=True)


def iteration_columns(numbers: list[int], track: Track) -> list[rr.TimeColumn]:
    """Iterations on their own timeline, and on `progress`, the default one, so that they play there too.

    On both every iterate gets the same time: most methods do most in their first iterations.
    """
    steps = track.steps(numbers)
    progress = np.round(PROGRESS * steps / max(1, track.last_step)).astype(np.int64)
    return [rr.TimeColumn("iteration", sequence=steps), rr.TimeColumn("progress", sequence=progress)]
