"""Times of two versions of the program in turns, schema `replay.timing/1`: `timing.json` of a run's folder."""

from typing import Final, Literal

from msgspec import Struct

from replay.base.documents import Count

TIMING_SCHEMA: Final = "replay.timing/1"
LARGEST_TIMING: Final = 512 * 2**20
"""Size limit of the document [bytes]."""


class TimeRatio(Struct, frozen=True, kw_only=True):
    """The times of one method over those of the other version, on several logs."""

    ratio: float
    """Geometric mean of new over old [-]."""
    low: float | None = None
    high: float | None = None
    """95 % interval; null where there are too few logs for one."""
    pairs: Count
    """Number of logs."""
    alarm: bool
    """Whether the new version is slower for certain."""


class TimingDocument(Struct, frozen=True, kw_only=True):
    """This version timed against another one."""

    schema: Literal["replay.timing/1"]
    against: str
    """The other version, as it was given."""
    ratios: dict[str, dict[str, float]] = {}
    """New over old by method and log [-]."""
    compared: dict[str, TimeRatio]
    """By method; `all` is each log with the mean of its methods."""
