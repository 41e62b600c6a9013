"""Assembly of cases from a log: each path message is one request, on the map of its time."""

import dataclasses
import os
from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from optim.fit.poses import Fit
from optim.model.path import LENGTH_TOLERANCE
from optim.model.problem import Problem
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, frozen
from replay.base.errors import LogError, printable
from replay.logs.container.folder import open_log
from replay.logs.container.log import Log
from replay.logs.meaning.frames import Frames, frame_name, in_frame
from replay.logs.meaning.hitch import FRAME_WORD, Angles, Hitch, combined, sources
from replay.logs.meaning.maps import LogMap, Maps
from replay.logs.meaning.pairing import TOLERANCE, hitch_angles, hitch_misfit, trailer_at_poses
from replay.logs.meaning.planar import Refusal
from replay.logs.meaning.plausibility import check_ends, check_fit, check_recorded, deviation, hitch_notes
from replay.logs.meaning.read_options import ReadOptions
from replay.logs.meaning.recorded_poses import RecordedPoses, kept_indices, recorded_poses, to_plane
from replay.logs.meaning.repair import repaired
from replay.logs.meaning.roles import truck_and_trailer
from replay.logs.meaning.stated import (
    at_rear_axle,
    reference_offset,
    references,
    start_direction,
    steer_notes,
    with_stated_gears,
)
from replay.logs.meaning.topics import Topic, choose_map, choose_paths, is_wanted, refused, topics_of
from replay.logs.meaning.vehicle import nodes_of, vehicle_in
from replay.logs.messages.types import PoseSeries
from replay.run.case import Case, ReadReport

_NOTED_LENGTH = 0.03
"""Least difference between hitch_to_axle and the paths' own that gets a note [m]: noise averages to less."""


def read_cases(path: str | os.PathLike[str], options: ReadOptions | None = None) -> list[Case]:
    """All requests of a log, in the order of their log times, as ``STEM/0``, ``STEM/1``, ...

    Raises:
        LogError: the log cannot be read, leaves open what is meant, or none of its requests can be used. A request
            that cannot be used beside others that can is named in their notes, and `read.lost` is set.
    """
    log = open_log(path, is_wanted)
    return cases_of(log, topics_of(log), options or ReadOptions())


def cases_of(log: Log, topics: Sequence[Topic], options: ReadOptions) -> list[Case]:
    """`read_cases` for a log that is open, and its topics. Raises LogError."""
    map_topic = choose_map(log, topics, options.map_topic)
    trucks, trailers = choose_paths(log, topics, options.path_topic, options.trailer_topic)
    vehicle, notes = (options.vehicle, []) if options.vehicle else vehicle_in(log)
    frames = Frames(topics)
    maps = Maps(map_topic, options, frames)
    truck, trailer = truck_and_trailer(
        trucks,
        trailers,
        vehicle,
        truck_chosen=options.path_topic is not None,
        trailer_chosen=options.trailer_topic is not None,
        offset=reference_offset(vehicle, options),
        frames=frames,
    )
    notes += _doubts(vehicle, truck, trailer, options)
    reader = _CaseReader(
        log=log,
        topics=topics,
        options=options,
        vehicle=vehicle,
        maps=maps,
        truck=truck,
        trailer=trailer,
        notes=(*log.warnings, *notes),
    )
    return reader.cases()


def _doubts(vehicle: Vehicle, truck: Topic, trailer: Topic | None, options: ReadOptions) -> list[str]:
    """Notes about what is used as it is, and may be meant otherwise or be of no use to some methods."""
    notes = []
    if vehicle.hitch_offset != 0.0:
        needs = "shortcut and cpo need 0 and will fail; ddp, nlp and scp do not"
        notes.append(f"hitch_offset is {vehicle.hitch_offset:g} m: {needs}")
    if trailer is None and options.path_topic is None and FRAME_WORD in truck.name.lower():
        name = printable(truck.name, 60)
        notes.append(f"the only path, {name!r}, is taken as the truck's, and its name says trailer: is that right?")
    return notes


@dataclass(frozen=True, eq=False, kw_only=True)
class _Request:
    """One path message, and the trailer's that belongs to it."""

    index: int
    log_time: int
    series: PoseSeries
    trailer: PoseSeries | None


@dataclass(frozen=True, eq=False, kw_only=True)
class _CaseReader:
    """Makes the cases of one log."""

    log: Log
    topics: Sequence[Topic]
    options: ReadOptions
    vehicle: Vehicle
    maps: Maps
    truck: Topic
    trailer: Topic | None
    notes: tuple[str, ...]
    _angles: dict[str, tuple[list[Angles], list[str]]] = field(default_factory=dict)
    """Sources of hitch angles beside paths, and notes, by the frame of the path; filled as they are asked for."""

    def cases(self) -> list[Case]:
        """Cases of all usable requests, or of the one that the options choose."""
        cases: list[Case] = []
        errors: list[LogError] = []
        seen: set[tuple[object, ...]] = set()
        chosen, number = self.options.case, 0
        for index in range(len(self.truck.messages)):
            try:
                request = self._request(index)
                identity = self._identity(request)
                if identity in seen:
                    continue
                seen.add(identity)
                if chosen in (None, number):
                    cases.append(self._case(request, number))
            except LogError as error:
                errors += [error] if chosen in (None, number) else []
            number += 1
        if not cases and not errors:
            held = "one request, number 0" if number == 1 else f"{number} requests, numbers 0 to {number - 1}"
            raise LogError("E_NO_TOPIC", self.log.path, f"--case {chosen}: it holds {held}")
        if not cases:
            raise errors[0]
        repeated = len(self.truck.messages) - number
        notes = [f"{repeated} path messages repeat an earlier one and are not separate requests"] if repeated else []
        notes += [f"a request could not be used: {error.message}" for error in errors[:5]]
        lost = self.log.lost or bool(errors)
        return [_with_notes(case, (*self.notes, *notes), lost) for case in cases]

    def _request(self, index: int) -> _Request:
        series: PoseSeries = self.truck.decode(index)
        log_time = self.truck.messages[index].log_time
        return _Request(index=index, log_time=log_time, series=series, trailer=self._trailer_for(index, series))

    def _trailer_for(self, index: int, series: PoseSeries) -> PoseSeries | None:
        """The trailer's message of the same number where there are as many, else the nearest in time.

        Of the two nearest, one with the same stamp goes before.
        """
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
        """Key that is equal for messages with the same request: a latched topic repeats itself."""
        other = b"" if request.trailer is None else request.trailer.poses.tobytes()
        return self.maps.index_at(request.log_time), request.series.poses.tobytes(), other

    def _case(self, request: _Request, number: int) -> Case:
        log_map, notes = self.maps.at(request.log_time)
        try:
            return self._understood(request, number, log_map, notes)
        except Refusal as error:
            refused(self.truck, request.index, error)

    def _understood(self, request: _Request, number: int, log_map: LogMap, notes: list[str]) -> Case:
        request, frame, frame_notes = self._in_one_frame(request, log_map)
        plane, planar_notes = to_plane(request.series, log_map.centre)
        plane = at_rear_axle(plane, reference_offset(self.vehicle, self.options))
        recorded = recorded_poses(plane, start_direction(request.series, self.options))
        recorded = with_stated_gears(recorded, request.series)
        hitch = self._hitch(request, plane, recorded, log_map.centre)
        alpha = hitch.alpha
        fit, repairs = repaired(self.vehicle, log_map.scene, recorded, alpha, hitch.initial)
        check_fit(recorded, fit, hitch.sign_of)
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
        checks += steer_notes(recorded, fit, request.series)
        checks += hitch_notes(problem, recorded, fit) if alpha is None else []
        of_path = [self._of_path(note) for note in (*frame_notes, *planar_notes, *recorded.notes)]
        before = (*notes, *log_map.notes, *of_path, *hitch.notes)
        off = deviation(plane, recorded, fit)
        read = ReadReport(
            poses=len(plane),
            hitch=hitch.source,
            max_deviation_m=off.largest,
            max_deviation_rad=off.largest_turn,
            rms_deviation_m=off.rms,
            rms_deviation_rad=off.rms_turn,
            goal_hitch_sigma=fit.goal_hitch_sigma if alpha is None and not recorded.is_exact else 0.0,
            notes=(*before, *node_notes, *repairs, *checks),
        )
        return Case(
            name=f"{self.log.stem}/{number}",
            log=self.log.path,
            sha256=self.log.sha256,
            problem=problem,
            read=read,
            map=log_map.image,
            frame=frame,
            time_ns=request.log_time,
            logged=frozen(plane),
        )

    def _in_one_frame(self, request: _Request, log_map: LogMap) -> tuple[_Request, str, list[str]]:
        """The request in the frame of the map, that frame, and notes. Raises Refusal (E_FRAME)."""
        frame = frame_name(request.series.header.frame) if log_map.headless else log_map.scene.frame
        where = f"map topic {printable(self.maps.topic.name, 60)!r}"
        series, notes = in_frame(request.series, frame, where, self.maps.frames)
        trailer = request.trailer
        if trailer is not None:
            trailer, _ = in_frame(trailer, frame, where, self.maps.frames)
        return dataclasses.replace(request, series=series, trailer=trailer), frame, notes

    def _hitch(self, request: _Request, plane: Array, recorded: RecordedPoses, centre: Array) -> Hitch:
        """Hitch angles at the kept poses, from the best source that there is."""
        alpha, paths_notes = self._from_trailer(request, plane, recorded, centre)
        frame = frame_name(request.series.header.frame)
        if frame not in self._angles:
            self._angles[frame] = sources(self.topics, self.maps.frames, frame, self.options)
        others, notes = self._angles[frame]
        initial = self.options.initial_hitch
        hitch = combined(alpha, others, recorded, request.series, request.log_time, initial)
        return hitch._replace(notes=[*paths_notes, *notes, *hitch.notes])

    def _from_trailer(
        self, request: _Request, plane: Array, recorded: RecordedPoses, centre: Array
    ) -> tuple[Array | None, list[str]]:
        """Hitch angles at the kept poses, shape (n,), or None without a trailer path; and notes."""
        if request.trailer is None:
            return None, []
        assert self.trailer is not None, "a request has a trailer's path only where the log has its topic"
        trailer, _ = to_plane(request.trailer, centre)
        at = recorded.averaged(trailer_at_poses(plane, request.series, trailer, request.trailer, self.vehicle))
        misfit = float(np.median(hitch_misfit(recorded.poses, at, self.vehicle)))
        if misfit > TOLERANCE:
            text = (
                f"the trailer's path {printable(self.trailer.name, 60)!r} lies {misfit:.2f} m (median) from where "
                f"hitch_to_axle = {self.vehicle.hitch_to_axle:g} m puts it, expected at most {TOLERANCE:g} m"
            )
            raise Refusal("E_HITCH", text + self._other_reference(recorded, at))
        return hitch_angles(at[:, 2] - recorded.poses[:, 2]), self._length_notes(recorded, at)

    def _other_reference(self, recorded: RecordedPoses, at: Array) -> str:
        """Advice for an error: the --reference that would put the trailer's axle where it is; empty where none does."""
        taken = reference_offset(self.vehicle, self.options)
        for name, ahead in references(self.vehicle).items():
            moved = at_rear_axle(recorded.poses, ahead - taken)
            if np.median(hitch_misfit(moved, at, self.vehicle)) <= TOLERANCE:
                return f"; try --reference {name}"
        return ""

    def _length_notes(self, recorded: RecordedPoses, at: Array) -> list[str]:
        """Notes where the paths suggest another length of the trailer."""
        if self.vehicle.hitch_offset != 0.0:
            return []
        found = float(np.median(np.hypot(*(recorded.poses[:, :2] - at[:, :2]).T)))
        if abs(found - self.vehicle.hitch_to_axle) <= _NOTED_LENGTH:
            return []
        length = f"hitch_to_axle is {self.vehicle.hitch_to_axle:g} m"
        return [f"the trailer's path lies {found:.2f} m behind the truck's, and {length}: is that right?"]

    def _of_path(self, note: str) -> str:
        """A note about a path, its topic named where it speaks of `it`: it stands beside notes about other things."""
        return f"path {printable(self.truck.name, 60)!r}: {note}" if note.startswith(("it ", "its ")) else note

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
