"""The head of a regression run, schema `replay.run/1`: `run.json` of the run's folder."""

from typing import Final, Literal

from msgspec import UNSET, Struct, UnsetType

from replay.base.documents import Whole
from replay.base.schemas.corpus import Known
from replay.base.schemas.values import Exact, Scalar

RUN_SCHEMA: Final = "replay.run/1"
LARGEST_HEAD: Final = 64 * 2**20
"""Size limit of the document [bytes]."""

OptionValue = Scalar | list[Scalar]
MethodOptions = dict[str, OptionValue] | list[tuple[str, dict[str, OptionValue]]]
"""Options of a method by name; of a chain, those of its parts in their order."""


class OptionsDocument(Struct, frozen=True, kw_only=True):
    """Everything that decides the figures of a run. What is absent is not known."""

    memory_limit_mib: Whole | UnsetType | None = UNSET
    methods: dict[str, MethodOptions] = {}
    read: dict[str, OptionValue | dict[str, Scalar]] = {}
    """Options of the reader; `vehicle` is a table or null."""
    seed: Whole | UnsetType = UNSET
    time_limit_s: Exact | UnsetType | None = UNSET
    weights: dict[str, Exact] = {}


class CorpusPlace(Struct, frozen=True, kw_only=True):
    """Place of the logs of a run, and how many of them it covers."""

    path: str = ""
    num_logs: Whole | None = None


class Commands(Struct, frozen=True, kw_only=True):
    """Command lines that the reports give to paste; empty where there is none."""

    accept: str = ""
    """Makes the run the baseline."""
    view: str = ""
    """Shows the recordings."""


class RunHead(Struct, frozen=True, kw_only=True):
    """Plan of a run, the program that executes it, and whether it is complete."""

    schema: Literal["replay.run/1"]
    created: str = ""
    """Time of its start in UTC, as 2026-03-14T02:00:00Z."""
    revision: str = ""
    """Commit or version of the program."""
    complete: bool = False
    """Whether every log was worked on."""
    fingerprint: str = ""
    """Equal for runs with the same logs, selection and options."""
    versions: dict[str, Scalar] = {}
    machine: dict[str, Scalar] = {}
    corpus: CorpusPlace = CorpusPlace()
    logs: tuple[str, ...] = ()
    """Names of the logs that were to be worked on."""
    methods: tuple[str, ...] = ()
    options: OptionsDocument | None = None
    options_fingerprint: str = ""
    partial: str = ""
    """The selection in words; empty for the whole corpus."""
    partial_methods: bool = False
    """Whether methods were selected."""
    known: tuple[Known, ...] = ()
    baseline: str | None = None
    """File with which the run is compared; null where there is none."""
    accept_to: str | None = None
    """File that accepting the run writes."""
    commands: Commands | UnsetType = UNSET
    """Present once the run was judged, as is `other_options`."""
    other_options: str | UnsetType = UNSET
    """Options with which the baseline was made and this run was not, in words."""
