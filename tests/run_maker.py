"""Documents and folders of regression runs, with results that follow from simple rules, for the tests."""

import json
import pathlib
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

from replay.base.documents import convert, plain
from replay.base.schemas.log import LogResults
from replay.base.schemas.verdicts import Comparison

METHODS = ("shortcut", "cpo", "ddp", "scp", "nlp")
GAIN = {"shortcut": 0.72, "cpo": 0.93, "ddp": 0.66, "scp": 0.661, "nlp": 0.67}
COMMANDS = {
    "accept": ".venv/bin/replay regress accept runs/RUN --baseline baseline.json",
    "view": ".venv/bin/rerun runs/RUN/recordings/*.rrd",
}
CLASSES = ("open", "narrow", "cusps", "reverse")


def metrics(cost: float, cusps: int = 1, clearance: float | None = 0.25) -> dict[str, Any]:
    """All metrics of a path by simple rules; `cost` is J."""
    return {
        "objective": cost,
        "length": 0.8 * cost,
        "trailer_length": 0.7 * cost,
        "reverse_length": 0.3 * cost,
        "cusps": cusps,
        "max_abs_phi": 0.5,
        "max_abs_alpha": 0.9,
        "max_abs_kappa": 0.15,
        "max_abs_dphi_ds": 0.2,
        "steering_effort": 2.0,
        "steering_variation": 3.0,
        "min_clearance": clearance,
    }


def audit(passed: bool = True) -> dict[str, Any]:
    values = {"position_m": 1e-6, "heading_rad": 2e-6, "hitch_rad": 2e-6}
    return {
        "passed": passed,
        "checks": {name: {"passed": passed, "values": values} for name in ("defect", "defect_sum")},
    }


def method(name: str, before: float, scale: float = 1.0, status: str = "improved", **more: Any) -> dict[str, Any]:
    """The results of a method on a path with J `before`."""
    after = GAIN.get(name, 0.8) * before * scale if status == "improved" else before
    entry = {
        "name": name,
        "status": status,
        "stop": "converged" if status == "improved" else "stalled",
        "reason": "The step is small." if status == "improved" else "Nothing better was found.",
        "metrics": metrics(after, cusps=1 if status == "improved" else 2),
        "audit": audit(),
        "work": {"iterations": 12, "evaluations": 400},
        "wall_s": 0.1 + 0.4 * len(name),
    }
    return entry | more


def log(name: str, number: int, methods: Sequence[str] = METHODS, **more: Any) -> dict[str, Any]:
    """The results of one log with one case."""
    before = 80.0 + 7.3 * (number % 11)
    entries = [method(m, before, 1.0 + 0.01 * ((number * (k + 3)) % 7)) for k, m in enumerate(methods)]
    case = {"case": f"{name}/0", "recorded": {"metrics": metrics(before, 2), "audit": audit()}, "methods": entries}
    document = {
        "schema": "replay.run.log/1",
        "log": name,
        "sha256": f"{number:064x}",
        "class": CLASSES[number % len(CLASSES)],
        "tags": ["grid"] if number % 2 else [],
        "expect": "improved",
        "error": None,
        "cases": [case],
    }
    return document | more


def typed(entry: Mapping[str, Any]) -> LogResults:
    """The document of a log as the program has it."""
    return convert(entry, LogResults)


def verdict(
    name: str, which: str, key: str, verdict: str, before: Any = 1.0, after: Any = 1.0, **more: Any
) -> dict[str, Any]:
    """One entry of verdicts.json."""
    entry = {
        "log": name,
        "case": f"{name}/0",
        "method": which,
        "key": key,
        "unit": "-",
        "direction": "lower",
        "rel_tol": 0.001,
        "abs_tol": 0.0,
        "before": before,
        "after": after,
        "verdict": verdict,
    }
    return entry | more


def unchanged(logs: Iterable[Mapping[str, Any]]) -> list[dict[str, Any]]:
    """A comparison for each result that says "same"."""
    return [
        verdict(entry["log"], m["name"], "objective", "same", m["metrics"]["objective"], m["metrics"]["objective"])
        for entry in logs
        for case in entry.get("cases") or ()
        for m in case["methods"]
    ]


def write_run(
    folder: pathlib.Path,
    logs: Sequence[Mapping[str, Any]],
    verdicts: Sequence[Mapping[str, Any] | Comparison] | None = None,
    planned: Sequence[str] = (),
    **head: Any,
) -> pathlib.Path:
    """Write a run's folder; `head` overrides fields of run.json."""
    (folder / "logs").mkdir(parents=True)
    (folder / "recordings").mkdir()
    about = {
        "schema": "replay.run/1",
        "created": "2026-03-14T02:00:00Z",
        "revision": "84f303a",
        "versions": {"numpy": "2.3.4", "rerun-sdk": "0.41.0"},
        "machine": {"system": "Linux", "cores": 2},
        "corpus": {"path": "recordings", "num_logs": len(logs)},
        "methods": list(METHODS),
        "options": {"seed": 0, "time_limit_s": 60.0},
        "complete": True,
        "partial": "",
        "commands": COMMANDS,
        "logs": list(planned),
    }
    (folder / "run.json").write_text(json.dumps(about | head))
    for i, entry in enumerate(logs):
        (folder / "logs" / f"{i:05d}.json").write_text(json.dumps(entry))
    if verdicts is not None:
        document = {"schema": "replay.verdicts/1", "verdicts": plain(verdicts)}
        (folder / "verdicts.json").write_text(json.dumps(document))
    return folder


def logs(count: int = 8) -> list[dict[str, Any]]:
    """The results of `count` logs, a quarter of each class."""
    return [log(f"{CLASSES[i % 4]}_{i:02d}", i) for i in range(count)]


def regressed(folder: pathlib.Path) -> pathlib.Path:
    """A run in which scp is 0.5 % worse on both narrow logs, one method crashed, and one issue is known."""
    found = logs()
    verdicts = unchanged(found)
    for entry in (found[1], found[5]):
        (scp,) = (m for m in entry["cases"][0]["methods"] if m["name"] == "scp")
        before = scp["metrics"]["objective"]
        scp["metrics"]["objective"] = 1.005 * before
        entry["cases"][0]["recording"] = f"recordings/{entry['log']}.rrd"
        verdicts.append(verdict(entry["log"], "scp", "objective", "worse", before, 1.005 * before))
    crash = verdict(found[4]["log"], "nlp", "status", "crashed", "improved", "failed", rel_tol=None, abs_tol=None)
    verdicts.append(crash)
    verdicts.append(verdict(found[3]["log"], "cpo", "cusps", "known", 1.0, 2.0, note="being looked at"))
    run = write_run(folder, found, verdicts)
    for entry in (found[1], found[5]):
        (run / "recordings" / f"{entry['log']}.rrd").write_bytes(b"made by the test")
    return run
