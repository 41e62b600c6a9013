"""The figures that runs are compared with, schema `replay.baseline/1`: `baseline.json` beside a corpus."""

from typing import Final, Literal

from msgspec import Struct, field

from replay.base.schemas.run import OptionsDocument
from replay.base.schemas.values import Exact

BASELINE_SCHEMA: Final = "replay.baseline/1"
LARGEST_BASELINE: Final = 512 * 2**20
"""Size limit of the document [bytes]."""


class Figures(Struct, frozen=True, kw_only=True):
    """The figures of one method on one case that are compared; null where there is no value."""

    audit: bool | None = None
    """Whether the path passes the audit."""
    cusps: Exact | None = None
    defect: Exact | None = None
    """Largest position defect of an interval [m]."""
    defect_sum: Exact | None = None
    """Sum of the position defects [m]."""
    evaluations: Exact | None = None
    iterations: Exact | None = None
    min_clearance: Exact | None = None
    """Least swept clearance, up to the one that is enough [m]."""
    objective: Exact | None = None
    status: str | None = None
    """improved, kept or failed."""


class LogFigures(Struct, frozen=True, kw_only=True):
    """The figures of one log, or the code of the error with which it was refused."""

    sha256: str | None = None
    error: str | None = None
    cases: dict[str, dict[str, Figures]]
    """Figures by the number of the case within the log, then by method."""


class Baseline(Struct, frozen=True, kw_only=True):
    """The figures of a run that was accepted."""

    schema: Literal["replay.baseline/1"]
    created: str = ""
    revision: str = ""
    options_fingerprint: str = field(default="", name="options")
    options: OptionsDocument | None = field(default=None, name="settings")
    """Options with which it was made; absent in files of old versions."""
    logs: dict[str, LogFigures]
    """Figures by the log's name."""
