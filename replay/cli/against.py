"""The part of `replay regress --against VERSION` that times two versions in turns; the reports say which is slower."""

import json
from dataclasses import asdict

from rich.table import Table

from replay.base.errors import ReplayError, printable
from replay.base.files import atomic_write
from replay.cli.console import Voice
from replay.regress.bar import Bar
from replay.regress.corpus import STORES
from replay.regress.running import Plan
from replay.regress.store import Store
from replay.regress.timing import (
    AGAINST_ERROR,
    ALARM,
    LEAST_PAIRS,
    Comparison,
    Server,
    judged,
    measure,
    this_version,
    version,
)
from replay.regress.work import local_file
from replay.report.reading import TIMING, TIMING_SCHEMA


def time_against(voice: Voice, plan: Plan, store: Store, name: str) -> dict[str, Comparison] | None:
    """Time this version and another one in turns, and write timing.json into the run, for its reports.

    None, and a line that says why, where that fails: it costs no result.
    """
    try:
        return _timed(voice, plan, store, name)
    except ReplayError as error:
        if error.code != AGAINST_ERROR:
            raise
        voice.error(str(error))
        return None


def _timed(voice: Voice, plan: Plan, store: Store, name: str) -> dict[str, Comparison]:
    """The comparison by method, also written.

    Methods are timed with their default options: those are what both versions have. Raises ReplayError (E_AGAINST).
    """
    read = {document["log"] for document in store.documents() if document.get("error") is None}
    pairs = [
        (log.name, str(local_file(log.path).absolute()), method)
        for log in plan.logs
        if log.name in read or log.path.startswith(STORES)
        for method in plan.methods_of(log)
    ]
    with (
        version(name) as other,
        Server(other) as old,
        Server(this_version()) as new,
        Bar(voice.people, enabled=voice.wants_progress, unit="pairs") as bar,
    ):
        ratios = measure(old, new, pairs, lambda done: bar.count(done, len(pairs)))
    found = judged(ratios)
    document = {"schema": TIMING_SCHEMA, "against": name, "ratios": ratios}
    document["compared"] = {method: asdict(each) | {"alarm": each.alarm} for method, each in found.items()}
    with atomic_write(store.folder / TIMING) as temporary:
        temporary.write_text(json.dumps(document, indent=1, sort_keys=True) + "\n")
    return found


def tell_timing(voice: Voice, name: str, found: dict[str, Comparison]) -> None:
    """The table of the methods' ratios, and what it amounts to."""
    voice.show(_table(found), f"timed against {name}: {_sentence(found)}")


def _table(found: dict[str, Comparison]) -> Table:
    table = Table(box=None, pad_edge=False)
    for heading in ("method", "new / old", "95 % interval", "logs"):
        table.add_column(heading, justify="left" if heading == "method" else "right", no_wrap=True)
    for method, each in found.items():
        interval = "–" if each.low is None else f"{each.low:.3f} to {each.high:.3f}"
        table.add_row(printable(method, 60), f"{each.ratio:.3f}", interval, str(each.pairs))
    return table


def _sentence(found: dict[str, Comparison]) -> str:
    slower = [method for method, each in found.items() if each.alarm]
    if not found:
        return "nothing that both versions can do"
    if slower:
        return f"slower: {', '.join(slower)} (the whole interval lies above {ALARM})"
    if all(each.low is None for each in found.values()):
        return f"no verdict: at least {LEAST_PAIRS} logs are needed"
    return f"not slower (no interval lies above {ALARM})"
