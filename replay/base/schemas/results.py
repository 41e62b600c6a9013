"""Schema of a results file, `replay.results/1`: one case, its recorded path, and what each method made of it.

Paths, vehicle, scene and weights are plain data here: the audit reads these parts itself, and judges what is wrong with
them; `PathDocument` and `SceneDocument` say how they are where they are sound. Beyond what was published first a file
holds, additively: `weights` (of the objective, which the audit recomputes), `scene.boundary` (the map's outline or
null), `recorded_metrics` and `recorded_audit`, `methods[].rejected` (the audit of a rejected path), `read.lost`,
`tool.python`, and, where the options of reading are known, `tool.reading` and `tool.limits`: with them, the run can be
repeated exactly.
"""

from collections.abc import Mapping
from typing import Any, Final, Literal

import msgspec

from replay.base.documents import Count, Number, Whole

SCHEMA: Final = "replay.results/1"
Optional = Number | msgspec.UnsetType
"""A number that a file of an older version may lack."""
Plain = Mapping[str, Any]
"""Part of a document that is read elsewhere, with suspicion."""


class SegmentDocument(msgspec.Struct, frozen=True, kw_only=True):
    """Part of a path in one gear; as many values in each list as there are samples."""

    direction: Literal[1, -1]
    s: list[float]
    """Arc length of the truck's rear axle from the segment's start [m]."""
    x: list[float]
    y: list[float]
    theta: list[float]
    alpha: list[float]
    phi: list[float]


class PathDocument(msgspec.Struct, frozen=True, kw_only=True):
    """A path; SI units."""

    segments: list[SegmentDocument]


class SceneDocument(msgspec.Struct, frozen=True, kw_only=True):
    """Every obstacle that the methods had to respect, as convex polygons [m]."""

    polygons: list[list[tuple[float, float]]]
    boundary: list[tuple[float, float]] | None = None
    """The map's outline [m]."""
    frame: str | None = None
    margin: Number = None
    """Clearance asked for [m]."""


class MetricsDocument(msgspec.Struct, frozen=True, kw_only=True):
    """`optim.model.metrics.Metrics`, SI units; null for what is not finite."""

    objective: Optional = msgspec.UNSET
    length: Optional = msgspec.UNSET
    trailer_length: Optional = msgspec.UNSET
    reverse_length: Optional = msgspec.UNSET
    cusps: Whole | msgspec.UnsetType | None = msgspec.UNSET
    max_abs_phi: Optional = msgspec.UNSET
    max_abs_alpha: Optional = msgspec.UNSET
    max_abs_kappa: Optional = msgspec.UNSET
    max_abs_dphi_ds: Optional = msgspec.UNSET
    steering_effort: Optional = msgspec.UNSET
    steering_variation: Optional = msgspec.UNSET
    min_clearance: Optional = msgspec.UNSET


class PlaceDocument(msgspec.Struct, frozen=True, kw_only=True):
    """Place on a path where a check is worst."""

    segment: Whole
    s: Number
    body: str | msgspec.UnsetType = msgspec.UNSET
    polygon: Whole | msgspec.UnsetType = msgspec.UNSET


class CheckDocument(msgspec.Struct, frozen=True, kw_only=True):
    """`optim.audit.report.Check`; the names in `values` and `limits` end in their units."""

    passed: bool = False
    sentence: str = ""
    values: Mapping[str, Number] = msgspec.field(default_factory=dict)
    limits: Mapping[str, Number] = msgspec.field(default_factory=dict)
    place: PlaceDocument | None = None


class AuditDocument(msgspec.Struct, frozen=True, kw_only=True):
    """`optim.audit.report.AuditReport`; what a file leaves out has not passed."""

    passed: bool = False
    complete: bool | msgspec.UnsetType = msgspec.UNSET
    checks: Mapping[str, CheckDocument] = msgspec.field(default_factory=dict)


class IterateDocument(msgspec.Struct, frozen=True, kw_only=True):
    """`optim.model.result.IterateRecord`."""

    iteration: Whole
    objective: Number = None
    violation: Number = None
    step: Number = None
    residuals: Mapping[str, Number] = msgspec.field(default_factory=dict)
    accepted: bool = True
    trust_region: Number = None
    solver_s: Number = None


class MethodDocument(msgspec.Struct, frozen=True, kw_only=True):
    """Outcome of one method on the case; `path` is the recorded one unless `status` is "improved"."""

    name: str
    status: Literal["improved", "kept", "failed"]
    stop: str = ""
    reason: str = ""
    path: Plain
    metrics: MetricsDocument
    audit: AuditDocument
    iterations: Count = 0
    wall_s: Number = None
    history: tuple[IterateDocument, ...] = ()
    rejected: AuditDocument | None = None


class LogDocument(msgspec.Struct, frozen=True, kw_only=True):
    """The log and the request in it."""

    path: str
    sha256: str
    case: str


class LimitsDocument(msgspec.Struct, frozen=True, kw_only=True):
    """Limits of each method; null for none."""

    time_s: Number = None
    memory_mib: Whole | None = None


class ToolDocument(msgspec.Struct, frozen=True, kw_only=True):
    """The program that made a document, and the options of its run."""

    version: str | None = None
    packages: Mapping[str, str | None] = msgspec.field(default_factory=dict)
    python: str | None = None
    options: Mapping[str, Mapping[str, Any]] = msgspec.field(default_factory=dict)
    """Options of each method by its name."""
    seed: Whole = 0
    reading: Plain | msgspec.UnsetType = msgspec.UNSET
    limits: LimitsDocument | msgspec.UnsetType = msgspec.UNSET


class ReadDocument(msgspec.Struct, frozen=True, kw_only=True):
    """`replay.run.case.ReadReport`."""

    poses: Count = 0
    hitch: Literal["trailer path", "joint", "transform", "reconstructed"] = "reconstructed"
    max_deviation_m: Number = None
    max_deviation_rad: Number = None
    rms_deviation_m: Number = 0.0
    rms_deviation_rad: Number = 0.0
    goal_hitch_sigma: Number = 0.0
    notes: tuple[str, ...] = ()
    lost: bool = False


class ResultsDocument(msgspec.Struct, frozen=True, kw_only=True):
    """A results file."""

    schema: Literal["replay.results/1"]
    log: LogDocument
    tool: ToolDocument
    vehicle: Plain
    scene: Plain
    weights: Plain
    recorded: Plain
    recorded_metrics: MetricsDocument | msgspec.UnsetType = msgspec.UNSET
    recorded_audit: AuditDocument | msgspec.UnsetType = msgspec.UNSET
    read: ReadDocument = ReadDocument()
    methods: tuple[MethodDocument, ...]

    def __post_init__(self) -> None:
        names = [method.name for method in self.methods]
        if len(set(names)) < len(names):
            raise ValueError("two methods have one name")
