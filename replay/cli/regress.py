"""`replay regress`: every log of a corpus with every method, compared with a baseline; and `replay regress accept`."""

import json
import pathlib
import sys
from contextlib import AbstractContextManager, nullcontext
from typing import Annotated, Any

from cyclopts import App, Parameter

from replay.base.errors import ReplayError
from replay.base.files import WRITE_ERROR
from replay.base.numbers import count
from replay.cli import drop_output
from replay.cli.accepted import changes_for_people
from replay.cli.against import tell_timing, time_against
from replay.cli.console import Common, Voice
from replay.cli.invoked import recordings_to_paste, to_paste
from replay.cli.optimize import MethodFlags, WeightFlags
from replay.cli.options import UsageError, WholeNumber
from replay.cli.reading import Reading
from replay.cli.regress_plan import check_flags, settings_of
from replay.cli.settings import RUN, Layer, layer_of_assignments, layer_of_file, layer_of_flags, method_names
from replay.cli.usage import ExitStatus, reflowed
from replay.regress.acceptance import Wanted, accepted
from replay.regress.baseline import (
    Baseline,
    check_baseline,
    default_baseline,
    read_baseline,
    write_baseline,
)
from replay.regress.cluster import CLUSTER_ERROR, check_address, connected
from replay.regress.corpus import Known, find_corpus
from replay.regress.finish import FINISH_ERROR, finish
from replay.regress.pool import run_here
from replay.regress.running import Execute, Plan, carry_out, resumed, start
from replay.regress.selection import select
from replay.regress.settings import DIRTY, Recordings
from replay.regress.store import Store
from replay.regress.timing import check_version
from replay.regress.work import Outcome
from replay.report.history import SUMMARY

_FLAT = Parameter(name="*")
_PARTIAL = ("--method", "--tag", "--only")
"""Options that leave a part of the corpus out."""
_FIRST_BASELINE = "baseline.json"
"""The name that is proposed for the baseline of a corpus that is no folder, and has none yet."""
_MOST_HINTS = 5
_SHORT = (WRITE_ERROR, FINISH_ERROR, CLUSTER_ERROR)
"""Errors that come when the work is done: it fell short, rather than that it could not be begun."""

regress = App(
    name="regress",
    help_format="plaintext",
    help_epilogue="Exit status: 0 nothing is worse than the baseline; 1 something is worse, missing or crashed, or a"
    " log is another one; 2 wrong usage; 3 logs could not be read of which nothing is known; 130 interrupted, --resume"
    " does the rest.",
)


@regress.default
@reflowed
def run(
    corpus: str,
    /,
    *,
    method: Annotated[list[str] | None, Parameter(negative=())] = None,
    tag: Annotated[list[str] | None, Parameter(negative=())] = None,
    only: Annotated[list[str] | None, Parameter(negative=())] = None,
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
    set_: Annotated[list[str] | None, Parameter(name="--set", negative=())] = None,
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
    set_
        One option as GROUP.OPTION=VALUE, as for `replay optimize`; may be given several times.
    shuffle
        Work on the logs in the random order of this seed. Results do not depend on it.
    """
    voice = Voice(common or Common())
    check_flags(time_limit, jobs)
    if scheduler is not None:
        check_address(scheduler)
    found = find_corpus(corpus)
    limits: Layer = {RUN: {"time_limit": time_limit, "memory_limit": memory_limit}}
    given: Layer = {RUN: ({"method": tuple(method)} if method else {}) | ({} if seed is None else {"seed": seed})}
    layers = [limits] + ([] if config is None else [layer_of_file(config)])
    layers += [layer_of_assignments(set_ or ()), given, layer_of_flags(None, reading, weights, options)]
    settings, named = settings_of(layers, found, recordings)
    logs, partial = select(found, named, tag or (), only or ())
    compared_with = default_baseline(baseline, found.baseline)
    check_baseline(compared_with, found)
    if against is not None:
        check_version(against)
    plan = Plan(
        corpus=found.path,
        logs=logs,
        known=found.known,
        settings=settings,
        baseline=compared_with,
        partial=partial,
        partial_methods=bool(named),
        shuffle=shuffle,
    )
    with _executor(voice, scheduler, jobs) as execute:
        store = resumed(plan, out) if resume else start(plan, out)
        return _carried_out(voice, plan, store, out, execute, against)


@regress.command
@reflowed
def accept(
    run: pathlib.Path,
    /,
    *,
    baseline: pathlib.Path | None = None,
    only: Annotated[list[str] | None, Parameter(negative=())] = None,
    method: Annotated[list[str] | None, Parameter(negative=())] = None,
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
    store = Store(run)
    head = store.head()
    file = _to_write(run, head, baseline)
    before = read_baseline(file) if file.exists() else Baseline()
    known = [Known(**issue) for issue in head.get("known") or ()]
    wanted = Wanted(logs=only or (), methods=list(method_names(method or ())))
    done = accepted(before, store.documents(), known, head, wanted)
    made, changes = done.baseline, done.changes
    lost = sorted(before.logs.keys() - made.logs.keys())
    voice.show(*changes_for_people(changes), *(f"out: {name}" for name in lost))
    if done.kept:
        voice.show(f"as it was: {count(done.kept, 'result')} of the baseline, by --only and --method")
    write_baseline(file, made)
    if DIRTY in made.revision:
        voice.note(f"{made.revision}: its program is no commit's, so that nobody can make this baseline again")
    extent = f"{count(len(made.logs), 'log')}; {count(len(changes), 'change')}, {count(len(lost), 'log')} out"
    voice.show(f"wrote {file}: {extent}")
    about = {"schema": "replay.accept/1", "exit_status": 0, "baseline": str(file)}
    voice.document(about | {"changes": changes, "out": lost, "kept": done.kept})
    return ExitStatus.OK


def _to_write(run: pathlib.Path, head: dict[str, Any], baseline: pathlib.Path | None) -> pathlib.Path:
    """The file that accepting a run writes. UsageError where the run is not fit to be a baseline."""
    if head.get("partial"):
        raise UsageError(f"{run}: a partial run ({head['partial']}) cannot become the baseline")
    if not head.get("complete"):
        raise UsageError(f"{run}: an unfinished run cannot become the baseline; --resume does the rest")
    if baseline is None and not head.get("accept_to"):
        raise UsageError(f"{run}: was compared with no file; name one: --baseline FILE")
    return baseline or pathlib.Path(head["accept_to"])


def _executor(voice: Voice, scheduler: str | None, jobs: int) -> AbstractContextManager[Execute]:
    if scheduler is not None:
        return connected(scheduler, voice.note)
    return nullcontext(lambda waiting: run_here(waiting, jobs))


def _carried_out(
    voice: Voice, plan: Plan, store: Store, out: pathlib.Path, execute: Execute, against: str | None
) -> int:
    """Do a run, or its rest, and say what came of it; the exit status."""
    from replay.regress.bar import Bar

    voice.note(f"{store.folder}: {count(len(plan.logs), 'log')}, {', '.join(plan.settings.methods)}")

    def progress(outcome: Outcome | None, done: int, total: int) -> None:
        if outcome is None and done:
            voice.note(f"{done} of {total} logs are done")
        bar.outcome(outcome, done, total)

    try:
        with Bar(voice.people, enabled=voice.wants_progress) as bar:
            carry_out(plan, store, execute, progress)
        timed = None if against is None else time_against(voice, plan, store, against)
        said = finish(store.folder, out, _commands(plan, store))
    except KeyboardInterrupt:
        voice.error(f"interrupted; what was finished is kept in {store.folder}")
        voice.error(f"the rest: {_again()}")
        return ExitStatus.INTERRUPTED
    except ReplayError as error:
        if error.code not in _SHORT:
            raise
        voice.error(str(error))
        voice.error(f"the rest: {_again()}")
        return ExitStatus.SHORT
    status = ExitStatus.SHORT if against is not None and timed is None else _status(said)
    try:
        _tell(voice, plan, store, said, status)
        if timed is not None:
            tell_timing(voice, str(against), timed)
    except BrokenPipeError:  # who reads the first lines alone must not turn a regression into a success
        drop_output()
    return status


def _tell(voice: Voice, plan: Plan, store: Store, said: Any, status: ExitStatus) -> None:
    """Say what a run amounts to: the verdict first, what to do last."""
    voice.show(said["headline"])
    voice.show(*(f"  {line}" for line in said["failing"]))
    if said["failing_more"]:
        voice.show(f"  and {said['failing_more']} more")
    voice.show(*(f"  known: {line}" for line in said["known"]), *(f"  {line}" for line in said["passing"]))
    for line in (*said["unread"], *(f"left out: {line}" for line in said["damaged"])):
        voice.error(line)
    if said["other_options"]:
        voice.note(said["other_options"])
    for line in filter(None, (said["unwritten"], said["twice"])):
        voice.note(line)
    voice.show(f"report: {store.folder / 'report.html'}")
    if voice.common.json:
        document = {key: said[key] for key in ("headline", "failing", "known", "passing", "unread", "files")}
        about = {"schema": "replay.regress/1", "exit_status": int(status), "run": str(store.folder)}
        voice.document(about | document | {"summary": json.loads((store.folder / SUMMARY).read_text())})
    for line in said["against_corpus"][:_MOST_HINTS]:
        voice.note(f"{line}: if it is as it should be, change `expect` there; accepting the run does not help")
    if said["state"] == "unjudged" or said["acceptable"]:
        voice.note(_advice(plan, store, said["state"]))


def _status(said: Any) -> ExitStatus:
    if said["state"] == "failed":
        return ExitStatus.SHORT
    return ExitStatus.PARTIAL if said["unread"] or said["damaged"] else ExitStatus.OK


def _commands(plan: Plan, store: Store) -> dict[str, str]:
    """What the reports give to paste."""
    return {"accept": _accept(plan, store), "view": recordings_to_paste(store.folder / "recordings")}


def _accept(plan: Plan, store: Store) -> str:
    """The command that makes a run the baseline; empty for a partial one."""
    if plan.partial:
        return ""
    words = ["regress", "accept", str(store.folder)]
    return to_paste(*words) if plan.baseline is not None else to_paste(*words, "--baseline", _FIRST_BASELINE)


def _advice(plan: Plan, store: Store, state: str) -> str:
    if plan.partial:
        return f"a partial run ({plan.partial}) cannot become the baseline; the whole: {_whole()}"
    why = "if this is as it should be" if state == "failed" else "there is no baseline yet; to make this run the one"
    named = "" if plan.baseline is not None else f" (and name it from then on: --baseline {_FIRST_BASELINE})"
    return f"{why}{named}: {_accept(plan, store)}"


def _whole() -> str:
    """This command without what makes its run partial."""
    kept, words = list[str](), iter(sys.argv[1:])
    for word in words:
        flag, sign, value = word.partition("=")
        if flag in (*_PARTIAL, "--set") and not sign:
            value = next(words, "")
        if flag in _PARTIAL or flag == "--resume" or (flag == "--set" and value.partition("=")[0].strip() == "method"):
            continue
        kept += [flag, value] if flag == "--set" else [word]
    return to_paste(*kept)


def _again() -> str:
    return to_paste(*(word for word in sys.argv[1:] if word != "--resume"), "--resume")
