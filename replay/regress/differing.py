"""With which other options a baseline was made, in words."""

import json
from collections.abc import Iterator, Mapping
from typing import Any

from replay.base.documents import plain
from replay.regress.baseline import Baseline

_MOST = 5
"""Options that are named."""


def uncompared(baseline: Baseline, options: Mapping[str, Any]) -> frozenset[str]:
    """Metrics that mean something else in the baseline than in a run with these options."""
    weights = baseline.settings.get("weights", {})
    differs = any(_differences(weights, plain(options.get("weights") or {})))
    return frozenset({"objective"} if differs else ())


def other_options(baseline: Baseline, options: Mapping[str, Any], fingerprint: str = "") -> str:
    """Which of a run's options the baseline was not made with; empty where there are none.

    `fingerprint` of the options tells for a baseline that does not hold its own; empty where methods were selected. Of
    the methods' options those of methods that both have; an option that only one of them knows is no difference.
    """
    if not baseline.logs:
        return ""
    if not baseline.settings:
        same = not fingerprint or baseline.options == fingerprint
        return "" if same else "the baseline was made with other options; it does not say which"
    found = list(_differences(baseline.settings, plain(options)))
    if not found:
        return ""
    more = f", and {len(found) - _MOST} more" if len(found) > _MOST else ""
    note = "; the weights differ, so that objective is not compared" if uncompared(baseline, options) else ""
    return f"the baseline was made with other options: {', '.join(found[:_MOST])}{more}{note}"


def _differences(before: Any, now: Any, name: str = "") -> Iterator[str]:
    """Each option that differs with its value, and the baseline's."""
    if isinstance(before, Mapping) and isinstance(now, Mapping):
        for key in (key for key in now if key in before):
            group = "" if not name and key in ("methods", "read") else f"{name}{key}"
            nested = isinstance(now[key], Mapping) and group
            yield from _differences(before[key], now[key], f"{group}." if nested else group)
    elif before != now:
        yield f"{name.rstrip('.')} {_shown(now)} (baseline: {_shown(before)})"


def _shown(value: Any) -> str:
    text = value if isinstance(value, str) else json.dumps(value)
    return text if len(text) <= 40 else f"{text[:39]}…"
