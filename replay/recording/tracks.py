"""Drawing data of each path: rows at which it is shown, their place on the timelines, distances, swept area."""

import dataclasses
import itertools
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import Final

import numpy as np
from shapely.geometry.base import BaseGeometry

from optim.audit.report import AuditReport
from optim.model.clearance import witnesses
from optim.model.metrics import Metrics
from optim.model.path import Path, Samples
from optim.model.problem import Problem
from optim.model.result import Iterate, Picture
from optim.numerics.arrays import Array, IntArray
from replay.base.style import RECORDED, Style, styles
from replay.recording.picture import swept_area
from replay.run.outcome import MethodRun, Run

PROGRESS: Final = 1000
"""Last value of the timeline `progress`."""
_SPACING: Final = 0.2  # [m] between rows; at most a display's frame at walking speed
_MOST_ROWS: Final = 1000  # of one path, so that a very long one does not grow the file


@dataclass(frozen=True, eq=False, kw_only=True)
class Track:
    """One path as it is drawn. The R rows are samples of the path, without interpolation."""

    name: str
    style: Style
    status: str
    """recorded, improved, kept or failed; the path of the last two is the recorded one."""
    path: Path
    metrics: Metrics
    audit: AuditReport
    area: BaseGeometry
    """Ground swept by truck and trailer."""
    progress: IntArray
    """0 to PROGRESS at each row. Shape (R,)."""
    arc_cm: IntArray
    """Distance driven at each row [cm]. Shape (R,)."""
    states: Array
    """Shape (R, 4)."""
    phi: Array
    """Shape (R,)."""
    starts: IntArray
    """Row at which each segment starts."""
    distance: Array
    """Distance from the nearer body to its nearest obstacle [m], inf without obstacles. Shape (R,)."""
    nearest: Array
    """The two points that are that far apart, on the body and on the obstacle. Shape (R, 2, 2)."""
    run: MethodRun | None = None
    """Outcome of the method on the case; None for the recorded path."""

    @property
    def is_own(self) -> bool:
        """Whether the path is its own, not the recorded one shown again."""
        return self.status in ("recorded", "improved")

    @property
    def picture(self) -> Picture | None:
        """The way in which the method drew its last iterate, if it ran."""
        return self.run.picture if self.run is not None else None

    @property
    def iterates(self) -> tuple[Iterate, ...]:
        """The iterates that are drawn; none for the recorded path."""
        return self.run.iterates if self.run is not None else ()

    def steps(self, numbers: Sequence[int]) -> IntArray:
        """The places of iterations in the method's history, from 0, which is their time on `iteration`.

        Of `shortcut`, 1,000 tries of which 20 lower J, numbers would squeeze every other method into a corner.
        """
        return np.searchsorted([record.iteration for record in self.run.history] if self.run else [], numbers)

    @property
    def last_step(self) -> int:
        """Place of the last iteration, as in `steps`."""
        return max(0, len(self.run.history) - 1) if self.run is not None else 0


def tracks_of(run: Run, looks: Mapping[str, Style] | None = None) -> list[Track]:
    """The recorded path, then every method's in the order in which they ran; `looks` instead of their own styles."""
    problem = run.case.problem
    path, values, audit = problem.recorded, run.recorded_metrics, run.recorded_audit
    recorded = _track(problem, path, "recorded", RECORDED, "recorded", values, audit)
    tracks, looks = [recorded], looks or styles(method.name for method in run.methods)
    for method in run.methods:
        style = looks[method.name]
        if method.status == "improved":
            track = _track(problem, method.path, method.name, style, method.status, method.metrics, method.audit)
        else:
            track = dataclasses.replace(recorded, name=method.name, style=style, status=method.status)
        tracks.append(dataclasses.replace(track, run=method))
    return tracks


def best_of(run: Run, tracks: list[Track]) -> Track | None:
    """The track of the run's best path, or None."""
    return next((track for track in tracks if track.run is not None and track.run is run.best), None)


def _track(
    problem: Problem,
    path: Path,
    name: str,
    style: Style,
    status: str,
    metrics: Metrics,
    audit: AuditReport,
) -> Track:
    samples = path.samples
    near = witnesses(problem.scene, problem.vehicle, samples.states)
    distance = near.distance.min(axis=1)
    rows = chosen_rows(samples, extra=int(np.argmin(distance)))
    body = near.distance[rows].argmin(axis=1)
    points = np.stack([near.on_body[rows, body], near.on_obstacle[rows, body]], axis=1)
    segment = samples.segment[rows]
    return Track(
        name=name,
        style=style,
        status=status,
        path=path,
        metrics=metrics,
        audit=audit,
        area=swept_area(problem.vehicle, path),
        progress=progress(path, problem.recorded)[rows],
        arc_cm=np.round(100.0 * samples.s[rows]).astype(np.int64),
        states=samples.states[rows],
        phi=samples.phi[rows],
        starts=np.flatnonzero(np.diff(segment, prepend=-1)),
        distance=distance[rows],
        nearest=points,
    )


def chosen_rows(samples: Samples, extra: int) -> IntArray:
    """Indices of the samples to show: about every 0.2 m, both sides of each cusp, the ends, and `extra`."""
    spacing = max(_SPACING, float(samples.s[-1]) / _MOST_ROWS)
    bucket = np.floor(samples.s / spacing)
    new = (np.diff(bucket, prepend=-1.0) != 0) | (np.diff(samples.segment, prepend=-1) != 0)
    last = np.diff(samples.segment, append=-1) != 0
    new[extra] = True
    return np.flatnonzero(new | last)


def progress(path: Path, recorded: Path) -> IntArray:
    """Place of every sample on the timeline `progress`, 0 to PROGRESS. Shape (N,).

    With as many gear changes as the recorded path, they fall on the same values as there, so that two vehicles
    shift together; otherwise progress is the share of the path's own length.
    """
    knots = np.array([0.0, *itertools.accumulate(segment.length for segment in path.segments)])
    places = knots / knots[-1]
    if [segment.direction for segment in path.segments] == [segment.direction for segment in recorded.segments]:
        places = np.array([0.0, *itertools.accumulate(segment.length for segment in recorded.segments)])
        places = places / places[-1]
    return np.round(PROGRESS * np.interp(path.samples.s, knots, places)).astype(np.int64)
