"""What is done with one log: read it, run the methods, compare, record, publish its document."""

import dataclasses
import hashlib
import os
import pathlib
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

from replay.base.errors import LogError, ReplayError
from replay.logs import read_cases
from replay.regress.compare import Entry, compare_log, worst
from replay.regress.corpus import STORES, Known, Log
from replay.regress.settings import Settings
from replay.regress.store import Store, file_stem
from replay.report.reading import LOG_SCHEMA
from replay.run.case import Case
from replay.run.judge import MethodRun, Run, run_case
from replay.run.solving import SolveEach

Tell = Callable[[str], None]


@dataclass(frozen=True, kw_only=True)
class Job:
    """One log, and all that is needed to work on it in another process."""

    log: Log
    folder: str
    """Of the run."""
    settings: Settings
    """With the methods that are to be run on this log."""
    whole: bool = True
    """Whether these are all that the corpus wants of it."""
    before: Mapping[str, Any] | None = None
    """The baseline's entry, where there is one."""
    known: tuple[Known, ...] = ()
    without: tuple[str, ...] = ()
    """Metrics that are not compared."""
    place: str = ""
    """Where the log is, if `log.path` is relative to another working directory."""

    @property
    def file(self) -> str:
        """Where the log is; on a cluster, the same from every working directory."""
        return self.place or self.log.path

    def anywhere(self) -> "Job":
        """The same job for processes of another working directory."""
        is_file = not self.log.path.startswith(STORES)
        return dataclasses.replace(self, place=os.path.abspath(self.log.path)) if is_file else self  # noqa: PTH100


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What became of a job; its results are in its document, never here."""

    name: str
    state: str
    """same, worse, crashed, or unread; skipped where its document was there already."""


def work(job: Job, solve: SolveEach, tell: Tell) -> Outcome:
    """Do a job; `tell` hears of each stage. What a log or a method does wrong ends in the document."""
    store = Store(job.folder)
    if store.file(job.log.name).exists():
        return Outcome(name=job.log.name, state="skipped")
    store.note_attempt(job.log.name)
    try:
        document, runs = _worked(job, solve, tell)
    except ReplayError as error:
        return publish_error(job, error.code, _message(job, error))
    except MemoryError:
        return publish_error(job, "E_MEMORY", f"needs more than {job.settings.memory_limit} MiB")
    except Exception as error:  # a border: a defect of ours, which must not cost the other logs
        words = " ".join(str(error).split())
        return publish_error(job, "E_INTERNAL", f"internal error, {type(error).__name__}: {words}")
    entries = compare_log(document, job.before, job.known, whole=job.whole, without=job.without)
    for case, run in zip(document["cases"], runs, strict=True):
        if _wants_recording(job, case["case"], entries):
            tell(f"recording {case['case']}")
            case |= _recorded(job, run)
    return _published(job, document, worst(entries))


def publish_error(job: Job, code: str, message: str) -> Outcome:
    """Publish that a log could not be worked on."""
    document = _outline(job) | {"error": {"code": code, "message": message}, "cases": []}
    entries = compare_log(document, job.before, job.known, whole=job.whole)
    known = code == job.log.expect or any(entry["verdict"] in ("same", "known") for entry in entries)
    state = worst(entries)
    return _published(job, document, "unread" if state == "same" and not known else state)


def _published(job: Job, document: Mapping[str, Any], state: str) -> Outcome:
    published = Store(job.folder).publish(document)
    return Outcome(name=job.log.name, state=state if published else "skipped")


def _worked(job: Job, solve: SolveEach, tell: Tell) -> tuple[dict[str, Any], list[Run]]:
    tell("reading")
    runs = []
    for number, case in enumerate(read_cases(local_file(job.file), job.settings.read)):
        named = dataclasses.replace(
            case,
            name=f"{job.log.name}/{number}",
            log=pathlib.Path(job.log.path),
            read=dataclasses.replace(case.read, notes=_as_named(job, case.read.notes)),
            problem=dataclasses.replace(case.problem, weights=job.settings.weights),
        )
        tell(f"measuring {named.name}")
        runs.append(
            run_case(
                named,
                job.settings.methods,
                on_start=lambda name, case=named: tell(f"method {name} on {case.name}"),
                seed=job.settings.seed,
                solve=solve,
            )
        )
    document = _outline(job) | {"error": None, "cases": [_case(run) for run in runs]}
    return document | {"sha256": runs[0].case.sha256 if runs else None}, runs


def _as_named(job: Job, notes: Iterable[str]) -> tuple[str, ...]:
    """Notes on a log with the path that the corpus gives it."""
    return tuple(note.replace(job.file, job.log.path) for note in notes)


def _outline(job: Job) -> dict[str, Any]:
    log = job.log
    return {
        "schema": LOG_SCHEMA,
        "log": log.name,
        "path": log.path,
        "sha256": digest(job.file),
        "class": log.kind,
        "tags": list(log.tags),
        "expect": log.expect,
        "declared": log.declared,
    }


def _case(run: Run) -> dict[str, Any]:
    recorded = {"metrics": dataclasses.asdict(run.recorded_metrics), "audit": run.recorded_audit.to_dict()}
    return {
        "case": run.case.name,
        "recorded": recorded,
        "read": _read(run.case),
        "methods": list(map(_method, run.methods)),
    }


def _read(case: Case) -> dict[str, Any]:
    read = dataclasses.asdict(case.read)
    return read | {"notes": [note.replace(str(case.log), case.name) for note in case.read.notes]}


def _method(run: MethodRun) -> dict[str, Any]:
    fields = ("name", "status", "stop", "reason", "wall_s")
    counters = {"iterations": run.iterations, "evaluations": len(run.history)}
    found = {key: getattr(run, key) for key in fields} | {"work": counters}
    found |= {"metrics": dataclasses.asdict(run.metrics), "audit": run.audit.to_dict()}
    found |= {"rejected": None if run.rejected is None else run.rejected.to_dict()}
    return found | {"traceback": run.traceback} if run.traceback else found


def _wants_recording(job: Job, case: str, entries: list[Entry]) -> bool:
    """Whether a case is recorded: for `changed`, where it is not the same as in the baseline and was there."""
    if job.settings.recordings != "changed":
        return job.settings.recordings == "all"
    changed = ("worse", "crashed", "known", "better")
    return any(entry["case"] == case and entry["verdict"] in changed for entry in entries)


def _recorded(job: Job, run: Run) -> dict[str, Any]:
    """Write the recording of a case: its path within the run's folder, or why there is none; results do not need it."""
    from replay.recording import write_recording  # Rerun takes a second to load

    name = f"recordings/{file_stem(run.case.name)}.rrd"
    try:
        write_recording(run, pathlib.Path(job.folder) / name)
    except ReplayError as error:
        return {"recording": None, "recording_error": str(error)}
    return {"recording": name}


def local_file(path: str) -> pathlib.Path:
    """A log as a file of this machine; of an object store, a copy that is kept."""
    if path.startswith(STORES):
        from replay.regress.stores import fetched

        return fetched(path)
    return pathlib.Path(path)


def digest(path: str) -> str | None:
    """SHA-256 of a local file in hexadecimal digits; None where it cannot be read, and for an object store."""
    if path.startswith(STORES):
        return None
    try:
        if not os.path.isfile(path):  # noqa: PTH113 - a pipe would block
            return None
        with pathlib.Path(path).open("rb") as file:
            return hashlib.file_digest(file, "sha256").hexdigest()
    except (OSError, ValueError):
        return None


def _message(job: Job, error: ReplayError) -> str:
    """The error's line; a copy's place on this machine is nobody's business."""
    if error.code == "E_NOT_FOUND" and job.log.declared:
        return f"{error.message}; {job.log.declared} names it"
    if isinstance(error, LogError) and error.path != job.log.path:
        return error.message.replace(error.path, job.log.path)
    return error.message
