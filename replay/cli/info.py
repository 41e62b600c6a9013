"""`replay info`: what was understood of a log."""

import dataclasses
import math
import pathlib
from collections.abc import Sequence
from typing import Annotated, Any

from cyclopts import Parameter

from replay.base.errors import ReplayError, printable
from replay.cli.console import Common, Voice
from replay.cli.options import options_of
from replay.cli.reading import Reading, read_options
from replay.cli.tables import channels_table, facts_table, gear_changes
from replay.cli.usage import ExitStatus, reflowed
from replay.logs import ReadOptions
from replay.logs.container.folder import open_log
from replay.logs.container.log import Log
from replay.logs.meaning.assemble import cases_of
from replay.logs.meaning.topics import Topic, is_wanted, topics_of
from replay.logs.meaning.understood import uses
from replay.run.case import Case
from replay.run.limits import LIMITS
from replay.run.plain import scene_to_document
from replay.run.reading import guarded

_HITCH = {
    "trailer path": "from the trailer's path",
    "joint": "from a joint's state",
    "transform": "from a transform",
    "reconstructed": "reconstructed by integration",
}


@reflowed
def info(
    logs: list[pathlib.Path],
    /,
    *,
    common: Annotated[Common | None, Parameter(name="*")] = None,
    reading: Annotated[Reading | None, Parameter(name="*")] = None,
) -> int:
    """Show what was understood of logs: channels, map, path, vehicle, notes.

    Parameters
    ----------
    logs
        MCAP files, or folders that rosbag2 recorded.
    """
    voice = Voice(common or Common())
    options = read_options(reading)
    documents = [_describe(voice, log, options) for log in logs]
    errors = [document["error"] is not None for document in documents]
    if all(errors):
        status = ExitStatus.USAGE
    elif any(errors) or any(document["lost"] for document in documents):
        status = ExitStatus.PARTIAL
    else:
        status = ExitStatus.OK
    voice.document({"schema": "replay.info/1", "exit_status": int(status), "logs": documents})
    return status


def _describe(voice: Voice, path: pathlib.Path, options: ReadOptions) -> dict[str, Any]:
    """Show what can be read of one log, and return the same as plain data."""
    document: dict[str, Any] = {"log": str(path), "error": None, "lost": False, "channels": [], "cases": []}
    try:
        seen = guarded(path, _look, path, options, memory_mib=LIMITS.memory_mib)
    except ReplayError as error:
        seen = _Seen(error=error)
    if seen.sha256:
        document |= {"sha256": seen.sha256, "lost": seen.lost, "channels": seen.channels}
        voice.show(f"{printable(path)}: {seen.size} bytes, sha256 {seen.sha256}", channels_table(seen.channels))
    for case in seen.cases:
        document["cases"].append(case.document)
        document["lost"] |= case.lost
        voice.show(facts_table(case.facts), "")
    if seen.error is not None:
        document["error"] = str(seen.error)
        voice.error(str(seen.error))
    return document


@dataclasses.dataclass(kw_only=True)
class _Seen:
    """What was read of a log, up to the error if there is one."""

    size: int = 0
    sha256: str = ""
    lost: bool = False
    channels: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    cases: list["_SeenCase"] = dataclasses.field(default_factory=list)
    error: ReplayError | None = None


@dataclasses.dataclass(frozen=True, kw_only=True)
class _SeenCase:
    """One parking request; its figures are measured where it is read, which spares loading the kernels twice."""

    document: dict[str, Any]
    facts: dict[str, str]
    lost: bool


def _look(path: pathlib.Path, options: ReadOptions) -> _Seen:
    """Read a log."""
    seen = _Seen()
    try:
        log = open_log(path, is_wanted)
        topics = topics_of(log)
        seen.size, seen.sha256, seen.lost, seen.channels = log.size, log.sha256, log.lost, _channels(log, topics)
        for case in cases_of(log, topics, options):
            seen.cases.append(_SeenCase(document=_case_document(case), facts=_facts(case), lost=case.read.lost))
    except ReplayError as error:
        seen.error = error
    return seen


def _channels(log: Log, topics: Sequence[Topic]) -> list[dict[str, Any]]:
    return [
        {
            "topic": channel.topic,
            "schema": channel.schema.name if channel.schema else None,
            "encoding": channel.encoding,
            "definition": channel.schema.encoding if channel.schema else None,
            "messages": log.counts.get(channel.id, 0),
            "read_as": use.role,
            "understood": use.text,
        }
        for channel, use in zip(log.channels, uses(log, topics), strict=True)
    ]


def _facts(case: Case) -> dict[str, str]:
    """A case in words."""
    problem, read = case.problem, case.read
    path, scene = problem.recorded, problem.scene
    gears = ", ".join(f"{'forward' if part.direction > 0 else 'reverse'} {part.length:.1f} m" for part in path.segments)
    hitch = _HITCH[read.hitch]
    most = f"{read.max_deviation_m * 1e3:.1f} mm and {math.degrees(read.max_deviation_rad):.2f}°"
    rms = f"{read.rms_deviation_m * 1e3:.1f} mm and {math.degrees(read.rms_deviation_rad):.2f}°"
    facts = {
        "case": case.name,
        "frame": case.frame,
        "map": f"{len(scene.polygons)} convex obstacles" + (f", {_size(case)}" if case.map else ""),
        "path": f"{read.poses} poses, {path.length:.2f} m, {gear_changes(path.num_cusps)}: {gears}",
        "start, goal": f"{_state(path.start)}; {_state(path.goal)}",
        "hitch angle": hitch,
        "deviation": f"at most {most} from the logged poses, RMS {rms}",
        "clearance": f"{problem.recorded_clearance:.3f} m; results must keep {problem.required_clearance:.3f} m",
        "vehicle": ", ".join(f"{key.name} {key.default:g} {key.unit}" for key in options_of(problem.vehicle))
        + "; `replay vehicle` says what each is",
    }
    return facts | ({"notes": "\n".join(read.notes)} if read.notes else {})


def _size(case: Case) -> str:
    assert case.map is not None, "asked for maps that are grids only"
    rows, columns = case.map.cells.shape
    return f"grid of {columns} × {rows} cells of {case.map.resolution:g} m"


def _state(state: Any) -> str:
    x, y, theta, alpha = state
    theta = math.remainder(theta, 2.0 * math.pi)  # it is counted on over whole turns
    return f"({x:z.2f} m, {y:z.2f} m, {math.degrees(theta):z.1f}°, hitch {math.degrees(alpha):z.1f}°)"


def _case_document(case: Case) -> dict[str, Any]:
    """A case as plain data, SI units."""
    problem = case.problem
    path = problem.recorded
    grid = case.map
    return {
        "case": case.name,
        "frame": case.frame,
        "read": dataclasses.asdict(case.read),
        "vehicle": dataclasses.asdict(problem.vehicle),
        "map": {
            "polygons": len(problem.scene.polygons),
            "boundary": scene_to_document(problem.scene)["boundary"],
            "cells": None if grid is None else list(grid.cells.shape),
            "resolution": None if grid is None else grid.resolution,
        },
        "path": {
            "length": path.length,
            "cusps": path.num_cusps,
            "segments": [{"direction": part.direction, "length": part.length} for part in path.segments],
            "start": list(map(float, path.start)),
            "goal": list(map(float, path.goal)),
            "min_clearance": problem.recorded_clearance,
        },
        "required_clearance": problem.required_clearance,
        "num_nodes": None if problem.nodes is None else len(problem.nodes),
    }
