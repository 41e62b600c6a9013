"""The floors of the house: which room may import which, held against the imports drawn from the code."""

import ast
import itertools
import sys
from collections.abc import Iterable
from typing import Final

import pytest
from import_graph import TREES, Import, circles, imports, imports_of, modules, names_read, tree_of

from replay.cli import COMMANDS

MATHEMATICS: Final = {
    "optim.numerics": [],
    "optim.geometry": ["optim.numerics"],
    "optim.audit": [],
    "optim.model": ["optim.geometry", "optim.numerics"],
    "optim.fit": ["optim.model", "optim.geometry", "optim.numerics"],
    "optim.steering": ["optim.model", "optim.geometry", "optim.numerics"],
    "optim.knots": ["optim.model", "optim.geometry", "optim.numerics"],
    "optim.planning": ["optim.steering", "optim.model", "optim.geometry", "optim.numerics"],
}
BELOW_METHODS: Final = [room for room in MATHEMATICS if room != "optim.audit"]
METHODS: Final = {
    **{f"optim.methods.{name}": BELOW_METHODS for name in ("shortcut", "cpo", "ddp", "nlp", "scp")},
    "optim.methods.chain": BELOW_METHODS,
    "optim.methods": [
        *(f"optim.methods.{name}" for name in ("shortcut", "cpo", "ddp", "nlp", "scp", "chain")),
        *BELOW_METHODS,
    ],
}
OPTIM: Final = [*MATHEMATICS, *METHODS]
READERS: Final = ["replay.logs.container", "replay.logs.messages", "replay.logs.meaning"]
LOGS: Final = [*READERS, "replay.logs"]
BELOW_REPORT: Final = ["replay.pipeline", "replay.recording", "replay.run", *LOGS, "replay.base", *OPTIM]
ROOMS: Final[dict[str, list[str]]] = {
    **MATHEMATICS,
    **METHODS,
    "replay.base": OPTIM,
    "replay.run": ["replay.base", *OPTIM],
    "replay.logs.container": ["replay.base", "replay.run", *OPTIM],
    "replay.logs.messages": ["replay.logs.container", "replay.base", "replay.run", *OPTIM],
    "replay.logs.meaning": ["replay.logs.messages", "replay.logs.container", "replay.base", "replay.run", *OPTIM],
    "replay.logs": [*READERS, "replay.base", "replay.run", *OPTIM],
    "replay.recording": ["replay.run", "replay.base", *OPTIM],
    "replay.pipeline": [room for room in BELOW_REPORT if room != "replay.pipeline"],
    "replay.report": BELOW_REPORT,
    "replay.regress": ["replay.report", *BELOW_REPORT],
    "replay.cli": ["replay.regress", "replay.report", *BELOW_REPORT],
    "replay": BELOW_REPORT,
    "optim": [],
}
"""Every room and the rooms that it may import. A room holds what no room of a longer name holds."""
SOLVING: Final = ("replay.run.judge", "replay.run.solving")
"""Modules whose functions lead from a problem to a result."""
WORLD: Final = {
    *("os", "pathlib", "io", "shutil", "tempfile", "glob", "fcntl", "mmap"),  # files
    *("time", "datetime", "signal", "random", "secrets", "uuid", "locale", "platform"),  # clock, machine, chance
    *("threading", "multiprocessing", "concurrent", "subprocess", "asyncio", "socket"),  # other processes
    *("logging", "argparse", "json", "tomllib", "pickle", "csv"),  # words and documents
    *("mcap", "rerun", "rich", "cyclopts", "jinja2", "pyarrow", "msgspec"),
}
"""What mathematics has no use for."""
KEEPS_COMPILED_CODE: Final = "optim.numerics.kernel"  # which locks the files that Numba keeps


def room_of(module: str) -> str:
    """The room that holds a module: the longest name in the table that begins the module's."""
    return max((room for room in ROOMS if f"{module}.".startswith(f"{room}.")), key=len, default="")


def is_in(module: str, package: str) -> bool:
    return f"{module}.".startswith(f"{package}.")


def inside() -> list[Import]:
    """The imports of modules of the project."""
    return [each for each in imports() if each.target in modules() and each.target != each.file]


def listed(found: Iterable[Import]) -> str:
    return "\n".join(sorted({str(each) for each in found}))


def test_every_module_has_a_room_and_every_room_a_module() -> None:
    packages = [module for module in modules() if not is_in(module, "tools")]
    assert not [module for module in packages if room_of(module) in ("optim", "replay") and "." in module]
    assert not set(ROOMS) - {room_of(module) for module in packages}, "rooms that no module lives in"


def test_every_arrow_between_rooms_runs_down() -> None:
    wrong = []
    for each in inside():
        start, end = room_of(each.file), room_of(each.target)
        if start and start != end and end not in ROOMS[start]:
            wrong.append(each)
    assert not wrong, listed(wrong)


def test_the_table_itself_has_no_circle() -> None:
    assert not circles((room, below) for room, rooms in ROOMS.items() for below in rooms)
    assert not {below for rooms in ROOMS.values() for below in rooms} - set(ROOMS)


def test_no_files_import_each_other_in_a_circle() -> None:
    assert not circles((each.file, each.target) for each in inside())


def test_no_packages_import_each_other_in_a_circle_on_any_level() -> None:
    found = []
    parents = {module.rpartition(".")[0] for module in modules()}
    for parent in sorted(parents - {""}):
        arrows = {
            (_child(parent, each.file), _child(parent, each.target))
            for each in inside()
            if each.file != parent != each.target and is_in(each.file, parent) and is_in(each.target, parent)
        }
        found += circles((start, end) for start, end in arrows if start != end)
    assert not found
    assert not circles(
        (start, end)
        for start, end in {(each.file.split(".")[0], each.target.split(".")[0]) for each in inside()}
        if start != end
    )


def _child(parent: str, module: str) -> str:
    """The module or package directly inside `parent` that a module is, or lies in."""
    return f"{parent}.{module.removeprefix(parent + '.').split('.')[0]}"


def test_no_import_for_types_alone_hides_an_arrow() -> None:
    # the face of the package loads its names on first use, and shows type checkers where they are; nobody imports it
    assert not [each for each in imports() if each.target == "replay" and each.file.split(".")[0] != "tools"]
    hidden = [each for each in imports() if each.is_for_types and each.target.split(".")[0] in TREES]
    wrong = [each for each in hidden if each.file != "replay"]
    assert not wrong, listed(wrong)


def test_nothing_is_imported_for_its_side_effect() -> None:
    wrong = []
    for module in modules():
        read = names_read(tree_of(module))
        mine = [each for each in imports() if each.file == module and each.bound]
        wrong += [each for each in mine if each.bound not in read and each.target != "__future__"]
    assert not wrong, listed(wrong)


def test_no_command_imports_another() -> None:
    commands = {f"replay.cli.{name}" for name in COMMANDS}
    wrong = [each for each in inside() if each.file in commands and each.target in commands]
    assert not wrong, listed(wrong)


def test_only_the_end_of_a_regression_and_the_command_line_make_reports() -> None:
    users = [each for each in inside() if is_in(each.target, "replay.report") and not is_in(each.file, "replay.report")]
    rooms = {room_of(each.file) for each in users}
    assert rooms <= {"replay.regress", "replay.cli"}, listed(users)
    ends = {each.file for each in users if room_of(each.file) == "replay.regress"}
    assert len(ends) <= 1, listed(each for each in users if each.file in ends)


def test_only_the_pipeline_leads_from_a_log_to_a_result() -> None:
    functions = [
        each
        for each in inside()
        if (each.target in SOLVING and each.name[:1].islower())
        or (is_in(each.target, "replay.logs") and each.name == "read_cases")
    ]
    wrong = [each for each in functions if is_in(each.file, "replay.cli") or is_in(each.file, "replay.regress")]
    # it also runs with the packages of versions from before the pipeline
    wrong = [each for each in wrong if each.file != "replay.regress.timing_server"]
    assert not wrong, listed(wrong)


def test_the_product_does_without_the_tools_and_the_tools_without_the_command_line() -> None:
    wrong = [each for each in imports() if not is_in(each.file, "tools") and is_in(each.target, "tools")]
    wrong += [each for each in imports() if is_in(each.file, "tools") and is_in(each.target, "replay.cli")]
    wrong += [each for each in imports() if each.target.split(".")[0] in ("tests", "conftest")]
    assert not wrong, listed(wrong)


def test_only_the_recording_knows_rerun() -> None:
    known = {"rerun", "rerun_cli", "rerun_bindings"}
    using = [each for each in imports() if each.target.split(".")[0] in known]
    wrong = [each for each in using if not is_in(each.file, "replay.recording") and not is_in(each.file, "tools")]
    assert using
    assert not wrong, listed(wrong)


def test_the_mathematics_knows_nothing_of_files_clocks_and_processes() -> None:
    of_optim = [each for each in imports() if is_in(each.file, "optim") and each.file != KEEPS_COMPILED_CODE]
    wrong = [each for each in of_optim if each.target.split(".")[0] in {*WORLD, "replay", "tools"}]
    assert not wrong, listed(wrong)
    for module in modules():
        if is_in(module, "optim") and module != KEEPS_COMPILED_CODE:
            called = {ast.unparse(node.func) for node in ast.walk(tree_of(module)) if isinstance(node, ast.Call)}
            assert not called & {"open", "print", "input", "np.load", "np.save", "np.loadtxt"}, module


@pytest.mark.parametrize(
    ("room", "allowed"),
    [("optim.audit", {"numpy", "shapely"}), ("optim.numerics", {"numpy", "numba", "jaxtyping"})],
)
def test_a_room_uses_only_the_packages_it_is_meant_to(room: str, allowed: set[str]) -> None:
    tops = {each.target.split(".")[0] for each in imports() if is_in(each.file, room)}
    assert tops - sys.stdlib_module_names - {"optim"} <= allowed


def test_documents_are_plain_data() -> None:
    rooms = [each for each in imports() if is_in(each.file, "replay.base.schemas")]
    assert rooms, "the documents' structs have a room of their own"
    outside = [each for each in rooms if each.target.split(".")[0] not in sys.stdlib_module_names]
    wrong = [each for each in outside if not is_in(each.target, "replay.base") and each.target != "msgspec"]
    assert not wrong, listed(wrong)


SAMPLE = """
from typing import TYPE_CHECKING
import optim.model.path
import optim.model.path as path
from optim.model import scene, nothing
from . import connect
from .flat import Flat as F
if TYPE_CHECKING:
    from optim.model.vehicle import Vehicle
def later():
    import importlib
    importlib.import_module("optim.fit.poses")
    from optim.numerics import arrays
    return optim.model.path.Path, arrays
def quoted(of: "Vehicle | None") -> None: ...
__all__ = ["scene"]
"""


def test_imports_are_drawn_from_wherever_they_stand() -> None:
    found = {
        (each.target, each.name, each.bound, each.is_for_types)
        for each in imports_of("optim.steering.turns", ast.parse(SAMPLE), modules())
    }
    assert found == {
        ("typing", "TYPE_CHECKING", "TYPE_CHECKING", False),
        ("optim.model.path", "", "optim.model.path", False),
        ("optim.model.path", "", "path", False),
        ("optim.model.scene", "", "scene", False),
        ("optim.model", "nothing", "nothing", False),
        ("optim.steering.connect", "", "connect", False),
        ("optim.steering.flat", "Flat", "F", False),
        ("optim.model.vehicle", "Vehicle", "Vehicle", True),
        ("importlib", "", "importlib", False),
        ("optim.fit.poses", "", "", False),
        ("optim.numerics.arrays", "", "arrays", False),
    }
    of_package = imports_of("optim.steering", ast.parse("from .flat import Flat\nfrom ..model import path"), modules())
    assert [each.target for each in of_package] == ["optim.steering.flat", "optim.model.path"]


def test_names_that_are_read_are_told_from_names_that_are_only_bound() -> None:
    read = names_read(ast.parse(SAMPLE))
    assert {"optim.model.path", "arrays", "scene", "Vehicle"} <= read
    assert not {"connect", "F", "nothing", "path"} & read


def test_circles_are_found_however_long() -> None:
    chain = list(itertools.pairwise("abcdea"))
    assert circles([*chain, ("x", "a"), ("e", "y")]) == [["a", "b", "c", "d", "e"]]
    assert circles([*chain[:-1], ("x", "a"), ("e", "y")]) == []
