"""Roles of the paths in a log: truck or trailer."""

import numpy as np

from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array
from replay.base.errors import LogError
from replay.logs.meaning.frames import Frames, frame_name, in_frame
from replay.logs.meaning.pairing import TOLERANCE, hitch_misfit, trailer_at_poses
from replay.logs.meaning.planar import Refusal
from replay.logs.meaning.recorded_poses import recorded_poses, to_plane
from replay.logs.meaning.stated import at_rear_axle, references
from replay.logs.meaning.topics import Topic, refused, titles
from replay.logs.messages.types import PoseSeries

MOST_CANDIDATES = 8
"""Path topics that are compared with each other; more ask for a choice at once."""


def truck_and_trailer(
    trucks: list[Topic],
    trailers: list[Topic],
    vehicle: Vehicle,
    *,
    truck_chosen: bool,
    trailer_chosen: bool,
    offset: float,
    frames: Frames,
) -> tuple[Topic, Topic | None]:
    """The truck's topic, and the trailer's if there is one: the pair in which one follows the other on its hitch.

    offset: how far ahead of the rear axle the truck's poses are [m].

    Raises:
        LogError: the log leaves it open; the error lists the topics and names the options.
    """
    if len(trucks) == 1 and trailers == trucks:
        return trucks[0], None
    if truck_chosen and trailer_chosen:
        return trucks[0], trailers[0]
    every = [topic for _, topic in sorted({topic.name: topic for topic in (*trucks, *trailers)}.items())]
    if len(every) > MOST_CANDIDATES and not truck_chosen:
        raise _ambiguous(every, "too many to compare")
    misfits = {(a, b): _misfit(a, b, vehicle, offset, frames) for a in trucks for b in trailers if a is not b}
    fitting = [pair for pair, (misfit, _) in misfits.items() if misfit <= TOLERANCE]
    if len(fitting) == 1:
        return fitting[0]
    if fitting:
        raise _ambiguous(every, "several pairs of them belong together as truck and trailer")
    if truck_chosen and not trailer_chosen:
        return trucks[0], None
    for topic in every:  # a path that is broken in itself fits nothing: the error about it says more
        _check_alone(topic)
    raise _unpaired(every, misfits, vehicle, frames)


def _unpaired(
    every: list[Topic], misfits: dict[tuple[Topic, Topic], tuple[float, str]], vehicle: Vehicle, frames: Frames
) -> LogError:
    """The error where no two topics belong together; `misfits` of truck and trailer as in `_misfit`."""
    found = "no two of them belong together as truck and trailer"
    reasons = [reason for _, reason in misfits.values() if reason]
    if reasons:
        return _ambiguous(every, f"{found} ({reasons[0]})")
    nearest = min(misfit for misfit, _ in misfits.values())
    place = f"where hitch_to_axle = {vehicle.hitch_to_axle:g} m puts it"
    found += f" (the nearest axle is {nearest:.2f} m from {place}, expected at most {TOLERANCE:g} m)"
    for name, ahead in references(vehicle).items():
        if any(_misfit(a, b, vehicle, ahead, frames)[0] <= TOLERANCE for a, b in misfits):
            return _ambiguous(every, found, f"as poses of the truck's {name} they do: try --reference {name}")
    return _ambiguous(every, found)


def _ambiguous(
    topics: list[Topic], found: str, advice: str = "choose with --path-topic and --trailer-topic"
) -> LogError:
    text = f"{len(topics)} topics hold a path, {found}: {titles(topics)}; {advice}"
    return LogError("E_AMBIGUOUS", topics[0].log.path, text)


def _first(topic: Topic) -> tuple[PoseSeries, Array]:
    series: PoseSeries = topic.decode(0)
    try:
        return series, _plane(series)
    except Refusal as error:
        refused(topic, 0, error)


def _plane(series: PoseSeries) -> Array:
    return to_plane(series, series.poses[0, :2] if len(series.poses) else np.zeros(2))[0]


def _misfit(truck: Topic, trailer: Topic, vehicle: Vehicle, offset: float, frames: Frames) -> tuple[float, str]:
    """Median distance of the trailer's axle from where the hitch puts it, in the first messages [m].

    Infinite where the poses cannot be paired; then the text says why.
    """
    (series, plane), (trailer_series, trailer_plane) = _first(truck), _first(trailer)
    try:
        plane = at_rear_axle(plane, offset)
        if trailer_series.header.frame != series.header.frame:
            moved, _ = in_frame(trailer_series, frame_name(series.header.frame), "the other path", frames)
            trailer_plane = _plane(moved)
        at = trailer_at_poses(plane, series, trailer_plane, trailer_series, vehicle)
    except Refusal as error:
        return np.inf, str(error)
    return float(np.median(hitch_misfit(plane, at, vehicle))), ""


def _check_alone(topic: Topic) -> None:
    try:
        recorded_poses(_first(topic)[1], 1)
    except Refusal as error:
        refused(topic, 0, error)
