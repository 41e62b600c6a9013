"""The run as a Parquet file for analysts: one row for each case and method, typed columns with their units.

Missing results and logs that could not be read have rows too, with status "missing" and "unread".
"""

import pathlib
from collections import defaultdict
from collections.abc import Callable, Iterable, Sequence
from typing import Any

import pyarrow as pa
import pyarrow.parquet as pq

from optim.model.metrics import UNITS
from replay.base.schemas.log import MethodResult, Recorded
from replay.base.schemas.results import AuditDocument, MetricsDocument
from replay.base.schemas.values import known
from replay.base.schemas.verdicts import VERDICTS
from replay.report.facts import class_of_logs, is_failing
from replay.report.run_data import ResultRow, RunData

SCHEMA = "replay.rows/1"
_TEXTS: dict[str, Callable[[ResultRow], str | None]] = {
    "log": lambda row: row.log,
    "case": lambda row: row.case,
    "class": lambda row: row.kind,
    "sha256": lambda row: row.sha256,
    "method": lambda row: row.method,
    "status": lambda row: row.result.status,
    "stop": lambda row: row.result.stop,
    "reason": lambda row: row.result.reason,
    "recording": lambda row: row.recording,
}
_Column = tuple[pa.Field, pa.Array]
_Key = tuple[str, str, str]


def write_parquet(run: RunData, path: pathlib.Path) -> None:
    """Write the rows. A number that the run does not have is null."""
    pq.write_table(table(run), path, compression="zstd")


def table(run: RunData) -> pa.Table:
    """The rows as a table. The metadata of each field has its `unit`, that of the schema names the run."""
    rows, head = [*run.rows, *_absent(run)], run.head
    columns = [
        _column("run", "", pa.string(), [run.name] * len(rows)),
        _column("revision", "", pa.string(), [head.revision] * len(rows)),
        *(_column(name, "", pa.string(), list(map(text, rows))) for name, text in _TEXTS.items()),
        _column("tags", "", pa.list_(pa.string()), [list(row.tags) for row in rows]),
        *_verdict_columns(run, [(row.log, row.case, row.method) for row in rows]),
        _column("audit_passed", "", pa.bool_(), [_passed(row.result.audit) for row in rows]),
        _column("recorded_audit_passed", "", pa.bool_(), [_passed(row.recorded.audit) for row in rows]),
        _column("wall_s", "s", pa.float64(), [row.result.wall_s for row in rows]),
        *_metric_columns(rows),
        *_number_columns("work", [_counters(row.result) for row in rows]),
        *_number_columns("audit", [_audit_numbers(row.result.audit) for row in rows]),
    ]
    about = {"schema": SCHEMA, "run": run.name, "created": head.created, "revision": head.revision}
    about |= {"corpus": head.corpus.path, "complete": "yes" if head.complete else "no", "partial": head.partial}
    schema = pa.schema([field for field, _ in columns], metadata=about)
    return pa.Table.from_arrays([array for _, array in columns], schema=schema)


def _absent(run: RunData) -> list[ResultRow]:
    """Rows for results that the run does not have."""
    kinds = class_of_logs(run)

    def row(log: str, case: str, method: str, status: str, reason: str) -> ResultRow:
        return ResultRow(
            log=log,
            case=case,
            kind=kinds.get(log, ""),
            tags=(),
            sha256="",
            recorded=Recorded(metrics=MetricsDocument()),
            result=MethodResult(name=method, status=status, reason=reason),
            recording=None,
            recording_error="",
        )

    unread = [row(error.log, "", "", "unread", error.error) for error in run.errors]
    missing = [c for c in run.changes if c.verdict == "missing"]
    return unread + [row(c.log, c.case, c.method, "missing", c.note) for c in missing]


def _verdict_columns(run: RunData, keys: Sequence[_Key]) -> list[_Column]:
    ranks: dict[_Key, int] = {}
    failing: dict[_Key, list[str]] = defaultdict(list)
    before: dict[_Key, float | str | None] = {}
    for change in run.changes:
        key = (change.log, change.case, change.method)
        ranks[key] = min(VERDICTS.index(change.verdict), ranks.get(key, len(VERDICTS)))
        if is_failing(change):
            failing[key].append(change.key)
        if change.key == "objective":
            before[key] = change.before
    costs = [value if isinstance(value := before.get(key), float) else None for key in keys]
    return [
        _column("verdict", "", pa.string(), [VERDICTS[ranks[key]] if key in ranks else None for key in keys]),
        _column("regressed", "", pa.bool_(), [key in failing for key in keys]),
        _column("failing", "", pa.list_(pa.string()), [failing.get(key, []) for key in keys]),
        _column("baseline_objective", UNITS["objective"], pa.float64(), costs),
    ]


def _metric_columns(rows: Iterable[ResultRow]) -> Iterable[_Column]:
    for key, unit in UNITS.items():
        kind = pa.int64() if key == "cusps" else pa.float64()
        yield _column(key, unit, kind, [known(getattr(row.result.metrics, key)) for row in rows])
        yield _column(f"recorded_{key}", unit, kind, [known(getattr(row.recorded.metrics, key)) for row in rows])


def _number_columns(prefix: str, found: Sequence[dict[str, float]]) -> Iterable[_Column]:
    """One column for each number that any row has."""
    for key in sorted({key for entry in found for key in entry}):
        yield _column(f"{prefix}.{key}", _unit(key), pa.float64(), [entry.get(key) for entry in found])


def _column(name: str, unit: str, kind: pa.DataType, values: list[Any]) -> _Column:
    return pa.field(name, kind, metadata={"unit": unit}), pa.array(values, kind)


def _passed(audit: AuditDocument | None) -> bool | None:
    return None if audit is None else audit.passed


def _counters(result: MethodResult) -> dict[str, float]:
    counters = {"evaluations": result.work.evaluations, "iterations": result.work.iterations}
    return {name: value for name, value in counters.items() if value is not None}


def _audit_numbers(audit: AuditDocument | None) -> dict[str, float]:
    """All numbers of an audit by their place in it, as `checks.defect.values.position_m`."""
    found: dict[str, float | None] = {}
    for name, check in audit.checks.items() if audit is not None else ():
        found |= {f"checks.{name}.values.{key}": value for key, value in check.values.items()}
        found |= {f"checks.{name}.limits.{key}": value for key, value in check.limits.items()}
        if check.place is not None:
            place = {"segment": check.place.segment, "s": check.place.s, "polygon": known(check.place.polygon)}
            found |= {f"checks.{name}.place.{key}": value for key, value in place.items()}
    return {key: value for key, value in found.items() if value is not None}


def _unit(name: str) -> str:
    """The unit that a name ends in; a place `s` along the path is a length."""
    if name.endswith(".s"):
        return "m"
    last = name.rpartition("_")[2]
    return last if last in ("m", "rad", "s", "rad/m") else "-"
