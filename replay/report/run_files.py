"""Read the folder of a run. What is damaged is left out and named, never guessed."""

import json
import pathlib
import re
from collections.abc import Iterable, Iterator
from typing import TypeVar

import msgspec

from replay.base.documents import DocumentError, read_json
from replay.base.errors import printable
from replay.base.run_folder import TIMING_FILE, VERDICTS_FILE, log_files, read_head
from replay.base.schemas.log import CRASHES, LARGEST_LOG, CaseResult, LogResults
from replay.base.schemas.run import Commands, RunHead
from replay.base.schemas.summary import Change, MethodTiming, UnreadLog
from replay.base.schemas.timing import LARGEST_TIMING, TimingDocument
from replay.base.schemas.values import Scalar
from replay.base.schemas.verdicts import LARGEST_VERDICTS, Comparison, Verdicts
from replay.report.run_data import ResultRow, RunData
from replay.report.safe import LONGEST_TEXT, safe

_T = TypeVar("_T", bound=msgspec.Struct)


def read_run(folder: pathlib.Path) -> RunData:
    """Read the run in a folder. Raises ReplayError (E_RUN), one line, where there is none; damaged files are named."""
    head = _head(folder)
    damaged: list[str] = []
    rows: list[ResultRow] = []
    errors: list[UnreadLog] = []
    for path in log_files(folder):
        if (log := _tolerant(path, LogResults, LARGEST_LOG, damaged)) is not None:
            rows += _rows(folder, log)
            errors += _errors(log)
    verdicts = _tolerant(folder / VERDICTS_FILE, Verdicts, LARGEST_VERDICTS, damaged)
    timing = _tolerant(folder / TIMING_FILE, TimingDocument, LARGEST_TIMING, damaged)
    changes = [_change(comparison) for comparison in verdicts.comparisons] if verdicts else []
    of_logs = [change for change in changes if not change.method]
    return RunData(
        name=printable(folder.resolve().name),
        head=head,
        methods=tuple(dict.fromkeys((*head.methods, *(row.method for row in rows)))),
        rows=tuple(rows),
        errors=tuple(_judged(error, of_logs) for error in errors),
        changes=tuple(changes),
        compared=any(change.verdict != "new" for change in changes),
        against=timing.against if timing else "",
        timing=_timing(timing) if timing else (),
        damaged=tuple(damaged),
    )


def _head(folder: pathlib.Path) -> RunHead:
    head = safe(read_head(folder))
    return msgspec.structs.replace(
        head, commands=head.commands or Commands(), other_options=head.other_options or ""
    )  # absent before a run was judged


def _tolerant(path: pathlib.Path, kind: type[_T], largest: int, damaged: list[str]) -> _T | None:
    """Read a document; None where there is none, and with a line in `damaged` where it cannot be read."""
    if not path.exists():
        return None
    try:
        return safe(read_json(path, kind, largest))
    except DocumentError as error:
        damaged.append(printable(f"{path.parent.name}/{path.name}: {error}", LONGEST_TEXT))
        return None


def _errors(log: LogResults) -> Iterator[UnreadLog]:
    if log.error is None:
        return
    code = log.error.code
    expected = code == log.expect
    cure = "" if expected or code in CRASHES else _cure(log.path, code)
    error = f"{log.error.message} [{code}]"
    yield UnreadLog(log=log.log, kind=log.kind, error=error, expected=expected, cure=cure)


def _cure(path: str, code: str) -> str:
    """The lines of `corpus.toml` that announce an error of a log."""
    if not path or "://" in path:
        return ""
    file = pathlib.PurePath(path)
    name = file.stem if re.fullmatch(r"[A-Za-z0-9_-]+", file.stem) else json.dumps(file.stem)
    return f'if this is expected, add to {file.parent / "corpus.toml"}: [logs.{name}] expect = "{code}"'


def _judged(error: UnreadLog, changes: Iterable[Change]) -> UnreadLog:
    """Add what the comparison with the baseline says about an error."""
    verdict = next((c.verdict for c in changes if c.log == error.log and c.key == "error"), "new")
    expected = error.expected or verdict in ("same", "known")
    return msgspec.structs.replace(error, expected=expected, cure=error.cure if verdict == "new" else "")


def _rows(folder: pathlib.Path, log: LogResults) -> Iterator[ResultRow]:
    for case in log.cases if log.error is None else ():
        recording = _recording(folder, case)
        for result in case.methods:
            yield ResultRow(
                log=log.log,
                case=case.case,
                kind=log.kind,
                tags=log.tags,
                sha256=log.sha256 or "",
                recorded=case.recorded,
                result=result,
                recording=recording,
                recording_error=case.recording_error or "",
            )


def _recording(folder: pathlib.Path, case: CaseResult) -> str | None:
    """The recording of a case if it exists within the run's folder; nothing else may become a link."""
    if not case.recording or "\0" in case.recording:
        return None
    path = pathlib.PurePosixPath(case.recording)
    if path.is_absolute() or ".." in path.parts or path.suffix != ".rrd":
        return None
    return path.as_posix() if (folder / path).is_file() else None


def _timing(document: TimingDocument) -> tuple[MethodTiming, ...]:
    return tuple(
        MethodTiming(method=method, ratio=each.ratio, low=each.low, high=each.high, logs=each.pairs, slower=each.alarm)
        for method, each in document.compared.items()
    )


def _change(comparison: Comparison) -> Change:
    return Change(
        log=comparison.log,
        case=comparison.case,
        method=comparison.method,
        key=comparison.key,
        unit=comparison.unit,
        direction=comparison.direction,
        before=_value(comparison.before),
        after=_value(comparison.after),
        verdict=comparison.verdict,
        tolerance=_tolerance(comparison),
        note=comparison.note,
    )


def _value(value: Scalar) -> float | str | None:
    return value if value is None or isinstance(value, str) else str(value) if isinstance(value, bool) else float(value)


def _tolerance(comparison: Comparison) -> str:
    relative, absolute = comparison.rel_tol, comparison.abs_tol
    parts = [f"{100.0 * relative:g} %"] if relative else []
    parts += [f"{absolute:g} {comparison.unit}".strip()] if absolute else []
    if relative is None and absolute is None:
        return ""
    return " or ".join(parts) or "none: exact"
