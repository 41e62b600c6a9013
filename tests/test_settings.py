"""Options come from flags, a file and an earlier run, in this order; a run can be repeated exactly."""

import json
import pathlib
import shutil
from typing import Any

import pytest
from logs_maker import LogMaker, drive, grid, path, sound_log, yard
from results_maker import results_data

import replay.cli
from optim.methods import METHODS
from replay.base.errors import UsageError
from replay.cli.settings import RUN, groups, layer_of_file, layer_of_results, settled
from replay.run.results import results_of

CONFIG = """
method = ["shortcut", "ddp+shortcut"]
seed = 3
[shortcut]
tries = 15
spacing-of-nodes = 3
[weights]
cusp = 6
[reading]
margin = 0.15
vehicle = "truck.toml"
"""


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> pathlib.Path:
    return sound_log().write(tmp_path_factory.mktemp("logs") / "yard.mcap")


@pytest.fixture
def config(tmp_path) -> pathlib.Path:
    (tmp_path / "sub").mkdir()
    (tmp_path / "sub" / "truck.toml").write_text("trailer_rear = 11.5\n")
    (tmp_path / "sub" / "run.toml").write_text(CONFIG)
    return tmp_path / "sub" / "run.toml"


def run(*arguments: str | pathlib.Path) -> int:
    return replay.cli.main([str(argument) for argument in arguments])


def timeless(file: pathlib.Path) -> dict[str, Any]:
    """A results document without the times, which no two runs share."""
    document = results_data(file)
    for method in document["methods"]:
        method["wall_s"] = None
        for iterate in method["history"]:
            iterate["solver_s"] = None
    return document


def test_methods_may_be_named_with_commas_between(log, tmp_path, capsys):
    settings = settled([{RUN: {"method": ("ddp, shortcut+scp",)}}])
    assert list(settings.methods) == ["ddp", "shortcut+scp"]
    command = ["optimize", log, "--out", tmp_path, "--no-recording", "--shortcut.tries", "5"]
    assert run(*command, "--method", "shortcut,cpo") == 0
    document = results_data(tmp_path / "yard.results.json")
    assert [method["name"] for method in document["methods"]] == ["shortcut", "cpo"]
    assert run(*command, "--method", "shortcut,ddpp") == 2
    assert "unknown method 'ddpp'. Did you mean 'ddp'?" in capsys.readouterr().err


def test_a_file_sets_what_it_names_and_nothing_else(config):
    settings = settled([layer_of_file(config)])
    assert list(settings.methods) == ["shortcut", "ddp+shortcut"]
    shortcut: Any = settings.methods["shortcut"]
    assert (shortcut.tries, shortcut.spacing_of_nodes, shortcut.seed) == (15, 3.0, 3)
    assert shortcut.interval == METHODS["shortcut"].interval  # pyright: ignore[reportAttributeAccessIssue]
    assert (settings.weights.cusp, settings.weights.length) == (6.0, 1.0)
    assert settings.read.margin == 0.15
    assert settings.read.vehicle is not None
    assert settings.read.vehicle.trailer_rear == 11.5


def test_flags_stand_above_the_file(config, log, tmp_path):
    flags = ["--config", config, "--no-recording", "--out", tmp_path, "--method", "shortcut"]
    given = ["--shortcut.spacing", "0.1", "--shortcut.tries", "17"]
    assert run("optimize", log, *flags, *given) == 0
    document = results_data(tmp_path / "yard.results.json")
    options = document["tool"]["options"]
    assert list(options) == ["shortcut"]
    chosen = {name: options["shortcut"][name] for name in ("tries", "spacing", "spacing_of_nodes", "seed")}
    assert chosen == {"tries": 17, "spacing": 0.1, "spacing_of_nodes": 3.0, "seed": 3}
    assert (document["weights"]["cusp"], document["scene"]["margin"]) == (6.0, 0.15)
    assert document["vehicle"]["trailer_rear"] == 11.5


def test_a_flag_that_names_the_default_still_stands_above_the_file(config, log, tmp_path):
    plain: Any = METHODS["shortcut"]
    flags = ["--config", config, "--no-recording", "--out", tmp_path, "--method", "shortcut"]
    assert run("optimize", log, *flags, "--seed", "0", "--shortcut.spacing-of-nodes", plain.spacing_of_nodes) == 0
    options = results_data(tmp_path / "yard.results.json")["tool"]["options"]["shortcut"]
    assert (options["seed"], options["spacing_of_nodes"]) == (0, plain.spacing_of_nodes)


def test_a_higher_layers_common_seed_stands_above_a_lower_layers_own_one():
    low, high = {"shortcut": {"seed": 4}}, {RUN: {"seed": 5}}
    assert settled([low, high]).methods["shortcut"].seed == 5  # pyright: ignore[reportAttributeAccessIssue]
    assert settled([high, low]).methods["shortcut"].seed == 4  # pyright: ignore[reportAttributeAccessIssue]


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("shortcut = {tries = 3", ["not TOML", "at end of document"]),
        ("\n\n[shortcut]\ntries = = 3", ["not TOML", "line 4, column 9"]),
        ("[shortct]\ntries = 3", ["unknown key 'shortct'. Did you mean 'shortcut'?"]),
        ("[shortcut]\ntrys = 3", ["unknown key 'trys' in shortcut. Did you mean 'tries'?"]),
        ("sed = 3", ["unknown key 'sed'. Did you mean 'seed'?"]),
        ("[weights]\ncosp = 3", ["unknown key 'cosp' in weights. Did you mean 'cusp'?"]),
        ("shortcut = 3", ["shortcut is 3, expected a table"]),
        ("[shortcut]\ntries = 3.5", ["shortcut.tries is 3.5, expected a whole number"]),
        ("[shortcut]\ntries = true", ["shortcut.tries is true, expected a whole number"]),
        ("[reading]\nmargin = 'wide'", ["reading.margin is 'wide', expected a number"]),
        ("[reading]\nunknown = 'maybe'", ["reading.unknown is 'maybe', expected 'obstacle' or 'free'"]),
        ("[weights]\ncusp = 1" + "0" * 400, ["weights.cusp is a number of 401 digits, expected a number"]),
        ("[reading]\nvehicle = 3", ["reading.vehicle is 3, expected a text"]),
        ("method = 3", ["method is 3, expected a text or a list"]),
        ("method = 'shortct'", ["unknown method 'shortct'. Did you mean 'shortcut'?"]),
        ("time_limit = -1", ["--time-limit is -1, expected more than 0 s"]),
        ("jobs = 0", ["--jobs is 0, expected 1 to 1024"]),
    ],
)
def test_a_mistake_in_a_file_is_one_line_that_says_where(tmp_path, capsys, text, words):
    (tmp_path / "run.toml").write_text(text)
    assert run("optimize", "none.mcap", "--config", tmp_path / "run.toml", "--out", tmp_path) == 2
    said = capsys.readouterr()
    assert said.out == ""
    assert said.err.count("\n") == 1
    for word in words:
        assert word in said.err


NUMBERS = [
    f"[{group}]\n{name} = " if group else f"{name} = "
    for group, options in groups().items()
    for name, option in options.items()
    if option.hint in (int, float, int | None)
]


@pytest.mark.parametrize("number", ["1" + "0" * 400, "-1" + "0" * 400, "1e400"])
def test_a_number_of_four_hundred_digits_in_a_file_is_refused_by_its_name(tmp_path, number):
    assert len(NUMBERS) > 60
    for start in NUMBERS:
        (tmp_path / "run.toml").write_text(start + number)
        with pytest.raises(UsageError) as caught:
            layer_of_file(tmp_path / "run.toml")
        name = start.replace("[", "").replace("]\n", ".").removesuffix(" = ")
        assert f"run.toml: {name} is a number of 401 digits, expected a" in str(caught.value)


def test_a_run_from_its_results_gives_the_same_but_for_the_times(log, tmp_path):
    flags = ["--method", "shortcut", "--method", "ddp+shortcut", "--shortcut.tries", "12", "--seed", "7"]
    more = ["--weights.rate", "4.5", "--margin", "0.12", "--memory-limit", "3000", "--no-recording"]
    assert run("optimize", log, *flags, *more, "--out", tmp_path / "a") == 0
    assert (
        run("optimize", "--from", tmp_path / "a" / "yard.results.json", "--no-recording", "--out", tmp_path / "b") == 0
    )
    first, second = (timeless(tmp_path / name / "yard.results.json") for name in "ab")
    assert first == second
    assert first["tool"]["limits"] == {"time_s": None, "memory_mib": 3000}
    assert [method["name"] for method in second["methods"]] == ["shortcut", "ddp+shortcut"]


def test_flags_replace_options_of_the_run_that_is_repeated(log, tmp_path):
    flags = ["--method", "shortcut", "--shortcut.tries", "12", "--no-recording"]
    assert run("optimize", log, *flags, "--out", tmp_path / "a") == 0
    again = ["--from", tmp_path / "a" / "yard.results.json", "--out", tmp_path / "b", "--no-recording"]
    assert run("optimize", *again, "--seed", "9", "--weights.cusp", "8") == 0
    document = results_data(tmp_path / "b" / "yard.results.json")
    options = document["tool"]["options"]["shortcut"]
    assert (options["tries"], options["seed"], document["weights"]["cusp"]) == (12, 9, 8.0)


def test_one_of_several_requests_is_repeated_alone(tmp_path):
    truck, _ = drive()
    maker = LogMaker().vehicle().add("/map", grid(yard()), 1)
    for k in range(2):
        maker.add("/truck", path(truck[: 70 + 20 * k]), 2 + k)
    maker.write(tmp_path / "two.mcap")
    flags = ["--method", "shortcut", "--shortcut.tries", "3", "--no-recording"]
    assert run("optimize", tmp_path / "two.mcap", *flags, "--out", tmp_path / "a") == 0
    assert (
        run("optimize", "--from", tmp_path / "a" / "two-1.results.json", "--no-recording", "--out", tmp_path / "b") == 0
    )
    assert [file.name for file in (tmp_path / "b").iterdir()] == ["two-1.results.json"]
    assert timeless(tmp_path / "a" / "two-1.results.json") == timeless(tmp_path / "b" / "two-1.results.json")


@pytest.fixture(scope="module")
def results(log, tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("results")
    flags = ["--method", "shortcut", "--shortcut.tries", "3", "--no-recording"]
    assert run("optimize", log, *flags, "--out", folder) == 0
    return folder / "yard.results.json"


def test_another_log_under_the_same_name_is_refused(results, tmp_path, capsys):
    other = sound_log(trailer=False).write(tmp_path / "yard.mcap")
    assert run("optimize", other, "--from", results, "--out", tmp_path / "out") == 2
    assert "another log [E_OTHER_LOG]" in capsys.readouterr().err
    assert list((tmp_path / "out").iterdir()) == []


def test_the_results_that_are_repeated_are_not_overwritten(results, capsys):
    before = results.read_bytes()
    assert run("optimize", "--from", results, "--no-recording", "--out", results.parent) == 2
    assert "is an input and will not be overwritten" in capsys.readouterr().err
    assert results.read_bytes() == before


def test_a_log_beside_its_results_is_found_and_a_lost_one_is_asked_for(results, log, tmp_path, capsys):
    document = json.loads(results.read_text())
    document["log"]["path"] = "gone/yard.mcap"
    moved = tmp_path / "yard.results.json"
    moved.write_text(json.dumps(document))
    assert run("optimize", "--from", moved, "--no-recording", "--out", tmp_path / "b") == 2
    assert "give the path of the log as well" in capsys.readouterr().err
    shutil.copy(log, tmp_path)
    assert run("optimize", "--from", moved, "--no-recording", "--out", tmp_path / "b") == 0


@pytest.mark.parametrize(
    ("change", "words"),
    [
        (lambda tool: tool.pop("reading"), "does not hold the options of its run"),
        (lambda tool: tool["options"]["shortcut"].update(trys=3), "unknown key 'trys' in tool.options.shortcut"),
        (lambda tool: tool["options"].update(fancy={"tries": 3}), "unknown method 'tries' in tool.options.fancy"),
        (lambda tool: tool["options"].update({"a+b": {"a": {}}}), "unknown method 'a'"),
        (lambda tool: tool["options"].update({"shortcut+ddp": {"shortcut": {"tries": 9}}}), "two sets of options"),
        (
            lambda tool: tool["reading"].update(vehicle={"wheelbase": -1}),
            "tool.reading.vehicle: vehicle: wheelbase",
        ),
    ],
)
def test_results_whose_options_cannot_be_used_are_refused(results, change, words):
    document = json.loads(results.read_text())
    change(document["tool"])
    with pytest.raises(UsageError) as caught:
        layer_of_results(results_of(document, "x.json"), "x.json")
    assert words in str(caught.value)


def test_another_version_of_what_computes_is_named(results, tmp_path, capsys):
    document = json.loads(results.read_text())
    document["tool"]["packages"]["numpy"] = "1.0"
    (tmp_path / "old.json").write_text(json.dumps(document))
    assert run("optimize", "--from", tmp_path / "old.json", "--no-recording", "--out", tmp_path / "out") == 0
    assert "numpy 1.0 then" in capsys.readouterr().err
