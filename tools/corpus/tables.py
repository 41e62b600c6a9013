"""Look-up tables of the planners, kept in files of the user's cache folder."""

import hashlib
import os
from functools import lru_cache
from pathlib import Path

import numpy as np

import optim.planning.lookup
import optim.steering
from optim.model.vehicle import Vehicle
from optim.planning.lookup import HALF, Table, build_table, table_key, table_of, table_shape
from replay.base.files import atomic_write


@lru_cache(maxsize=8)
def kept_table(vehicle: Vehicle, half: int = HALF, folder: Path | None = None) -> Table:
    """The table of a vehicle: read from its file in the cache folder, else built (10 to 20 s) and written there."""
    folder = folder or cache_folder()
    path = folder / f"lookup-{_digest(vehicle, half)}.npy"
    if path.exists():
        values = np.load(path)
        if values.shape == table_shape(half):
            return table_of(vehicle, values)
    table = build_table(vehicle, half)
    folder.mkdir(parents=True, exist_ok=True)
    with atomic_write(path) as temporary, temporary.open("wb") as file:
        np.save(file, table.values.astype(np.float32))  # which they are rounded to
    return table


def cache_folder() -> Path:
    """Folder of the tables, below XDG_CACHE_HOME or ~/.cache."""
    base = os.environ.get("XDG_CACHE_HOME") or str(Path.home() / ".cache")
    return Path(base) / "truck-trailer-replay"


def _digest(vehicle: Vehicle, half: int) -> str:
    """Digest of all that a table depends on: the vehicle, the grid, and the sources that build it."""
    digest = hashlib.sha256(table_key(vehicle, half).encode())
    steering = Path(optim.steering.__file__).parent
    for source in [*sorted(steering.glob("*.py")), Path(optim.planning.lookup.__file__)]:
        digest.update(source.read_bytes())
    return digest.hexdigest()[:20]
