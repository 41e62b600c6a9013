"""Plan a regression run, start or resume it, and carry it out."""

import contextlib
import dataclasses
import datetime
import errno
import os
import pathlib
from collections.abc import Callable, Generator, Iterable, Iterator
from dataclasses import dataclass

import numpy as np

from optim.model.method import Method
from replay.base.documents import DocumentError, read_json
from replay.base.errors import ReplayError
from replay.base.files import WRITE_ERROR, reserved
from replay.base.run_folder import HEAD, SUMMARY_FILE
from replay.base.schemas.baseline import Baseline
from replay.base.schemas.corpus import Known
from replay.base.schemas.log import LARGEST_LOG, LogResults
from replay.base.schemas.run import RUN_SCHEMA, CorpusPlace, RunHead
from replay.regress.baseline import read_baseline
from replay.regress.corpus import CorpusLog
from replay.regress.folder import RunFolder, file_stem
from replay.regress.job import Job, Outcome
from replay.regress.options import Options, fingerprint, uncompared
from replay.regress.program import machine, revision, versions
from replay.regress.sources import digest

RESUME_ERROR = "E_RESUME"
Execute = Callable[[Iterable[Job]], Generator[Outcome]]
"""Does jobs somewhere: `supervisor.run_here`, or a cluster."""
OnOutcome = Callable[[Outcome | None, int, int], None]
"""Takes an outcome (None at the start), the number of logs that are done, and the number of all logs."""


@dataclass(frozen=True, kw_only=True)
class Plan:
    """What a run is to do."""

    corpus: str
    logs: tuple[CorpusLog, ...]
    """Selected logs."""
    known: tuple[Known, ...]
    options: Options
    baseline: pathlib.Path | None = None
    """File that the run is compared with, and that accepting it writes; it need not exist."""
    partial: str = ""
    """The selection of logs or methods in words; empty for the whole corpus."""
    partial_methods: bool = False
    """Whether methods were selected."""
    shuffle: int | None = None
    """Seed of a random order of the logs."""

    @property
    def fingerprint(self) -> str:
        """Digest that is equal for runs with the same logs, selection and options."""
        options = self.options.document()
        return fingerprint([self.corpus, self.logs, options, self.options.recordings, str(self.baseline)])

    def methods_of(self, log: CorpusLog) -> dict[str, Method]:
        """The methods that are run on a log."""
        methods = self.options.methods
        return {name: method for name, method in methods.items() if not log.methods or name in log.methods}


def start(plan: Plan, runs: pathlib.Path) -> RunFolder:
    """Make the folder of a new run, named by time and revision. Raises ReplayError (E_WRITE)."""
    now = datetime.datetime.now(datetime.UTC)
    version = revision()
    name = f"{now:%Y-%m-%dT%H-%M-%SZ}_{version}"
    try:
        runs.mkdir(parents=True, exist_ok=True)
        path = _new_folder(runs, name)
    except OSError as error:
        raise ReplayError(WRITE_ERROR, f"{runs}: {error.strerror}") from error
    folder = RunFolder(path)
    folder.make()
    folder.write_head(_head(plan, f"{now:%Y-%m-%dT%H:%M:%SZ}", version))
    return folder


def _new_folder(runs: pathlib.Path, name: str) -> pathlib.Path:
    for number in range(1, 1000):
        folder = runs / (name if number == 1 else f"{name}_{number}")
        with contextlib.suppress(FileExistsError):
            folder.mkdir()
            return folder
    raise FileExistsError(errno.EEXIST, "a thousand runs have begun in one second")


def _head(plan: Plan, created: str, version: str) -> RunHead:
    options = plan.options.document()
    given = None if plan.baseline is None else str(plan.baseline.absolute())
    exists = plan.baseline is not None and plan.baseline.exists()
    return RunHead(
        schema=RUN_SCHEMA,
        created=created,
        revision=version,
        fingerprint=plan.fingerprint,
        versions=versions(),
        machine=machine(),
        corpus=CorpusPlace(path=plan.corpus, num_logs=len(plan.logs)),
        logs=tuple(log.name for log in plan.logs),
        methods=tuple(plan.options.methods),
        options=options,
        options_fingerprint=fingerprint(options),
        partial=plan.partial,
        partial_methods=plan.partial_methods,
        known=plan.known,
        baseline=given if exists else None,
        accept_to=given,
    )


def resumed(plan: Plan, runs: pathlib.Path) -> RunFolder:
    """Find the newest unfinished run of the same plan and program. Raises ReplayError (E_RESUME)."""
    version, others = revision(), ""
    for path in sorted(runs.iterdir() if runs.is_dir() else [], reverse=True):
        folder = RunFolder(path)
        try:
            head = folder.head()
        except ReplayError:
            continue
        if head.complete and (path / SUMMARY_FILE).exists():
            continue
        if (head.fingerprint, head.revision) == (plan.fingerprint, version):
            folder.make()
            return folder
        same = head.fingerprint == plan.fingerprint
        others = others or f"; {path.name} is of {'another revision' if same else 'another corpus or other options'}"
    raise ReplayError(RESUME_ERROR, f"{runs}: holds no unfinished run of this revision with these options{others}")


def remaining(plan: Plan, folder: RunFolder) -> list[CorpusLog]:
    """The logs that are still to be done, in the order in which they will be.

    Documents of logs that have changed since, or that cannot be read, are removed: these logs are done again.
    """
    done = folder.done()
    logs = [log for log in plan.logs if file_stem(log.name) + ".json" not in done]
    if done:
        logs += [log for log in plan.logs if file_stem(log.name) + ".json" in done and _removed(log, folder)]
    if plan.shuffle is not None:
        logs = [logs[k] for k in np.random.default_rng(plan.shuffle).permutation(len(logs))]
    return logs


def _removed(log: CorpusLog, folder: RunFolder) -> bool:
    """Remove a log's document if it is not that of the log as it is now; whether it was removed."""
    path = folder.file(log.name)
    try:
        document = read_json(path, LogResults, LARGEST_LOG)
        kept = document.sha256 in (None, digest(log.path)) and document.log == log.name
    except DocumentError:
        kept = False
    if not kept:
        path.unlink(missing_ok=True)
    return not kept


def carry_out(plan: Plan, folder: RunFolder, execute: Execute, on_outcome: OnOutcome) -> None:
    """Do what remains of a run."""
    baseline = read_baseline(folder.head().baseline)
    with reserved(folder.path / HEAD):
        logs = remaining(plan, folder)
        folder.sweep()
        done = len(plan.logs) - len(logs)
        on_outcome(None, done, len(plan.logs))
        with contextlib.closing(execute(jobs_of(plan, folder, logs, baseline))) as outcomes:
            for outcome in outcomes:
                done += 1
                on_outcome(outcome, done, len(plan.logs))
        folder.sweep()


def jobs_of(plan: Plan, folder: RunFolder, logs: Iterable[CorpusLog], baseline: Baseline) -> Iterator[Job]:
    """The jobs of a run for some of its logs."""
    path = os.fspath(folder.path.absolute())
    without = tuple(uncompared(baseline, plan.options.document()))
    for log in logs:
        yield Job(
            log=log,
            folder=path,
            options=dataclasses.replace(plan.options, methods=plan.methods_of(log)),
            whole=not plan.partial_methods,
            before=baseline.logs.get(log.name),
            known=tuple(issue for issue in plan.known if issue.concerns(log.name)),
            without=without,
        )
