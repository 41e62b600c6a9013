"""The text of the recording: the verdict, the table of methods, vehicle and options, the audits. Markdown."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Iterable, Mapping
from typing import Any

from optim.audit.report import AuditReport
from optim.model.metrics import Metrics
from optim.numerics.arrays import Array
from replay.recording.text import cell, change, count, measured, number, table
from replay.recording.tracks import Track
from replay.run.outcome import AS_GOOD, Run

_NO_VALUE = "–"
_LONGEST_OPTION = 60  # characters


def summary(run: Run, tracks: list[Track], best: Track | None) -> str:
    """Verdict first, then the table, then every method's reason in its own words."""
    lines = [*_verdict(tracks, best, run.case.problem.required_clearance), *_as_good(run, tracks)]
    lines += ["", _comparison(tracks, best), ""]
    lines += [_outcome(track) for track in tracks[1:]]
    lines += _warnings(run, tracks[0])
    lines += ["", "**Space** plays. Solid: forward, dashed: reverse, ring: gear change, white bar: front wheel."]
    lines += [f"{cell(run.case.name)} from {cell(run.case.log.name)}"]
    return "\n".join(lines)


def _verdict(tracks: list[Track], best: Track | None, required: float) -> list[str]:
    """The best method, its gain, and whether its path is safe."""
    before = tracks[0].metrics
    if best is None:
        head = "No method ran" if len(tracks) == 1 else "✗ Not improved: the recorded path stands"
        sound = tracks[0].audit.passed
        audit = "✓ Safe: it passes the audit" if sound else "✗ Not safe: it fails the audit"
        cost, length = number(before.objective, 1), number(before.length, 1)
        detail = f"J {cost}, {length} m, {count(before.cusps, 'gear change')}"
        safe = f"{audit}, {clearance(before)}"
        return [f"# {head}", "", f"**{detail}**", "", f"**{safe}**"]
    after = best.metrics
    cost = [number(row.objective, 1) for row in (before, after)]
    length = [number(row.length, 1) for row in (before, after)]
    percent = change(before.objective, after.objective)
    gain = f"improved the path: J {percent}"
    if not tracks[0].audit.passed:
        gain = f"passes the audit, the recorded path fails it (J {percent})"
    detail = (
        f"J {cost[0]} → {cost[1]}, {length[0]} → {length[1]} m, {before.cusps:g} → {count(after.cusps, 'gear change')}"
    )
    asked = f" (required: {number(required)} m)" if math.isfinite(after.min_clearance) else ""
    safe = f"✓ Safe: audit passed, {clearance(after)}{asked}"
    return [f"# ✓ {cell(best.style.label)} {gain}", "", f"**{detail}**", "", f"**{safe}**"]


def clearance(metrics: Metrics) -> str:
    """The smallest clearance in words."""
    value = metrics.min_clearance
    return f"clearance {number(value)} m" if math.isfinite(value) else "no obstacles"


def _comparison(tracks: list[Track], best: Track | None) -> str:
    """Paths as columns, so that the numbers to compare stand side by side and the names stay short."""
    improved = [track for track in tracks if track.status in ("recorded", "improved")]

    def row(head: str, value: Callable[[Track], str]) -> list[str]:
        values = [value(track) if track in improved else _NO_VALUE for track in tracks]
        return [head, *(f"**{text}**" if track is best else text for track, text in zip(tracks, values, strict=True))]

    def metric(head: str, key: str, digits: int, scale: float = 1.0) -> list[str]:
        return row(head, lambda track: number(scale * getattr(track.metrics, key), digits))

    rows = [
        ["", *(cell(track.style.label) for track in tracks)],
        ["Improved", *(_mark(track) for track in tracks)],
        metric("**J** (lower is better)", "objective", 1),
        metric("Length [m]", "length", 1),
        metric("Gear changes", "cusps", 0),
        metric("Clearance [m]", "min_clearance", 2),
        metric("Steering variation [°]", "steering_variation", 0, math.degrees(1.0)),
        row("Swept area [m²]", lambda track: number(track.area.area, 0)),
        ["Time [s]", *(number(track.run.wall_s if track.run else None, 2) for track in tracks)],
    ]
    return table(rows)


def _mark(track: Track) -> str:
    if track.run is None:
        return _NO_VALUE if track.audit.passed else "✗ unsound"
    if track.run.rejected is not None:
        return "✗ rejected"
    # one letter where all is well: five methods fit into a window of 1280 pixels so
    return {"improved": "✓", "kept": "kept", "failed": "✗ failed"}.get(track.status, cell(track.status))


def _as_good(run: Run, tracks: list[Track]) -> list[str]:
    """Equally good methods: their time may decide then."""
    names = [cell(track.style.label) for track in tracks if track.run in run.as_good]
    return ["", f"Equally good (within {100.0 * AS_GOOD:g} %): {', '.join(names)}"] if names else []


def _outcome(track: Track) -> str:
    """One line: what became of a method, and why, in its own words."""
    run = track.run
    assert run is not None
    what = {
        "improved": "improved",
        "kept": "kept the recorded path",
        "failed": "failed, the recorded path stands",
    }.get(run.status, run.status)
    return f"- **{cell(track.style.label)}** {what} ({cell(run.stop)}, {run.iterations} iterations): {cell(run.reason)}"


def _warnings(run: Run, recorded: Track) -> list[str]:
    """Notes about the log or the recorded path."""
    lines = [f"- ⚠ The recorded path fails its audit. {cell(text)}" for text in recorded.audit.failures]
    if run.case.read.lost:
        lines.append("- ⚠ Part of the log could not be read.")
    return lines


def _starts_again(track: Track) -> bool:
    """Whether J ever rises by a tenth of what was gained in all, as where a method solves a changed problem."""
    costs = [row.objective for row in track.run.history if row.accepted] if track.run is not None else []
    return any(after - before > 0.1 * (max(costs) - min(costs)) for before, after in itertools.pairwise(costs))


def convergence_help(tracks: list[Track]) -> str:
    """Explanation of the convergence plots, only of those that are there."""
    rows = [row for track in tracks if track.run is not None for row in track.run.history]
    quiet = [cell(track.style.label) for track in tracks[1:] if not track.iterates]
    lines = [
        "From the recorded path (progress 0) to each method's result (1000); **space** plays. On the timeline "
        "**iteration** (bottom left) one step is one iterate, and Signals shows its extremes."
    ]
    if any(row.residuals for row in rows):
        lines.append("Residuals are relative to their tolerances: converged below the **red line**.")
    if not all(row.accepted for row in rows):
        lines.append("**✗** is a rejected trial step.")
    if any(_starts_again(track) for track in tracks):
        lines.append("Where J jumps up, a method started again: new obstacles, or a segment left out.")
    if quiet:
        lines.append(f"No iterates: {', '.join(quiet)}.")
    return " ".join(lines)


def residuals_help() -> str:
    """Explanation of the plots of single residuals."""
    return (
        "Each residual relative to its tolerance, log10: converged where all of a method's are below the **red line**."
    )


def vehicle_sheet(run: Run) -> str:
    """Dimensions in metres, limits in degrees, and what the objective weighs."""
    problem = run.case.problem
    vehicle = problem.vehicle
    metres = [
        ("Wheelbase", vehicle.wheelbase),
        ("Truck ahead of its rear axle", vehicle.truck_front),
        ("Truck behind its rear axle", vehicle.truck_rear),
        ("Truck width", vehicle.truck_width),
        ("Hitch to trailer axle", vehicle.hitch_to_axle),
        ("Hitch behind the rear axle", vehicle.hitch_offset),
        ("Trailer ahead of the hitch", vehicle.trailer_front),
        ("Trailer behind the hitch", vehicle.trailer_rear),
        ("Trailer width", vehicle.trailer_width),
    ]
    degrees = [
        ("Largest steering angle", vehicle.max_steer, "°"),
        ("Largest hitch angle", vehicle.max_hitch, "°"),
        ("Largest steering rate", vehicle.max_steer_rate, "°/m"),
    ]
    rows = [["Dimension or limit", "Value"]]
    rows += [[name, f"{number(value)} m"] for name, value in metres]
    rows += [[name, f"{number(math.degrees(value), 1)}{unit}"] for name, value, unit in degrees]
    rows += [["Clearance asked for", f"{number(problem.margin)} m"]]
    rows += [["Clearance required here", f"{number(problem.required_clearance)} m"]]
    weights = [["Weight of", "Value"], *([cell(name), f"{value:g}"] for name, value in vars(problem.weights).items())]
    formula = "J = length · L + steer · ∫φ² ds + rate · ∫(dφ/ds)² ds + cusp · gear changes + jump · Σ(Δφ)²"
    return "\n".join(["# Vehicle", "", table(rows), "", "## Objective", "", cell(formula), "", table(weights)])


def run_sheet(run: Run, version: str, offset: Array) -> str:
    """Origin of the data, and the options of every method."""
    case = run.case
    read, turn = case.read, math.degrees(case.read.max_deviation_rad)
    facts = [
        ["Fact", "Value"],
        ["Log", cell(case.log.name)],
        ["Case", cell(case.name)],
        ["SHA-256", cell(case.sha256[:16] + "…")],
        ["Frame", cell(case.frame)],
        ["Pictures are relative to", f"({number(offset[0], 0)}, {number(offset[1], 0)}) m"],
        ["Poses in the log", str(read.poses)],
        ["Hitch angle from", cell(read.hitch)],
        ["Recorded path off the log's poses", f"{number(read.max_deviation_m, 3)} m, {number(turn, 2)}° at most"],
        ["The same, RMS", f"{number(read.rms_deviation_m, 3)} m, {number(math.degrees(read.rms_deviation_rad), 2)}°"],
        ["Obstacles", count(len(case.problem.scene.polygons), "convex polygon")],
        ["Map", _map_size(run)],
        ["Tool version", cell(version)],
        ["Seed", str(run.seed)],
    ]
    lines = ["# Log", "", table(facts), *(f"- {cell(note)}" for note in read.notes)]
    rows = [["Option", "Value"], *([cell(name), cell(value)] for name, value in _flat(run.options))]
    lines += ["", "# Options", "", table(rows) if len(rows) > 1 else "None."]
    return "\n".join(lines)


def _map_size(run: Run) -> str:
    grid = run.case.map
    if grid is None:
        return "shapes"
    rows, columns = grid.cells.shape
    return f"{columns} × {rows} cells of {grid.resolution:.3g} m"


def _flat(options: Mapping[str, Any], prefix: str = "") -> Iterable[tuple[str, str]]:
    for name, value in options.items():
        if dataclasses.is_dataclass(value) and not isinstance(value, type):
            value = vars(value)
        if isinstance(value, Mapping):
            yield from _flat(value, f"{prefix}{name}.")
        else:
            text = f"{value:g}" if isinstance(value, float) else str(value)
            yield f"{prefix}{name}", text if len(text) <= _LONGEST_OPTION else text[: _LONGEST_OPTION - 1] + "…"


def audit_sheet(tracks: list[Track]) -> str:
    """Every check of every path: the value nearest to its limit; in full where a check failed."""
    audits = [(cell(track.style.label), track.audit) for track in tracks if track.is_own]
    for track in tracks[1:]:
        if track.run is not None and track.run.rejected is not None:
            audits.append((f"{cell(track.style.label)}, rejected", track.run.rejected))
    names = dict.fromkeys(name for _, audit in audits for name in audit.checks)
    rows = [["Check", *(label for label, _ in audits)]]
    rows += [[cell(name), *(_verdict_of(audit, name) for _, audit in audits)] for name in names]
    rows += [["**All**", *("**✓ passed**" if audit.passed else "**✗ failed**" for _, audit in audits)]]
    lines = ["# Audit", "", "An independent check of each path, from its samples alone.", "", table(rows), ""]
    for label, audit in audits:
        lines += [f"- **{label}** {cell(text)}" for text in audit.failures]
    return "\n".join(lines)


def _verdict_of(audit: AuditReport, name: str) -> str:
    check = audit.checks.get(name)
    if check is None:
        return _NO_VALUE
    value = cell(measured(check))  # without a mark where all is well: six paths fit into a small window so
    return (value or "✓") if check.passed else f"**✗ {value}**"
