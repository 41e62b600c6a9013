"""Geometry of the charts: what the page draws as SVG. Coordinates in pixels, y down."""

import itertools
import math
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from typing import ClassVar, Final

from replay.base.numbers import shown
from replay.base.schemas.summary import TrendPoint

WIDTH, HEIGHT = 400, 250
_LEFT, _RIGHT, _TOP, _BOTTOM = 52, 12, 20, 44
_MOST_TICKS: Final = 6
_FARTHEST: Final = 3.0
"""Upper end of performance profiles, as a multiple of the best J."""


@dataclass(frozen=True, kw_only=True)
class Line:
    """One curve."""

    method: str
    pieces: tuple[str, ...]
    """Points of SVG polylines; a new piece begins where figures are not comparable."""
    dots: tuple[tuple[float, float, str], ...] = ()
    """Points of measurements, and their labels."""


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Axes and curves."""

    title: str
    x_label: str
    y_label: str
    x_ticks: tuple[tuple[float, str], ...]
    y_ticks: tuple[tuple[float, str], ...]
    lines: tuple[Line, ...]
    breaks: tuple[float, ...] = ()
    """Positions on the x-axis between runs over different logs."""
    marks: tuple[tuple[float, str], ...] = ()
    """Positions on the x-axis of runs that failed, and their names."""
    width: ClassVar = WIDTH
    height: ClassVar = HEIGHT
    left: ClassVar = _LEFT
    right: ClassVar = WIDTH - _RIGHT
    top: ClassVar = _TOP
    bottom: ClassVar = HEIGHT - _BOTTOM


@dataclass(frozen=True, kw_only=True)
class _Scale:
    """Linear map from values to pixels."""

    low: float
    high: float
    start: float
    end: float

    def __call__(self, value: float) -> float:
        share = (value - self.low) / (self.high - self.low)
        return round(self.start + share * (self.end - self.start), 2)


def profile_chart(profiles: Mapping[str, Sequence[float]]) -> Chart | None:
    """Performance profiles: share of cases on which a method's J is at most a multiple of the best J."""
    if not profiles:
        return None
    largest = max(ratios[min(len(ratios) - 1, math.ceil(0.98 * len(ratios)))] for ratios in profiles.values())
    high = min(max(1.02 + 1.02 * (largest - 1.0), 1.05), _FARTHEST)
    x = _Scale(low=1.0, high=high, start=_LEFT, end=WIDTH - _RIGHT)
    y = _Scale(low=0.0, high=1.0, start=HEIGHT - _BOTTOM, end=_TOP)
    lines = [Line(method=name, pieces=(_steps(ratios, high, x, y),)) for name, ratios in profiles.items()]
    return Chart(
        title="Performance profiles",
        x_label="J over the best method's J",
        y_label="share of cases",
        x_ticks=tuple((x(value), shown(value)) for value in ticks(1.0, high)),
        y_ticks=tuple((y(value), f"{100 * value:.0f} %") for value in (0.0, 0.25, 0.5, 0.75, 1.0)),
        lines=tuple(lines),
    )


def _steps(ratios: Sequence[float], high: float, x: _Scale, y: _Scale) -> str:
    """A staircase from (1, 0): after each case's ratio the share is higher by one case."""
    corners, share = [(x(1.0), y(0.0))], 0.0
    for i, ratio in enumerate(ratios):
        if ratio > high:
            break
        if i + 1 < len(ratios) and ratios[i + 1] == ratio:
            continue
        corners += [(x(ratio), y(share)), (x(ratio), y((i + 1) / len(ratios)))]
        share = (i + 1) / len(ratios)
    corners.append((x(high), y(share)))
    return _path(corners)


def drift_chart(points: Sequence[TrendPoint]) -> Chart | None:
    """Change of each method's J over the recorded J since the first run over the same logs [%]."""
    first: dict[tuple[str, str], float] = {}
    values = [
        {
            name: 100.0 * (ratio / first.setdefault((at.comparable, name), ratio) - 1.0)
            for name, ratio in at.ratio.items()
        }
        for at in points
    ]
    return _trend(points, values, title="J against the first run", y_label="change of J [%]", logarithmic=False)


def time_chart(points: Sequence[TrendPoint]) -> Chart | None:
    """Median time of each method, on a logarithmic scale."""
    values = [{name: time for name, time in at.wall_s.items() if time > 0.0} for at in points]
    return _trend(points, values, title="Median time", y_label="median wall time [s]", logarithmic=True)


def _trend(
    points: Sequence[TrendPoint], values: Sequence[Mapping[str, float]], *, title: str, y_label: str, logarithmic: bool
) -> Chart | None:
    """Chart of a quantity of each method over the runs; None where there is only one run."""
    known = [_place(value, logarithmic) for entry in values for value in entry.values()]
    if len(points) < 2 or not known:
        return None
    low, high = _padded(min(known), max(known))
    x = _Scale(low=0.0, high=len(points) - 1.0, start=_LEFT + 8, end=WIDTH - _RIGHT - 8)
    y = _Scale(low=low, high=high, start=HEIGHT - _BOTTOM, end=_TOP)
    stretches = [list(indices) for _, indices in itertools.groupby(range(len(points)), lambda i: points[i].comparable)]
    lines = []
    for name in dict.fromkeys(name for entry in values for name in entry):
        dots = {
            i: (x(i), y(_place(entry[name], logarithmic)), f"{points[i].name}: {name} {shown(entry[name], 4)}")
            for i, entry in enumerate(values)
            if name in entry
        }
        pieces = [_path([dots[i][:2] for i in stretch if i in dots]) for stretch in stretches]
        lines.append(Line(method=name, pieces=tuple(filter(None, pieces)), dots=tuple(dots.values())))
    x_label, dates = _dates(points)
    return Chart(
        title=title,
        x_label=x_label,
        y_label=y_label,
        x_ticks=tuple((x(i), label) for i, label in dates),
        y_ticks=tuple((y(place), text) for place, text in _y_ticks(low, high, logarithmic)),
        lines=tuple(lines),
        breaks=tuple(x(stretch[0] - 0.5) for stretch in stretches[1:]),
        marks=tuple((x(i), point.name) for i, point in enumerate(points) if point.state == "failed"),
    )


def _place(value: float, logarithmic: bool) -> float:
    return math.log10(value) if logarithmic else value


def _padded(low: float, high: float) -> tuple[float, float]:
    """A range with some room at both ends; never empty."""
    room = max(0.06 * (high - low), 0.05)
    return low - room, high + room


def _y_ticks(low: float, high: float, logarithmic: bool) -> list[tuple[float, str]]:
    if not logarithmic:
        return [(value, shown(value, 4)) for value in ticks(low, high)]
    decades = range(math.floor(low), math.ceil(high) + 1)
    fine = (1.0, 2.0, 5.0) if high - low < 2.5 else (1.0,)
    places = [(math.log10(m) + k, m * 10.0**k) for k in decades for m in fine]
    return [(place, shown(value, 2)) for place, value in places if low <= place <= high]


def _dates(points: Sequence[TrendPoint]) -> tuple[str, list[tuple[int, str]]]:
    """Label of the axis of runs, and the days of some of them, or their times on a single day."""
    chosen = {i: points[i].created or points[i].name for i in _chosen(len(points))}
    days = {created[:10] for created in chosen.values()}
    if len(days) == 1:
        return f"run of {days.pop()}, time in UTC", [(i, made[11:16].replace("-", ":")) for i, made in chosen.items()]
    return "run", [(i, created[:10]) for i, created in chosen.items()]


def _chosen(count: int) -> list[int]:
    """At most three runs whose dates are written, the first and last among them."""
    return sorted({round(k * (count - 1) / 2) for k in range(3)})


def ticks(low: float, high: float) -> list[float]:
    """Round values from `low` to `high`."""
    raw = (high - low) / _MOST_TICKS
    power = 10.0 ** math.floor(math.log10(raw))
    step = next(factor * power for factor in (1.0, 2.0, 2.5, 5.0, 10.0) if factor * power >= raw * (1.0 - 1e-9))
    first = math.ceil(low / step - 1e-9)
    return [round(k * step, 12) for k in range(first, math.floor(high / step + 1e-9) + 1)]


def _path(places: Sequence[tuple[float, float]]) -> str:
    return " ".join(f"{a:g},{b:g}" for a, b in places)
