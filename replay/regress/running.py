"""One regression run: what is to be done, its folder, and doing it, or the rest of it."""

import contextlib
import dataclasses
import datetime
import errno
import os
import pathlib
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np

from replay.base.errors import ReplayError
from replay.base.files import WRITE_ERROR, reserved
from replay.base.strict_json import JsonError, read_json
from replay.regress.baseline import Baseline, read_baseline
from replay.regress.corpus import Known, Log
from replay.regress.differing import uncompared
from replay.regress.settings import Settings, about_program, fingerprint, revision
from replay.regress.store import Store, file_stem
from replay.regress.work import Job, Outcome, digest
from replay.report.history import SUMMARY
from replay.report.reading import LARGEST_LOG

RESUME_ERROR = "E_RESUME"
Execute = Callable[[Iterable[Job]], Generator[Outcome]]
"""Does jobs somewhere: `pool.run_here`, or on a cluster."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a run is to do."""

    corpus: str
    logs: tuple[Log, ...]
    """Those that were selected."""
    known: tuple[Known, ...]
    settings: Settings
    baseline: pathlib.Path | None = None
    """The file that the run is compared with, and that accepting it writes; it need not be there."""
    partial: str = ""
    """How logs or methods were selected, in words; empty for the whole corpus."""
    partial_methods: bool = False
    """Whether methods were selected."""
    shuffle: int | None = None
    """Seed of a random order of the logs."""

    @property
    def fingerprint(self) -> str:
        """The same for runs that do the same: logs, selection and options."""
        logs = [dataclasses.asdict(log) for log in self.logs]
        return fingerprint([self.corpus, logs, self.settings.plain(), self.settings.recordings, str(self.baseline)])

    def methods_of(self, log: Log) -> dict[str, Any]:
        """The methods that are run on a log."""
        methods = self.settings.methods
        return {name: method for name, method in methods.items() if not log.methods or name in log.methods}


def start(plan: Plan, runs: pathlib.Path) -> Store:
    """A new run's folder, named by time and revision. ReplayError (E_WRITE) where it cannot be made."""
    now = datetime.datetime.now(datetime.UTC)
    version = revision()
    name = f"{now:%Y-%m-%dT%H-%M-%SZ}_{version}"
    try:
        runs.mkdir(parents=True, exist_ok=True)
        folder = _new_folder(runs, name)
    except OSError as error:
        raise ReplayError(WRITE_ERROR, f"{runs}: {error.strerror}") from error
    store = Store(folder)
    store.make()
    store.write_head(_head(plan, f"{now:%Y-%m-%dT%H:%M:%SZ}", version))
    return store


def _new_folder(runs: pathlib.Path, name: str) -> pathlib.Path:
    for number in range(1, 1000):
        folder = runs / (name if number == 1 else f"{name}_{number}")
        with contextlib.suppress(FileExistsError):
            folder.mkdir()
            return folder
    raise FileExistsError(errno.EEXIST, "a thousand runs have begun in one second")


def _head(plan: Plan, created: str, version: str) -> dict[str, Any]:
    """The content of run.json."""
    options = plan.settings.plain()
    about = {"created": created, "revision": version, "complete": False, "fingerprint": plan.fingerprint}
    what = {"corpus": {"path": plan.corpus, "num_logs": len(plan.logs)}, "logs": [log.name for log in plan.logs]}
    how = {
        "methods": list(plan.settings.methods),
        "options": options,
        "options_fingerprint": fingerprint(options),
        "partial": plan.partial,
        "partial_methods": plan.partial_methods,
        "known": [dataclasses.asdict(issue) for issue in plan.known],
    }
    given = None if plan.baseline is None else str(plan.baseline.absolute())
    exists = plan.baseline is not None and plan.baseline.exists()
    return about | about_program() | what | how | {"baseline": given if exists else None, "accept_to": given}


def resumed(plan: Plan, runs: pathlib.Path) -> Store:
    """The newest unfinished run of the same plan and program. ReplayError (E_RESUME) where there is none."""
    version, others = revision(), ""
    for folder in sorted(runs.iterdir() if runs.is_dir() else [], reverse=True):
        try:
            head = read_json(folder / "run.json", LARGEST_LOG)
        except JsonError:
            continue
        if not isinstance(head, dict) or (head.get("complete") and (folder / SUMMARY).exists()):
            continue
        if (head.get("fingerprint"), head.get("revision")) == (plan.fingerprint, version):
            store = Store(folder)
            store.make()
            return store
        same = head.get("fingerprint") == plan.fingerprint
        others = others or f"; {folder.name} is of {'another revision' if same else 'another corpus or other options'}"
    raise ReplayError(RESUME_ERROR, f"{runs}: holds no unfinished run of this revision with these options{others}")


def remaining(plan: Plan, store: Store) -> list[Log]:
    """The logs that are still to be done, in the order in which they are.

    Documents of logs that have changed since, or that cannot be read, are removed: these logs are done again.
    """
    done = store.done()
    logs = [log for log in plan.logs if file_stem(log.name) + ".json" not in done]
    if done:
        logs += [log for log in plan.logs if file_stem(log.name) + ".json" in done and _stale(log, store)]
    if plan.shuffle is not None:
        logs = [logs[k] for k in np.random.default_rng(plan.shuffle).permutation(len(logs))]
    return logs


def _stale(log: Log, store: Store) -> bool:
    """Whether a document does not say what it should; it is removed then."""
    path = store.file(log.name)
    try:
        document = read_json(path, LARGEST_LOG)
        kept = document.get("sha256") in (None, digest(log.path)) and document.get("log") == log.name
    except (JsonError, AttributeError):
        kept = False
    if not kept:
        path.unlink(missing_ok=True)
    return not kept


def carry_out(
    plan: Plan, store: Store, execute: Execute, on_outcome: Callable[[Outcome | None, int, int], None]
) -> None:
    """Do what remains of a run. `on_outcome` gets each outcome, how many are done and how many there are."""
    baseline = _baseline(store)
    with reserved(store.folder / "run.json"):
        logs = remaining(plan, store)
        store.sweep()
        done = len(plan.logs) - len(logs)
        on_outcome(None, done, len(plan.logs))
        with contextlib.closing(execute(_jobs(plan, store, logs, baseline))) as outcomes:
            for outcome in outcomes:
                done += 1
                on_outcome(outcome, done, len(plan.logs))
        store.sweep()


def _baseline(store: Store) -> Baseline:
    path = store.head().get("baseline")
    return read_baseline(path) if path else Baseline()


def _jobs(plan: Plan, store: Store, logs: Iterable[Log], baseline: Baseline) -> Iterator[Job]:
    folder = os.fspath(store.folder.absolute())
    without = tuple(uncompared(baseline, plan.settings.plain()))
    for log in logs:
        yield Job(
            log=log,
            folder=folder,
            settings=dataclasses.replace(plan.settings, methods=plan.methods_of(log)),
            whole=not plan.partial_methods,
            before=baseline.logs.get(log.name),
            known=tuple(issue for issue in plan.known if issue.concerns(log.name)),
            without=without,
        )
