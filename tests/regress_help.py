"""Runs of a regression with real processes, for its tests."""

import pathlib
import shutil
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from optim.methods import METHODS
from optim.model.method import Method
from replay.base.documents import plain, read_json
from replay.base.schemas.run import Commands
from replay.base.schemas.verdicts import Comparison, Verdicts
from replay.regress.corpus import find_corpus
from replay.regress.finish import judge_and_report
from replay.regress.folder import RunFolder
from replay.regress.options import Options
from replay.regress.plan import Execute, Plan, carry_out, start
from replay.regress.supervisor import Supervisor, run_here
from replay.report.conclusion import Conclusion
from tools.attacks.same_results import timeless
from tools.processes import REPLAY

ROOT = pathlib.Path(__file__).resolve().parent.parent
RECORDINGS = ROOT / "recordings"
LENGTHS = {"bay_01": 71.33, "bay_02": 84.78}
"""Length of the recorded paths of the class bay [m]."""


def make_corpus(folder: pathlib.Path, names: Iterable[str] = ("bay_01", "bay_02", "dock_01"), more: str = "") -> str:
    """A corpus of sample logs with their classes; `more` is added to its list."""
    folder.mkdir(parents=True)
    lines = []
    for name in names:
        shutil.copy(RECORDINGS / f"{name}.mcap", folder)
        lines.append(f'[logs.{name}]\nclass = "{name[:-3]}"\nexpect = "improved"\n')
    (folder / "corpus.toml").write_text("\n".join(lines) + more)
    return str(folder)


def make_plan(corpus: str, methods: Mapping[str, Method] | None = None, **more: Any) -> Plan:
    """A plan for a corpus; `more` are fields of `Plan`, and which recordings are kept."""
    found = find_corpus(corpus)
    options = Options(methods=dict(methods or {"ddp": METHODS["ddp"]}), recordings=more.pop("recordings", "none"))
    baseline = pathlib.Path(found.baseline) if found.baseline else None
    return Plan(corpus=corpus, logs=found.logs, known=found.known, options=options, baseline=baseline, **more)


def here(jobs: int = 1) -> Execute:
    """Does jobs in processes of its own."""
    return lambda waiting: run_here(waiting, jobs)


def through(supervisor: Supervisor) -> Execute:
    """Does jobs in a worker that is warm already."""
    return lambda jobs: (supervisor.run(job) for job in jobs)


def run(plan: Plan, runs: pathlib.Path, execute: Execute) -> tuple[RunFolder, Conclusion]:
    """A whole run; its folder, and the verdict. The reports are made in this process, which spares a start."""
    folder = start(plan, runs)
    carry_out(plan, folder, execute, lambda *_: None)
    return folder, judge_and_report(folder.path, runs, Commands())


def command(*arguments: str, **more: Any) -> subprocess.CompletedProcess[str]:
    """`replay` with these arguments."""
    return subprocess.run(call(*arguments), capture_output=True, text=True, timeout=120, **more)


def call(*arguments: str) -> Sequence[str]:
    """The command `replay` with these arguments."""
    return [*REPLAY, *arguments]


def verdicts(folder: RunFolder, *wanted: str) -> list[Comparison]:
    """The comparisons in verdicts.json with these verdicts."""
    found = read_json(folder.path / "verdicts.json", Verdicts, 2**20).comparisons
    return [each for each in found if each.verdict in wanted]


def attempts(folder: RunFolder) -> list[str]:
    """The logs on which work began, one entry each time."""
    return (folder.path / "attempts").read_text().split()


def results(folder: RunFolder) -> dict[str, Any]:
    """The documents of a run as plain data, without what may differ between runs, by log."""
    return {log.log: timeless(plain(log)) for log in folder.documents()}


def below(pid: int) -> list[int]:
    """The processes below one, at whatever depth."""
    parents: dict[int, list[int]] = {}
    for entry in pathlib.Path("/proc").iterdir():
        if entry.name.isdigit():
            try:
                fields = (entry / "stat").read_text().rpartition(")")[2].split()
            except OSError:
                continue
            if fields[0] != "Z":
                parents.setdefault(int(fields[1]), []).append(int(entry.name))
    found, waiting = [], [pid]
    while waiting:
        children = parents.get(waiting.pop(), [])
        found += children
        waiting += children
    return found
