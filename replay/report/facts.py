"""Facts of a run that all reports share: its verdict in one line, and figures by method and class."""

import math
import statistics
from collections import Counter
from collections.abc import Iterable, Sequence

from msgspec import UNSET, UnsetType

from replay.base.numbers import count, percent, shown
from replay.base.schemas.log import MethodResult
from replay.base.schemas.summary import Change, MethodFigures
from replay.base.schemas.verdicts import FAILING, VERDICTS
from replay.base.style import styles
from replay.report.run_data import ResultRow, RunData


def figures(rows: Iterable[ResultRow]) -> MethodFigures:
    """Figures of some rows, usually those of one method."""
    rows = list(rows)
    results = [row.result for row in rows]
    status = Counter(result.status for result in results)
    return MethodFigures(
        results=len(rows),
        improved=status["improved"],
        kept=status["kept"],
        failed=status["failed"],
        ratio=geometric_mean(ratio for row in rows if (ratio := cost_ratio(row)) is not None),
        cusps=_mean(_known(result.metrics.cusps for result in results)),
        clearance=min(_known(result.metrics.min_clearance for result in results), default=None),
        wall_s=statistics.median(times) if (times := _known(result.wall_s for result in results)) else None,
        total_s=math.fsum(times),
    )


def _known(values: Iterable[float | UnsetType | None]) -> list[float]:
    return [value for value in values if value is not None and value is not UNSET]


def cost(result: MethodResult) -> float | None:
    """J of a method's path, where it is positive."""
    found = result.metrics.objective
    return found if found and found > 0.0 else None


def cost_ratio(row: ResultRow) -> float | None:
    """J over the recorded path's J [-]."""
    before, after = row.recorded.metrics.objective or 0.0, cost(row.result)
    return after / before if before > 0.0 and after is not None else None


def geometric_mean(values: Iterable[float]) -> float | None:
    """Geometric mean of positive values; None where there are none."""
    logarithms = [math.log(value) for value in values]
    return math.exp(math.fsum(logarithms) / len(logarithms)) if logarithms else None


def _mean(values: Iterable[float]) -> float | None:
    values = list(values)
    return math.fsum(values) / len(values) if values else None


def by_method(run: RunData) -> dict[str, MethodFigures]:
    """Figures of each method over all cases."""
    return {name: figures(row for row in run.rows if row.method == name) for name in run.methods}


def by_class(run: RunData) -> dict[str, dict[str, MethodFigures]]:
    """Figures of each class of logs and method."""
    kinds = sorted({row.kind for row in run.rows})
    return {
        kind: {name: figures(r for r in run.rows if (r.kind, r.method) == (kind, name)) for name in run.methods}
        for kind in kinds
    }


def profiles(run: RunData) -> dict[str, list[float]]:
    """For each method, J over the least J that any method reached on that case, ascending."""
    best: dict[str, float] = {}
    for row in run.rows:
        best[row.case] = min(cost(row.result) or math.inf, best.get(row.case, math.inf))
    found: dict[str, list[float]] = {name: [] for name in run.methods}
    for row in run.rows:
        if (reached := cost(row.result)) is not None:
            found[row.method].append(reached / best[row.case])
    return {name: sorted(ratios) for name, ratios in found.items() if ratios}


def tally(changes: Iterable[Change]) -> dict[str, int]:
    """Number of comparisons by verdict, the gravest first; verdicts that do not occur are left out."""
    counted = Counter(change.verdict for change in changes)
    return {verdict: counted[verdict] for verdict in VERDICTS if counted[verdict]}


def ranked(changes: Iterable[Change]) -> list[Change]:
    """Changes that do not say "same": the gravest first, of equal ones the largest relative change first."""
    differing = [change for change in changes if change.verdict != "same"]
    return sorted(
        differing, key=lambda c: (VERDICTS.index(c.verdict), -abs(c.relative or 0.0), c.log, c.case, c.method)
    )


def state(run: RunData) -> str:
    """failed, passed, unfinished (and nothing failed so far), unjudged (without a baseline) or empty."""
    if run.failing or run.slower:
        return "failed"
    if not run.head.complete:
        return "unfinished"
    if not run.rows and not run.errors:
        return "empty"
    return "passed" if run.compared else "unjudged"


def headline(run: RunData) -> str:
    """The verdict in one line."""
    extent = f"{count(len(run.rows), 'result')} of {logs_in_all(run)}"
    so_far = "" if run.head.complete else f" (unfinished: {_progress(run)})"
    match state(run):
        case "failed":
            return _regression(run) + so_far
        case "unfinished":
            return f"Unfinished: {_progress(run)}; no regression so far"
        case "empty":
            return "Empty: no log was worked on"
        case "unjudged":
            return f"Not compared: {extent}, no baseline"
        case _:
            better = sum(change.verdict == "better" for change in run.changes)
            more = f"; {count(better, 'metric')} better than the baseline" if better else ""
            return f"No regression: {extent}{more}"


def _regression(run: RunData) -> str:
    """Number of results that fell short; `groups` says which."""
    failing = run.failing
    results = {v: {(c.log, c.case, c.method) for c in failing if c.verdict == v} for v in VERDICTS if v in FAILING}
    nouns = {"changed": "log"}
    parts = [f"{count(len(found), nouns.get(v, 'result'))} {v}" for v, found in results.items() if found]
    logs = {change.log for change in failing}
    in_all = count(len(logs.union(run.logs)), "log")  # missing logs too
    affected = [f"{len(logs)} of {in_all} affected"] if failing else []
    slower = [f"slower than {run.against}: {', '.join(run.slower)}"] if run.slower else []
    return "Regression: " + "; ".join([*([", ".join(parts)] if parts else []), *affected, *slower])


def logs_in_all(run: RunData) -> str:
    """'3 logs': how many were worked on."""
    return count(len(run.logs), "log")


def sentence(change: Change) -> str:
    """One comparison in words."""
    place = change.case or change.log
    where = f"{change.method} on {place}" if change.method else f"log {place}"
    if change.verdict == "crashed":
        return f"{where} crashed: {change.note}".removesuffix(": ")
    if change.verdict == "changed":
        return change.note
    if change.verdict == "missing":
        return f"renamed: {change.before} → {change.after}" if change.after else f"{where} is missing"
    if change.verdict == "new" and change.key in ("log", "result"):
        return f"{where} is new"
    unit = f" {change.unit}" if change.unit not in ("", "-") else ""
    relative = f" ({text})" if (text := percent(change.relative)) else ""
    why = f", {change.note}" if is_declared(change) and change.note else ""
    return f"{where}: {change.key} {shown(change.before)} → {shown(change.after)}{unit}{relative}{why}"


def _progress(run: RunData) -> str:
    done, planned = len(run.logs), run.head.corpus.num_logs
    return f"{done} of {planned} logs done" if planned else f"{count(done, 'log')} done"


def class_of_logs(run: RunData) -> dict[str, str]:
    """The class of each log."""
    return {row.log: row.kind for row in run.rows} | {error.log: error.kind for error in run.errors}


def is_failing(change: Change) -> bool:
    """Whether a run fails with this change."""
    return change.verdict in FAILING


def is_declared(change: Change) -> bool:
    """Whether a change contradicts `corpus.toml`: that file has to be changed, accepting the run does not help."""
    return change.key == "expect" or (change.key == "error" and change.after == "read")


def acceptable(run: RunData) -> bool:
    """Whether accepting the run would mend any failure."""
    return any(not is_declared(change) for change in run.failing)


def labels(methods: Sequence[str]) -> dict[str, str]:
    """Names of methods as people read them."""
    return {name: style.label for name, style in styles(methods).items()}
