"""The run as a Parquet file for analysts: one row for each case and method, typed columns with their units."""

import pathlib
from collections.abc import Iterable

import pyarrow as pa
import pyarrow.parquet as pq

from optim.metrics import UNITS
from replay.regress.reports.facts import is_failing
from replay.regress.reports.model import VERDICTS, Numbers, RunData

SCHEMA = "replay.rows/1"
_MOST_COUNTED = 2.0**63  # what a column of whole numbers can hold
_WORDS = ("log", "case", "kind", "sha256", "method", "status", "stop", "reason", "recording")


def write_parquet(run: RunData, path: pathlib.Path) -> None:
    """Write the rows. A number that its column cannot hold, or that the run does not have, is null."""
    pq.write_table(table(run), path, compression="zstd")


def table(run: RunData) -> pa.Table:
    """The rows as a table. Each field's metadata has its `unit`, the schema's what run they are of."""
    rows = run.rows
    gravest = _gravest(run)
    columns: list[tuple[pa.Field, pa.Array]] = [
        _column("class" if name == "kind" else name, "", pa.string(), [getattr(row, name) for row in rows])
        for name in _WORDS
    ]
    columns.append(_column("tags", "", pa.list_(pa.string()), [list(row.tags) for row in rows]))
    keys = [(row.log, row.case, row.method) for row in rows]
    columns.append(_column("verdict", "", pa.string(), [gravest.get(key) for key in keys]))
    failing = {(c.log, c.case, c.method) for c in run.changes if is_failing(c)}
    columns.append(_column("regressed", "", pa.bool_(), [key in failing for key in keys]))
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


def _column(name: str, unit: str, kind: pa.DataType, values: list) -> tuple[pa.Field, pa.Array]:
    return pa.field(name, kind, metadata={"unit": unit}), pa.array(values, kind)


def _cast(value: float | None, kind: pa.DataType) -> float | int | None:
    if value is None or kind != pa.int64():
        return value
    return round(value) if abs(value) < _MOST_COUNTED else None


def _keys(found: Iterable[Numbers]) -> list[str]:
    return sorted({key for entry in found for key in entry})


def _unit(name: str) -> str:
    """The unit that a name ends in."""
    last = name.rpartition("_")[2]
    return last if last in ("m", "rad", "s", "rad/m") else "-"


def _gravest(run: RunData) -> dict[tuple[str, str, str], str]:
    found: dict[tuple[str, str, str], int] = {}
    for change in run.changes:
        key = (change.log, change.case, change.method)
        found[key] = min(VERDICTS.index(change.verdict), found.get(key, len(VERDICTS)))
    return {key: VERDICTS[rank] for key, rank in found.items()}
