"""The study's second part: what becomes of the methods when the obstacles are described less well."""

from collections.abc import Sequence
from typing import Any, Final

from tools.study_rows import Rows, table

SHOWN: Final = {
    "shortcut": {"polygons": "shortcut", "discs": "shortcut by discs", "points": "shortcut by points"},
    "cpo": {"discs": "cpo", "points": "cpo points"},
    "ddp": {"polygons": "ddp", "discs": "ddp by discs", "points": "ddp by points"},
    "scp": {"polygons": "scp", "discs": "scp by discs", "points": "scp by points"},
}
"""The variants of a run that show a method each description. `cpo` covers the vehicle with discs, not the obstacles,
and its points are a cost map of the trailer's axle."""
DESCRIPTIONS: Final = ("polygons", "discs", "points")
SAMPLES: Final = ("angled", "bay", "dock", "lot", "parallel", "yard")
"""Classes of two logs each, taken together."""
LOSS: Final = 0.1
"""Share of logs whose loss counts as failing [-]."""


def obstacles_report(document: dict[str, Any]) -> str:
    """STUDY_OBSTACLES.md."""
    rows, head = Rows(document["rows"]), document["head"]
    kinds = [kind for kind in rows.classes if kind not in SAMPLES]
    groups = {kind: rows.of(kind) for kind in kinds}
    groups["sample logs"] = [log for kind in SAMPLES for log in rows.of(kind)]
    groups = {name: logs for name, logs in groups.items() if logs} | {"**all**": rows.logs}
    lines = [
        [name if k == 0 else "", what, *(_cell(rows, logs, method, what) for method in SHOWN)]
        for name, logs in groups.items()
        for k, what in enumerate(DESCRIPTIONS)
    ]
    ran = [row for row in document["rows"] if "stop" in row]
    left_out = [name for name in SHOWN if not any((log, name) in rows.by for log in rows.logs)]
    stopped, ran = sum(row["stop"] == "time limit" for row in ran), len(ran)
    versions = ", ".join(f"{name} {version}" for name, version in head["versions"].items())
    return f"""# A good description of the obstacles is needed, and scarce ones fail in narrow scenes

This claim of the source, tested. Written by `tools/study.py --part obstacles`; every figure is of one run, at commit
{head["commit"]}, on {head["machine"]},
{versions};
{len(rows.logs)} logs, each method on one thread and at most {head["time_limit"]:g} s,
which ended {stopped} of {ran} runs.

*polygons*: the exact obstacles. *discs*: each is covered by a row of discs as wide as it is and 2 m or more long, so
that nothing is missed and room is lost. *points*: only points on their outlines, 1 m apart. Every path is judged in the
true scene. `cpo` knows no polygons: its discs cover the vehicle (closely), its points are the source's cost map, which
looks at the trailer's axle only. Improved of all, and J over the recorded J; in brackets the paths that the audit
turned down in the true scene.

{table(("class", "obstacles as", *(f"`{method}`" for method in SHOWN)), lines)}

{_verdict(rows, groups)}

## Limits of the comparison

- Not measured in this run: {", ".join(f"`{name}`" for name in (*left_out, "nlp"))}. `nlp` solves the problem that `scp`
  does and takes ten times as long.
- A path may pass by chance: a method that is shown too little may still keep clear. The recorded path, where all begin,
  is clear in the true scene, and all methods change it step by step.
- Where a time limit ends a method, its best iterate counts.
- Classes that are not in the table have not been measured in this run.
"""


def _cell(rows: Rows, logs: Sequence[str], method: str, what: str) -> str:
    name = SHOWN[method].get(what)
    some = [log for log in logs if (log, name) in rows.by]
    if name is None or not some:
        return "–"
    rejected = sum(rows.by[log, name]["rejected"] for log in some)
    cell = f"{rows.improved(some, name)}/{len(some)} {rows.ratio(some, name):.3f}"
    return cell + (f" ({rejected})" if rejected else "")


def lost(rows: Rows, logs: Sequence[str], method: str, what: str) -> tuple[int, int]:
    """(logs that the method improves with the best description it has but not with this one, logs it improves)."""
    best, name = next(iter(SHOWN[method].values())), SHOWN[method].get(what)
    measured = [log for log in logs if (log, name) in rows.by and (log, best) in rows.by]
    some = [log for log in measured if rows.by[log, best]["status"] == "improved"]
    return sum(rows.by[log, name]["status"] != "improved" for log in some), len(some)


def _share(rows: Rows, logs: Sequence[str], what: str) -> tuple[float, str]:
    """Share of pairs of method and log that a description loses, and the count in words."""
    pairs = [lost(rows, logs, method, what) for method in SHOWN if next(iter(SHOWN[method])) != what]
    gone, of = sum(pair[0] for pair in pairs), sum(pair[1] for pair in pairs)
    return (gone / of if of else 0.0), f"{gone} of {of}"


def _verdict(rows: Rows, groups: dict[str, list[str]]) -> str:
    sentences = [
        "Pairs of a method and a log that it improves with its best description but not with a scarcer one:",
        "",
    ]
    shares: dict[str, dict[str, float]] = {"discs": {}, "points": {}}
    for what, by_group in shares.items():
        counts = []
        for name, logs in groups.items():
            by_group[name], count = _share(rows, logs, what)
            counts.append(f"{name.strip('*')} {count}")
        sentences.append(f"- *{what}*: {', '.join(counts)}.")
    verdicts = []
    for what, by_group in shares.items():
        narrow, open_ground = by_group.get("narrow", 0.0), by_group.get("open", 0.0)
        fails = narrow >= LOSS and narrow >= 2.0 * open_ground
        everywhere = all(share >= LOSS for name, share in by_group.items() if name != "**all**")
        verdicts.append(
            f"with *{what}* {100.0 * narrow:.0f} % are lost in narrow scenes, {100.0 * open_ground:.0f} % in open ones:"
            f" that they fail in narrow ones is {_word(fails)}, that all classes here need more is {_word(everywhere)}"
        )
    limit = f"(Failing: {100.0 * LOSS:.0f} % or more are lost; in narrow scenes, and twice as many as in open ones.)"
    return "\n".join(sentences) + f"\n\nVerdict: **{'; '.join(verdicts)}.** {limit}"


def _word(is_so: bool) -> str:
    return "supported" if is_so else "not supported"
