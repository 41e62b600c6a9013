"""The run as a Parquet file for analysts: one row for each case and method, typed columns with their units.

Results that are missing and logs that could not be read have rows too, of status missing and unread.
"""

import pathlib
from collections import defaultdict
from collections.abc import Iterable

import pyarrow as pa
import pyarrow.parquet as pq

from optim.model.metrics import UNITS
from replay.report.facts import class_of_logs, is_failing
from replay.report.model import VERDICTS, Numbers, Row, RunData

SCHEMA = "replay.rows/1"
_MOST_COUNTED = 2.0**63  # what a column of whole numbers can hold
_WORDS = ("log", "case", "kind", "sha256", "method", "status", "stop", "reason", "recording")


def write_parquet(run: RunData, path: pathlib.Path) -> None:
    """Write the rows. A number that its column cannot hold, or that the run does not have, is null."""
    pq.write_table(table(run), path, compression="zstd")


def table(run: RunData) -> pa.Table:
    """The rows as a table. Each field's metadata has its `unit`, the schema's what run they are of."""
    rows = [*run.rows, *_absent(run)]
    gravest = _gravest(run)
    columns: list[tuple[pa.Field, pa.Array]] = [
        _column("run", "", pa.string(), [run.name] * len(rows)),
        _column("revision", "", pa.string(), [run.revision] * len(rows)),
    ]
    columns += [
        _column("class" if name == "kind" else name, "", pa.string(), [getattr(row, name) for row in rows])
        for name in _WORDS
    ]
    columns.append(_column("tags", "", pa.list_(pa.string()), [list(row.tags) for row in rows]))
    keys = [(row.log, row.case, row.method) for row in rows]
    columns.append(_column("verdict", "", pa.string(), [gravest.get(key) for key in keys]))
    failing: dict[tuple[str, str, str], list[str]] = defaultdict(list)
    for change in filter(is_failing, run.changes):
        failing[change.log, change.case, change.method].append(change.key)
    columns.append(_column("regressed", "", pa.bool_(), [key in failing for key in keys]))
    columns.append(_column("failing", "", pa.list_(pa.string()), [failing.get(key, []) for key in keys]))
    before = {(c.log, c.case, c.method): c.before for c in run.changes if c.key == "objective"}
    costs = [value if isinstance(value := before.get(key), float) else None for key in keys]
    columns.append(_column("baseline_objective", UNITS["objective"], pa.float64(), costs))
    columns.append(_column("audit_passed", "", pa.bool_(), [row.passed for row in rows]))
    columns.append(_column("recorded_audit_passed", "", pa.bool_(), [row.recorded_passed for row in rows]))
    columns.append(_column("wall_s", "s", pa.float64(), [row.wall_s for row in rows]))
    for key, unit in UNITS.items():
        kind = pa.int64() if key == "cusps" else pa.float64()
        columns.append(_column(key, unit, kind, [_cast(row.metrics.get(key), kind) for row in rows]))
        columns.append(
            _column(f"recorded_{key}", unit, kind, [_cast(row.recorded.get(key), kind) for row in rows]),
        )
    for key in _keys(row.work for row in rows):
        columns.append(_column(f"work.{key}", _unit(key), pa.float64(), [row.work.get(key) for row in rows]))
    for key in _keys(row.audit for row in rows):
        columns.append(_column(f"audit.{key}", _unit(key), pa.float64(), [row.audit.get(key) for row in rows]))
    about = {"schema": SCHEMA, "run": run.name, "created": run.created, "revision": run.revision}
    about |= {"corpus": run.corpus, "complete": "yes" if run.complete else "no", "partial": run.partial}
    schema = pa.schema([field for field, _ in columns], metadata=about)
    return pa.Table.from_arrays([array for _, array in columns], schema=schema)


def _absent(run: RunData) -> list[Row]:
    """Rows of what the run has no result of."""
    empty = {"sha256": "", "stop": "", "recorded": {}, "metrics": {}, "recorded_passed": None, "passed": None}
    empty |= {"audit": {}, "work": {}, "wall_s": None, "recording": None, "recording_error": "", "tags": ()}
    kinds = class_of_logs(run)
    unread = [
        Row(log=e.log, case="", kind=e.kind, method="", status="unread", reason=e.error, **empty) for e in run.errors
    ]
    missing = [
        Row(
            log=c.log, case=c.case, kind=kinds.get(c.log, ""), method=c.method, status="missing", reason=c.note, **empty
        )
        for c in run.changes
        if c.verdict == "missing"
    ]
    return unread + missing


def _column(name: str, unit: str, kind: pa.DataType, values: list) -> tuple[pa.Field, pa.Array]:
    return pa.field(name, kind, metadata={"unit": unit}), pa.array(values, kind)


def _cast(value: float | None, kind: pa.DataType) -> float | int | None:
    if value is None or kind != pa.int64():
        return value
    return round(value) if abs(value) < _MOST_COUNTED else None


def _keys(found: Iterable[Numbers]) -> list[str]:
    return sorted({key for entry in found for key in entry})


def _unit(name: str) -> str:
    """The unit that a name ends in; a place `s` along the path is a length."""
    if name.endswith(".s"):
        return "m"
    last = name.rpartition("_")[2]
    return last if last in ("m", "rad", "s", "rad/m") else "-"


def _gravest(run: RunData) -> dict[tuple[str, str, str], str]:
    found: dict[tuple[str, str, str], int] = {}
    for change in run.changes:
        key = (change.log, change.case, change.method)
        found[key] = min(VERDICTS.index(change.verdict), found.get(key, len(VERDICTS)))
    return {key: VERDICTS[rank] for key, rank in found.items()}
