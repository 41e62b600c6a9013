"""What `replay optimize` does: log by log and case by case, with whatever fails kept to itself."""

import dataclasses
import pathlib
from collections.abc import Iterator, Mapping, Sequence
from contextlib import AbstractContextManager, contextmanager, nullcontext
from dataclasses import asdict
from functools import partial
from typing import Any

from optim.model.method import Method
from optim.model.objective import Weights
from optim.model.result import Iterate
from replay.base.documents import plain
from replay.base.errors import LogError, OutputLost, ReplayError
from replay.base.files import reserved
from replay.base.kernels import any_compiled
from replay.base.schemas.results import ResultsDocument, ToolDocument
from replay.cli.console import Voice
from replay.cli.outputs import Names, Outputs
from replay.cli.tables import reasons, recorded_failures, remarks, result_table, verdict
from replay.cli.usage import ExitStatus
from replay.logs import ReadOptions, read_cases
from replay.logs.export import write_export
from replay.recording.viewer import LiveView
from replay.run.case import Case
from replay.run.judge import Interrupted, run_case
from replay.run.limits import NO_LIMITS, Limits
from replay.run.outcome import MethodRun, Run
from replay.run.progress import Progress
from replay.run.results import audit_document, program, to_document, write_results
from replay.run.solving import SolveEach, solve_in_turn
from replay.run.worker import Workers, can_isolate, usable_cores


@dataclasses.dataclass(kw_only=True)
class LogEntry:
    """What became of one log."""

    log: str
    error: str | None = None
    """One line, if the log could not be used."""
    lost: bool = False
    """Part of the log could not be read."""
    fell_short: bool = False
    """A method or an audit failed, or a file could not be written."""
    cases: list[dict[str, Any]] = dataclasses.field(default_factory=list)
    """One for each case that was run, for the JSON document."""
    files: list[str] = dataclasses.field(default_factory=list)
    """What was written of the log as a whole."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class _Work:
    """One log while it is worked on."""

    log: pathlib.Path
    entry: LogEntry
    position: str
    """Which log of how many it is, as 2/5."""
    solver: SolveEach
    finished: list[Run] = dataclasses.field(default_factory=list)
    """What there is of it so far."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Origin:
    """The earlier run that is repeated."""

    source: str
    """The results file."""
    sha256: str
    """Of its log."""
    case: str
    """Its request, as STEM/0."""
    tool: ToolDocument
    """The program that made it."""

    @classmethod
    def of(cls, document: ResultsDocument, source: pathlib.Path) -> "Origin":
        """From a results document."""
        return cls(source=str(source), sha256=document.log.sha256, case=document.log.case, tool=document.tool)

    def chosen(self, cases: Sequence[Case]) -> list[Case]:
        """The same request of the same log. Raises ReplayError where it is another log, or has no such request."""
        first = cases[0]
        if first.sha256 != self.sha256:
            found = f"its digest is {first.sha256[:12]}…, and {self.source} was made from {self.sha256[:12]}…"
            raise LogError("E_OTHER_LOG", first.log, f"{found}: another log")
        number = self.case.rpartition("/")[2]
        same = [case for case in cases if case.name.rpartition("/")[2] == number]
        if not same:
            raise LogError("E_OTHER_LOG", first.log, f"it has no request {number}, which {self.source} is of")
        return same

    @property
    def differences(self) -> list[str]:
        """Programs of another version than then: numbers may differ."""
        now = program()
        then = {"replay": self.tool.version, **self.tool.packages}
        here = {"replay": now["version"], **now["packages"]}
        return [f"{name} {then[name]} then, {here[name]} now" for name in here if then.get(name) != here[name]]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Session:
    """One call of the command, its arguments understood."""

    voice: Voice
    methods: Mapping[str, Method]
    read: ReadOptions
    weights: Weights
    seed: int
    outputs: Outputs
    recording: bool
    live: LiveView | None = None
    """Shows the run while it goes on."""
    export: bool = False
    """Write the paths into a copy of each log."""
    limits: Limits = NO_LIMITS
    jobs: int = 1
    """Methods that run at the same time, on as many cores at most."""
    origin: Origin | None = None

    def run(self, logs: Sequence[pathlib.Path]) -> ExitStatus:
        """Run all logs; the exit status. What was finished before a Ctrl-C is written and shown."""
        entries: list[LogEntry] = []
        interrupted = False
        if not any_compiled():
            self.voice.note("the first run on this machine compiles the inner loops, which may take a minute or two")
        try:
            with self._solver() as solver:
                for log in logs:
                    entries.append(LogEntry(log=str(log)))
                    position = f"{len(entries)}/{len(logs)}"
                    with self._failures_kept(entries[-1]):
                        self._run_log(_Work(log=log, entry=entries[-1], position=position, solver=solver))
        except KeyboardInterrupt:
            interrupted = True
            self.voice.error("interrupted; what was finished has been kept")
        status = ExitStatus.INTERRUPTED if interrupted else _status(entries)
        if not interrupted:
            self._summarize(entries)
        document = {"schema": "replay.optimize/1", "exit_status": int(status)}
        self.voice.document(document | {"logs": [dataclasses.asdict(entry) for entry in entries]})
        return status

    def _run_log(self, work: _Work) -> None:
        with self._progress(work) as progress:
            progress.show(work.log.name, "reading")
            cases = read_cases(work.log, self.read)
        try:
            self._run_cases(work, cases)
        finally:  # after Ctrl-C too: what was finished is kept
            if self.export and work.finished:
                self._write_export(work)

    def _run_cases(self, work: _Work, cases: Sequence[Case]) -> None:
        for case in self._wanted(cases):
            work.entry.lost |= case.read.lost
            names = self.outputs.names(case, len(cases))
            for note in case.read.notes:
                self.voice.note(f"{case.name}: {note}")
            weighted = dataclasses.replace(case.problem, weights=self.weights)
            named = dataclasses.replace(case, problem=weighted, reading=asdict(self.read))
            with reserved(names.results):
                self._run_case(work, named, names)

    def _wanted(self, cases: Sequence[Case]) -> Sequence[Case]:
        if self.origin is None:
            return cases
        chosen = self.origin.chosen(cases)
        for line in self.origin.differences:
            self.voice.note(f"{self.origin.source}: {line}; numbers may differ")
        return chosen

    def _write_export(self, work: _Work) -> None:
        """Write the paths of all cases into a copy of their log."""
        with self._failures_kept(work.entry, writing=True), self._progress(work) as progress:
            target = self.outputs.export(work.log)
            progress.show(work.log.name, f"writing {target.name}")
            write_export(work.finished, target)
            work.entry.files.append(str(target))
            self.voice.show(f"wrote {target}", "")

    def _run_case(self, work: _Work, case: Case, names: Names) -> None:
        interruption = None
        live = self.live
        with self._progress(work) as progress:
            progress.show(case.name, "measuring the recorded path")
            if live is not None:
                live.begin(case)
            try:
                run = self._run_methods(case, work.solver, progress)
            except Interrupted as interrupted:
                run, interruption = interrupted.run, interrupted
        run = dataclasses.replace(run, limits=self.limits)
        if run.methods:
            work.finished.append(run)
            self._finish_case(work, run, names)
        if live is not None:
            if run.methods:
                live.finish(run)
            live.end()
        if interruption is not None:
            raise interruption

    def _run_methods(self, case: Case, solver: SolveEach, progress: Progress) -> Run:
        """Run the methods, each with its line of progress. Raises Interrupted."""

        def line(name: str) -> str:
            return f"{case.name} {name}"

        def start(name: str) -> None:
            progress.end(case.name)
            progress.begin(line(name), "starting")

        def tell(name: str, iterate: Iterate) -> None:
            progress.iterate(line(name), iterate)
            if self.live is not None:
                self.live.iterate(name, iterate)

        def end(method: MethodRun) -> None:
            progress.end(line(method.name))

        return run_case(case, self.methods, on_iterate=tell, on_start=start, on_end=end, seed=self.seed, solve=solver)

    def _finish_case(self, work: _Work, run: Run, names: Names) -> None:
        """Write the files of a run and show its table, also when a file fails."""
        work.entry.fell_short |= run.fell_short
        written: list[str] = []
        work.entry.cases.append(_case_document(run, written))
        with self._failures_kept(work.entry, writing=True), self._progress(work) as progress:
            progress.show(run.case.name, f"writing {names.results.name}")
            write_results(names.results, to_document(run))
            written.append(str(names.results))
            if self.recording:
                from replay.recording import write_recording  # Rerun takes a second to load

                progress.show(run.case.name, f"writing {names.recording.name}")
                write_recording(run, names.recording)
                written.append(str(names.recording))
        self.voice.show(verdict(run), *remarks(run), result_table(run), *(f"wrote {name}" for name in written), "")
        compile_s = sum(method.compile_s for method in run.methods)
        if compile_s >= 1.0:
            self.voice.note(
                f"kernels were compiled for {compile_s:.0f} s, all methods together; they are kept for the next runs"
            )
        for line in recorded_failures(run):
            self.voice.note(f"{run.case.name}: {line}")
        for line, method in zip(reasons(run), run.methods, strict=True):
            say = self.voice.detail if method.status == "improved" else self.voice.note
            say(f"{run.case.name}: {line}")
            if method.traceback:
                self.voice.trace(method.traceback)

    @contextmanager
    def _failures_kept(self, entry: LogEntry, *, writing: bool = False) -> Iterator[None]:
        """A log's failure, whatever it is, is told in one line and noted in its entry; the next log goes on."""
        try:
            yield
        except (OutputLost, BrokenPipeError):  # nobody would read what the next logs give
            raise
        except ReplayError as error:
            entry.fell_short |= writing  # an input that cannot be used is another status
            entry.error = str(error)
            self.voice.error(entry.error)
        except Exception as error:  # a border: a defect of ours, which must not cost the other logs
            entry.fell_short = True
            entry.error = f"{entry.log}: internal error, {type(error).__name__}: {' '.join(str(error).split())}"
            self.voice.error(entry.error + ("" if self.voice.common.verbose else " (--verbose shows where)"))

    def _solver(self) -> AbstractContextManager[SolveEach]:
        """What runs the methods: processes of their own, where the system has such."""
        if not can_isolate():
            return nullcontext(partial(solve_in_turn, time_limit=self.limits.time_s))
        return Workers(self.limits, min(self.jobs, usable_cores()), self._meanwhile)

    def _meanwhile(self) -> None:
        """While the methods run, load what writes the recording."""
        if self.recording:
            from replay.recording import prepare

            prepare()

    def _progress(self, work: _Work) -> Progress:
        return Progress(self.voice.people, enabled=self.voice.wants_progress, prefix=work.position)

    def _summarize(self, entries: Sequence[LogEntry]) -> None:
        """For several logs, the last line: which of them could not be used."""
        failed = [entry.log for entry in entries if entry.error is not None]
        if len(entries) > 1 and failed:
            done = len(entries) - len(failed)
            self.voice.error(f"{done} of {len(entries)} logs done; not done: {', '.join(failed)}")


def _status(entries: Sequence[LogEntry]) -> ExitStatus:
    """The exit status of a command that ran to its end; of two that apply, the smaller."""
    if any(entry.fell_short for entry in entries):
        return ExitStatus.SHORT
    unusable = [entry.error is not None for entry in entries]
    if all(unusable):
        return ExitStatus.USAGE
    if any(unusable) or any(entry.lost for entry in entries):
        return ExitStatus.PARTIAL
    return ExitStatus.OK


def _case_document(run: Run, written: list[str]) -> dict[str, Any]:
    """A run in the JSON document: all numbers of the results file but the paths."""
    return {
        "case": run.case.name,
        "recorded": {"metrics": asdict(run.recorded_metrics), "audit": plain(audit_document(run.recorded_audit))},
        "best": run.best.name if run.best else None,
        "methods": [
            {key: getattr(method, key) for key in ("name", "status", "stop", "reason", "iterations", "wall_s")}
            | {"metrics": asdict(method.metrics), "audit": plain(audit_document(method.audit))}
            | {"rejected": None if method.rejected is None else plain(audit_document(method.rejected))}
            for method in run.methods
        ],
        "files": written,
    }
