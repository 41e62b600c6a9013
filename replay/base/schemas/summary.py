"""A regression run in figures, schema `replay.summary/1`: `summary.json` of the run's folder."""

from typing import Final, Literal

from msgspec import Struct

from replay.base.documents import Count
from replay.base.schemas.verdicts import Verdict

SUMMARY_SCHEMA: Final = "replay.summary/1"
LARGEST_SUMMARY: Final = 8 * 2**20
"""Size limit of the document where it is read for the trend [bytes]."""


class Change(Struct, frozen=True, kw_only=True):
    """A comparison with the baseline, for people: whole numbers as floats, truth values and tolerance in words."""

    log: str
    case: str = ""
    method: str = ""
    key: str = ""
    unit: str = ""
    direction: str = ""
    """Direction that is better: lower, higher or exact."""
    before: float | str | None = None
    after: float | str | None = None
    verdict: Verdict
    tolerance: str = ""
    """Tolerance in words; empty where there is none."""
    note: str = ""

    @property
    def difference(self) -> float | None:
        """After less before, where both are numbers."""
        if isinstance(self.before, float) and isinstance(self.after, float):
            return self.after - self.before
        return None

    @property
    def relative(self) -> float | None:
        """The difference over the magnitude before, where there is one [-]."""
        if isinstance(self.before, float) and isinstance(self.after, float) and self.before:
            return (self.after - self.before) / abs(self.before)
        return None


class UnreadLog(Struct, frozen=True, kw_only=True):
    """A log that could not be worked on."""

    log: str
    kind: str
    """Class of the log."""
    error: str
    """Message and code."""
    expected: bool
    """Whether the corpus announces the error, the baseline has it, or it is a known issue."""
    cure: str
    """Line for the corpus list that would declare it; empty where that does not help."""


class MethodTiming(Struct, frozen=True, kw_only=True):
    """The times of one method, or of "all", over those of another version on the same logs."""

    method: str
    ratio: float
    """Geometric mean of new over old [-]."""
    low: float | None
    high: float | None
    """95 % interval; null where there are too few logs for one."""
    logs: Count
    slower: bool
    """Whether this version is slower for certain."""


class MethodFigures(Struct, frozen=True, kw_only=True):
    """One method on a set of cases; null where there is no data."""

    results: Count
    improved: Count
    kept: Count
    failed: Count
    ratio: float | None
    """Geometric mean of J over the recorded J [-]."""
    cusps: float | None
    """Mean number of gear changes."""
    clearance: float | None
    """Least clearance on any case [m]."""
    wall_s: float | None
    """Median wall time [s]."""
    total_s: float
    """Sum of wall times [s]."""


class TrendPoint(Struct, frozen=True, kw_only=True):
    """One run in the trend."""

    name: str
    created: str
    revision: str
    state: str
    logs: Count
    comparable: str
    """Equal for runs whose figures may be compared: those that worked on the same logs."""
    ratio: dict[str, float]
    """Geometric mean of J over the recorded J, by method [-]."""
    wall_s: dict[str, float]
    """Median wall time by method [s]."""


class Summary(Struct, frozen=True, kw_only=True):
    """The figures of a run, for programs and for the trend of later runs."""

    schema: Literal["replay.summary/1"]
    run: str
    """Name of the run's folder."""
    created: str
    revision: str
    corpus: str
    complete: bool
    partial: str
    compared: bool
    """Whether the run was compared with a baseline."""
    other_options: str
    state: str
    """failed, passed, unfinished, unjudged or empty."""
    headline: str
    logs: Count
    results: Count
    verdicts: dict[str, Count]
    """Number of comparisons by verdict."""
    against: str
    timing: tuple[MethodTiming, ...]
    changes: tuple[Change, ...]
    """All comparisons that do not say "same", the gravest first."""
    unread: tuple[UnreadLog, ...]
    damaged: tuple[str, ...]
    """Files of the run that cannot be read, one line each."""
    methods: dict[str, MethodFigures]
    classes: dict[str, dict[str, MethodFigures]]
    trend: TrendPoint
