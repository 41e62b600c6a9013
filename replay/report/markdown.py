"""The run as Markdown for a pull request: the verdict, and what changed. Short."""

import re
from collections.abc import Sequence

from replay.base.numbers import count, fixed, percent, shown
from replay.report.facts import acceptable, by_method, headline, labels, state
from replay.report.groups import Group, groups
from replay.report.html import SIGNS
from replay.report.run_data import RunData

MOST_LINES = 20
"""Rows of the table of changes; the page has all."""


def markdown(run: RunData) -> str:
    """The text of a comment."""
    about = [("revision", run.head.revision), ("corpus", run.head.corpus.path), ("run", run.name)]
    parts = [f"### {SIGNS[state(run)]} {escaped(headline(run))}"]
    parts.append(", ".join(f"{name} {escaped(value)}" for name, value in about if value))
    parts += [*_extent(run), *_unusable(run)]
    changed = groups(run) if run.compared else []  # else all is new, which the headline says
    others = [group.sentence for group in changed if group.verdict == "changed"]
    parts += [f"**{escaped(line)}**" for line in others[:MOST_LINES]]
    if changed:
        parts.append(_changes(changed[:MOST_LINES]))
    if len(changed) > MOST_LINES:
        parts.append(f"{len(changed) - MOST_LINES} more lines are in `report.html`.")
    if run.rows:
        parts.append(_methods(run))
    if run.timing:
        parts.append(_timing(run))
    accept = run.head.commands.accept if run.head.commands else ""
    if accept and acceptable(run):
        parts.append(f"If this is intended: `{accept.replace('`', '')}`")
    return "\n\n".join(part for part in parts if part) + "\n"


def _extent(run: RunData) -> list[str]:
    """Notes on an unfinished or partial run, and on changed options."""
    parts = []
    if not run.head.complete:
        parts.append("**Unfinished:** the results so far.")
    if run.head.partial:
        parts.append(f"**Only a part of the corpus:** {escaped(run.head.partial)}.")
    if run.head.other_options:
        parts.append(f"**Other options:** {escaped(run.head.other_options)}.")
    return parts


def _unusable(run: RunData) -> list[str]:
    """Files of the run, logs and recordings that could not be read or written."""
    parts = []
    if run.damaged:
        parts.append(f"**{count(len(run.damaged), 'file')} of the run cannot be read** and are left out.")
    if unexpected := run.unexpected:
        names = ", ".join(escaped(error.log) for error in unexpected[:MOST_LINES])
        parts.append(f"{count(len(unexpected), 'log')} could not be used: {names}")
        parts += [escaped(error.cure) for error in unexpected[:MOST_LINES] if error.cure]
    if unwritten := run.unwritten:
        reason = escaped(next(iter(unwritten.values())))
        parts.append(f"**{count(len(unwritten), 'recording')} could not be written:** {reason}")
    return parts


def _changes(found: Sequence[Group]) -> str:
    """One row for each method, metric and class, with the worst case of each."""
    rows = []
    for group in found:
        change = group.worst
        unit = f" {change.unit}" if change.unit not in ("", "-") else ""
        values = [escaped(shown(value, 7)) for value in (change.before, change.after)]
        row = [f"{SIGNS[group.verdict]} {group.verdict}", *map(escaped, (group.method, group.key + unit, group.kind))]
        row += [str(len(group.changes)), percent(group.median), escaped(change.case or change.log), *values]
        rows.append([*row, escaped(change.tolerance)])
    header = ["verdict", "method", "metric", "class", "cases", "median", "most changed", "before", "after", "tolerance"]
    return _table(header, rows, right=("cases", "median", "before", "after"))


def _methods(run: RunData) -> str:
    names = labels(run.methods)
    rows = []
    for name, found in by_method(run).items():
        done = f"{found.improved} of {found.results}"
        row = [escaped(names[name]), done, str(found.failed), fixed(found.ratio, 4), fixed(found.wall_s, 2)]
        rows.append(row)
    header = ["method", "improved", "failed", "J / recorded J", "median time [s]"]
    return _table(header, rows, right=header[1:])


def _timing(run: RunData) -> str:
    rows = []
    for each in run.timing:
        interval = "too few logs" if each.low is None else f"{fixed(each.low, 3)} to {fixed(each.high, 3)}"
        verdict = "✗ slower" if each.slower else ""
        rows.append([escaped(each.method), fixed(each.ratio, 3), interval, str(each.logs), verdict])
    header = [f"times against {escaped(run.against)}", "new / old", "95 % interval", "logs", ""]
    return _table(header, rows, right=("new / old", "95 % interval", "logs"))


def _table(header: Sequence[str], rows: Sequence[Sequence[str]], right: Sequence[str]) -> str:
    rule = "|" + "|".join("--:" if name in right else "---" for name in header) + "|"
    return "\n".join(["| " + " | ".join(header) + " |", rule, *("| " + " | ".join(row) + " |" for row in rows)])


def escaped(text: str) -> str:
    """The text as part of a sentence or a cell: nothing in it acts as markup, links or mentions anybody."""
    text = " ".join(text.split())
    text = text.replace("&", "&amp;").replace("<", "&lt;").replace(">", "&gt;")
    text = re.sub(r"([\\`*_|\[\]#~!])", r"\\\1", text)
    return re.sub(r"@(?=\w)", "@\u200b", text).replace("://", ":\u200b//")
