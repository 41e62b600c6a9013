"""What a report is made of: one run of a regression as plain, checked data."""

from collections.abc import Mapping
from dataclasses import dataclass
from typing import Final

VERDICTS: Final = ("crashed", "missing", "changed", "worse", "known", "better", "new", "same")
"""What the comparison with the baseline can say, the gravest first; changed: the log is another one, and its results
are not compared."""
FAILING: Final = frozenset({"crashed", "missing", "changed", "worse"})
"""Verdicts with which a run fails."""

CRASHES: Final = ("E_CRASHED", "E_HUNG", "E_INTERNAL", "E_MEMORY")
"""Codes of logs on which the program itself, not the log, was at fault."""

Numbers = Mapping[str, float]


@dataclass(frozen=True, kw_only=True)
class Row:
    """What one method made of one case."""

    log: str
    case: str
    kind: str
    """Class of the log."""
    tags: tuple[str, ...]
    sha256: str
    method: str
    status: str
    """improved, kept or failed."""
    stop: str
    reason: str
    recorded: Numbers
    """Metrics of the recorded path; what is not finite is left out."""
    metrics: Numbers
    """Metrics of the path that the method ends with, which is the recorded one unless it improved."""
    recorded_passed: bool | None
    passed: bool | None
    """Whether the path passes the audit; None where nothing is said."""
    audit: Numbers
    """Values of the audit's checks, by `check.value`."""
    work: Numbers
    """Counters: iterations, evaluations, ..."""
    wall_s: float | None
    recording: str | None
    """Path of the recording within the run's folder, where there is one."""
    recording_error: str
    """Why it could not be written; empty where it could, or was not wanted."""
    traceback: tuple[str, ...] = ()
    """Lines, where an exception ended the method."""


@dataclass(frozen=True, kw_only=True)
class LogError:
    """A log that could not be worked on."""

    log: str
    kind: str
    error: str
    expected: bool
    """Whether the corpus says that this log cannot be used, or it is as in the baseline, or a known issue."""
    cure: str
    """How the corpus would say so; empty where that is no cure."""


@dataclass(frozen=True, kw_only=True)
class Change:
    """One metric compared with the baseline."""

    log: str
    case: str
    method: str
    key: str
    unit: str
    direction: str
    """Which way is better: lower, higher or exact."""
    before: float | str | None
    after: float | str | None
    verdict: str
    tolerance: str
    """In words, as far as the run says."""
    note: str

    @property
    def difference(self) -> float | None:
        """After less before, where both are numbers."""
        if isinstance(self.before, float) and isinstance(self.after, float):
            return self.after - self.before
        return None

    @property
    def relative(self) -> float | None:
        """The difference over the magnitude before, where there is one."""
        if isinstance(self.before, float) and isinstance(self.after, float) and self.before:
            return (self.after - self.before) / abs(self.before)
        return None


@dataclass(frozen=True, kw_only=True)
class Timed:
    """The times of one method, or of "all", over those of another version on the same logs."""

    method: str
    ratio: float
    """Geometric mean of new over old [-]."""
    low: float | None
    high: float | None
    """95 % interval; None where there are too few logs for one."""
    logs: int
    slower: bool
    """Whether this version is slower for certain."""


@dataclass(frozen=True, kw_only=True)
class RunData:
    """One run of a regression, as its folder says."""

    name: str
    """Of its folder."""
    created: str
    revision: str
    corpus: str
    machine: Mapping[str, str]
    versions: Mapping[str, str]
    options: Mapping[str, str]
    methods: tuple[str, ...]
    complete: bool
    """Whether every log was worked on."""
    partial: str
    """What the run was restricted to, in words; empty for the whole corpus."""
    other_options: str
    """With which other options the baseline was made, in words; empty where with the same."""
    planned: int | None
    """Number of logs that were to be worked on, where it is known."""
    rows: tuple[Row, ...]
    errors: tuple[LogError, ...]
    changes: tuple[Change, ...]
    """Every comparison, those that say "same" too."""
    compared: bool
    """Whether the run has been compared with a baseline."""
    against: str
    """The version that this one was timed against; empty without."""
    timing: tuple[Timed, ...]
    damaged: tuple[str, ...]
    """Files of the run that cannot be read, one line each."""
    accept: str = ""
    """The command that makes this run the baseline; empty where it is not known, and for a partial run."""
    view: str = ""
    """The command that shows all recordings; empty where it is not known."""

    @property
    def logs(self) -> list[str]:
        """Names of the logs that were worked on, those in vain too."""
        return sorted({row.log for row in self.rows} | {error.log for error in self.errors})

    @property
    def slower(self) -> list[str]:
        """The methods that are slower for certain than in the other version; "all" is one."""
        return [each.method for each in self.timing if each.slower]

    @property
    def failing(self) -> list[Change]:
        """The changes with which the run fails."""
        return [change for change in self.changes if change.verdict in FAILING]
