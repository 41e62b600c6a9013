"""The vehicle of a log's JSON message, as the check against a manifest of bad logs puts it into `replay`'s terms."""

import json
import pathlib
from collections.abc import Callable

import logs_maker as make
import pytest

from optim.model.vehicle import Vehicle
from replay.base.errors import LogError
from replay.run.case import Case
from tools.attacks.bad_logs_vehicle import vehicle_message, with_vehicle

VEHICLE = Vehicle()
TRACTOR = {
    "wheelbase_m": VEHICLE.wheelbase,
    "front_overhang_m": VEHICLE.truck_front - VEHICLE.wheelbase,
    "rear_overhang_m": VEHICLE.truck_rear,
    "width_m": 2.5,
    "max_steer_rad": VEHICLE.max_steer,
}
TRAILER = {
    "length_m": VEHICLE.hitch_to_axle,
    "front_overhang_m": VEHICLE.trailer_front,
    "rear_overhang_m": VEHICLE.trailer_rear - VEHICLE.hitch_to_axle,
    "width_m": 2.5,
    "max_hitch_rad": VEHICLE.max_hitch,
    "hitch_offset_m": VEHICLE.hitch_offset,
}
SOUND = json.dumps({"tractor": TRACTOR, "trailer": TRAILER}).encode()


def log_with(payload: bytes) -> bytes:
    truck, axle = make.drive()
    maker = make.LogMaker().add("/map", make.grid(make.yard()), 1)
    maker.add_raw("/vehicle", "vehicle", payload, 1, encoding="json", schema_encoding="jsonschema")
    return maker.add("/truck", make.path(truck), 2).add("/trailer", make.path(axle), 2).bytes()


def rewritten(payload: bytes) -> bytes:
    data = log_with(payload)
    found = vehicle_message(data)
    assert found is not None
    assert found == payload
    return with_vehicle(data, found)


def test_the_vehicle_of_a_message_is_the_one_that_is_read(tmp_path: pathlib.Path) -> None:
    cases: list[Case] = make.read_log(tmp_path / "log.mcap", rewritten(SOUND))
    vehicle = cases[0].problem.vehicle
    assert (vehicle.truck_width, vehicle.trailer_width) == (2.5, 2.5)
    assert vehicle.truck_front == pytest.approx(VEHICLE.truck_front, abs=1e-12)
    assert vehicle.trailer_rear == pytest.approx(VEHICLE.trailer_rear, abs=1e-12)


@pytest.mark.parametrize(
    ("key", "value"),
    [
        ('"wheelbase_m"', "NaN"),
        ('"width_m"', "0.0"),
        ('"length_m"', '"twelve"'),
        ('"max_hitch_rad"', "1" + "0" * 20_000),
        ('"wheelbase_m"', "[" * 5_000),
    ],
)
def test_what_is_wrong_with_a_value_is_still_wrong_with_it(
    refusal: Callable[..., LogError], key: str, value: str
) -> None:
    before, after = SOUND.decode().split(key + ": ", 1)
    rest = after[after.index(",") :]
    assert refusal(rewritten(f"{before}{key}: {value}{rest}".encode())).code == "E_VEHICLE"


def test_a_message_without_the_two_objects_is_refused_as_a_vehicle(refusal: Callable[..., LogError]) -> None:
    assert refusal(rewritten(b'{"tractor": 3}')).code == "E_VEHICLE"


def test_a_log_without_the_message_or_with_a_damaged_container_has_none() -> None:
    assert vehicle_message(make.sound_log().bytes()) is None
    assert vehicle_message(log_with(SOUND)[:200]) is None
