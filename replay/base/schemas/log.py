"""The results of one log within a regression run, schema `replay.run.log/1`: `logs/NAME.json` of the run's folder."""

from typing import Final, Literal

from msgspec import UNSET, Struct, UnsetType, field

from replay.base.documents import Count, Number
from replay.base.schemas.results import AuditDocument, MetricsDocument, ReadDocument

LOG_SCHEMA: Final = "replay.run.log/1"
LARGEST_LOG: Final = 64 * 2**20
"""Size limit of one document [bytes]."""
CRASHES: Final = ("E_CRASHED", "E_HUNG", "E_INTERNAL", "E_MEMORY")
"""Codes of errors for which the program, not the log, is at fault."""


class Recorded(Struct, frozen=True, kw_only=True):
    """The recorded path of a case, measured and audited."""

    metrics: MetricsDocument
    audit: AuditDocument | None = None


class Work(Struct, frozen=True, kw_only=True):
    """Counters of the work that a method did."""

    evaluations: Count | None = None
    iterations: Count | None = None


class MethodResult(Struct, frozen=True, kw_only=True):
    """The result of one method on one case."""

    name: str
    status: str
    """improved, kept or failed."""
    stop: str = ""
    reason: str = ""
    metrics: MetricsDocument = MetricsDocument()
    """Metrics of the method's path, which is the recorded one unless the status is "improved"."""
    audit: AuditDocument | None = None
    wall_s: Number = None
    rejected: AuditDocument | None = None
    """Audit of a path that the audit rejected."""
    work: Work = Work()
    traceback: str | UnsetType = UNSET
    """Present where an exception ended the method."""


class CaseResult(Struct, frozen=True, kw_only=True):
    """The results of all methods on one case of a log."""

    case: str
    recorded: Recorded
    read: ReadDocument = ReadDocument()
    methods: tuple[MethodResult, ...]
    recording: str | UnsetType | None = UNSET
    """Path of the recording within the run's folder; null where it could not be written, absent where none was
    wanted."""
    recording_error: str | UnsetType = UNSET
    """Reason why the recording could not be written."""


class LogFailure(Struct, frozen=True, kw_only=True):
    """Reason why a log could not be used."""

    code: str
    message: str


class LogResults(Struct, frozen=True, kw_only=True):
    """The results of one log, or why there are none."""

    schema: Literal["replay.run.log/1"]
    log: str
    """Name of the log within its corpus."""
    path: str = ""
    """File of the log, or its address in an object store."""
    sha256: str | None = None
    kind: str = field(default="", name="class")
    tags: tuple[str, ...] = ()
    expect: str = ""
    """Outcome that `corpus.toml` expects: improved, kept or an error's code."""
    declared: str = ""
    """Line of `corpus.toml` that says so, as path:line."""
    error: LogFailure | None = None
    cases: tuple[CaseResult, ...] = ()
