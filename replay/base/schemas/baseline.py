"""The figures that runs are compared with, schema `replay.baseline/1`: `baseline.json` beside a corpus."""

from typing import Final

from msgspec import Struct, field

from replay.base.schemas.run import OptionsDocument
from replay.base.schemas.values import Number

BASELINE_SCHEMA: Final = "replay.baseline/1"
LARGEST_BASELINE: Final = 512 * 2**20
"""Size limit of the document [bytes]."""


class Figures(Struct, frozen=True, kw_only=True):
    """The figures of one method on one case that are compared; null where there is no value."""

    audit: bool | None = None
    """Whether the path passes the audit."""
    cusps: Number | None = None
    defect: Number | None = None
    """Largest position defect of an interval [m]."""
    defect_sum: Number | None = None
    """Sum of the position defects [m]."""
    evaluations: Number | None = None
    iterations: Number | None = None
    min_clearance: Number | None = None
    """Least swept clearance, up to the one that is enough [m]."""
    objective: Number | None = None
    status: str | None = None
    """improved, kept or failed."""


class LogFigures(Struct, frozen=True, kw_only=True):
    """The figures of one log, or the code of the error with which it was refused."""

    sha256: str | None = None
    error: str | None = None
    cases: dict[str, dict[str, Figures]]
    """By the number of the case within the log, then by method."""


class Baseline(Struct, frozen=True, kw_only=True, tag_field="schema", tag=BASELINE_SCHEMA):
    """The figures of a run that was accepted."""

    created: str = ""
    revision: str = ""
    options_fingerprint: str = field(default="", name="options")
    options: OptionsDocument | None = field(default=None, name="settings")
    """Options with which it was made; absent in files of old versions."""
    logs: dict[str, LogFigures]
    """By the log's name."""
