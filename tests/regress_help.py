"""Runs of a regression with real processes, for its tests."""

import json
import pathlib
import shutil
import subprocess
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from optim.methods import METHODS
from optim.model.method import Method
from replay.regress.corpus import find_corpus
from replay.regress.finish import conclude
from replay.regress.pool import run_here
from replay.regress.running import Execute, Plan, carry_out, start
from replay.regress.settings import Settings
from replay.regress.slot import Slot
from replay.regress.store import Store
from tools.processes import REPLAY

ROOT = pathlib.Path(__file__).resolve().parent.parent
RECORDINGS = ROOT / "recordings"
LENGTHS = {"bay_01": 71.33, "bay_02": 84.78}
"""Of the recorded paths of the class bay [m]."""


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
    settings = Settings(methods=dict(methods or {"ddp": METHODS["ddp"]}), recordings=more.pop("recordings", "none"))
    baseline = pathlib.Path(found.baseline) if found.baseline else None
    return Plan(corpus=corpus, logs=found.logs, known=found.known, settings=settings, baseline=baseline, **more)


def here(jobs: int = 1) -> Execute:
    """Does jobs in processes of its own."""
    return lambda waiting: run_here(waiting, jobs)


def through(slot: Slot) -> Execute:
    """Does jobs in a process that is warm already."""
    return lambda jobs: (slot.run(job) for job in jobs)


def run(plan: Plan, runs: pathlib.Path, execute: Execute) -> tuple[Store, dict[str, Any]]:
    """A whole run; its files, and what is said of it. The reports are made in this process, which spares a start."""
    store = start(plan, runs)
    carry_out(plan, store, execute, lambda *_: None)
    return store, conclude(store.folder, runs, {})


def command(*arguments: str, **more: Any) -> subprocess.CompletedProcess[str]:
    """`replay` with these arguments."""
    return subprocess.run(call(*arguments), capture_output=True, text=True, timeout=120, **more)


def call(*arguments: str) -> Sequence[str]:
    """The command `replay` with these arguments."""
    return [*REPLAY, *arguments]


def verdicts(store: Store, *wanted: str) -> list[dict[str, Any]]:
    """The entries of verdicts.json with these verdicts."""
    found = json.loads((store.folder / "verdicts.json").read_text())["verdicts"]
    return [entry for entry in found if entry["verdict"] in wanted]


def attempts(store: Store) -> list[str]:
    """The logs on which work began, one entry each time."""
    return (store.folder / "attempts").read_text().split()


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
