"""What holds for the project as a whole: what is imported, what the files say, what the README promises."""

import ast
import pathlib
import re
import shutil
import subprocess
import sys
import tomllib

import pytest

import optim
import replay

ROOT = pathlib.Path(__file__).resolve().parent.parent
IGNORED = {".git", ".venv", "out", "__pycache__", ".pytest_cache", ".ruff_cache", ".hypothesis"}


def project_files() -> list[pathlib.Path]:
    """Tracked files and new ones that are not ignored; all files where the project is no git checkout."""
    if shutil.which("git") and (ROOT / ".git").exists():
        command = ["git", "ls-files", "-z", "--cached", "--others", "--exclude-standard"]
        listed = subprocess.run(command, cwd=ROOT, capture_output=True, check=True, text=True).stdout
        return sorted(path for name in listed.split("\0") if name and (path := ROOT / name).is_file())
    return sorted(path for path in ROOT.rglob("*") if path.is_file() and not IGNORED & set(path.parts))


def text_files() -> list[tuple[str, str]]:
    """Name and content of every file that is text."""
    found = []
    for path in project_files():
        data = path.read_bytes()
        if b"\0" not in data[:8192] and path.suffix not in (".mcap", ".png"):
            found.append((path.relative_to(ROOT).as_posix(), data.decode("utf-8")))
    assert found, "the project's files were not found"
    return found


@pytest.mark.parametrize("package", [optim, replay])
def test_the_packages_imported_are_this_projects_own(package) -> None:
    # distributions of both names exist elsewhere, under other owners
    (place,) = {pathlib.Path(folder).resolve() for folder in package.__path__}
    assert place == ROOT / package.__name__


def test_no_file_names_a_place_on_one_machine_or_a_package_registry() -> None:
    folders = "|".join(["wor" + "k", "roo" + "t", "hom" + "e", "far" + "m", "User" + "s"])
    hosts = "|".join(["pyp" + "i", "npm" + "js", "debia" + "n", "python" + "hosted", "ubunt" + "u"])
    wrong = re.compile(rf"(?<![\w.}}])/(?:{folders})/[A-Za-z.]|https?://[^\s/]*(?:{hosts})\.", re.IGNORECASE)
    found = [f"{name}: {match.group()}" for name, text in text_files() for match in wrong.finditer(text)]
    assert not found


def test_every_constraint_is_a_name_and_one_version() -> None:
    lines = (ROOT / "constraints.txt").read_text().splitlines()
    assert lines
    assert not [line for line in lines if not re.fullmatch(r"[A-Za-z0-9][A-Za-z0-9._-]*==[A-Za-z0-9.+!]+", line)]


def test_every_dependency_has_a_constraint_and_a_lower_bound() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = project["optional-dependencies"]
    assert all(">=" in line for line in extras["bench"])  # only compared with: no test depends on their versions
    wanted = project["dependencies"] + [line for name, extra in extras.items() if name != "bench" for line in extra]
    pinned = {_canonical(line.partition("==")[0]) for line in (ROOT / "constraints.txt").read_text().splitlines()}
    for line in wanted:
        assert ">=" in line
        assert _canonical(re.split(r"[<>=\[]", line)[0]) in pinned


def test_every_package_imported_is_a_declared_dependency() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    extras = [line for extra, lines in project["optional-dependencies"].items() if extra != "dev" for line in lines]
    declared = {_canonical(re.split(r"[<>=\[]", line)[0]) for line in [*project["dependencies"], *extras]}
    modules = {
        "rerun": "rerun-sdk",
        "rerun_cli": "rerun-sdk",
        "fsspec": "s3fs",
        "google": "protobuf",
        "IPython": "ipython",
    }
    for name in ("optim", "replay"):
        for path in (ROOT / name).rglob("*.py"):
            for module in _imports(path):
                top = module.partition(".")[0]
                if top not in sys.stdlib_module_names and top not in ("optim", "replay"):
                    assert _canonical(modules.get(top, top)) in declared, f"{path.relative_to(ROOT)} imports {top}"


def test_every_dependency_is_used() -> None:
    project = tomllib.loads((ROOT / "pyproject.toml").read_text())["project"]
    used = {
        module.partition(".")[0] for name in ("optim", "replay") for module in _imports(*(ROOT / name).rglob("*.py"))
    }
    modules = {"rerun-sdk": "rerun", "protobuf": "google"}
    for line in project["dependencies"]:
        name = _canonical(re.split(r"[<>=\[]", line)[0])
        assert modules.get(name, name.replace("-", "_")) in used, f"{name} is not imported"


def test_the_layout_in_the_readme_is_the_tree() -> None:
    section = (ROOT / "README.md").read_text().partition("## Layout")[2]
    block = section.split("```")[1].partition("\n")[2]
    listed, folder = set(), ""
    for line in block.splitlines():
        entry = line.split()[0] if line.strip() else ""
        if not line.startswith(" "):
            folder = entry if entry.endswith("/") else ""
        listed.add(folder + entry if line.startswith(" ") else entry)
    missing = {entry for entry in listed if entry and not (ROOT / entry).exists()}
    assert not missing, "in the README, not in the tree"
    modules = {
        path.relative_to(ROOT).as_posix() for name in ("optim", "replay") for path in (ROOT / name).rglob("*.py")
    }
    covered = tuple(entry for entry in listed if entry.count("/") > 1 and entry.endswith("/"))
    unlisted = {name for name in modules if name not in listed and not name.startswith(covered)}
    assert not {name for name in unlisted if not name.endswith("__init__.py")}, "in the tree, not in the README"


def test_files_stay_short_enough_to_hold_one_idea() -> None:
    lengths = {name: text.count("\n") for name, text in text_files() if name.endswith(".py")}
    assert not {name: length for name, length in lengths.items() if length > 350}


def _canonical(name: str) -> str:
    return re.sub(r"[-_.]+", "-", name).lower()


def _imports(*files: pathlib.Path) -> set[str]:
    """The modules that files import, wherever in them."""
    found = set()
    for node in (node for file in files for node in ast.walk(ast.parse(file.read_text(encoding="utf-8")))):
        if isinstance(node, ast.Import):
            found |= {alias.name for alias in node.names}
        elif isinstance(node, ast.ImportFrom) and node.module and node.level == 0:
            found.add(node.module)
    return found
