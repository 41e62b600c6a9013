"""`replay vehicle`: what it prints is a vehicle file, and says what each line of it is."""

import dataclasses
import json
import pathlib
import tomllib

import logs_maker as make
import pytest

import replay.cli
from optim.model.vehicle import Vehicle
from replay.base.errors import UsageError
from replay.run.vehicle_file import read_vehicle

OWN = Vehicle(wheelbase=3.8, hitch_to_axle=7.7, trailer_rear=11.123456789012345, max_steer_rate=0.45)


@pytest.fixture
def log(tmp_path: pathlib.Path) -> pathlib.Path:
    return make.LogMaker().vehicle(OWN).write(tmp_path / "own.mcap")


def printed(capsys: pytest.CaptureFixture[str], *arguments: str | pathlib.Path) -> tuple[str, str]:
    assert replay.cli.main(["vehicle", *map(str, arguments)]) == 0
    said = capsys.readouterr()
    return said.out, said.err


def test_the_default_vehicle_is_printed_with_the_meaning_of_each_line(capsys: pytest.CaptureFixture[str]) -> None:
    out, err = printed(capsys)
    assert tomllib.loads(out) == dataclasses.asdict(Vehicle())
    assert err == ""
    for line, field in zip(out.splitlines()[1:], dataclasses.fields(Vehicle), strict=True):
        value, _, meaning = line.partition("#")
        assert value.startswith(f"{field.name} = ")
        assert "[m]" in meaning or "[rad" in meaning
        assert meaning.endswith(f"Default {field.default:g}.")


def test_the_vehicle_of_a_log_is_read_back_from_what_is_printed(
    log: pathlib.Path, tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = tmp_path / "truck.toml"
    file.write_text(printed(capsys, log)[0])
    assert read_vehicle(file) == OWN
    assert read_vehicle(file) == Vehicle(**tomllib.loads(printed(capsys, "--vehicle", file)[0]))


def test_a_log_that_names_no_vehicle_has_the_default_one_with_a_note(
    tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    out, err = printed(capsys, make.LogMaker().write(tmp_path / "none.mcap"))
    assert tomllib.loads(out) == dataclasses.asdict(Vehicle())
    assert "names no vehicle" in err


def test_as_json_it_is_one_document(log: pathlib.Path, capsys: pytest.CaptureFixture[str]) -> None:
    document = json.loads(printed(capsys, log, "--json")[0])
    assert (document["schema"], document["source"]) == ("replay.vehicle/1", str(log))
    assert document["vehicle"] == dataclasses.asdict(OWN)
    assert {key["name"]: key["unit"] for key in document["keys"]}["max_steer_rate"] == "rad/m"


@pytest.mark.parametrize(("text", "words"), [('"3.8"', "expected a number"), ("3800", "millimetres?")])
def test_a_vehicle_of_a_log_that_cannot_be_used_is_an_error(
    text: str, words: str, tmp_path: pathlib.Path, capsys: pytest.CaptureFixture[str]
) -> None:
    file = make.LogMaker().vehicle(wheelbase=text).write(tmp_path / "bad.mcap")
    assert replay.cli.main(["vehicle", str(file)]) == 2
    assert words in capsys.readouterr().err
    assert replay.cli.main(["vehicle", str(file), "--vehicle", "truck.toml"]) == 2
    assert "both are given" in capsys.readouterr().err


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("max_steer = 35", "expected a number from 0.01 to 1.5 rad; is it in degrees?"),
        ("max_hitch = 60", "rad; is it in degrees?"),
        ("wheelbase = 3600", "expected a number from 0.05 to 100 m; is it in millimetres?"),
        ("wheelbase = -1", "expected a number from 0.05 to 100 m"),
        ("[vehicle]\nwheelbase = 3.6", "keys stand outside of tables"),
    ],
)
def test_a_value_in_another_unit_and_a_table_are_asked_about(tmp_path: pathlib.Path, text: str, words: str) -> None:
    (tmp_path / "truck.toml").write_text(text)
    with pytest.raises(UsageError) as caught:
        read_vehicle(tmp_path / "truck.toml")
    assert words in str(caught.value)
