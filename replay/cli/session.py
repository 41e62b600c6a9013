"""The work of `replay optimize`: log by log and case by case; a failure of one does not affect the others."""

import dataclasses
import pathlib
from collections.abc import Iterator, Sequence
from contextlib import contextmanager
from typing import Any

from replay import pipeline
from replay.base.documents import plain
from replay.base.errors import OutputLost, ReplayError
from replay.base.files import reserved
from replay.base.kernels import any_compiled
from replay.cli.console import Voice
from replay.cli.origin import Origin
from replay.cli.outputs import Names, Outputs
from replay.cli.settings import Settings
from replay.cli.tables import reasons, recorded_failures, remarks, result_table, verdict
from replay.cli.usage import ExitStatus
from replay.recording.viewer import LiveView
from replay.run.case import Case
from replay.run.judge import Interrupted
from replay.run.outcome import Run
from replay.run.progress import Progress
from replay.run.results import audit_document


@dataclasses.dataclass(kw_only=True)
class LogEntry:
    """Outcome of one log."""

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
    """Files written for the log as a whole."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class _LogInProgress:
    """One log while it is worked on."""

    log: pathlib.Path
    entry: LogEntry
    workers: pipeline.Solver
    progress: Progress
    finished: list[Run] = dataclasses.field(default_factory=list)
    """Runs of its cases so far."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Session:
    """One call of the command, its arguments understood."""

    voice: Voice
    settings: Settings
    outputs: Outputs
    export: bool = False
    """Write the paths into a copy of each log."""
    live: LiveView | None = None
    """Shows the run live."""
    origin: Origin | None = None

    def run(self, logs: Sequence[pathlib.Path]) -> ExitStatus:
        """Run all logs; the exit status. What was finished before a Ctrl-C is written and shown."""
        entries: list[LogEntry] = []
        interrupted = False
        if not any_compiled():
            self.voice.note("the first run on this machine compiles the inner loops, which may take a minute or two")
        run = self.settings.run
        try:
            with pipeline.open_workers(run.limits, run.jobs, self._meanwhile) as workers:
                for log in logs:
                    entries.append(LogEntry(log=str(log)))
                    progress = self._progress(f"{len(entries)}/{len(logs)}")
                    with self._failures_kept(entries[-1]):
                        self._run_log(_LogInProgress(log=log, entry=entries[-1], workers=workers, progress=progress))
        except KeyboardInterrupt:
            interrupted = True
            self.voice.error("interrupted; what was finished has been kept")
        status = ExitStatus.INTERRUPTED if interrupted else _status(entries)
        if not interrupted:
            self._summarize(entries)
        document = {"schema": "replay.optimize/1", "exit_status": int(status)}
        self.voice.document(document | {"logs": [dataclasses.asdict(entry) for entry in entries]})
        return status

    def _run_log(self, work: _LogInProgress) -> None:
        run = self.settings.run
        with work.progress:
            work.progress.show(work.log.name, "reading")
            cases = pipeline.read(work.log, self.settings.read, memory_mib=run.memory_limit)
        try:
            for case in self._wanted(cases):
                work.entry.lost |= case.read.lost
                names = self.outputs.names(case, len(cases))
                for note in case.read.notes:
                    self.voice.note(f"{case.name}: {note}")
                with reserved(names.results):
                    self._run_case(work, pipeline.with_weights(case, self.settings.weights), names)
        finally:  # after Ctrl-C too: what was finished is kept
            if self.export and work.finished:
                self._write_export(work)

    def _wanted(self, cases: Sequence[Case]) -> Sequence[Case]:
        if self.origin is None:
            return cases
        chosen = self.origin.chosen(cases)
        for line in self.origin.differences:
            self.voice.note(f"{self.origin.source}: {line}; numbers may differ")
        return chosen

    def _run_case(self, work: _LogInProgress, case: Case, names: Names) -> None:
        live, interruption = self.live, None
        if live is not None:
            live.begin(case)
        try:
            run = pipeline.optimize(
                case,
                self.settings.methods,
                seed=self.settings.run.seed,
                on_iterate=None if live is None else live.iterate,
                progress=work.progress,
                workers=work.workers,
            )
        except Interrupted as interrupted:
            run, interruption = interrupted.run, interrupted
        if run.methods:
            work.finished.append(run)
            self._finish_case(work, run, names)
        if live is not None:
            if run.methods:
                live.finish(run)
            live.end()
        if interruption is not None:
            raise interruption

    def _finish_case(self, work: _LogInProgress, run: Run, names: Names) -> None:
        """Write the files of a run and show its table, also when a file fails."""
        work.entry.fell_short |= run.fell_short
        written: list[str] = []
        work.entry.cases.append(_case_document(run, written))
        with self._failures_kept(work.entry, writing=True), work.progress:
            work.progress.show(run.case.name, f"writing {names.results.name}")
            pipeline.save(run, names.results)
            written.append(str(names.results))
            if self.settings.run.recording:
                work.progress.show(run.case.name, f"writing {names.recording.name}")
                pipeline.record(run, names.recording)
                written.append(str(names.recording))
        self.voice.show(verdict(run), *remarks(run), result_table(run), *(f"wrote {name}" for name in written), "")
        self._say_how(run)

    def _say_how(self, run: Run) -> None:
        """Notes on how a run went."""
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

    def _write_export(self, work: _LogInProgress) -> None:
        """Write the paths of all cases into a copy of their log."""
        with self._failures_kept(work.entry, writing=True), work.progress:
            target = self.outputs.export(work.log)
            work.progress.show(work.log.name, f"writing {target.name}")
            pipeline.export(work.finished, target)
            work.entry.files.append(str(target))
            self.voice.show(f"wrote {target}", "")

    @contextmanager
    def _failures_kept(self, entry: LogEntry, *, writing: bool = False) -> Iterator[None]:
        """Report a log's failure, whatever it is, in one line, and note it in its entry; the next log follows."""
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

    def _meanwhile(self) -> None:
        """While the methods run, load what writes the recording."""
        if self.settings.run.recording:
            from replay.recording import prepare  # Rerun takes a second to load

            prepare()

    def _progress(self, position: str) -> Progress:
        return Progress(self.voice.people, enabled=self.voice.wants_progress, prefix=position)

    def _summarize(self, entries: Sequence[LogEntry]) -> None:
        """Print the last line after several logs: which of them could not be used."""
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
    recorded = {"metrics": run.recorded_metrics, "audit": audit_document(run.recorded_audit)}
    methods = [
        {key: getattr(method, key) for key in ("name", "status", "stop", "reason", "iterations", "wall_s", "metrics")}
        | {"audit": audit_document(method.audit)}
        | {"rejected": None if method.rejected is None else audit_document(method.rejected)}
        for method in run.methods
    ]
    found = {"case": run.case.name, "recorded": recorded, "best": run.best.name if run.best else None}
    return plain(found | {"methods": methods}) | {"files": written}
