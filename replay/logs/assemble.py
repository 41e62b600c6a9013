"""From a log file to cases: each path message is one request, on the map that was there at its time."""

import dataclasses
import os
from dataclasses import dataclass
from pathlib import Path as FilePath

import numpy as np

from optim.arrays import Array, frozen
from optim.fit import Fit
from optim.path import LENGTH_TOLERANCE
from optim.problem import Problem
from optim.vehicle import Vehicle
from replay.case import Case, ReadReport
from replay.errors import LogError, printable
from replay.logs.checks import check_ends, check_fit, check_recorded, deviation, hitch_notes
from replay.logs.container import scan
from replay.logs.maps import LogMap, Maps, frame_name
from replay.logs.options import ReadOptions
from replay.logs.pairing import TOLERANCE, hitch_angles, hitch_misfit, trailer_at_poses
from replay.logs.planar import Refusal
from replay.logs.poses import RecordedPoses, kept_indices, recorded_poses, to_plane
from replay.logs.records import Log
from replay.logs.repair import repaired
from replay.logs.roles import truck_and_trailer
from replay.logs.ros2 import PoseSeries
from replay.logs.topics import Topic, choose_map, choose_paths, is_wanted, refused, topics_of
from replay.logs.vehicle import nodes_of, vehicle_of


def read_cases(path: str | os.PathLike[str], options: ReadOptions | None = None) -> list[Case]:
    """All requests of a log, in the order of their log times, as ``STEM/0``, ``STEM/1``, ...

    Raises:
        LogError: the log cannot be read, leaves open what is meant, or none of its requests can be used. A request
            that cannot be used beside others that can is named in their notes, and `read.lost` is set.
    """
    options = options or ReadOptions()
    log = scan(FilePath(path), is_wanted)
    topics = topics_of(log)
    map_topic = choose_map(log, topics, options.map_topic)
    trucks, trailers = choose_paths(log, topics, options.path_topic, options.trailer_topic)
    try:
        vehicle, notes = (options.vehicle, []) if options.vehicle else vehicle_of(log.metadata)
    except Refusal as error:
        raise LogError(error.code, log.path, str(error)) from None
    maps = Maps(map_topic, options)
    truck, trailer = truck_and_trailer(
        trucks,
        trailers,
        vehicle,
        truck_chosen=options.path_topic is not None,
        trailer_chosen=options.trailer_topic is not None,
    )
    reader = _Reader(log, options, vehicle, maps, truck, trailer, (*log.warnings, *notes))
    return reader.cases()


@dataclass(frozen=True, eq=False, kw_only=True)
class _Request:
    """One path message, and the trailer's that belongs to it."""

    index: int
    log_time: int
    series: PoseSeries
    trailer: PoseSeries | None


class _Reader:
    """Makes the cases of one log."""

    def __init__(
        self,
        log: Log,
        options: ReadOptions,
        vehicle: Vehicle,
        maps: Maps,
        truck: Topic,
        trailer: Topic | None,
        notes: tuple[str, ...],
    ) -> None:
        self.log, self.options, self.vehicle, self.maps = log, options, vehicle, maps
        self.truck, self.trailer, self.notes = truck, trailer, notes

    def cases(self) -> list[Case]:
        """All requests that can be used."""
        cases: list[Case] = []
        errors: list[LogError] = []
        seen: set[tuple[object, ...]] = set()
        repeated = 0
        for index in range(len(self.truck.messages)):
            try:
                request = self._request(index)
                identity = self._identity(request)
                if identity in seen:
                    repeated += 1
                    continue
                seen.add(identity)
                cases.append(self._case(request, number=len(cases) + len(errors)))
            except LogError as error:
                errors.append(error)
        if not cases:
            raise errors[0]
        notes = [f"{repeated} path messages repeat an earlier one and are no requests of their own"] if repeated else []
        notes += [f"a request could not be used: {error.message}" for error in errors[:5]]
        lost = self.log.lost or bool(errors)
        return [_with_notes(case, (*self.notes, *notes), lost) for case in cases]

    def _request(self, index: int) -> _Request:
        series: PoseSeries = self.truck.decode(index)
        log_time = self.truck.messages[index].log_time
        return _Request(index=index, log_time=log_time, series=series, trailer=self._trailer_for(index, series))

    def _trailer_for(self, index: int, series: PoseSeries) -> PoseSeries | None:
        """The trailer's message with the same stamp, else of the same number, else the nearest in time."""
        if self.trailer is None:
            return None
        count = len(self.trailer.messages)
        if count == len(self.truck.messages):
            return self.trailer.decode(index)
        times = [message.log_time for message in self.trailer.messages]
        order = sorted(range(count), key=lambda i: abs(times[i] - self.truck.messages[index].log_time))
        nearest = [self.trailer.decode(i) for i in order[:2]]
        return next((other for other in nearest if other.header.stamp == series.header.stamp), nearest[0])

    def _identity(self, request: _Request) -> tuple[object, ...]:
        """Equal for messages that ask the same: a latched topic repeats itself."""
        other = b"" if request.trailer is None else request.trailer.poses.tobytes()
        return self.maps.index_at(request.log_time), request.series.poses.tobytes(), other

    def _case(self, request: _Request, number: int) -> Case:
        log_map, notes = self.maps.at(request.log_time)
        try:
            return self._understood(request, number, log_map, notes)
        except Refusal as error:
            refused(self.truck, request.index, error)

    def _understood(self, request: _Request, number: int, log_map: LogMap, notes: list[str]) -> Case:
        frame = _common_frame(request, log_map, self.maps.topic)
        plane, planar_notes = to_plane(request.series, log_map.centre)
        recorded = recorded_poses(plane, self.options.start_direction)
        alpha = self._hitch(request, plane, recorded, log_map.centre)
        fit, repairs = repaired(self.vehicle, log_map.scene, recorded, alpha, self.options.initial_hitch)
        check_fit(recorded, fit)
        log_map.check_under(self.vehicle, _states(fit))
        nodes, node_notes = self._nodes(recorded, fit)
        problem = Problem(
            vehicle=self.vehicle,
            scene=log_map.scene,
            recorded=fit.path,
            margin=self.options.margin,
            nodes=nodes,
        )
        check_ends(problem, log_map.hint, alpha is None)
        checks = check_recorded(problem, recorded, fit, alpha, log_map.hint)
        if alpha is None:
            checks += hitch_notes(problem, recorded, fit)
        all_notes = (*notes, *log_map.notes, *planar_notes, *recorded.notes, *node_notes, *repairs, *checks)
        off = deviation(plane, recorded, fit)
        read = ReadReport(
            poses=len(plane),
            hitch="reconstructed" if alpha is None else "trailer path",
            max_deviation_m=off.largest,
            max_deviation_rad=off.largest_turn,
            rms_deviation_m=off.rms,
            rms_deviation_rad=off.rms_turn,
            goal_hitch_sigma=fit.goal_hitch_sigma if alpha is None and not recorded.is_exact else 0.0,
            notes=all_notes,
        )
        return Case(
            name=f"{self.log.path.stem}/{number}",
            log=self.log.path,
            sha256=self.log.sha256,
            problem=problem,
            read=read,
            map=log_map.image,
            frame=frame,
        )

    def _hitch(self, request: _Request, plane: Array, recorded: RecordedPoses, centre: Array) -> Array | None:
        """Hitch angles at the kept poses, shape (n,), or None without a trailer path."""
        if request.trailer is None:
            return None
        assert self.trailer is not None, "a request has a trailer's path only where the log has its topic"
        trailer, _ = to_plane(request.trailer, centre)
        length = self.vehicle.hitch_to_axle
        at = recorded.averaged(trailer_at_poses(plane, request.series, trailer, request.trailer, length))
        misfit = float(np.median(hitch_misfit(recorded.poses, at, length)))
        if misfit > TOLERANCE:
            text = (
                f"the trailer's path {printable(self.trailer.name, 60)!r} lies {misfit:.2f} m (median) from where "
                f"hitch_to_axle = {length:g} m puts it, expected at most {TOLERANCE:g} m"
            )
            raise Refusal("E_HITCH", text)
        return hitch_angles(recorded.poses, at)

    def _nodes(self, recorded: RecordedPoses, fit: Fit) -> tuple[Array | None, list[str]]:
        indices = nodes_of(self.log.metadata, len(recorded.nearest))
        if indices is None:
            return None, []
        if len(self.truck.messages) > 1:
            return None, ["metadata record 'path_nodes' is not used: the log holds several paths"]
        return frozen(fit.pose_s[kept_indices(recorded, indices)]), []


def _with_notes(case: Case, notes: tuple[str, ...], lost: bool) -> Case:
    every = tuple(printable(note, 400) for note in (*notes, *case.read.notes))
    return dataclasses.replace(case, read=dataclasses.replace(case.read, notes=every, lost=lost))


def _states(fit: Fit) -> Array:
    """The fitted path at the logged poses: where the bodies stood, without the noise of the headings. Shape (n, 4)."""
    samples = fit.path.samples
    rows = np.searchsorted(samples.s, fit.pose_s - LENGTH_TOLERANCE)
    return samples.states[np.minimum(rows, len(samples.s) - 1)]


def _common_frame(request: _Request, log_map: LogMap, map_topic: Topic) -> str:
    """The frame of map and path. Raises Refusal (E_FRAME) unless there is one."""
    expected = log_map.scene.frame
    named = {request.series.header.frame, *(request.series.frames - {""})}
    if request.trailer is not None:
        named |= {request.trailer.header.frame, *(request.trailer.frames - {""})}
    others = sorted({frame_name(frame) for frame in named} - {expected})
    where = f"map topic {printable(map_topic.name, 60)!r}"
    if others:
        text = f"it is in frame {printable(others[0], 60)!r} and {where} in {printable(expected, 60)!r}"
        raise Refusal("E_FRAME", f"{text}, expected one frame for both")
    if not expected:
        raise Refusal("E_FRAME", f"neither it nor {where} names its frame (frame_id is empty)")
    return expected
