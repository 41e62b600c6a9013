"""One job of a run: read a log, run the methods, compare, record, publish the log's document."""

import dataclasses
import os
import pathlib
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import msgspec

from replay.base.errors import LogError, ReplayError
from replay.base.run_folder import RECORDINGS
from replay.base.schemas.baseline import LogFigures
from replay.base.schemas.corpus import Known
from replay.base.schemas.log import LOG_SCHEMA, CaseResult, LogFailure, LogResults, MethodResult, Recorded, Work
from replay.base.schemas.verdicts import Comparison
from replay.pipeline import Solver, optimize, read, record
from replay.regress.compare import compare_log, worst
from replay.regress.corpus import CorpusLog
from replay.regress.folder import RunFolder, file_stem
from replay.regress.options import Options
from replay.regress.sources import STORES, digest, local_file
from replay.run.case import Case, ReadReport
from replay.run.outcome import MethodRun, Run
from replay.run.results import audit_document, metrics_document, read_document

OnStage = Callable[[str], None]
"""Takes the name of the stage that a job has reached."""


@dataclass(frozen=True, kw_only=True)
class Job:
    """One log, and all that is needed to work on it in another process."""

    log: CorpusLog
    folder: str
    """Folder of the run."""
    options: Options
    """Options of the run, with the methods to run on this log."""
    whole: bool = True
    """Whether these are all methods that the corpus wants for it."""
    before: LogFigures | None = None
    """The baseline's figures of the log."""
    known: tuple[Known, ...] = ()
    without: tuple[str, ...] = ()
    """Figures that are not compared."""
    place: str = ""
    """Path of the log, if `log.path` is relative to another working directory."""

    @property
    def file(self) -> str:
        """Path of the log; on a cluster, one that holds in every working directory."""
        return self.place or self.log.path

    def anywhere(self) -> "Job":
        """The same job for processes with another working directory."""
        is_file = not self.log.path.startswith(STORES)
        return dataclasses.replace(self, place=os.path.abspath(self.log.path)) if is_file else self  # noqa: PTH100


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """The outcome of a job, without its results: these are in the log's document."""

    name: str
    state: str
    """same, worse, crashed, or unread; skipped where the document was there already."""


def run_job(job: Job, workers: Solver, on_stage: OnStage) -> Outcome:
    """Do a job; `on_stage` is called at each stage. A failure of the log or of a method ends in the document."""
    folder = RunFolder(job.folder)
    if folder.file(job.log.name).exists():
        return Outcome(name=job.log.name, state="skipped")
    folder.note_attempt(job.log.name)
    try:
        document, runs = _results(job, workers, on_stage)
    except ReplayError as error:
        return publish_error(job, error.code, _message(job, error))
    except MemoryError:
        return publish_error(job, "E_MEMORY", f"needs more than {job.options.limits.memory_mib} MiB")
    except Exception as error:  # a border: a defect of ours, which must not cost the other logs
        words = " ".join(str(error).split())
        return publish_error(job, "E_INTERNAL", f"internal error, {type(error).__name__}: {words}")
    found = compare_log(document, job.before, job.known, whole=job.whole, without=job.without)
    cases = [
        _recorded(job, case, run, on_stage) if _wants_recording(job, case.case, found) else case
        for case, run in zip(document.cases, runs, strict=True)
    ]
    return _published(job, msgspec.structs.replace(document, cases=tuple(cases)), worst(found))


def publish_error(job: Job, code: str, message: str) -> Outcome:
    """Publish that a log could not be worked on."""
    document = _document(job, error=LogFailure(code=code, message=message))
    found = compare_log(document, job.before, job.known, whole=job.whole)
    announced = code == job.log.expect or any(each.verdict in ("same", "known") for each in found)
    state = worst(found)
    return _published(job, document, "unread" if state == "same" and not announced else state)


def _published(job: Job, document: LogResults, state: str) -> Outcome:
    published = RunFolder(job.folder).publish(document)
    return Outcome(name=job.log.name, state=state if published else "skipped")


def _results(job: Job, workers: Solver, on_stage: OnStage) -> tuple[LogResults, list[Run]]:
    on_stage("reading")
    options, runs = job.options, []
    for number, case in enumerate(read(local_file(job.file), options.read)):
        named = _named(job, case, number)
        on_stage(f"measuring {named.name}")
        runs.append(
            optimize(
                named,
                options.methods,
                weights=options.weights,
                seed=options.seed,
                on_start=lambda name, case=named: on_stage(f"method {name} on {case.name}"),
                progress=False,
                workers=workers,
            )
        )
    sha256 = runs[0].case.sha256 if runs else None
    return _document(job, cases=tuple(map(_case, runs)), sha256=sha256), runs


def _named(job: Job, case: Case, number: int) -> Case:
    """A case of a log with the name and the path that the corpus gives it, in its notes too."""
    notes = tuple(note.replace(job.file, job.log.path) for note in case.read.notes)
    return dataclasses.replace(
        case,
        name=f"{job.log.name}/{number}",
        log=pathlib.Path(job.log.path),
        read=dataclasses.replace(case.read, notes=notes),
    )


def _document(
    job: Job,
    *,
    error: LogFailure | None = None,
    cases: tuple[CaseResult, ...] = (),
    sha256: str | None = None,
) -> LogResults:
    log = job.log
    return LogResults(
        schema=LOG_SCHEMA,
        log=log.name,
        path=log.path,
        sha256=sha256 or digest(job.file),
        kind=log.kind,
        tags=log.tags,
        expect=log.expect,
        declared=log.declared,
        error=error,
        cases=cases,
    )


def _case(run: Run) -> CaseResult:
    return CaseResult(
        case=run.case.name,
        recorded=Recorded(metrics=metrics_document(run.recorded_metrics), audit=audit_document(run.recorded_audit)),
        read=read_document(_named_notes(run.case)),
        methods=tuple(map(_method, run.methods)),
    )


def _named_notes(case: Case) -> ReadReport:
    """How a case was read, with notes that name the case instead of its file."""
    notes = tuple(note.replace(str(case.log), case.name) for note in case.read.notes)
    return dataclasses.replace(case.read, notes=notes)


def _method(run: MethodRun) -> MethodResult:
    return MethodResult(
        name=run.name,
        status=run.status,
        stop=run.stop,
        reason=run.reason,
        metrics=metrics_document(run.metrics),
        audit=audit_document(run.audit),
        wall_s=run.wall_s,
        rejected=None if run.rejected is None else audit_document(run.rejected),
        work=Work(iterations=run.iterations, evaluations=len(run.history)),
        traceback=run.traceback or msgspec.UNSET,
    )


def _wants_recording(job: Job, case: str, found: Sequence[Comparison]) -> bool:
    """Whether a case is recorded: for `changed`, where it is not the same as in the baseline and was there."""
    if job.options.recordings != "changed":
        return job.options.recordings == "all"
    changed = ("worse", "crashed", "known", "better")
    return any(each.case == case and each.verdict in changed for each in found)


def _recorded(job: Job, case: CaseResult, run: Run, on_stage: OnStage) -> CaseResult:
    """Write the recording of a case; a failure is noted in the case, since the results do not need the recording."""
    on_stage(f"recording {case.case}")
    name = f"{RECORDINGS}/{file_stem(case.case)}.rrd"
    try:
        record(run, pathlib.Path(job.folder) / name)
    except ReplayError as error:
        return msgspec.structs.replace(case, recording=None, recording_error=str(error))
    return msgspec.structs.replace(case, recording=name)


def _message(job: Job, error: ReplayError) -> str:
    """The error's line, without the path of a copy on this machine."""
    if error.code == "E_NOT_FOUND" and job.log.declared:
        return f"{error.message}; {job.log.declared} names it"
    if isinstance(error, LogError) and error.path != job.log.path:
        return error.message.replace(error.path, job.log.path)
    return error.message
