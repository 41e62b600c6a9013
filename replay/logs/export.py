"""Runs written back into a copy of their log, a file or a folder of rosbag2's, for Foxglove and ROS tools.

For each method two topics with one `nav_msgs/msg/Path` for each request, `/replay/<method>/path` of the truck's rear
axle and `/replay/<method>/trailer_path` of the trailer's axle, in the frame and at the log time of the recorded path.
A method that kept the recorded path has that one; a method that failed has none. The metadata record `replay` holds
the status of each method.
"""

import json
import math
import os
import pathlib
import re
import struct
from collections.abc import Sequence
from typing import Final

import numpy as np

from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array
from replay.base.errors import LogError
from replay.base.files import atomic_write
from replay.logs.container.append import NewTopic, append
from replay.logs.container.bag import write_bag
from replay.logs.container.folder import open_log
from replay.logs.container.scan import scan
from replay.logs.meaning.topics import EXPORTED
from replay.logs.messages.ros2_definitions import PATH as DEFINITION
from replay.run.outcome import MethodRun, Run

PATH: Final = "nav_msgs/msg/Path"
_SECOND: Final = 1_000_000_000


def write_export(runs: Sequence[Run], path: str | os.PathLike[str]) -> None:
    """Write the runs of one log into a copy of it.

    A file is written under a temporary name and read back before it gets its name. Raises LogError (E_EXPORT) where
    the log has changed since, or part of it is lost; ReplayError (E_WRITE) where a file cannot be written.
    """
    case = runs[0].case
    log = open_log(case.log, lambda _: False)
    if log.sha256 != case.sha256:
        raise LogError("E_EXPORT", case.log, "it has changed since it was read")
    outcome = {run.case.name: {method.name: method.status for method in run.methods} for run in runs}
    topics, metadata = _topics(runs), {"replay": {"paths": json.dumps(outcome)}}
    if case.log.is_dir():
        write_bag(log, pathlib.Path(path), topics, metadata)
        return
    with atomic_write(path) as temporary:
        with temporary.open("wb") as file:
            append(log, file, topics, metadata)
        copy = scan(temporary, lambda _: False)
        wrong = [finding.text for finding in copy.findings if finding not in log.findings]
        if wrong or sum(copy.counts.values()) != sum(log.counts.values()) + sum(len(t.messages) for t in topics):
            reason = wrong[0] if wrong else "messages are missing"
            raise LogError("E_EXPORT", case.log, f"its copy cannot be read back: {reason}")


def topic_names(methods: Sequence[str]) -> dict[str, str]:
    """Topic prefix of each method's paths, as ROS names allow: A+B becomes A_B."""
    names: dict[str, str] = {}
    for method in methods:
        name = re.sub(r"_+", "_", re.sub(r"[^A-Za-z0-9]", "_", method)).strip("_") or "method"
        while f"{EXPORTED}{name}" in names.values():
            name += "x"
        names[method] = f"{EXPORTED}{name}"
    return names


def _topics(runs: Sequence[Run]) -> list[NewTopic]:
    methods = list(dict.fromkeys(method.name for run in runs for method in run.methods))
    found = []
    for method, topic in topic_names(methods).items():
        paths = [(run, each) for run in runs for each in run.methods if each.name == method and each.status != "failed"]
        for k, name in enumerate(("path", "trailer_path")):
            messages = [_message(run, each, body=k) for run, each in paths]
            if messages:
                found.append(NewTopic(topic=f"{topic}/{name}", schema=PATH, definition=DEFINITION, messages=messages))
    return found


def _message(run: Run, method: MethodRun, body: int) -> tuple[int, bytes]:
    """Log time and payload of a path: of the truck (`body` 0) or of the trailer (1)."""
    case = run.case
    poses = axle_poses(case.problem.vehicle, method.path.samples.states)[:, body]
    return case.time_ns, path_message(poses, case.frame, case.time_ns)


def axle_poses(vehicle: Vehicle, states: Array) -> Array:
    """(x, y, heading) of the truck's rear axle and of the trailer's axle for states (N, 4), repeated ones left out.

    Shape (M, 2, 3).
    """
    x, y, theta, alpha = states.T
    heading = theta + alpha
    axle = np.stack([x, y], axis=1) - vehicle.hitch_offset * np.stack([np.cos(theta), np.sin(theta)], axis=1)
    axle = axle - vehicle.hitch_to_axle * np.stack([np.cos(heading), np.sin(heading)], axis=1)
    truck, trailer = np.stack([x, y, theta], axis=1), np.column_stack([axle, heading])
    poses = np.stack([truck, trailer], axis=1)
    new = np.ones(len(poses), bool)
    new[1:] = np.any(poses[1:] != poses[:-1], axis=(1, 2))  # at a gear change, two segments share a pose
    return poses[new]


def path_message(poses: Array, frame: str, time_ns: int) -> bytes:
    """A `nav_msgs/msg/Path` of poses (N, 3) in CDR, little-endian; every stamp is `time_ns`."""
    stamp = struct.pack("<iI", *divmod(time_ns, _SECOND)) if time_ns < _SECOND << 31 else bytes(8)
    name = frame.encode("utf-8") + b"\0"
    header = stamp + struct.pack("<I", len(name)) + name
    content = bytearray(header)
    _align(content, 4)
    content += struct.pack("<I", len(poses))
    for x, y, heading in poses.tolist():
        _align(content, 4)
        content += header
        _align(content, 8)
        content += struct.pack("<7d", x, y, 0.0, 0.0, 0.0, math.sin(heading / 2), math.cos(heading / 2))
    return b"\0\1\0\0" + bytes(content)


def _align(content: bytearray, size: int) -> None:
    content += bytes(-len(content) % size)
