"""The plots along each path: curvature, steering, hitch angle, clearance and gear."""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import rerun as rr

from optim.model.clearance import witnesses
from optim.model.path import Path
from optim.model.problem import Problem
from optim.numerics.arrays import Array
from replay.base.style import ALARM
from replay.recording.entities import entity
from replay.recording.plan_view import columns_of
from replay.recording.text import count, plain
from replay.recording.tracks import PROGRESS, Track

FORWARD: Final = (44, 92, 66)
REVERSE: Final = (112, 66, 44)
COUNTED: Final = (62, 66, 92)


def signals_of(problem: Problem, track: Track) -> Mapping[str, Array]:
    """Signals of a path by entity name, in the units the names end in; rows as the track's."""
    return _signals(problem, track.states, track.phi, track.distance)


def _signals(problem: Problem, states: Array, phi: Array, distance: Array) -> Mapping[str, Array]:
    alpha = states[:, 3]
    values = {
        "steering_deg": np.degrees(phi),
        "hitch_deg": np.degrees(alpha),
        "curvature_per_m": -np.tan(alpha) / problem.vehicle.hitch_to_axle,
    }
    return values | ({"clearance_m": distance} if np.isfinite(distance).all() else {})


def _extremes(problem: Problem, path: Path) -> Mapping[str, float]:
    """One value of each signal for a whole path on `iteration`: the least clearance, else the largest magnitude."""
    samples = path.samples
    distance = witnesses(problem.scene, problem.vehicle, samples.states).distance.min(axis=1)
    signals = _signals(problem, samples.states, samples.phi, distance)
    return {name: float(x.min() if name == "clearance_m" else np.abs(x).max()) for name, x in signals.items()}


def limits_of(problem: Problem) -> Mapping[str, tuple[float, ...]]:
    """The limits drawn in each plot, in its unit."""
    vehicle = problem.vehicle
    steer, hitch = math.degrees(vehicle.max_steer), math.degrees(vehicle.max_hitch)
    limits = {
        "steering_deg": (-steer, steer),
        "hitch_deg": (-hitch, hitch),
        "curvature_per_m": (-vehicle.max_kappa, vehicle.max_kappa),
    }
    return limits | ({"clearance_m": (problem.required_clearance,)} if problem.scene.polygons else {})


def log_signals(rec: rr.RecordingStream, problem: Problem, tracks: list[Track], best: Track | None) -> None:
    """All signals of all paths of their own, those of iterates, and the limits.

    The best path's line is the widest, so that an equal one drawn over it does not hide it.
    """
    for track in tracks:
        look = rr.SeriesLines(
            colors=[track.style.colour],
            names=[plain(track.style.label)],
            widths=[4.0 if track is best else 3.0 if track.status == "recorded" else 2.0],
        )
        if track.is_own or track.iterates:
            _log_gear(rec, track)
        for signal, values in signals_of(problem, track).items():
            path = entity("signals", signal, track.name)
            rec.log(path, look, static=True)
            if track.is_own:
                rec.send_columns(path, columns_of(track), rr.Scalars.columns(scalars=values))
    last = max([1, *(track.last_step for track in tracks)])
    _log_iterates(rec, problem, tracks, last)
    longest = max(int(track.arc_cm[-1]) for track in tracks)
    ends = {"progress": PROGRESS, "arc_cm": longest, "iteration": last}
    columns = [rr.TimeColumn(name, sequence=[0, end]) for name, end in ends.items()]
    for signal, limits in limits_of(problem).items():
        path, num = entity("signals", signal, "limit"), len(limits)
        rec.send_columns(path, columns, rr.Scalars.columns(scalars=[*limits, *limits]).partition([num, num]))
        look = rr.SeriesLines(colors=[ALARM] * num, names=["limit"] * num, widths=[1.0] * num)
        rec.log(path, look, static=True)


def _log_iterates(rec: rr.RecordingStream, problem: Problem, tracks: list[Track], last: int) -> None:
    """The extremes of every iterate, and the recorded path's as a level."""
    for track in tracks:
        if track.status == "recorded":
            numbers, rows = np.array([0, last]), [_extremes(problem, track.path)] * 2
        else:
            numbers = track.steps([iterate.iteration for iterate in track.iterates])
            rows = [_extremes(problem, iterate.path) for iterate in track.iterates]
        for signal in rows[0] if rows else ():
            path, column = entity("signals", signal, track.name), [rr.TimeColumn("iteration", sequence=numbers)]
            rec.send_columns(path, column, rr.Scalars.columns(scalars=[row[signal] for row in rows]))


def _log_gear(rec: rr.RecordingStream, track: Track) -> None:
    """The gear along the path; on `iteration`, where nothing drives, how often each iterate changes it."""
    path = entity("gear", track.name)
    names = ["forward", "reverse"]
    colours = [FORWARD, REVERSE]
    if track.is_own:
        gears = ["forward" if segment.direction > 0 else "reverse" for segment in track.path.segments]
        when = [
            rr.TimeColumn("progress", sequence=track.progress[track.starts]),
            rr.TimeColumn("arc_cm", sequence=track.arc_cm[track.starts]),
        ]
        rec.send_columns(path, when, rr.StateChange.columns(state=gears))
    steps = track.steps([iterate.iteration for iterate in track.iterates])
    changes = {int(step): iterate.path.num_cusps for step, iterate in zip(steps, track.iterates, strict=True)}
    if track.status == "recorded":
        changes = {0: track.path.num_cusps}
    numbers = [number for k, number in enumerate(changes) if k == 0 or changes[number] != list(changes.values())[k - 1]]
    if numbers:
        counts = [count(changes[number], "gear change") for number in numbers]
        column = [rr.TimeColumn("iteration", sequence=numbers)]
        rec.send_columns(path, column, rr.StateChange.columns(state=counts))
        names += dict.fromkeys(counts)
        colours += [COUNTED] * (len(names) - len(colours))
    rec.log(path, rr.StateConfiguration(values=names, labels=names, colors=colours), static=True)
