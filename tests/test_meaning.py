"""What a log says must be able to be meant: what cannot is named with its place, its amount and what was expected."""

from collections.abc import Callable
from typing import Any

import logs_maker as make
import numpy as np
import pytest

from replay.base.errors import LogError

TRUCK, AXLE = make.drive()


def trailer(row: int, column: int, value: float) -> make.LogMaker:
    axle = AXLE.copy()
    axle[row, column] = value
    return make.log_of(TRUCK, axle)


def grid(**info: Any) -> make.LogMaker:
    message = make.grid(make.yard())
    for name, value in info.items():
        setattr(message.info, name, value)
    return make.LogMaker().vehicle().add("/map", message, 1).add("/truck", make.path(TRUCK), 2)


def marked(message: Any) -> make.LogMaker:
    return make.LogMaker().vehicle().add("/walls", make.markers(message), 1).add("/truck", make.path(TRUCK), 2)


def turned(quaternion: tuple[float, ...]) -> make.LogMaker:
    message = make.path(TRUCK)
    message.poses[5].pose = make.pose(*TRUCK[5], quaternion=quaternion)
    return make.log_of(message)


def vehicle(**values: str) -> make.LogMaker:
    maker = make.sound_log()
    maker.metadata = []
    return maker.vehicle(None, **values)


def stamps_back(row: int) -> make.LogMaker:
    stamps = list(range(1, len(TRUCK) + 1))
    stamps[row] = 3
    return make.log_of(make.path(TRUCK, stamps=stamps))


BOX = (1.0, 1.0, 1.0)
WRONG: dict[str, tuple[Callable[[], make.LogMaker], str]] = {
    "NaN in a quaternion": (lambda: turned((0.0, 0.0, np.nan, 1.0)), "pose 5: orientation.z is nan, expected a number"),
    "infinity in the trailer's path": (
        lambda: trailer(9, 1, -np.inf),
        "path topic '/trailer', message 0: pose 9: position.y is -inf, expected a number",
    ),
    "an absurd place of the trailer": (lambda: trailer(9, 1, 1e300), "pose 9 is at (14.2782, 1e+300) m, 1e+300 m from"),
    "one stamp that goes back": (lambda: stamps_back(10), "the stamp of pose 10 is earlier than that of pose 9"),
    "a map resolution in millimetres": (lambda: grid(resolution=200.0), "resolution is 200 m, expected 0.01 to 2"),
    "a grid of no width": (lambda: grid(width=0), "the grid has 0 x 200 cells, expected at least 1 x 1"),
    "a grid with a value too few": (lambda: grid(width=301), "301 x 200 cells and 60000 values, expected one for each"),
    "a map far away": (lambda: grid(origin=make.pose(1e9, 0, 0)), "origin is (1e+09, 0) m, expected at most 1e8"),
    "a map without rotation": (
        lambda: grid(origin=make.pose(0, 0, 0, quaternion=(0, 0, 0, 0))),
        "info.origin: its quaternion has the norm 0, expected 1",
    ),
    "NaN in the size of a marker": (
        lambda: marked(make.marker(1, (1.0, np.nan, 1.0), (5, 5, 0), ns="wall", id=7)),
        "marker 'wall'/7: scale[1] is nan, expected a number up to 1e+08",
    ),
    "an absurd place of a marker": (
        lambda: marked(make.marker(1, BOX, (1e300, 5, 0))),
        "marker ''/0: pose[0] is 1e+300, expected a number up to 1e+08",
    ),
    "infinity in the points of a marker": (
        lambda: marked(make.marker(4, (0.1, 0.0, 0.0), points=[(0, 0, 0), (1, np.inf, 0)])),
        "marker ''/0: points[1, 1] is inf, expected",
    ),
    "a negative size of a marker": (
        lambda: marked(make.marker(1, (1.0, -2.0, 1.0), (5, 5, 0))),
        "marker ''/0: scale is (1, -2, 1) m, expected none below 0",
    ),
    "a vehicle in millimetres": (lambda: vehicle(wheelbase="3600"), "wheelbase is 3600.0, expected a number from"),
    "a steering limit in degrees": (lambda: vehicle(max_steer="31"), "max_steer is 31.0, expected a number from"),
    "a steering rate in degrees": (
        lambda: vehicle(max_steer_rate="28.6"),
        "max_steer_rate is 28.6 rad/m, expected at most 10 with that wheelbase; is it in degrees?",
    ),
    "a trailer's rear measured from its axle": (
        lambda: vehicle(trailer_rear="4"),
        "trailer_rear is 4.0, expected hitch_to_axle, 8.0, or more: both are measured from the hitch",
    ),
    "a truck's front measured from its front axle": (
        lambda: vehicle(truck_front="1.4"),
        "truck_front is 1.4, expected wheelbase, 3.6, or more: both are measured from the rear axle",
    ),
    "a hitch limit in degrees": (lambda: vehicle(max_hitch="57"), "max_hitch is 57.0, expected a number from"),
}


@pytest.mark.parametrize("what", WRONG)
def test_what_cannot_be_meant_is_refused_with_place_amount_and_expectation(
    refusal: Callable[..., LogError], what: str
) -> None:
    log, says = WRONG[what]
    assert says in str(refusal(log()))
