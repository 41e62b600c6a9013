"""Options of a run: all that decides its figures, apart from the program; and how they differ from a baseline's."""

import dataclasses
import hashlib
import json
from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

import msgspec

from optim.methods.chain import Chain
from optim.model.method import Method
from optim.model.objective import Weights
from replay.base.documents import plain
from replay.base.schemas.baseline import Baseline
from replay.base.schemas.run import MethodOptions, OptionsDocument
from replay.logs import ReadOptions
from replay.run.limits import Limits

Recordings = Literal["all", "changed", "none"]
"""Cases that get a recording; changed: those with another verdict than "same" or "new"."""
DEFAULT_LIMITS = Limits(time_s=120.0, by_processor=True, memory_mib=4096)
_MOST_NAMED = 5
_LONGEST_VALUE = 40


@dataclass(frozen=True, kw_only=True)
class Options:
    """What a run does with each log."""

    methods: Mapping[str, Method]
    read: ReadOptions = field(default_factory=ReadOptions)
    weights: Weights = field(default_factory=Weights)
    seed: int = 0
    """Seed of the run, for the record; the methods hold their own."""
    limits: Limits = DEFAULT_LIMITS
    """Limits of a method on a case. The time limit is a watchdog: what it ends depends on the machine's load. The
    memory limit also holds for the worker."""
    recordings: Recordings = "changed"

    def document(self) -> OptionsDocument:
        """Everything that decides the figures, as the head of a run and a baseline hold it."""
        return OptionsDocument(
            seed=self.seed,
            time_limit_s=self.limits.time_s,
            memory_limit_mib=self.limits.memory_mib,
            methods={name: _method_options(method) for name, method in self.methods.items()},
            weights=dataclasses.asdict(self.weights),
            read=dataclasses.asdict(self.read),
        )


def _method_options(method: Method) -> MethodOptions:
    if isinstance(method, Chain):
        return [(name, _plain_options(part)) for name, part in method.parts]
    return _plain_options(method)


def _plain_options(method: Method) -> dict[str, Any]:
    fields = dataclasses.fields(method) if dataclasses.is_dataclass(method) else ()
    return {each.name: getattr(method, each.name) for each in fields}


def fingerprint(data: object) -> str:
    """Digest of documents and plain data, equal for equal data."""
    plain_data = msgspec.to_builtins(data, enc_hook=str)
    return hashlib.sha256(json.dumps(plain_data, sort_keys=True).encode()).hexdigest()[:16]


def uncompared(baseline: Baseline, options: OptionsDocument | None) -> frozenset[str]:
    """Figures that mean something else in the baseline than in a run with these options."""
    if baseline.options is None or options is None:
        return frozenset()
    differs = any(_differences(baseline.options.weights, options.weights))
    return frozenset({"objective"} if differs else ())


def other_options(baseline: Baseline, options: OptionsDocument, options_fingerprint: str = "") -> str:
    """Name the options of a run with which the baseline was not made; empty where there are none.

    `options_fingerprint` decides for a baseline that does not hold its options; empty where methods were selected.
    Options of methods are compared where both have the method; an option that only one of them knows is no difference.
    """
    if not baseline.logs:
        return ""
    if baseline.options is None:
        same = not options_fingerprint or baseline.options_fingerprint == options_fingerprint
        return "" if same else "the baseline was made with other options; it does not say which"
    found = list(_differences(plain(baseline.options), plain(options)))
    if not found:
        return ""
    more = f", and {len(found) - _MOST_NAMED} more" if len(found) > _MOST_NAMED else ""
    note = "; the weights differ, so that objective is not compared" if uncompared(baseline, options) else ""
    return f"the baseline was made with other options: {', '.join(found[:_MOST_NAMED])}{more}{note}"


def _differences(before: Any, now: Any, name: str = "") -> Iterator[str]:
    """Each option that differs, with its value and the baseline's."""
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        for key in (key for key in now if key in before):
            group = "" if not name and key in ("methods", "read") else f"{name}{key}"
            nested = isinstance(now[key], Mapping) and group
            yield from _differences(before[key], now[key], f"{group}." if nested else group)
    elif before != now:
        yield f"{name.rstrip('.')} {_shown(now)} (baseline: {_shown(before)})"


def _shown(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= _LONGEST_VALUE else f"{text[: _LONGEST_VALUE - 1]}…"
