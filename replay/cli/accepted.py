"""What accepting a run changes, for people: a table of changed figures, and how much is new."""

from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from rich.table import Table

from replay.base.errors import printable
from replay.base.numbers import count, shown

_LONGEST = 60


def changes_for_people(changes: Sequence[Mapping[str, Any]]) -> Iterator[Table | str]:
    """Every changed figure as a row; of what is new, counts: its figures are lines of the baseline."""
    changed = [entry for entry in changes if entry["verdict"] != "new"]
    if changed:
        yield _table(changed)
    new = [entry for entry in changes if entry["verdict"] == "new"]
    if new:
        results = {(entry["case"], entry["method"]) for entry in new if entry["method"]}
        refused = [entry for entry in new if not entry["method"]]
        words = [count(len(results), "result")] if results else []
        words += [f"{count(len(refused), 'log')} that cannot be read"] if refused else []
        logs = count(len({entry["log"] for entry in new}), "log")
        yield f"new: {' and '.join(words)}, in {count(len(new), 'figure')} of {logs}"


def _table(changed: Sequence[Mapping[str, Any]]) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("verdict", "case", "method", "figure", "before", "after"):
        is_number = heading in ("before", "after")
        table.add_column(heading, justify="right" if is_number else "left", overflow="fold")
    for entry in changed:
        values = (shown(entry["before"], 7), shown(entry["after"], 7))
        words = (entry["verdict"], entry["case"] or entry["log"], entry["method"], entry["key"], *values)
        table.add_row(*(printable(word, _LONGEST) for word in words))
    return table
