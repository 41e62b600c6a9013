"""The results of one log within a regression run, schema `replay.run.log/1`: `logs/NAME.json` of the run's folder."""

from typing import Final

from msgspec import UNSET, Struct, UnsetType, field

from replay.base.schemas.values import Count

LOG_SCHEMA: Final = "replay.run.log/1"
LARGEST_LOG: Final = 64 * 2**20
"""Size limit of one document [bytes]."""
CRASHES: Final = ("E_CRASHED", "E_HUNG", "E_INTERNAL", "E_MEMORY")
"""Codes of errors for which the program, not the log, is at fault."""


class Metrics(Struct, frozen=True, kw_only=True):
    """Metrics of a path, units as in `optim.model.metrics.UNITS`; null where a value is not finite."""

    objective: float | None = None
    length: float | None = None
    trailer_length: float | None = None
    reverse_length: float | None = None
    cusps: Count | None = None
    max_abs_phi: float | None = None
    max_abs_alpha: float | None = None
    max_abs_kappa: float | None = None
    max_abs_dphi_ds: float | None = None
    steering_effort: float | None = None
    steering_variation: float | None = None
    min_clearance: float | None = None


class Place(Struct, frozen=True, kw_only=True, omit_defaults=True):
    """Where on a path a check is worst."""

    segment: Count | None = None
    s: float | None = None
    """Arc length within the segment [m]."""
    body: str | None = None
    polygon: Count | None = None


class Check(Struct, frozen=True, kw_only=True):
    """One check of an audit. The names in `values` and `limits` end in their units."""

    passed: bool
    sentence: str = ""
    values: dict[str, float | None] = {}
    limits: dict[str, float | None] = {}
    place: Place | None = None


class Audit(Struct, frozen=True, kw_only=True):
    """The audit of a path."""

    passed: bool
    complete: bool = True
    checks: dict[str, Check] = {}


class Recorded(Struct, frozen=True, kw_only=True):
    """The recorded path of a case, measured and audited."""

    metrics: Metrics
    audit: Audit | None = None


class Read(Struct, frozen=True, kw_only=True):
    """How a case was read from its log; the fields of `replay.run.case.ReadReport`."""

    poses: Count = 0
    hitch: str = ""
    max_deviation_m: float | None = None
    max_deviation_rad: float | None = None
    rms_deviation_m: float | None = None
    rms_deviation_rad: float | None = None
    goal_hitch_sigma: float | None = None
    notes: tuple[str, ...] = ()
    lost: bool = False


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
    metrics: Metrics = Metrics()
    """Of the method's path, which is the recorded one unless the status is "improved"."""
    audit: Audit | None = None
    wall_s: float | None = None
    rejected: Audit | None = None
    """Audit of a path that the audit rejected."""
    work: Work = Work()
    traceback: str | UnsetType = UNSET
    """Present where an exception ended the method."""


class CaseResult(Struct, frozen=True, kw_only=True):
    """The results of all methods on one case of a log."""

    case: str
    recorded: Recorded
    read: Read = Read()
    methods: tuple[MethodResult, ...]
    recording: str | UnsetType | None = UNSET
    """Path of the recording within the run's folder; null where it could not be written, absent where none was
    wanted."""
    recording_error: str | UnsetType = UNSET
    """Why the recording could not be written."""


class LogError(Struct, frozen=True, kw_only=True):
    """Why a log could not be used."""

    code: str
    message: str


class LogDocument(Struct, frozen=True, kw_only=True, tag_field="schema", tag=LOG_SCHEMA):
    """The results of one log, or why there are none."""

    log: str
    """Name of the log within its corpus."""
    path: str = ""
    """File of the log, or its address in an object store."""
    sha256: str | None = None
    kind: str = field(default="", name="class")
    tags: tuple[str, ...] = ()
    expect: str = ""
    """What `corpus.toml` expects: improved, kept or an error's code."""
    declared: str = ""
    """Line of `corpus.toml` that says so, as path:line."""
    error: LogError | None = None
    cases: tuple[CaseResult, ...] = ()
