"""Reads the folder of a run. What is damaged is left out and named, never guessed."""

import dataclasses
import json
import os
import pathlib
import re
from collections.abc import Callable, Iterable, Iterator, Mapping
from typing import Any, TypeVar

from replay.base.errors import ReplayError, printable
from replay.base.strict_json import JsonError, read_json
from replay.report import fields
from replay.report.fields import Malformed
from replay.report.model import CRASHES, VERDICTS, Change, LogError, Row, RunData, Timed

RUN_ERROR = "E_RUN"
RUN_SCHEMA, LOG_SCHEMA, VERDICTS_SCHEMA = "replay.run/1", "replay.run.log/1", "replay.verdicts/1"
TIMING, TIMING_SCHEMA = "timing.json", "replay.timing/1"
LARGEST_LOG = 64 * 2**20
LARGEST_VERDICTS = 512 * 2**20
"""Largest files that are read [bytes]."""
_T = TypeVar("_T")


def read_run(folder: pathlib.Path) -> RunData:
    """The run in a folder. ReplayError (E_RUN), one line, where there is none; files damaged in it are named."""
    about = _about(folder)
    damaged: list[str] = []
    rows: list[Row] = []
    errors: list[LogError] = []
    for path in log_files(folder):
        if (found := _tolerant(path, LOG_SCHEMA, LARGEST_LOG, damaged, lambda d: _log(folder, d))) is not None:
            rows += found[0]
            errors += found[1]
    changes: list[Change] | None = None
    verdicts = folder / "verdicts.json"
    if verdicts.exists():
        changes = _tolerant(verdicts, VERDICTS_SCHEMA, LARGEST_VERDICTS, damaged, _changes)
    timing: tuple[str, tuple[Timed, ...]] | None = None
    if (folder / TIMING).exists():
        timing = _tolerant(folder / TIMING, TIMING_SCHEMA, LARGEST_VERDICTS, damaged, _timing)
    of_logs = [change for change in changes or () if not change.method]
    methods = dict.fromkeys((*about.pop("methods"), *(row.method for row in rows)))
    return RunData(
        **about,
        name=printable(folder.resolve().name),
        methods=tuple(methods),
        rows=tuple(rows),
        errors=tuple(_judged(error, of_logs) for error in errors),
        changes=tuple(changes or ()),
        compared=bool(changes) and any(change.verdict != "new" for change in changes),
        against=timing[0] if timing else "",
        timing=timing[1] if timing else (),
        damaged=tuple(damaged),
    )


def log_files(folder: pathlib.Path) -> list[pathlib.Path]:
    """The results of the logs, one file each, in the order of their names."""
    logs = folder / "logs"
    try:
        names = sorted(os.listdir(logs))  # noqa: PTH208 - there may be tens of thousands
    except FileNotFoundError:
        return []
    except OSError as error:
        raise ReplayError(RUN_ERROR, f"{logs}: {error.strerror}") from error
    return [logs / name for name in names if name.endswith(".json") and not name.startswith(".")]


def _about(folder: pathlib.Path) -> dict[str, Any]:
    """The fields of a run that its run.json gives."""
    path = folder / "run.json"
    if not folder.is_dir():
        raise ReplayError(RUN_ERROR, f"{folder}: no such folder, expected one written by `replay regress`")
    try:
        head = _document(path, RUN_SCHEMA, LARGEST_LOG)
        corpus = fields.optional(head, "corpus")
        num_logs = fields.number(corpus, "num_logs")
        commands = fields.optional(head, "commands")
        return {
            "created": fields.text(head, "created", ""),
            "revision": fields.text(head, "revision", ""),
            "corpus": fields.text(corpus, "path", ""),
            "machine": fields.facts(head.get("machine")),
            "versions": fields.facts(head.get("versions")),
            "options": fields.facts(head.get("options")),
            "methods": fields.words(head, "methods"),
            "complete": bool(head.get("complete")),
            "partial": fields.text(head, "partial", ""),
            "other_options": fields.text(head, "other_options", "", fields.LONGEST_TEXT),
            "planned": None if num_logs is None else round(num_logs),
            "accept": fields.text(commands, "accept", "", fields.LONGEST_COMMAND),
            "view": fields.text(commands, "view", "", fields.LONGEST_COMMAND),
        }
    except (JsonError, Malformed) as error:
        raise ReplayError(RUN_ERROR, f"{path}: {error}; expected the folder of a run of `replay regress`") from None


def _document(path: pathlib.Path, schema: str, largest: int) -> Mapping[str, Any]:
    document = read_json(path, largest)
    if not isinstance(document, Mapping):
        raise Malformed(f"holds a {type(document).__name__}, expected an object")
    if document.get("schema") != schema:
        raise Malformed(f"schema is {str(document.get('schema'))[:60]!r}, expected {schema!r}")
    return document


def _tolerant(
    path: pathlib.Path, schema: str, largest: int, damaged: list[str], take: Callable[[Mapping[str, Any]], _T]
) -> _T | None:
    """What `take` finds in a file; None, and a line in `damaged`, where the file cannot be used."""
    try:
        return take(_document(path, schema, largest))
    except (JsonError, Malformed) as error:
        damaged.append(printable(f"{path.parent.name}/{path.name}: {error}", fields.LONGEST_TEXT))
        return None


def _log(folder: pathlib.Path, data: Mapping[str, Any]) -> tuple[list[Row], list[LogError]]:
    kind = fields.text(data, "class", "")
    if data.get("error") is not None:
        error = fields.mapping(data, "error")
        code = fields.text(error, "code")
        line = f"{fields.text(error, 'message', limit=fields.LONGEST_TEXT)} [{code}]"
        expected = code == fields.text(data, "expect", "")
        cure = "" if expected or code in CRASHES else _cure(fields.text(data, "path", ""), code)
        return [], [LogError(log=fields.text(data, "log"), kind=kind, error=line, expected=expected, cure=cure)]
    return [row for case in fields.entries(data, "cases") for row in _rows(folder, data, case)], []


def _cure(path: str, code: str) -> str:
    """The line with which the list beside a log says that it is refused."""
    if not path or "://" in path:
        return ""
    file = pathlib.PurePath(path)
    name = file.stem if re.fullmatch(r"[A-Za-z0-9_-]+", file.stem) else json.dumps(file.stem)
    return f'expected? in {file.parent / "corpus.toml"}: [logs.{name}] expect = "{code}"'


def _judged(error: LogError, changes: Iterable[Change]) -> LogError:
    """The error with what the comparison knows of it."""
    verdict = next((c.verdict for c in changes if c.log == error.log and c.key == "error"), "new")
    expected = error.expected or verdict in ("same", "known")
    return dataclasses.replace(error, expected=expected, cure=error.cure if verdict == "new" else "")


def _rows(folder: pathlib.Path, log: Mapping[str, Any], case: Mapping[str, Any]) -> Iterator[Row]:
    recorded = fields.mapping(case, "recorded")
    for method in fields.entries(case, "methods"):
        audit = fields.optional(method, "audit")
        yield Row(
            log=fields.text(log, "log"),
            case=fields.text(case, "case"),
            kind=fields.text(log, "class", ""),
            tags=fields.words(log, "tags"),
            sha256=fields.text(log, "sha256", ""),
            method=fields.text(method, "name"),
            status=fields.text(method, "status"),
            stop=fields.text(method, "stop", ""),
            reason=fields.text(method, "reason", "", fields.LONGEST_TEXT),
            recorded=fields.numbers(recorded.get("metrics")),
            metrics=fields.numbers(method.get("metrics")),
            recorded_passed=fields.flag(fields.optional(recorded, "audit"), "passed"),
            passed=fields.flag(audit, "passed"),
            audit=fields.numbers(audit),
            work=fields.numbers(method.get("work")),
            wall_s=fields.number(method, "wall_s"),
            recording=_recording(folder, case.get("recording")),
            recording_error=fields.text(case, "recording_error", "", fields.LONGEST_TEXT),
            traceback=fields.lines(method, "traceback"),
        )


def _recording(folder: pathlib.Path, name: Any) -> str | None:
    """A recording within the run's folder that is there; nothing else may become a link."""
    if not isinstance(name, str) or "\0" in name:
        return None
    path = pathlib.PurePosixPath(name)
    if path.is_absolute() or ".." in path.parts or path.suffix != ".rrd":
        return None
    return path.as_posix() if (folder / path).is_file() else None


def _timing(data: Mapping[str, Any]) -> tuple[str, tuple[Timed, ...]]:
    compared = fields.mapping(data, "compared")
    found = []
    for method in compared:
        entry = fields.mapping(compared, method)
        figures = {key: fields.number(entry, key) for key in ("low", "high")}
        ratio, logs = fields.number(entry, "ratio"), fields.number(entry, "pairs")
        if ratio is None or logs is None:
            raise Malformed(f"compared.{method[:60]} has no ratio of a number of pairs")
        slower = bool(fields.flag(entry, "alarm"))
        found.append(Timed(method=printable(method), ratio=ratio, **figures, logs=round(logs), slower=slower))
    return fields.text(data, "against"), tuple(found)


def _changes(data: Mapping[str, Any]) -> list[Change]:
    return [_change(entry) for entry in fields.entries(data, "verdicts")]


def _change(entry: Mapping[str, Any]) -> Change:
    verdict = fields.text(entry, "verdict")
    if verdict not in VERDICTS:
        raise Malformed(f"a verdict is {verdict[:40]!r}, expected one of {', '.join(VERDICTS)}")
    return Change(
        log=fields.text(entry, "log"),
        case=fields.text(entry, "case", ""),
        method=fields.text(entry, "method", ""),
        key=fields.text(entry, "key", ""),
        unit=fields.text(entry, "unit", ""),
        direction=fields.text(entry, "direction", ""),
        before=_value(entry.get("before")),
        after=_value(entry.get("after")),
        verdict=verdict,
        tolerance=_tolerance(entry),
        note=fields.text(entry, "note", "", fields.LONGEST_TEXT),
    )


def _value(value: Any) -> float | str | None:
    if value is None:
        return None
    finite = fields.number({"": value}, "")
    return finite if finite is not None else printable(value)


def _tolerance(entry: Mapping[str, Any]) -> str:
    relative, absolute = fields.number(entry, "rel_tol"), fields.number(entry, "abs_tol")
    parts = [f"{100.0 * relative:g} %"] if relative else []
    parts += [f"{absolute:g} {entry.get('unit') or ''}".strip()] if absolute else []
    if relative is None and absolute is None:
        return ""
    return " or ".join(parts) or "none: exact"
