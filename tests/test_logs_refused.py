"""Logs that cannot be used, or leave a choice: which words they are refused with."""

import dataclasses
import json
from collections.abc import Callable
from typing import Any

import logs_maker as make
import numpy as np
import pytest

from optim.model.kinematics import roll_out
from optim.model.vehicle import Vehicle
from replay.base.errors import LogError
from replay.logs import ReadOptions
from replay.run.case import Case

Read = Callable[..., list[Case]]
TRUCK, AXLE = make.drive()


# ---- which topics


def test_what_is_missing_is_named_with_what_there_is(refusal: Callable[..., LogError]) -> None:
    error = refusal(make.LogMaker().add("/truck", make.path(TRUCK)).add_raw("/evil\x1b[2J", "a/msg/B", b"x"))
    assert error.code == "E_NO_MAP"
    assert "nav_msgs/msg/OccupancyGrid" in str(error)
    assert r"/evil\x1b[2J (a/msg/B)" in str(error)
    error = refusal(make.LogMaker().add("/map", make.grid(make.yard())))
    assert error.code == "E_NO_PATH"
    assert "/map (nav_msgs/msg/OccupancyGrid)" in str(error)


def test_two_maps_ask_for_a_choice(read: Read, refusal: Callable[..., LogError]) -> None:
    walls = make.markers(make.marker(1, (1.0, 1.0, 1.0), (5.0, 5.0, 0.0), z=0.5))
    maker = make.sound_log().add("/costmap", make.grid(make.yard())).add("/walls", walls)
    error = refusal(maker)
    assert error.code == "E_AMBIGUOUS"
    assert "--map-topic" in str(error)
    assert "/map (nav_msgs/msg/OccupancyGrid, 1 message)" in str(error)
    assert read(maker, map_topic="/walls")[0].map is None
    error = refusal(maker, map_topic="/nothing")
    assert (error.code, "/costmap" in str(error)) == ("E_NO_TOPIC", True)


def test_paths_that_do_not_belong_together_ask_for_a_choice(read: Read, refusal: Callable[..., LogError]) -> None:
    maker = make.log_of(TRUCK, make.shifted(AXLE, -3.0))
    error = refusal(maker)
    assert error.code == "E_AMBIGUOUS"
    for part in ("--path-topic", "--trailer-topic", "/truck", "/trailer", "3.00 m"):
        assert part in str(error)
    error = refusal(maker, path_topic="/truck", trailer_topic="/trailer")
    assert error.code == "E_HITCH"
    assert read(maker, path_topic="/truck")[0].read.hitch == "reconstructed"
    copy = make.log_of(TRUCK, AXLE).add("/again", make.path(TRUCK), 2)
    assert refusal(copy).code == "E_AMBIGUOUS"
    assert read(copy, path_topic="/truck")[0].read.hitch == "trailer path"


def test_messages_in_another_encoding_or_layout_are_refused_by_name(refusal: Callable[..., LogError]) -> None:
    sound = make.sound_log(trailer=False)
    name, kind, _, _, definition, data, time = sound.messages.pop()
    for change, code in (
        ({"encoding": "json"}, "E_ENCODING"),
        ({"schema_encoding": "omgidl"}, "E_ENCODING"),
        ({"schema_encoding": "ros2idl"}, "E_SCHEMA"),
        ({"definition": definition.replace(b"float64 w", b"float32 w")}, "E_SCHEMA"),
        ({"definition": b""}, "E_SCHEMA"),
    ):
        maker = make.LogMaker(messages=list(sound.messages))
        settings = {"definition": definition} | change
        error = refusal(maker.add_raw(name, kind, data, time, **settings))  # type: ignore[arg-type]
        assert error.code == code
        assert "'/truck'" in str(error)


# ---- the vehicle


def test_the_vehicle_of_the_log_is_used_and_the_option_comes_before_it(read: Read) -> None:
    maker = make.sound_log(trailer=False)
    maker.metadata = [("vehicle", {"wheelbase": "3.9", "hitch_to_axle": "7.5", "colour": '"red"'})]
    (case,) = read(maker)
    assert case.problem.vehicle == dataclasses.replace(Vehicle(), wheelbase=3.9, hitch_to_axle=7.5)
    assert any("unknown keys are ignored (colour)" in note for note in case.read.notes)
    assert any("lacks max_hitch, max_steer" in note for note in case.read.notes)
    (case,) = read(maker, vehicle=Vehicle(wheelbase=4.0))
    assert case.problem.vehicle.wheelbase == 4.0
    maker.metadata = []
    (case,) = read(maker)
    assert any("the default truck is used" in note for note in case.read.notes)


@pytest.mark.parametrize(
    ("values", "says"),
    [
        ({"wheelbase": "3.6"}, "lacks hitch_to_axle"),
        ({"wheelbase": "NaN", "hitch_to_axle": "8"}, "'NaN', expected a number"),
        ({"wheelbase": '"3.6"', "hitch_to_axle": "8"}, "expected a number"),
        ({"wheelbase": "[" * 60, "hitch_to_axle": "8"}, "expected a number"),
        ({"wheelbase": "true", "hitch_to_axle": "8"}, "expected a number"),
        ({"wheelbase": "-3.6", "hitch_to_axle": "8"}, "wheelbase is -3.6"),
        ({"wheelbase": "3.6", "hitch_to_axle": "8000"}, "hitch_to_axle is 8000"),
        ({"wheelbase": "3.6", "hitch_to_axle": "8", "max_steer": "35"}, "max_steer is 35"),
    ],
)
def test_a_vehicle_that_cannot_be_is_refused(
    refusal: Callable[..., LogError], values: dict[str, str], says: str
) -> None:
    maker = make.sound_log()
    maker.metadata = [("vehicle", values)]
    error = refusal(maker)
    assert error.code == "E_VEHICLE"
    assert says in str(error)


@pytest.mark.parametrize(
    "values",
    [
        {"trailer_rear": "8.0"},  # the axle at the very end
        {"hitch_to_axle": "12.036", "trailer_rear": "12"},  # or a little beyond
        {"truck_front": "3.6", "truck_rear": "0"},
        {"max_steer_rate": "10"},  # that steers while it hardly moves
        {"max_steer_rate": "0.01"},
        {"hitch_offset": "-0.4"},
    ],
)
def test_a_vehicle_that_is_odd_but_possible_is_used(read: Read, values: dict[str, str]) -> None:
    maker = make.sound_log(trailer=False)
    maker.metadata = []
    (case,) = read(maker.vehicle(None, **values))
    found = dataclasses.asdict(case.problem.vehicle)
    assert {name: found[name] for name in values} == {name: float(text) for name, text in values.items()}


def test_a_body_whose_length_the_log_does_not_give_reaches_its_axle(read: Read) -> None:
    maker = make.sound_log(trailer=False)
    maker.metadata = [("vehicle", {"wheelbase": "5.6", "hitch_to_axle": "12.036"})]
    (case,) = read(maker)
    assert (case.problem.vehicle.truck_front, case.problem.vehicle.trailer_rear) == (5.6, 12.036)
    assert any("trailer_rear is taken to be hitch_to_axle, 12.036 m" in note for note in case.read.notes)
    maker.metadata = [("vehicle", {"wheelbase": "3.6", "hitch_to_axle": "11"})]
    (case,) = read(maker)
    assert (case.problem.vehicle.truck_front, case.problem.vehicle.trailer_rear) == (5.0, 12.0)


@pytest.mark.parametrize("text", ["", "7", "[1, 2.5]", "[true]", "[1, 900]", "[-1]", "[" * 5000, json.dumps(["1"])])
def test_node_indices_that_are_none_are_refused(refusal: Callable[..., LogError], text: str) -> None:
    assert refusal(make.sound_log().nodes(text)).code == "E_PATH_NODES"


# ---- what is refused


def _edited(rows: slice | int, column: int, change: Callable[[np.ndarray], Any]) -> np.ndarray:
    poses = TRUCK.copy()
    poses[rows, column] = change(poses[rows, column])
    return poses


@pytest.mark.parametrize(
    ("poses", "code", "says"),
    [
        (_edited(17, 0, lambda _: np.nan), "E_NONFINITE", "pose 17: position.x is nan"),
        (_edited(17, 1, lambda _: np.inf), "E_NONFINITE", "pose 17: position.y is inf"),
        (_edited(17, 0, lambda _: 1e308), "E_RANGE", "pose 17 is at"),
        (_edited(slice(None), 0, lambda x: 1000.0 * x), "E_RANGE", "are these metres?"),
        (_edited(slice(30, None), 1, lambda y: y + 5.0), "E_PATH_DISCONTINUOUS", "from pose 29 at"),
        (_edited(slice(None), 2, lambda a: a + np.pi / 2.0), "E_KINEMATICS", "90 degrees off"),
        (_edited(slice(None), 2, lambda a: np.degrees(a) * 7.0), "E_PATH_HEADING", "are they in radians"),
        (TRUCK[:0], "E_PATH_EMPTY", "no poses"),
        (TRUCK[:1], "E_PATH_SHORT", "one pose"),
        (TRUCK[[0, 0, 0]], "E_PATH_ZERO_LENGTH", "all at (20.00, 18.00)"),
        (make.shifted(TRUCK, 100.0), "E_OUTSIDE_MAP", "outside the map at (120.00, 18.00)"),
        (
            make.shifted(TRUCK, 0.0, -16.0),
            "E_START_COLLISION",
            "first pose (20.00, 2.00) m the trailer overlaps obstacle",
        ),
    ],
)
def test_paths_that_cannot_be_used_are_refused_with_the_place(
    refusal: Callable[..., LogError], poses: np.ndarray, code: str, says: str
) -> None:
    error = refusal(make.log_of(poses))
    assert error.code == code
    assert says in str(error)
    assert "path topic '/truck', message 0: " in str(error)


@pytest.mark.parametrize(
    ("quaternion", "says"),
    [((0.0, 0.0, 0.0, 0.0), "norm 0"), ((0.0, 0.0, 0.0, 2.0), "norm 2"), ((0.26, 0.0, 0.0, 0.9656), "tilted by 30")],
)
def test_poses_that_are_not_in_the_plane_are_refused(
    refusal: Callable[..., LogError], quaternion: tuple[float, ...], says: str
) -> None:
    message = make.path(TRUCK)
    message.poses[5].pose = make.pose(*TRUCK[5], quaternion=quaternion)
    error = refusal(make.log_of(message))
    assert (error.code, "pose 5" in str(error), says in str(error)) == ("E_QUATERNION", True, True)


def test_quaternions_are_normalised_with_a_note_from_a_millionth_on(read: Read) -> None:
    for off, noted in ((1e-7, False), (1e-4, True)):
        message = make.path(TRUCK)
        for stamped in message.poses:
            stamped.pose.orientation.z *= 1.0 + off
            stamped.pose.orientation.w *= 1.0 + off
        (case,) = read(make.log_of(message))
        assert any("normalised" in note for note in case.read.notes) == noted


def test_stamps_that_run_backwards_are_refused(refusal: Callable[..., LogError]) -> None:
    error = refusal(make.log_of(make.path(TRUCK, stamps=list(range(len(TRUCK), 0, -1)))))
    assert (error.code, "pose 1 is earlier" in str(error)) == ("E_TIME_ORDER", True)


def test_frames_must_agree(read: Read, refusal: Callable[..., LogError]) -> None:
    error = refusal(make.log_of(make.path(TRUCK, frame="odom")))
    assert (error.code, "'odom'" in str(error), "'map'" in str(error)) == ("E_FRAME", True, True)
    assert refusal(make.log_of(make.path(TRUCK, frame=""), frame="")).code == "E_FRAME"
    assert read(make.log_of(make.path(TRUCK, frame="/map")))[0].frame == "map"


@pytest.mark.parametrize(
    ("changes", "code"),
    [
        ({"resolution": 0.0}, "E_GRID_RESOLUTION"),
        ({"resolution": 20.0}, "E_GRID_RESOLUTION"),
        ({"resolution": float("nan")}, "E_GRID_RESOLUTION"),
        ({"width": 299}, "E_GRID_SIZE"),
        ({"width": 0}, "E_GRID_EMPTY"),
        ({"width": 2**32 - 1, "height": 2**32 - 1}, "E_GRID_LIMIT"),
        ({"origin": make.pose(np.nan, 0.0, 0.0)}, "E_NONFINITE"),
    ],
)
def test_grids_that_cannot_be_are_refused(refusal: Callable[..., LogError], changes: dict[str, Any], code: str) -> None:
    message = make.grid(make.yard())
    for name, value in changes.items():
        setattr(message.info, name, value)
    error = refusal(make.LogMaker().add("/map", message).add("/truck", make.path(TRUCK)))
    assert error.code == code
    assert "grid topic '/map', message 0: " in str(error)


def test_cells_out_of_range_are_named(refusal: Callable[..., LogError]) -> None:
    cells = make.yard()
    cells[3, 7] = 101
    error = refusal(make.log_of(TRUCK, cells=cells))
    assert (error.code, "cell (7, 3) has the value 101" in str(error)) == ("E_GRID_VALUE", True)


def test_a_goal_inside_an_obstacle_is_refused_and_a_collision_on_the_way_is_told(
    read: Read, refusal: Callable[..., LogError]
) -> None:
    straight = np.linspace([15.0, 20.0, 0.0], [45.0, 20.0, 0.0], 61)
    cells = make.yard()
    cells[104, 125] = 100  # at (25.1, 20.9) m, in the lane
    error = refusal(make.log_of(straight[:16], cells=cells))
    assert error.code == "E_GOAL_COLLISION"
    assert "at its last pose (22.50, 20.00) m the truck overlaps obstacle" in str(error)
    (case,) = read(make.log_of(straight, cells=cells))
    (note,) = case.read.notes
    assert "overlaps obstacles on 57 % of its way" in note
    assert "by 0.475 m (at " in note


def test_limits_that_the_recorded_path_exceeds_are_told_with_the_place(read: Read) -> None:
    tight = Vehicle(max_steer=0.1, max_steer_rate=0.01)
    (case,) = read(make.sound_log(trailer=False), vehicle=tight)
    assert any("the steering angle reaches 0.2" in note and "pose" in note for note in case.read.notes)
    assert any("the steering rate reaches" in note for note in case.read.notes)


def test_a_path_that_no_truck_can_drive_is_told_by_its_deviation(read: Read) -> None:
    corner = np.concatenate(
        [np.linspace([20.0, 18.0, 0.0], [30.0, 18.0, 0.0], 21), np.linspace([30.5, 18.5, 0.7], [36.0, 24.0, 0.7], 12)]
    )
    (case,) = read(make.log_of(corner))
    assert case.read.max_deviation_m > 0.05
    assert any("the drivable path differs from the log" in note for note in case.read.notes)


# ---- options


@pytest.mark.parametrize(
    "wrong",
    [
        {"occupied_from": 0},
        {"initial_hitch": 2.0},
        {"margin": -1.0},
        {"height": 0.0},
        {"unknown": "maybe"},
        {"start_direction": 2},
        {"case": -1},
        {"reference": "hitch"},
        {"reference_offset": 31.0},
    ],
)
def test_options_out_of_range_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValueError, match=next(iter(wrong))):
        ReadOptions(**wrong)


def test_a_recorded_roll_out_is_found_again(read: Read) -> None:
    s = np.arange(0.0, 15.0 + 1e-9, 0.25)
    phi = 0.3 * np.sin(np.pi * s / 15.0)
    states = roll_out(Vehicle(), np.array([25.0, 15.0, 0.0, 0.0]), s, phi, 1)
    (case,) = read(make.log_of(states[:, :3]))
    samples = case.problem.recorded.samples
    assert np.abs(np.interp(s, samples.s, samples.phi) - phi).max() < 0.01


def test_a_recorded_path_nearer_to_an_obstacle_than_the_margin_is_told_with_place_and_amount(read: Read) -> None:
    straight = np.linspace([15.0, 20.0, 0.0], [45.0, 20.0, 0.0], 61)
    cells = make.yard()
    cells[107, 150] = 100  # from 21.4 m up, beside the side of the bodies at 21.275 m
    (case,) = read(make.log_of(straight, cells=cells), margin=0.5)
    (note,) = case.read.notes
    assert "comes within 0.125 m of an obstacle, the margin is 0.5 m (at " in note
    assert case.problem.required_clearance == pytest.approx(0.125, abs=1e-5)
