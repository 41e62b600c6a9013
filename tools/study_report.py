"""The text and the plot of the study, from its rows."""

import io
from typing import Any

import matplotlib
import numpy as np
from matplotlib.figure import Figure

from replay.base.style import styles
from tools.study_rows import METHODS, Rows, table


def report(document: dict[str, Any]) -> tuple[str, str]:
    """STUDY.md and the plot of performance profiles (SVG)."""
    rows, head = Rows(document["rows"]), document["head"]
    parts = [_head(rows, head), _overall(rows), _by_class(rows), _claims(rows), _limits()]
    return "\n\n".join(parts) + "\n", _profiles(rows)


def _head(rows: Rows, head: dict[str, Any]) -> str:
    versions = ", ".join(f"{name} {version}" for name, version in head["versions"].items())
    sound = [log for log in rows.logs if rows.by[log, "recorded"]["feasible"]]
    missed = [log for log in rows.logs if not any(rows.by[log, m]["status"] == "improved" for m in METHODS)]
    some, all_some = len(set(sound) - set(missed)), len(rows.logs) - len(missed)
    return f"""# What the methods make of the corpus

Written by `tools/study.py`; every figure is of one run, at commit {head["commit"]}, on {head["machine"]},
{versions};
{head["jobs"]} logs at a time, each method on one thread and at most {head["time_limit"]:g} s.
{len(rows.logs)} logs, {len(sound)} with a recorded path that is feasible by the audit, {len(rows.unreadable)} unread.

**At least one of the five methods, which are what runs by default, ends `improved` (a lower J, and the audit passed) on
{some} of the {len(sound)} logs whose recorded path is feasible: {100.0 * some / len(sound):.1f} %, where 98 % are asked
for;** on {all_some} of all {len(rows.logs)}{f" (not on {', '.join(missed)})" if missed else ""}. A path that is not
improved counts with the recorded path's figures.

![Performance profiles](study_profiles.svg)

Share of logs on which a method's J is at most so many times the best method's J: the higher the curve, the better."""


def _overall(rows: Rows) -> str:
    header = (
        "method",
        "improved",
        "J",
        "length",
        "gear changes",
        "steering variation",
        "largest curvature",
        "clearance [m]",
        "time [s]",
    )
    lines = [_line(rows, rows.logs, method) for method in ("recorded", *METHODS)]
    return f"""## All classes

J, length, steering variation (∫|dφ|) and largest curvature of the trailer's path: geometric mean of the ratios to the
recorded path's. Gear changes: mean. Clearance: median. Time: median of the wall time, compiling not counted.

{table(header, lines)}"""


def _line(rows: Rows, logs: list[str], method: str) -> list[str]:
    keys = ("objective", "length", "steering_variation", "max_abs_kappa")
    ratios = [f"{rows.ratio(logs, method, key=key):.3f}" for key in keys]
    cusps = f"{np.mean([rows.value(log, method, 'cusps') for log in logs]):.2f}"
    clear = f"{np.median([rows.value(log, method, 'min_clearance') for log in logs]):.2f}"
    if method == "recorded":
        return ["recorded", "–", *ratios[:2], cusps, *ratios[2:], clear, "–"]
    done = f"{rows.improved(logs, method)} of {len(logs)}"
    return [f"`{method}`", done, *ratios[:2], cusps, *ratios[2:], clear, f"{rows.median(logs, method, 'wall_s'):.2f}"]


def _by_class(rows: Rows) -> str:
    text = ["## By class", "", "Improved of all, J over the recorded J, and median time [s].", ""]
    lines = []
    for kind in rows.classes:
        logs = rows.of(kind)
        cells = [
            f"{rows.improved(logs, m)}/{len(logs)} {rows.ratio(logs, m):.3f} {rows.median(logs, m, 'wall_s'):.2f}"
            for m in METHODS
        ]
        cusps = np.mean([rows.value(log, "recorded", "cusps") for log in logs])
        lines.append([kind, str(len(logs)), f"{cusps:.1f}", *cells])
    return "\n".join([*text, table(("class", "logs", "recorded gear changes", *(f"`{m}`" for m in METHODS)), lines)])


_ELSEWHERE = """### (a) A good description of the obstacles is needed, and scarce ones fail in narrow scenes

Tested by a run of its own, in [STUDY_OBSTACLES.md](STUDY_OBSTACLES.md).

"""


def _claims(rows: Rows) -> str:
    claims = (_starts, _trailer_length, _cusps, _ladder)
    return "## The source's claims, tested\n\n" + _ELSEWHERE + "\n\n".join(claim(rows) for claim in claims)


def _starts(rows: Rows) -> str:
    pairs = (("scp", "shortcut+scp"), ("scp", "ddp+scp"), ("nlp", "shortcut+nlp"), ("nlp", "ddp+nlp"))
    lines = []
    for plain, chain in pairs:
        time_ratio = [rows.by[log, chain]["wall_s"] / rows.by[log, plain]["wall_s"] for log in rows.logs]
        quicker = sum(ratio < 1.0 for ratio in time_ratio)
        lines.append(
            [
                f"`{chain}` against `{plain}`",
                f"{np.median(time_ratio):.2f}",
                f"{quicker} of {len(rows.logs)}",
                f"{rows.ratio(rows.logs, chain, plain):.4f}",
                f"{rows.improved(rows.logs, chain)} / {rows.improved(rows.logs, plain)}",
            ]
        )
    medians = [float(line[1]) for line in lines]
    verdict = (
        "supported" if max(medians) < 1.0 else ("supported for some starts" if min(medians) < 1.0 else "not supported")
    )
    header = ("chain", "time ratio (median)", "quicker on", "J ratio (geometric mean)", "improved")
    return f"""### (b) A good feasible start shortens convergence

The chain's time includes the method that makes the start.

{table(header, lines)}

Verdict: **{verdict}.**"""


def _trailer_length(rows: Rows) -> str:
    name = "shortcut by trailer length"
    worse = _num_above(rows, name, "max_abs_kappa", 1.01)
    plain = _num_above(rows, "shortcut", "max_abs_kappa", 1.01)
    variation = _num_above(rows, name, "steering_variation", 1.0)
    return f"""### (c) Shortcut's cost on trailer length alone can worsen the curvature

With trailer length as cost the largest curvature of the trailer's path grows on {worse} of {len(rows.logs)} logs
(with J as cost on {plain}), and the steering varies more than the recorded path's on {variation}. J falls to
{rows.ratio(rows.logs, name):.3f} of the recorded J, against {rows.ratio(rows.logs, "shortcut"):.3f} with J as cost.
Verdict: **{"supported" if worse else "not supported"}.** A result counts only where it lowers J."""


def _num_above(rows: Rows, method: str, key: str, times: float) -> int:
    """Logs on which a metric after a method is more than so many times that of the recorded path."""
    return sum(rows.value(log, method, key) > times * rows.value(log, "recorded", key) for log in rows.logs)


def _cusps(rows: Rows) -> str:
    moved = [log for log in rows.logs if rows.value(log, "cpo", "cusps") != rows.value(log, "recorded", "cusps")]
    same = [log for log in rows.logs if rows.value(log, "ddp", "cusps") == rows.value(log, "recorded", "cusps")]
    fewer = [log for log in rows.logs if rows.value(log, "ddp", "cusps") < rows.value(log, "recorded", "cusps")]
    return f"""### (d) CPO leaves the gear changes where they were, and what that costs

The number of gear changes after `cpo` differs from the recorded one on {len(moved)} of {len(rows.logs)} logs. `ddp`,
which moves them and leaves needless ones out, ends with fewer on {len(fewer)}. Where it keeps their number
({len(same)} logs) J of `cpo` is {rows.ratio(same, "cpo", "ddp"):.3f} times that of `ddp`; where it has fewer,
{rows.ratio(fewer, "cpo", "ddp"):.3f} times.
Verdict: **{"not supported" if moved else "supported, and the cost is of that size"}.**"""


def _ladder(rows: Rows) -> str:
    order = ("recorded", *METHODS)
    lines = [
        [
            f"`{now}` after `{before}`",
            f"{100.0 * (1.0 - rows.ratio(rows.logs, now, before)):.1f} %",
            _better(rows, now, before),
        ]
        for before, now in zip(order, METHODS, strict=False)
    ]
    return f"""### (e) What each method gains over the one before

Each begins with the recorded path; only their results are compared.

{table(("step", "J less by (geometric mean)", "lower J on"), lines)}"""


def _better(rows: Rows, now: str, before: str) -> str:
    count = sum(rows.value(log, now) < rows.value(log, before) * (1.0 - 1e-4) for log in rows.logs)
    return f"{count} of {len(rows.logs)}"


def _limits() -> str:
    return """## Limits of the comparison

- The scenes are made, not recorded; sampled paths leave much to gain, a good driver's less.
- Three of the methods are local: which optimum they end in depends on the recorded path.
- Times are wall times while another log is being worked on beside, on shared cores: ratios of 1.2 mean nothing.
- `nlp` and `scp` make no use of more cores; a time limit ends some runs of `nlp`, whose best iterate counts then.
- The recorded paths of some logs were made with another planner (`corpus.toml` names it): of those that had to be, and
  of the public scenes. Classes of two logs say little.
- Where a time limit ends a method, its best iterate counts."""


def _profiles(rows: Rows) -> str:
    matplotlib.rcParams["svg.hashsalt"] = "study"
    figure = Figure(figsize=(7.0, 3.6), layout="constrained")
    axes = figure.add_subplot()
    best = {log: min(rows.value(log, method) for method in METHODS) for log in rows.logs}

    def ratio(method: str) -> np.ndarray:
        return np.sort([rows.value(log, method) / best[log] for log in rows.logs])

    share = np.arange(1, len(rows.logs) + 1) / len(rows.logs)
    for method, style in styles(METHODS).items():
        colour = tuple(part / 255.0 for part in style.colour)
        values = np.concatenate([[1.0], ratio(method), [3.0]])
        axes.step(values, np.concatenate([[0.0], share, [share[-1]]]), where="post", color=colour, label=style.label)
    axes.step(
        np.concatenate([[1.0], ratio("recorded"), [3.0]]),
        np.concatenate([[0.0], share, [1.0]]),
        where="post",
        color="0.6",
        label="Recorded",
    )
    axes.set(xlim=(1.0, 2.2), ylim=(0.0, 1.01), xlabel="J over the best method's J [-]", ylabel="share of logs [-]")
    axes.legend(loc="lower right", frameon=False)
    axes.grid(alpha=0.3)
    out = io.StringIO()
    figure.savefig(out, format="svg", metadata={"Date": None})
    return out.getvalue()
