"""Tables for people, at most 100 columns wide. Angles in degrees; the files and JSON keep SI units."""

import math
from collections.abc import Iterable, Mapping
from typing import Any

from rich import box
from rich.table import Table
from rich.text import Text

from optim.audit.report import AuditReport, Check
from optim.model.metrics import Metrics
from replay.base.errors import printable
from replay.run.outcome import AS_GOOD, Run

_STYLE_OF_STATUS = {"improved": "green", "kept": "yellow", "failed": "red"}


def verdict(run: Run) -> str:
    """One sentence: what the best method gained."""
    best, before = run.best, run.recorded_metrics
    if best is None:
        return f"{run.case.name}: nothing better than the recorded path was found (J {before.objective:.2f})"
    after = best.metrics
    saved = 1.0 - after.objective / before.objective
    gains = [f"J {after.objective:.2f} instead of {before.objective:.2f}"]
    gains.append(f"{after.length:.2f} m instead of {before.length:.2f} m")
    if after.cusps != before.cusps:
        gains.append(f"{gear_changes(after.cusps)} instead of {before.cusps:.0f}")
    if not run.recorded_audit.passed:
        return f"{run.case.name}: the recorded path fails the audit, {best.name}'s passes: {', '.join(gains)}"
    share = f"{saved:.1%}" if saved >= 0.001 else "less than 0.1%"
    return f"{run.case.name}: {best.name} is {share} better: {', '.join(gains)}"


def remarks(run: Run) -> list[str]:
    """Whether the path to drive is safe, and which methods' paths are equally good."""
    best, required = run.best, run.case.problem.required_clearance
    if best is None:
        passes = "passes the audit" if run.recorded_audit.passed else "does not pass the audit"
        return [f"the recorded path stands: it {passes}, {_clearance(run.recorded_metrics)}"]
    asked = "" if math.isinf(best.metrics.min_clearance) else f" (required {required:.3f} m)"
    lines = [f"safe: it passes the audit, {_clearance(best.metrics)}{asked}"]
    if run.as_good:
        lines.append(f"equally good (within {100.0 * AS_GOOD:g} %): {', '.join(method.name for method in run.as_good)}")
    return lines


def _clearance(metrics: Metrics) -> str:
    value = metrics.min_clearance
    return "no obstacles" if math.isinf(value) else f"clearance {value:.3f} m"


def gear_changes(count: float) -> str:
    """The number and its noun."""
    return f"{count:.0f} gear change" + ("" if count == 1 else "s")


def result_table(run: Run) -> Table:
    """The recorded path against each method's."""
    table = _bare_table()
    table.add_column("path", overflow="fold")
    shape = ("J", "length\n[m]", "cusps", "max|φ|\n[°]", "max|α|\n[°]")
    for heading in (*shape, "∫|dφ|\n[°]", "clear.\n[m]", "time\n[s]"):
        table.add_column(heading, justify="right", no_wrap=True)
    table.add_column("status", no_wrap=True)
    table.add_row("recorded", *_metrics_cells(run.recorded_metrics), "", _recorded_status(run))
    for method in run.methods:
        status = Text(method.status, style=_STYLE_OF_STATUS[method.status])
        table.add_row(method.name, *_metrics_cells(method.metrics), f"{method.wall_s:.2f}", status)
    return table


def reasons(run: Run) -> list[str]:
    """One line for each method: how it stopped, and why its path counts or does not."""
    stops = ["" if method.stop == method.status else f" ({method.stop})" for method in run.methods]
    return [
        f"{method.name}: {method.status}{stop}. {method.reason}"
        for method, stop in zip(run.methods, stops, strict=True)
    ]


def recorded_failures(run: Run) -> list[str]:
    """One line for each check of the audit that the recorded path does not pass."""
    return [f"the recorded path does not pass the audit: {failure}" for failure in run.recorded_audit.failures]


def checks_table(reports: Mapping[str, AuditReport]) -> Table:
    """Audit reports by the name of the path: every number that is checked, and its limit."""
    table = _table("check", "what")
    for name in reports:
        table.add_column(printable(name, 20), justify="right", no_wrap=True)
    table.add_column("limit", justify="right", no_wrap=True)
    limits = {
        (check, key): limit
        for report in reports.values()
        for check, outcome in report.checks.items()
        for key, limit in (outcome.limits or {"": None}).items()
    }
    for (check, key), limit in limits.items():
        cells = [_check_cell(report.checks.get(check), key) for report in reports.values()]
        sign = "≥" if check in ("clearance", "boundary") else "≤"
        table.add_row(check, _quantity(key), *cells, "" if limit is None or math.isnan(limit) else f"{sign}{limit:.3g}")
    return table


def _check_cell(check: Check | None, key: str) -> Text:
    """Cell with the value of a check; marked where it failed."""
    if check is None:
        return Text("not made", style="red")
    value = check.values.get(key, math.nan)
    found = f"{value:.3g}" if math.isfinite(value) else "passed" if check.passed else ""
    return Text(found) if check.passed else Text(f"FAILED {found}".rstrip(), style="red")


def _quantity(key: str) -> str:
    """A name that ends in its unit, with the unit in brackets: `heading_rad` is "heading [rad]"."""
    name, _, unit = key.rpartition("_")
    return f"{name.replace('_', ' ')} [{unit}]" if unit in ("m", "rad", "rad/m") else key.replace("_", " ")


def options_table(options: Iterable[Any]) -> Table:
    """The options of one method (`replay.cli.options.Option`)."""
    table = _table("flag", "unit", "default")
    table.add_column("meaning", overflow="fold")
    for option in options:
        meaning = " ".join(option.doc.split())
        choices = f" ({option.kind})" if "|" in option.kind and option.kind not in meaning else ""
        table.add_row(option.flag, option.unit, str(option.default), meaning + choices)
    return table


def channels_table(channels: Iterable[Mapping[str, Any]]) -> Table:
    """Topics of a log with schema, encoding, number of messages, and what was understood of them."""
    table = _bare_table()
    for heading in ("topic", "schema", "encoding"):
        table.add_column(heading, overflow="fold")
    table.add_column("messages", justify="right", no_wrap=True)
    table.add_column("understood", overflow="fold")
    for channel in channels:
        cells = (channel["topic"], channel["schema"] or "(none)", channel["encoding"])
        table.add_row(*map(printable, cells), str(channel["messages"]), printable(channel["understood"], 200))
    return table


def facts_table(facts: Mapping[str, str]) -> Table:
    """Names and what is known about them, without a heading."""
    table = Table(box=None, show_header=False, pad_edge=False, padding=(0, 1, 0, 0))
    table.add_column(no_wrap=True)
    table.add_column(overflow="fold")
    for name, fact in facts.items():
        table.add_row(name, fact)
    return table


def _table(*headings: str) -> Table:
    """A table whose first columns hold words."""
    table = _bare_table()
    for heading in headings:
        table.add_column(heading, no_wrap=True)
    return table


def _bare_table() -> Table:
    return Table(box=box.SIMPLE_HEAD, pad_edge=False, padding=(0, 1, 0, 0))


def _metrics_cells(metrics: Metrics) -> list[str]:
    """The cells of one path, in the order of `result_table`."""
    return [
        f"{metrics.objective:.2f}",
        f"{metrics.length:.2f}",
        f"{metrics.cusps:.0f}",
        *(f"{math.degrees(getattr(metrics, key)):.1f}" for key in ("max_abs_phi", "max_abs_alpha")),
        f"{math.degrees(metrics.steering_variation):.0f}",
        "free" if math.isinf(metrics.min_clearance) else f"{metrics.min_clearance:.3f}",
    ]


def _recorded_status(run: Run) -> Text:
    return Text("") if run.recorded_audit.passed else Text("not sound", style="red")
