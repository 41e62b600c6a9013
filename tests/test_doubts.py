"""What is asked where a log is read otherwise than it was meant: reference point, sign and unit of angles, lengths."""

from collections.abc import Callable

import logs_maker as make
import numpy as np
import pytest

from optim.methods import METHODS
from optim.model.vehicle import Vehicle
from replay.base.errors import LogError
from replay.run.case import Case

Read = Callable[..., list[Case]]
Refusal = Callable[..., LogError]
TRUCK, AXLE = make.drive()
ALPHA = AXLE[:, 2] - TRUCK[:, 2]


def ahead(distance: float) -> np.ndarray:
    """The truck's path as of a point ahead of its rear axle."""
    moved = TRUCK.copy()
    moved[:, :2] += distance * np.stack([np.cos(TRUCK[:, 2]), np.sin(TRUCK[:, 2])], axis=1)
    return moved


def with_joint(angles: np.ndarray) -> make.LogMaker:
    maker = make.log_of(TRUCK)
    for number, angle in enumerate(angles):
        maker.add("/joints", make.joints({"trailer_hitch": float(angle)}, number), 3)
    return maker


@pytest.mark.parametrize(("reference", "distance"), [("front-axle", 3.6), ("centre", 2.0)])
def test_poses_of_another_point_are_met_with_the_option_that_says_so(
    refusal: Refusal, reference: str, distance: float
) -> None:
    log = make.log_of(ahead(distance), AXLE)
    for options in ({}, {"path_topic": "/truck", "trailer_topic": "/trailer"}):
        assert refusal(log, **options).message.endswith(f"try --reference {reference}")
    both = refusal(make.log_of(TRUCK, AXLE), reference="front-axle").message
    assert both.endswith("try --reference rear-axle")


def test_angles_of_a_joint_in_degrees_are_told_as_they_are(read: Read) -> None:
    (case,) = read(with_joint(np.degrees(ALPHA)))
    (note,) = [note for note in case.read.notes if "not taken from" in note]
    largest = np.degrees(ALPHA)[np.argmax(np.abs(ALPHA))]
    assert note.endswith(
        f"'trailer_hitch': it holds an angle of {largest:.1f} rad, expected below 1.57: is it in degrees?"
    )
    (case,) = read(with_joint(ALPHA))
    assert case.read.hitch == "joint"


def test_a_path_that_no_truck_drives_with_a_joints_angles_asks_for_their_sign(refusal: Refusal) -> None:
    s = np.arange(0.0, 30.0, 0.25)
    states = make.roll_out(Vehicle(), np.array([20.0, 15.0, 0.0, 0.4]), s, 0.3 * np.sin(s / 3.0), 1)
    maker = make.log_of(states[:, :3])
    for number, angle in enumerate(-states[:, 3]):
        maker.add("/joints", make.joints({"trailer_hitch": float(angle)}, number), 3)
    text = refusal(maker, unknown="free").message
    assert text.endswith("is the sign of joint 'trailer_hitch' right, the trailer's heading minus the truck's?")


def test_a_lone_path_that_is_named_after_the_trailer_is_asked_about(read: Read) -> None:
    maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()), 1).add("/trailer_path", make.path(TRUCK), 2)
    asked = "the only path, '/trailer_path', is taken as the truck's, and its name says trailer: is that right?"
    assert asked in read(maker)[0].read.notes
    assert asked not in read(maker, path_topic="/trailer_path")[0].read.notes


def test_a_trailer_that_is_longer_than_the_vehicle_says_is_asked_about(read: Read) -> None:
    truck, axle = make.drive(Vehicle(hitch_to_axle=8.15))
    (case,) = read(make.log_of(truck, axle))
    assert (
        "the trailer's path lies 8.15 m behind the truck's, and hitch_to_axle is 8 m: is that right?" in case.read.notes
    )
    (case,) = read(make.log_of(TRUCK, AXLE))
    assert not case.read.notes


def test_methods_that_need_the_hitch_over_the_axle_say_so(read: Read) -> None:
    (case,) = read(make.log_of(TRUCK), vehicle=Vehicle(hitch_offset=0.3))
    (note,) = [note for note in case.read.notes if note.startswith("hitch_offset is 0.3 m: ")]
    failing, _, others = note.partition(" need 0 and will fail; ")
    for name, method in METHODS.items():
        assert (name in failing, name in others) == ((True, False) if name in ("shortcut", "cpo") else (False, True))
        if name in failing:
            result = method.solve(case.problem)
            assert result.stop.value == "failed"
            assert result.reason.startswith("hitch_offset is 0.3 m; this method needs")


@pytest.mark.parametrize("step", [1, 2], ids=["as many poses", "half as many"])
def test_a_hitch_behind_the_axle_fits_its_trailer_path(read: Read, step: int) -> None:
    vehicle = Vehicle(hitch_offset=0.6)
    truck, axle = make.drive(vehicle)
    maker = make.log_of(make.path(truck), make.path(axle[::step]))
    (case,) = read(maker, vehicle=vehicle)
    assert case.read.hitch == "trailer path"
    assert case.read.max_deviation_m < 0.02


def test_frames_that_move_are_refused_with_how_far(refusal: Refusal) -> None:
    maker = make.log_of(make.path(TRUCK, "odom"))
    for number, shift in enumerate((0.0, 0.05, 0.02)):
        maker.add("/tf", make.transforms(make.transform("map", "odom", (shift, 0.0, 0.1 * shift), number)), 3)
    text = refusal(maker).message
    assert "they move against each other, by up to 0.05 m and 0.29 degrees" in text
