"""The page of a run: one file, nothing fetched, every string escaped by the template engine."""

import base64
import hashlib
import pathlib
from collections.abc import Sequence
from typing import Any, Final, NamedTuple

from jinja2 import Environment, FileSystemLoader, StrictUndefined

from optim.methods import METHODS
from replay.base.numbers import fixed, percent, shown
from replay.base.schemas.summary import TrendPoint
from replay.base.style import styles
from replay.report import page_data
from replay.report.charts import Chart, drift_chart, profile_chart, time_chart
from replay.report.facts import (
    acceptable,
    by_class,
    by_method,
    class_of_logs,
    headline,
    profiles,
    state,
    tally,
)
from replay.report.groups import gravest, groups
from replay.report.run_data import RunData
from replay.report.safe import facts

SIGNS: Final = {
    "failed": "✗",
    "passed": "✓",
    "unfinished": "…",
    "unjudged": "○",
    "empty": "○",
    "crashed": "✗",
    "missing": "✗",
    "changed": "≠",
    "worse": "▼",
    "known": "!",
    "better": "▲",
    "new": "+",
    "same": "=",
}
"""Shown beside every colour, for people who do not see it."""
_DASHES: Final = ("none", "9 3", "3 3", "12 3 3 3", "6 2 2 2", "1.5 2.5")
"""Dash patterns: nearly equal curves hide each other, and dashes let the ones below show through."""
_PAGE: Final = pathlib.Path(__file__).parent / "page"
_MOST_ERRORS: Final = 200
_MOST_SENTENCES: Final = 5


def page(run: RunData, trend: Sequence[TrendPoint]) -> str:
    """The page as text."""
    environment = Environment(
        loader=FileSystemLoader(_PAGE, encoding="utf-8"), autoescape=True, undefined=StrictUndefined
    )
    names = list(dict.fromkeys((*run.methods, *(name for point in trend for name in point.ratio))))
    style = _text("style.css") + _colours(names)
    script = _text("script.js")
    together = groups(run)
    lines, cases = page_data.change_lines(run), page_data.case_lines(run)
    content: dict[str, Any] = {
        "run": run,
        "head": run.head,
        "about": {name: facts(getattr(run.head, name.lower())) for name in ("Machine", "Versions", "Options")},
        "state": state(run),
        "headline": headline(run),
        "has_kinds": any(class_of_logs(run).values()),
        "has_tags": any(row.tags for row in run.rows),
        "acceptable": acceptable(run),
        "tally": tally(run.changes),
        "groups": together,
        "worst": [group.sentence for group in gravest(together)[:_MOST_SENTENCES]],
        "changes": lines[: page_data.MOST_CHANGES],
        "more_changes": max(0, len(lines) - page_data.MOST_CHANGES),
        "errors": sorted(run.errors, key=lambda error: (error.expected, error.log))[:_MOST_ERRORS],
        "methods": by_method(run),
        "classes": by_class(run),
        "charts": _charts(run, trend),
        "trend": trend,
        "legend": names,
        "cases": cases[: page_data.MOST_CASES],
        "more_cases": max(0, len(cases) - page_data.MOST_CASES),
        "look": {name: _Look(style.label, f"m{i}") for i, (name, style) in enumerate(styles(names).items())},
        "signs": SIGNS,
        "style": style,
        "script": script,
        "style_hash": _hash(style),
        "script_hash": _hash(script),
    }
    functions = {"shown": shown, "fixed": fixed, "percent": percent}
    return environment.get_template("page.html").render(**content, **functions)


class _Look(NamedTuple):
    """Label and style of a method on the page."""

    label: str
    css: str
    """Class of the method's curves in the style sheet."""


def _charts(run: RunData, trend: Sequence[TrendPoint]) -> list[Chart]:
    charts = (profile_chart(profiles(run)), drift_chart(trend), time_chart(trend))
    return [chart for chart in charts if chart is not None]


def _colours(names: Sequence[str]) -> str:
    """Style rules for the methods' curves: colours as in the recordings, and dashes that each method keeps."""
    rules = []
    known = list(METHODS)
    others = [name for name in names if name not in known]
    for i, (name, style) in enumerate(styles(names).items()):
        red, green, blue = style.colour
        place = known.index(name) if name in known else len(known) + others.index(name)
        dash = _DASHES[place % len(_DASHES)]
        rules.append(f".m{i} {{ stroke: rgb({red} {green} {blue}); stroke-dasharray: {dash}; }}\n")
        rules.append(f".dot.m{i} {{ fill: rgb({red} {green} {blue}); stroke: none; }}\n")
    return "".join(rules)


def _text(name: str) -> str:
    return (_PAGE / name).read_text(encoding="utf-8")


def _hash(text: str) -> str:
    """Digest with which the page's policy allows this text and no other."""
    return "sha256-" + base64.b64encode(hashlib.sha256(text.encode()).digest()).decode()
