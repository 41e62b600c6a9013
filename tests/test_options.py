"""Flags and vehicle files become settings; a new method has its flags by itself."""

import dataclasses
import re
from typing import Annotated, Any, Literal

import pytest
from cyclopts import App, Parameter

from optim.model.vehicle import Vehicle
from replay.base.errors import UsageError
from replay.cli.options import flags_of, options_of, with_flags
from replay.run.vehicle_file import read_vehicle

FIELDS = [field.name for field in dataclasses.fields(Vehicle)]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Sixth:
    """A method nobody has heard of."""

    step_size: float = 0.5
    """Largest step [m]."""
    variant: Literal["plain", "fancy"] = "plain"
    """Which of the two."""
    polish: bool = True
    """Polish at the end."""

    def __post_init__(self) -> None:
        if self.step_size <= 0:
            raise ValueError(f"step_size is {self.step_size}, expected more than 0 m")


def parsed(*tokens: str) -> Any:
    """The flags of a sixth method whose instance differs from its class's defaults."""
    flags = flags_of({"sixth": Sixth(step_size=2.0)}, "Options of {name}")
    app = App(result_action="return_value")

    @app.default
    def command(*, options: Annotated[flags | None, Parameter(name="*")] = None) -> Any:  # pyright: ignore
        return options

    return app(list(tokens), exit_on_error=False, print_error=False)


def test_a_new_method_has_its_flags_without_a_line_of_command_line_code():
    assert parsed() is None
    given = parsed("--sixth.variant", "fancy", "--sixth.no-polish")
    method = with_flags(Sixth(step_size=2.0), given.sixth, "sixth")
    assert method == Sixth(step_size=2.0, variant="fancy", polish=False)


def test_an_option_knows_its_flag_unit_choices_and_meaning():
    step, variant, polish = options_of(Sixth(step_size=2.0), "sixth")
    assert (step.flag, step.unit, step.kind, step.default) == ("--sixth.step-size", "m", "float", 2.0)
    assert (variant.kind, variant.unit, variant.doc) == ("plain|fancy", "", "Which of the two.")
    assert polish.default is True


def test_a_value_out_of_range_is_a_usage_error_that_names_the_method():
    with pytest.raises(UsageError, match=r"sixth: step_size is -1\.0, expected more than 0 m"):
        with_flags(Sixth(), parsed("--sixth.step-size", "-1").sixth, "sixth")


def test_a_vehicle_file_sets_what_it_names(tmp_path):
    (tmp_path / "truck.toml").write_text("wheelbase = 3.8\nmax_steer = 1\n")
    vehicle = read_vehicle(tmp_path / "truck.toml")
    assert (vehicle.wheelbase, vehicle.max_steer, vehicle.truck_width) == (3.8, 1.0, 2.55)


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("wheel_base = 3.8", "unknown key 'wheel_base'. Did you mean 'wheelbase'?"),
        ("colour = 3.8", "unknown key 'colour'. There are: wheelbase"),
        ("wheelbase = 3800", "truck.toml: wheelbase is 3800.0, expected"),
        ("wheelbase = 'long'", "wheelbase is 'long', expected"),
        ("wheelbase = true", "wheelbase is true, expected a number"),
        ("wheelbase = ", "not TOML"),
        *((f"{name} = 1" + "0" * 400, f"{name} is a number of 401 digits") for name in FIELDS),
        *((f"{name} = 1e400", f"{name} is a number of 401 digits") for name in FIELDS),
    ],
)
def test_a_vehicle_file_with_a_mistake_is_refused_by_name(tmp_path, text, words):
    (tmp_path / "truck.toml").write_text(text)
    with pytest.raises(UsageError, match=re.escape("truck.toml")) as caught:
        read_vehicle(tmp_path / "truck.toml")
    assert words in str(caught.value)
