"""Recordings served together, as one dataset of Rerun's catalog: a table to sort, and a link to each recording.

The server keeps nothing: it reads the files and gives them to viewers on this machine. The arrangement within a
file does not count for a dataset; one that fits all recordings is registered with it.
"""

import contextlib
import importlib.util
import math
import pathlib
import tempfile
import threading
import urllib.parse
import warnings
from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any, Final

from rerun.chunk import RrdReader
from rerun.error_utils import RerunWarning
from rerun.server import Server

from replay.base.errors import ReplayError, printable
from replay.recording.common_blueprint import common_blueprint
from replay.recording.writing import APPLICATION

LOOPBACK: Final = "127.0.0.1"
DATASET_ERROR: Final = "E_DATASET"
_PROPERTY: Final = "property:replay:"
_STOP_S: Final = 1.5
"""The server waits for viewers to leave; it is left to itself after so long [s]."""


@dataclass(frozen=True, kw_only=True)
class Entry:
    """One recording of a dataset."""

    name: str
    url: str
    """Opens it in a viewer."""
    properties: dict[str, Any]
    """What the recording says of its result."""


@dataclass(frozen=True, kw_only=True)
class Dataset:
    """A dataset that is being served."""

    name: str
    url: str
    """Of the table of recordings."""
    entries: list[Entry]
    skipped: list[str]
    """Files that are no whole recordings, one line each."""


@contextlib.contextmanager
def served(name: str, files: Sequence[pathlib.Path], port: int = 0) -> Iterator[Dataset]:
    """Serve recordings on the loopback interface while the block runs. `port` 0 is a free one.

    Raises ReplayError (E_DATASET) where the catalog is not installed, the port is taken, or no file can be used.
    """
    _require_catalog()
    whole, skipped = _whole(files)
    if not whole:
        raise ReplayError(DATASET_ERROR, f"none of {len(files)} recordings can be read: {'; '.join(skipped[:3])}")
    try:
        server = Server(host=LOOPBACK, port=port, datasets={name: whole})
    except (RuntimeError, ValueError, OSError) as error:
        raise ReplayError(DATASET_ERROR, f"port {port} of {LOOPBACK}: cannot be served on: {_line(error)}") from error
    try:
        with tempfile.TemporaryDirectory(prefix="replay-view-") as scratch:
            yield _dataset(server, name, skipped, pathlib.Path(scratch))
    finally:
        _stop(server)


def _require_catalog() -> None:
    if importlib.util.find_spec("datafusion") is None:  # what Rerun's catalog client needs
        raise ReplayError(
            DATASET_ERROR, "serving recordings needs Rerun's catalog: pip install 'truck-trailer-replay[view]'"
        )


def _whole(files: Sequence[pathlib.Path]) -> tuple[list[pathlib.Path], list[str]]:
    """Recordings that can be read, and why the others cannot."""
    whole, skipped = [], []
    for path in files:
        try:
            with warnings.catch_warnings():
                warnings.simplefilter("error", RerunWarning)
                recordings = RrdReader(path).recordings()
        except (RuntimeError, ValueError, OSError, RerunWarning) as error:
            skipped.append(f"{printable(path.name)}: {_line(error)}")
            continue
        if recordings:
            whole.append(path)
        else:
            skipped.append(f"{printable(path.name)}: holds no recording")
    return whole, skipped


def _dataset(server: Server, name: str, skipped: list[str], scratch: pathlib.Path) -> Dataset:
    client = server.client()
    dataset = client.get_dataset(name)
    plan = scratch / "replay.rbl"
    entities = {column.entity_path for column in dataset.schema().component_columns()}
    common_blueprint(entities).save(APPLICATION, plan)
    dataset.register_blueprint(plan.as_uri(), set_default=True)
    rows = dataset.segment_table().to_pylist()
    entries = [
        Entry(
            name=str(_first(row.get("property:RecordingInfo:name")) or row["rerun_segment_id"]),
            url=_quoted(dataset.segment_url(row["rerun_segment_id"])),
            properties={k.removeprefix(_PROPERTY): _first(v) for k, v in row.items() if k.startswith(_PROPERTY)},
        )
        for row in rows
    ]
    entries.sort(key=lambda entry: entry.name)
    return Dataset(name=name, url=f"{server.url()}/entry/{dataset.id}", entries=entries, skipped=skipped)


def _quoted(url: str) -> str:
    """The address of a recording as a link: its identity has blanks and slashes."""
    place, sign, identity = url.partition("?segment_id=")
    return place + sign + urllib.parse.quote(identity, safe="")


def _first(value: Any) -> Any:
    """Properties come as lists of one value."""
    value = value[0] if isinstance(value, list) and value else value
    return None if isinstance(value, float) and not math.isfinite(value) else value


def _stop(server: Server) -> None:
    """Stop the server, but do not wait for ever: it does so while a viewer is connected."""
    stopping = threading.Thread(target=server.shutdown, daemon=True)
    stopping.start()
    stopping.join(_STOP_S)


def _line(error: BaseException) -> str:
    return printable(" ".join(str(error).split()), 300)
