"""`replay regress`: every log of a corpus with every method, compared with a baseline; and `replay regress accept`."""

import json
import math
import pathlib
from contextlib import AbstractContextManager, nullcontext
from typing import Annotated

from cyclopts import App, Parameter

from optim.methods import METHODS
from replay.base.documents import plain
from replay.base.errors import ReplayError, UsageError
from replay.base.files import WRITE_ERROR
from replay.base.numbers import count
from replay.base.run_folder import SUMMARY_FILE
from replay.base.schemas.timing import TimingDocument
from replay.cli.console import Common, Voice
from replay.cli.options import WholeNumber
from replay.cli.reading import Reading
from replay.cli.regress_progress import RunProgress
from replay.cli.regress_view import again, changes_of_baseline, commands, show_advice, show_conclusion, show_timing
from replay.cli.settings import (
    MOST_JOBS,
    RUN,
    Layer,
    MethodFlags,
    WeightFlags,
    layer_of_file,
    layer_of_flags,
    method_names,
    settled,
)
from replay.cli.usage import ExitStatus, drop_output, reflowed
from replay.regress.acceptance import Selection, accept_run
from replay.regress.baseline import baseline_file, check_baseline, write_baseline
from replay.regress.cluster import CLUSTER_ERROR, check_address, connected
from replay.regress.corpus import Corpus, find_corpus, select
from replay.regress.finish import FINISH_ERROR, finish
from replay.regress.folder import RunFolder
from replay.regress.job import Outcome
from replay.regress.options import Options, Recordings
from replay.regress.plan import Execute, Plan, carry_out, resumed, start
from replay.regress.program import DIRTY
from replay.regress.supervisor import run_here
from replay.regress.timing import AGAINST_ERROR, check_version, time_against
from replay.report.conclusion import Conclusion
from replay.run.limits import Limits

_FLAT = Parameter(name="*")
_Words = Annotated[list[str] | None, Parameter(negative=())]
_SHORT = (WRITE_ERROR, FINISH_ERROR, CLUSTER_ERROR)
"""Errors that come when the work is done: the run fell short, rather than that it could not begin."""

regress = App(
    name="regress",
    help_format="plaintext",
    help_epilogue="Exit status: 0 nothing is worse than the baseline; 1 something is worse, missing or crashed, or a"
    " log file changed; 2 wrong usage; 3 logs could not be read, unexpectedly; 130 interrupted, --resume"
    " does the rest.",
)


@regress.default
@reflowed
def run(
    corpus: str,
    /,
    *,
    method: _Words = None,
    tag: _Words = None,
    only: _Words = None,
    baseline: pathlib.Path | None = None,
    out: pathlib.Path = pathlib.Path("runs"),
    resume: Annotated[bool, Parameter(negative=())] = False,
    against: str | None = None,
    jobs: WholeNumber = 2,
    scheduler: str | None = None,
    recordings: Recordings = "changed",
    seed: WholeNumber | None = None,
    time_limit: float = 120.0,
    memory_limit: WholeNumber = 4096,
    config: pathlib.Path | None = None,
    shuffle: WholeNumber | None = None,
    common: Annotated[Common | None, _FLAT] = None,
    reading: Annotated[Reading | None, _FLAT] = None,
    weights: Annotated[WeightFlags | None, _FLAT] = None,
    options: Annotated[MethodFlags | None, _FLAT] = None,
) -> int:
    """Run every log of a corpus through every method, compare with a baseline, and write reports.

    Parameters
    ----------
    corpus
        A folder (with all below it), a glob, a file with one path on each line, or s3://BUCKET/PREFIX.
    method
        A method to run, by name, or some joined by +; several with commas between, or by giving this several times. By
        default those that corpus.toml names, else all. A run of some methods is partial: it cannot become the baseline.
    tag
        Run only logs that have this tag or class in corpus.toml; may be given several times. Makes the run partial.
    only
        Run only logs whose name fits this pattern, as 'full/odd_*'; may be given several times. Makes the run partial.
    baseline
        File to compare with; by default baseline.json in the corpus's folder.
    out
        Folder in which runs are kept, each in a folder named by time and revision.
    resume
        Do the rest of the newest unfinished run of this corpus with these options.
    against
        Also time this version and another one in turns, on every log: the folder of an installed environment, or a git
        revision. Exit status 1 if this one is slower for certain.
    jobs
        Number of logs that are worked on at a time.
    scheduler
        Work on a Dask cluster instead: tcp://127.0.0.1:PORT or tls://HOST:PORT. Needs the extra `cluster`; the folder
        of the run must be one that all workers see.
    recordings
        Which cases get a recording; changed: those that are not the same as in the baseline.
    seed
        Seed for every method that has one; 0 by default.
    time_limit
        Processor time that each method has for a case [s], compiling not counted: a watchdog, which does not depend on
        what else the machine does. By the clock on the wall a method may take five times as long.
    memory_limit
        Memory that the process of a log, and that of its methods, may use [MiB].
    config
        TOML file with options, as for `replay optimize`.
    shuffle
        Work on the logs in the random order of this seed. Results do not depend on it.
    """
    voice = Voice(common or Common())
    if not 0.0 < time_limit < math.inf:
        raise UsageError(f"--time-limit is {time_limit:g}, expected more than 0 s")
    if not 1 <= jobs <= MOST_JOBS:
        raise UsageError(f"--jobs is {jobs}, expected 1 to {MOST_JOBS}")
    if scheduler is not None:
        check_address(scheduler)
    found = find_corpus(corpus)
    limits: Layer = {RUN: {"time_limit": time_limit, "memory_limit": memory_limit}}
    given: Layer = {RUN: ({"method": tuple(method)} if method else {}) | ({} if seed is None else {"seed": seed})}
    layers = [limits] + ([] if config is None else [layer_of_file(config)])
    layers += [given, layer_of_flags(None, reading, weights, options)]
    chosen, named = _options(layers, found, recordings)
    logs, partial = select(found, named, tag or (), only or ())
    compared_with = baseline_file(baseline, found.baseline)
    check_baseline(compared_with, found.path, {log.name for log in found.logs})
    if against is not None:
        check_version(against)
    plan = Plan(
        corpus=found.path,
        logs=logs,
        known=found.known,
        options=chosen,
        baseline=compared_with,
        partial=partial,
        partial_methods=bool(named),
        shuffle=shuffle,
    )
    with _executor(voice, scheduler, jobs) as execute:
        folder = resumed(plan, out) if resume else start(plan, out)
        return _carried_out(voice, plan, folder, execute, against)


@regress.command
@reflowed
def accept(
    run: pathlib.Path,
    /,
    *,
    baseline: pathlib.Path | None = None,
    only: _Words = None,
    method: _Words = None,
    common: Annotated[Common | None, _FLAT] = None,
) -> int:
    """Make a run the baseline: print every change against the present one, and write it.

    A run that is unfinished or partial is refused. What a known issue covers keeps the figures that it had.

    Parameters
    ----------
    run
        Folder of the run.
    baseline
        File to write; by default that with which the run was compared.
    only
        Take over only logs whose name fits this pattern, as 'full/odd_*'; may be given several times.
    method
        Take over only this method's results, by name; several with commas between, or by giving this several times.
    """
    voice = Voice(common or Common())
    file, done = accept_run(run, baseline, Selection(logs=only or (), methods=list(method_names(method or ()))))
    voice.show(*changes_of_baseline(done.changes), *(f"out: {name}" for name in done.lost))
    if done.kept:
        voice.show(f"unchanged: {count(done.kept, 'result')} of the baseline, left out by --only and --method")
    write_baseline(file, done.baseline)
    revision = done.baseline.revision
    if DIRTY in revision:
        voice.note(f"{revision}: made by a program with uncommitted changes, so this baseline cannot be reproduced")
    extent = f"{count(len(done.baseline.logs), 'log')}; {count(len(done.changes), 'change')}"
    voice.show(f"wrote {file}: {extent}, {count(len(done.lost), 'log')} out")
    about = {"schema": "replay.accept/1", "exit_status": 0, "baseline": str(file)}
    voice.document(about | {"changes": plain(done.changes), "out": list(done.lost), "kept": done.kept})
    return ExitStatus.OK


def _options(layers: list[Layer], corpus: Corpus, recordings: Recordings) -> tuple[Options, tuple[str, ...]]:
    """The options of a run, and the methods that were asked for: else those that the corpus names, else all."""
    made = settled(layers)
    named = made.run.method or ()
    if not named:
        wanted = dict.fromkeys(name for log in corpus.logs for name in log.methods or METHODS)
        made = settled([*layers, {RUN: {"method": tuple(wanted)}}])
    limits = Limits(time_s=made.run.time_limit, by_processor=True, memory_mib=made.run.memory_limit)
    about = {"methods": made.methods, "read": made.read, "weights": made.weights, "seed": made.run.seed}
    return Options(**about, limits=limits, recordings=recordings), named


def _executor(voice: Voice, scheduler: str | None, jobs: int) -> AbstractContextManager[Execute]:
    if scheduler is not None:
        return connected(scheduler, voice.note)
    return nullcontext(lambda waiting: run_here(waiting, jobs))


def _carried_out(voice: Voice, plan: Plan, folder: RunFolder, execute: Execute, against: str | None) -> int:
    """Do a run, or its rest, and show the verdict; the exit status."""
    voice.note(f"{folder.path}: {count(len(plan.logs), 'log')}, {', '.join(plan.options.methods)}")

    def on_outcome(outcome: Outcome | None, done: int, total: int) -> None:
        if outcome is None and done:
            voice.note(f"{done} of {total} logs are done")
        progress.outcome(outcome, done, total)

    try:
        with RunProgress(voice.people, enabled=voice.wants_progress) as progress:
            carry_out(plan, folder, execute, on_outcome)
        timing = None if against is None else _timed(voice, plan, folder, against)
        found = finish(folder.path, folder.path.parent, commands(plan, folder))
    except KeyboardInterrupt:
        voice.error(f"interrupted; what was finished is kept in {folder.path}")
        voice.error(f"the rest: {again()}")
        return ExitStatus.INTERRUPTED
    except ReplayError as error:
        if error.code not in _SHORT:
            raise
        voice.error(str(error))
        voice.error(f"the rest: {again()}")
        return ExitStatus.SHORT
    status = ExitStatus.SHORT if against is not None and timing is None else _status(found)
    try:
        show_conclusion(voice, folder, found)
        voice.document(_document(folder, found, status) if voice.common.json else {})
        show_advice(voice, plan, folder, found)
        if timing is not None:
            show_timing(voice, timing)
    except BrokenPipeError:  # a reader of the first lines alone must not turn a regression into a success
        drop_output()
    return status


def _timed(voice: Voice, plan: Plan, folder: RunFolder, version: str) -> TimingDocument | None:
    """Time this version and another one in turns; None, and a line that says why, where that fails."""
    try:
        with RunProgress(voice.people, enabled=voice.wants_progress, unit="pairs") as progress:
            return time_against(plan, folder, version, progress.count)
    except ReplayError as error:
        if error.code != AGAINST_ERROR:
            raise
        voice.error(str(error))
        return None


def _status(found: Conclusion) -> ExitStatus:
    if found.state == "failed":
        return ExitStatus.SHORT
    return ExitStatus.PARTIAL if found.unread or found.damaged else ExitStatus.OK


def _document(folder: RunFolder, found: Conclusion, status: ExitStatus) -> dict[str, object]:
    lines = {key: getattr(found, key) for key in ("headline", "failing", "known", "passing", "unread", "files")}
    about = {"schema": "replay.regress/1", "exit_status": int(status), "run": str(folder.path)}
    return about | lines | {"summary": json.loads((folder.path / SUMMARY_FILE).read_text())}
