"""The plots: curvature, steering, hitch angle, clearance and gear along each path; J over a method's iterations."""

import math
from collections.abc import Mapping
from typing import Final

import numpy as np
import rerun as rr

from optim.arrays import Array
from optim.problem import Problem
from replay.recording.entities import entity
from replay.recording.scene import columns_of, iteration_columns
from replay.recording.text import plain
from replay.recording.tracks import PROGRESS, Track
from replay.style import ALARM

FORWARD: Final = (44, 92, 66)
REVERSE: Final = (112, 66, 44)


def signals_of(problem: Problem, track: Track) -> Mapping[str, Array]:
    """What is plotted of a path by entity name, in the units the names end in; rows as the track's."""
    alpha = track.states[:, 3]
    values = {
        "steering_deg": np.degrees(track.phi),
        "hitch_deg": np.degrees(alpha),
        "curvature_per_m": -np.tan(alpha) / problem.vehicle.hitch_to_axle,
    }
    if np.isfinite(track.distance).all():
        values["clearance_m"] = track.distance
    return values


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


def log_signals(rec: rr.RecordingStream, problem: Problem, tracks: list[Track]) -> None:
    """All signals of all paths of their own, and the limits."""
    for track in tracks:
        if not track.is_own:
            continue
        look = rr.SeriesLines(
            colors=[track.style.colour],
            names=[plain(track.style.label)],
            widths=[3.0 if track.status == "recorded" else 2.0],
        )
        for signal, values in signals_of(problem, track).items():
            path = entity("signals", signal, track.name)
            rec.send_columns(path, columns_of(track), rr.Scalars.columns(scalars=values))
            rec.log(path, look, static=True)
        _log_gear(rec, track)
    longest = max(int(track.arc_cm[-1]) for track in tracks)
    ends = [rr.TimeColumn("progress", sequence=[0, PROGRESS]), rr.TimeColumn("arc_cm", sequence=[0, longest])]
    for signal, limits in limits_of(problem).items():
        path, count = entity("signals", signal, "limit"), len(limits)
        rec.send_columns(path, ends, rr.Scalars.columns(scalars=[*limits, *limits]).partition([count, count]))
        look = rr.SeriesLines(colors=[ALARM] * count, names=["limit"] * count, widths=[1.0] * count)
        rec.log(path, look, static=True)


def _log_gear(rec: rr.RecordingStream, track: Track) -> None:
    path = entity("gear", track.name)
    gears = ["forward" if segment.direction > 0 else "reverse" for segment in track.path.segments]
    when = [
        rr.TimeColumn("progress", sequence=track.progress[track.starts]),
        rr.TimeColumn("arc_cm", sequence=track.arc_cm[track.starts]),
    ]
    rec.send_columns(path, when, rr.StateChange.columns(state=gears))
    names = ["forward", "reverse"]
    rec.log(path, rr.StateConfiguration(values=names, labels=names, colors=[FORWARD, REVERSE]), static=True)


def log_convergence(rec: rr.RecordingStream, tracks: list[Track]) -> None:
    """J over the iterations, the recorded path's as a level, and the violation of methods that have one."""
    last = 1
    for track in tracks:
        history = track.run.history if track.run is not None else []
        if not history:
            continue
        last = max(last, int(history[-1]["iteration"]))
        violation = np.array([row["violation"] for row in history])
        _log_solver(rec, track, "objective", np.array([row["objective"] for row in history]))
        if (violation > 0.0).any():
            _log_solver(rec, track, "violation_log10", np.log10(np.maximum(violation, 1e-12)))
    level = tracks[0].metrics["objective"]
    ends = [rr.TimeColumn("iteration", sequence=[0, last]), rr.TimeColumn("progress", sequence=[0, PROGRESS])]
    path = entity("solver", "objective", "recorded")
    rec.send_columns(path, ends, rr.Scalars.columns(scalars=[level, level]))
    look = rr.SeriesLines(colors=[tracks[0].style.colour], names=[tracks[0].style.label], widths=[3.0])
    rec.log(path, look, static=True)


def _log_solver(rec: rr.RecordingStream, track: Track, name: str, values: Array) -> None:
    assert track.run is not None
    path, known = entity("solver", name, track.name), np.isfinite(values)
    numbers = [int(row["iteration"]) for row, keep in zip(track.run.history, known, strict=True) if keep]
    if not numbers:
        return
    rec.send_columns(path, iteration_columns(numbers, track), rr.Scalars.columns(scalars=values[known]))
    look = rr.SeriesLines(colors=[track.style.colour], names=[plain(track.style.label)], widths=[2.0])
    rec.log(path, look, static=True)
