"""Tables of the contenders on whole logs."""

import json
import math
import pathlib
import statistics
from typing import Any

from tools.bench.peers.obca import TIME_LIMIT

Row = dict[str, Any]
OBCA = "OBCA, all pairs, IPOPT"
WITHIN = 1e-3
"""J at most this much above the other's counts as equal [-]."""


def report(folder: pathlib.Path) -> str:
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))]
    by_log: dict[str, dict[str, Row]] = {}
    for row in rows:
        by_log.setdefault(row["log"], {})[row["name"]] = row
    names = list(dict.fromkeys(row["name"] for row in rows))
    order = sorted(names, key=lambda name: (_kind(name), -_success(by_log, name), _median(by_log, name)))
    parts = [
        "## Whole logs",
        _words(len(by_log)),
        *_missing(by_log, names),
        _summary(by_log, order),
        *_targets(by_log),
        *_compiling(rows),
        _each(by_log, order),
    ]
    return "\n\n".join(parts)


def _missing(by_log: dict[str, dict[str, Row]], names: list[str]) -> list[str]:
    """Who has not solved all of these logs yet."""
    counts = {name: sum(name in rows for rows in by_log.values()) for name in names}
    short = [f"{name} {count}" for name, count in counts.items() if count < len(by_log)]
    return [f"Measured on fewer of these logs so far: {', '.join(short)}."] if short else []


def _compiling(rows: list[Row]) -> list[str]:
    """What was spent in compilers, which the tables leave out."""
    spent: dict[str, list[float]] = {}
    for row in rows:
        if row.get("compile_s", 0.0) > 0.0:
            spent.setdefault(row["name"], []).append(row["compile_s"])
    return [
        f"{name} compiles its functions with JAX for each log, which the tables leave out: "
        f"{statistics.median(found):.3g} s of CPU in the median of {len(found)} logs. It keeps one problem from the "
        "recorded path to the end: no segment is left out, and clearance is kept at its nodes only."
        for name, found in spent.items()
    ]


def _kind(name: str) -> int:
    return int("cpo" in name or "Dolgov" in name)


def _words(count: int) -> str:
    return (
        f"{count} sample logs, every contender from the recorded path at the same knots (0.35 m). *Sound* are paths "
        "that our audit passes and that are better than the recorded one; of those J is compared with scp's on the "
        "logs on which both are sound. CPU seconds, building the problem included; the ratio is the median over the "
        "logs of this contender's time by the other's on the same log, sound or not."
    )


def _success(by_log: dict[str, dict[str, Row]], name: str) -> int:
    return sum(rows[name]["status"] == "improved" for rows in by_log.values() if name in rows)


def _median(by_log: dict[str, dict[str, Row]], name: str) -> float:
    return statistics.median(rows[name]["cpu_s"] for rows in by_log.values() if name in rows)


def _ratio(by_log: dict[str, dict[str, Row]], name: str, other: str) -> float:
    found = [rows[name]["cpu_s"] / rows[other]["cpu_s"] for rows in by_log.values() if name in rows and other in rows]
    return statistics.median(found) if found else math.nan


def _against(by_log: dict[str, dict[str, Row]], name: str, other: str) -> list[float]:
    """J of one over J of the other, on logs where both are sound."""
    pairs = [(rows[name], rows[other]) for rows in by_log.values() if name in rows and other in rows]
    return [a["objective"] / b["objective"] for a, b in pairs if a["status"] == b["status"] == "improved"]


def _summary(by_log: dict[str, dict[str, Row]], names: list[str]) -> str:
    lines = [
        "| | sound | J / J of scp | median CPU [s] | of it building | times scp's | times ddp's |",
        "|---|--:|--:|--:|--:|--:|--:|",
    ]
    for name in names:
        rows = [log[name] for log in by_log.values() if name in log]
        ratios = _against(by_log, name, "scp")
        mean = f"{math.exp(statistics.fmean(math.log(r) for r in ratios)):.4f} ({len(ratios)})" if ratios else "–"
        building = statistics.median(row["build_s"] / row["cpu_s"] for row in rows)
        cells = [
            f"{_success(by_log, name)} of {len(rows)}",
            mean,
            f"{_median(by_log, name):.3g}",
            f"{building:.0%}" if building else "",
            f"{_ratio(by_log, name, 'scp'):.3g}",
            f"{_ratio(by_log, name, 'ddp'):.3g}",
        ]
        lines.append(f"| {name} | " + " | ".join(cells) + " |")
    return "\n".join(lines)


def _targets(by_log: dict[str, dict[str, Row]]) -> list[str]:
    """What was asked for, and what came of it."""
    if not any(OBCA in rows and "scp" in rows and "ddp" in rows for rows in by_log.values()):
        return []
    values = _against(by_log, "scp", OBCA)
    equal = sum(value <= 1.0 + WITHIN for value in values)
    lines = [
        f"- scp: J equal to plain OBCA's within 0.1 % or less on {equal} of the {len(values)} logs where both are "
        f"sound; "
        f"{_ratio(by_log, OBCA, 'scp'):.3g} times less CPU time (asked for: 10), "
        f"{_success(by_log, 'scp')} sound against {_success(by_log, OBCA)}.",
        f"- ddp: {_ratio(by_log, OBCA, 'ddp'):.3g} times less CPU time than plain OBCA (asked for: 30), "
        f"{_success(by_log, 'ddp')} sound.",
        f"- IPOPT ends after {TIME_LIMIT:.0f} s, building the problem apart, which is where OBCA fails. Its paths "
        "pass the audit here because 0.1 m of clearance at the knots leaves room between them.",
    ]
    return ["\n".join(lines)]


def _each(by_log: dict[str, dict[str, Row]], names: list[str]) -> str:
    lines = ["J / gear changes, CPU seconds; in brackets what the audit turned down, and why.", ""]
    lines += ["| log | recorded | " + " | ".join(names) + " |", "|---|--:|" + "--:|" * len(names)]
    for log, rows in by_log.items():
        recorded = next(iter(rows.values()))["recorded"]
        lines.append(f"| {log} | {recorded:.2f} | " + " | ".join(_cell(rows.get(name)) for name in names) + " |")
    return "\n".join(lines)


def _cell(row: Row | None) -> str:
    if row is None:
        return ""
    seconds = f"{row['cpu_s']:.3g} s"
    if not math.isfinite(row["objective"]):
        return f"(no path) {seconds}"
    value = f"{row['objective']:.2f} / {row['cusps']}"
    if row["status"] == "improved":
        return f"{value}, {seconds}"
    why = ", ".join(row["failures"]) or "no better"
    return f"({value}: {why}) {seconds}"
