"""A run compared with its baseline, schema `replay.verdicts/1`: `verdicts.json` of the run's folder."""

from typing import Final, Literal, get_args

from msgspec import Struct, field

from replay.base.schemas.values import Scalar

VERDICTS_SCHEMA: Final = "replay.verdicts/1"
LARGEST_VERDICTS: Final = 512 * 2**20
"""Size limit of the document [bytes]."""
Verdict = Literal["crashed", "missing", "changed", "worse", "known", "better", "new", "same"]
VERDICTS: Final[tuple[Verdict, ...]] = get_args(Verdict)
"""All verdicts, the gravest first. A log is `changed` where its content is not that of the baseline's log; its results
are not compared."""
FAILING: Final[frozenset[Verdict]] = frozenset({"crashed", "missing", "changed", "worse"})
"""Verdicts with which a run fails."""


class Comparison(Struct, frozen=True, kw_only=True):
    """One figure of a result, or a log or a case as a whole, compared with the baseline."""

    log: str
    case: str = ""
    method: str = ""
    key: str = ""
    """Name of the figure; `result`, `case`, `log`, `error`, `expect`, `sha256` or `known issue` for what is none."""
    unit: str = "-"
    direction: str = "exact"
    """Direction that is better: lower, higher or exact."""
    rel_tol: float | None = None
    abs_tol: float | None = None
    """Absolute tolerance, in `unit`; both tolerances are added."""
    before: Scalar = None
    after: Scalar = None
    verdict: Verdict
    note: str = ""


class Verdicts(Struct, frozen=True, kw_only=True):
    """All comparisons of a run, those that say "same" too."""

    schema: Literal["replay.verdicts/1"]
    comparisons: tuple[Comparison, ...] = field(name="verdicts")
