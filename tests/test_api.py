"""`import replay`: from a log to a result in five lines, in a script or a notebook, with the command line's bits."""

import json
import os
import pathlib
import subprocess
import sys
import textwrap
import time
from typing import Any

import nbclient
import nbformat
import pytest

import replay
from tools.processes import REPLAY

ROOT = pathlib.Path(__file__).resolve().parent.parent
LOG = ROOT / "recordings" / "bay_01.mcap"
TIMES = ("wall_s", "solver_s")
LINES = f"""
import replay
case = replay.read({str(LOG)!r})[0]
run = replay.optimize(case, "ddp", "shortcut+scp", progress=PROGRESS)
run.best.path, run.best.audit.clearance.value
run.plot()
replay.record(run, "bay_01.rrd"); replay.save(run, "bay_01.results.json"); run = replay.load("bay_01.results.json")
"""


def without_times(node: Any) -> Any:
    if isinstance(node, dict):
        return {key: without_times(value) for key, value in node.items() if key not in TIMES}
    return [without_times(value) for value in node] if isinstance(node, list) else node


def told(what: str, seconds: float) -> None:
    """Seconds that something took, for `pytest -s`."""
    sys.stdout.write(f"{what}: {seconds:.4g} s\n")


def results(folder: pathlib.Path) -> Any:
    return without_times(json.loads((folder / "bay_01.results.json").read_text()))


def environment(**changes: str) -> dict[str, str]:
    """Without what would settle the threads."""
    return {name: value for name, value in os.environ.items() if not name.endswith("_THREADS")} | changes


@pytest.fixture(scope="module")
def by_command_line(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("command")
    command = [*REPLAY, "optimize", str(LOG), "--method", "ddp", "--method", "shortcut+scp", "--quiet"]
    began = time.monotonic()
    subprocess.run([*command, "--out", str(folder)], env=environment(), check=True, stdout=subprocess.DEVNULL)
    told("command line", time.monotonic() - began)
    return folder


def test_five_lines_in_a_script_give_the_bits_of_the_command_line(
    by_command_line: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    (tmp_path / "script.py").write_text(LINES.replace("PROGRESS", "None"))
    began = time.monotonic()
    done = subprocess.run(
        [sys.executable, "script.py"], cwd=tmp_path, env=environment(MPLBACKEND="agg"), capture_output=True, text=True
    )
    told("script", time.monotonic() - began)
    assert (done.returncode, done.stdout, done.stderr) == (0, "", ""), "nothing is shown where there is no terminal"
    assert results(tmp_path) == results(by_command_line)
    assert (tmp_path / "bay_01.rrd").stat().st_size > 100_000


CELLS = (
    "import numpy as np\nlarge = np.random.default_rng(0).random((800, 800)) @ np.ones((800, 800))  # on all cores",
    *LINES.replace("PROGRESS", "None").strip().split("\n"),
    "run, case, run['ddp'], run.best.path",
    "run.best.path.to_dataframe()",
    "import threadpoolctl\nprint(max(library['num_threads'] for library in threadpoolctl.threadpool_info()))",
)


@pytest.mark.filterwarnings("ignore")  # of nbclient and zmq
def test_the_same_lines_in_a_notebook_that_has_loaded_numpy_before_give_the_same_bits(
    by_command_line: pathlib.Path, tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in [name for name in os.environ if name.endswith("_THREADS")]:
        monkeypatch.delenv(name)
    monkeypatch.setenv("IPYTHONDIR", str(tmp_path / "ipython"))
    notebook = nbformat.v4.new_notebook(cells=[nbformat.v4.new_code_cell(cell) for cell in CELLS])
    client = nbclient.NotebookClient(notebook, timeout=600, resources={"metadata": {"path": str(tmp_path)}})
    began = time.monotonic()
    client.execute()
    told("notebook", time.monotonic() - began)
    assert results(tmp_path) == results(by_command_line)
    outputs = [cell.outputs for cell in notebook.cells]
    progress, shown, plot, table = (outputs[k] for k in (3, 4, 5, 8))
    assert progress[0].data["text/plain"] == "", "progress was shown there, and is gone"
    assert "Path(" in shown[0].data["text/plain"]
    assert [set(output.get("data", ())) & {"image/png"} for output in plot] == [{"image/png"}], "once"
    assert "text/html" in table[0].data
    cores = len(os.sched_getaffinity(0))
    assert outputs[9][0].text.strip() == str(cores), "the notebook has its threads back"


def test_importing_the_package_loads_nothing_and_takes_no_time() -> None:
    script = textwrap.dedent("""
        import sys, time
        began = time.perf_counter()
        import replay
        spent = time.perf_counter() - began
        heavy = {"numpy", "numba", "rerun", "rich", "cyclopts", "msgspec", "matplotlib", "optim"} & set(sys.modules)
        print(spent, *heavy)
    """)
    said = [subprocess.check_output([sys.executable, "-c", script], text=True).split() for _ in range(5)]
    assert all(len(words) == 1 for words in said), said
    best = min(float(words[0]) for words in said)
    told("import replay", best)
    assert best <= 0.1


def test_every_public_name_is_there_and_no_other() -> None:
    assert set(replay.__all__) <= set(dir(replay))
    for name in replay.__all__:
        assert getattr(replay, name).__name__ == name
    with pytest.raises(AttributeError, match="has no attribute 'optimise'"):
        _ = replay.optimise  # pyright: ignore[reportAttributeAccessIssue]
