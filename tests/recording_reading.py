"""Recordings for the tests: made from real runs, read back with the viewer's own reader."""

import pathlib
from collections import defaultdict
from typing import Any

import pyarrow as pa
from rerun.chunk import RrdReader

from replay.recording import write_recording
from replay.run.outcome import Run


class Contents:
    """What a file holds: for each entity and component, its rows in order, with their times."""

    def __init__(self, path: pathlib.Path) -> None:
        reader = RrdReader(path)
        self.recordings, self.blueprints = reader.recordings(), reader.blueprints()
        self.tables: dict[str, list[pa.RecordBatch]] = defaultdict(list)
        self.timelines: set[str] = set()
        for chunk in reader.stream():
            self.tables[chunk.entity_path].append(chunk.to_record_batch())
            self.timelines |= set(chunk.timeline_names)

    def rows(self, entity: str, component: str, timeline: str | None = None) -> list[Any]:
        """Values of a component, of the chunks that have the timeline."""
        values: list[Any] = []
        for batch in self.tables[entity]:
            names = batch.schema.names
            if component in names and (timeline is None or timeline in names):
                values += batch.column(component).to_pylist()
        return values

    def times(self, entity: str, timeline: str) -> list[int]:
        found: list[int] = []
        for batch in self.tables[entity]:
            if timeline in batch.schema.names:
                found += batch.column(timeline).to_pylist()
        return found

    def text(self, entity: str) -> str:
        (row,) = self.rows(entity, "TextDocument:text")
        return row[0]

    def strings(self) -> list[str]:
        """Every piece of text in the file that a viewer might draw."""
        found: list[str] = []
        for entity, batches in self.tables.items():
            found.append(entity)
            for batch in batches:
                for name, column in zip(batch.schema.names, batch.columns, strict=True):
                    value_type = getattr(column.type, "value_type", None)
                    if value_type is not None and pa.types.is_string(value_type) and "media_type" not in name:
                        found += [piece for row in column.to_pylist() for piece in row or []]
        return found


def names_in_blueprint(path: pathlib.Path) -> set[str]:
    """Names of all containers and views."""
    reader = RrdReader(path)
    (store,) = reader.blueprints()
    batches = [chunk.to_record_batch() for chunk in reader.stream(store=store)]
    columns = [f"{kind}:display_name" for kind in ("ContainerBlueprint", "ViewBlueprint")]
    return {
        row[0]
        for batch in batches
        for column in columns
        if column in batch.schema.names
        for row in batch.column(column).to_pylist()
        if row
    }


def written(run: Run, directory: pathlib.Path) -> pathlib.Path:
    """The recording of a run, written there."""
    path = directory / "run.rrd"
    write_recording(run, path)
    return path
