"""What `replay info` says of a log: every type of message that is understood, in its words."""

import json
from pathlib import Path
from typing import Any

import foxglove_maker as fox
import logs_maker as make
import numpy as np
import pytest
import stream_maker as single

import replay.cli
from replay.logs.messages import MESSAGE_TYPES

TRUCK, AXLE = make.drive()
TURN = (0.0, 0.0, 0.1)
RING = [(5.0, 5.0), (8.0, 5.0), (8.0, 8.0)]
CUBE = make.marker(1, (2.0, 4.0, 1.0), (5.0, 5.0, 0.0))
JOINT = fox.joints(trailer_hitch=0.1)
PLACED = fox.transform("truck", "trailer", TURN)
EVERY_TYPE = [
    make.grid(make.yard()),
    make.markers(CUBE),
    CUBE,
    make.polygon(RING),
    make.polygon(RING, None),
    make.path(TRUCK),
    make.pose_array(TRUCK),
    make.trajectory(TRUCK, np.zeros(len(TRUCK)), np.zeros(len(TRUCK))),
    *(one(TRUCK[0], 1, 0.0) for one in (single.odometry, single.stamped, single.with_covariance)),
    make.joints({"trailer_hitch": 0.1}),
    make.transforms(make.transform("truck", "trailer", TURN)),
    fox.grid(make.yard()),
    fox.scene(fox.entity("box", cubes=[fox.cube((5.0, 5.0, 0.0), (2.0, 2.0, 1.0))])),
    fox.poses(TRUCK),
    fox.message("PoseInFrame", timestamp=fox.time(1), frame_id="map", pose=fox.pose(*TRUCK[0])),
    PLACED,
    fox.message("FrameTransforms", transforms=[PLACED]),
    JOINT.joints[0],
    JOINT,
]


def kind_of(message: Any) -> str:
    return message.__msgtype__ if hasattr(message, "__msgtype__") else message.DESCRIPTOR.full_name


def added(maker: make.LogMaker, topic: str, message: Any, when: int) -> make.LogMaker:
    """A message of either kind, with another of the same after it."""
    add = make.LogMaker.add if hasattr(message, "__msgtype__") else fox.added
    return add(add(maker, topic, message, when), topic, message, when + 1)


def test_every_type_that_is_understood_is_tried() -> None:
    assert {kind_of(message) for message in EVERY_TYPE} == set(MESSAGE_TYPES)


@pytest.mark.parametrize("message", EVERY_TYPE, ids=kind_of)
def test_info_says_what_is_in_messages_of_every_type(
    message: Any, tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    role = MESSAGE_TYPES[kind_of(message)].role
    maker = make.LogMaker().vehicle()
    if role not in ("grid", "markers", "polygon"):
        maker.add("/map", make.grid(make.yard()), 1)
    if role != "path":
        maker.add("/truck", make.path(TRUCK), 3)
    file = added(maker, "/this", message, 2).write(tmp_path / "log.mcap")
    replay.cli.main(["info", str(file), "--json"])
    (log,) = json.loads(capsys.readouterr().out)["logs"]
    (channel,) = [channel for channel in log["channels"] if channel["topic"] == "/this"]
    assert (channel["read_as"], channel["messages"]) == (role, 2)
    assert channel["understood"][-1].isalpha()
    assert log["error"] is None, log["error"]
    assert len(log["cases"]) == 1


def test_a_heading_is_shown_within_half_a_turn(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    circle = np.linspace(0.0, 1.6 * np.pi, 200)
    poses = np.column_stack([30.0 + 10.0 * np.sin(circle), 20.0 - 10.0 * np.cos(circle), circle])
    file = make.log_of(poses).write(tmp_path / "round.mcap")
    assert replay.cli.main(["info", str(file), "--unknown", "free"]) == 0
    assert "-72.0°" in capsys.readouterr().out


def test_a_number_that_no_request_has_is_told_with_those_that_there_are(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = make.sound_log().write(tmp_path / "log.mcap")
    assert replay.cli.main(["info", str(file), "--case", "1"]) == 2
    assert "--case 1: it holds one request, number 0" in capsys.readouterr().err


def test_a_note_about_a_path_names_its_topic(tmp_path: Path, capsys: pytest.CaptureFixture[str]) -> None:
    maker = make.log_of(make.path(TRUCK, "odom"))
    file = maker.add("/tf", make.transforms(make.transform("map", "odom", (0.0, 0.0, 0.0)))).write(tmp_path / "a.mcap")
    assert replay.cli.main(["info", str(file), "--json"]) == 0
    (log,) = json.loads(capsys.readouterr().out)["logs"]
    notes = log["cases"][0]["read"]["notes"]
    assert "path '/truck': it is in frame 'odom'; a transform of the log puts it into 'map'" in notes
