"""Check how `replay info` behaves on a folder of broken, hostile and odd logs that come with a manifest.

Usage: python -m tools.attacks bad-logs FOLDER [--only TEXT] [--jobs N]

FOLDER/manifest.json lists `cases`, each with `file`, `class`, `code`, `messages` and `limits` (seconds, rss_mib):

    accepts      read without loss: every message counted, exit status 0
    recovers     read in part, or with a remark: exactly `messages` counted, and a remark or an error of one line
    clear_error  refused, or used without what is broken: a line with a stable code, never a traceback

Each log is read by a process of its own under a limit of address space and time. What behaves otherwise is listed; the
exit status is 1 then. The code of an error is compared too, and shown where it differs: both have names of their own.

Two things are the manifest's own, and are put into `replay`'s terms first: the vehicle in a JSON message becomes the
metadata record `vehicle` (`bad_logs_vehicle.py`; logs whose container is sound), and what `OWN_RULE` lists.
"""

import argparse
import json
import pathlib
import re
import resource
import subprocess
import tempfile
import time
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass
from typing import Any

from replay.base.errors import UsageError
from tools.attacks.bad_logs_vehicle import vehicle_message, with_vehicle
from tools.processes import REPLAY
from tools.script import existing, from_one

ADDRESS_SPACE = 6 << 30
"""Of one process [bytes]; loading the program alone takes some 2 GiB of addresses, little of it memory."""
START_S = 8.0
"""Added to the time limit of a case [s]: starting Python on a busy machine."""
VEHICLE_LAYERS = ("payload", "scenario")
"""Layers of the manifest whose logs have a sound container and a vehicle that means something."""
OWN_RULE = {
    "control_rotated_map_origin": "with its rotation honoured, this map has a parked truck where the trailer starts",
    "map_after_path": "a path without a map before it belongs to the first map after it, and a note says so",
    "pb_same_name_layout_a": "a path of a type that is not known is not read: refused, with every message counted",
    "pb_same_name_layout_b": "a path of a type that is not known is not read: refused, with every message counted",
}
"""Where a documented rule of `replay` differs from the manifest's; these are held to the rule instead."""
_CODE = re.compile(r"\[([EW]_[A-Z0-9_]+)\]\s*$")


@dataclass(frozen=True, kw_only=True)
class Outcome:
    """What reading one log came to."""

    wrong: tuple[str, ...]
    """What differs from the manifest; empty if nothing."""
    code: str
    """Of the first error; empty if there was none."""
    seconds: float
    rss_mib: float


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("folder", type=existing, metavar="FOLDER")
    parser.add_argument("--only", default="", help="cases whose name contains this")
    parser.add_argument("--jobs", type=from_one, default=2, help="processes (default: %(default)s)")


def main(arguments: argparse.Namespace) -> int:
    """Exit status: 0 where all is as it should be, else 1."""
    manifest = arguments.folder / "manifest.json"
    if not manifest.is_file():
        raise UsageError(f"{manifest} does not exist")
    cases = [case for case in json.loads(manifest.read_text())["cases"] if arguments.only in case["name"]]
    if not cases:
        raise UsageError(f"no case of {manifest} has {arguments.only!r} in its name")
    with ThreadPoolExecutor(arguments.jobs) as pool:
        outcomes = list(pool.map(lambda case: check(arguments.folder, case), cases))
    for case, outcome in zip(cases, outcomes, strict=True):
        if outcome.wrong:
            print(f"{case['name']} ({case['class']}, {case['why']}): {'; '.join(outcome.wrong)}")
    as_said = sum(not outcome.wrong for outcome in outcomes)
    refused = [pair for pair in zip(cases, outcomes, strict=True) if pair[0]["class"] == "clear_error"]
    for case, outcome in refused:
        if outcome.code != case["code"]:
            print(f"  code of {case['name']}: {outcome.code or 'none'}, in the manifest {case['code']}")
    slowest, largest = max(o.seconds for o in outcomes), max(o.rss_mib for o in outcomes)
    print(f"{as_said} of {len(cases)} as the manifest says; slowest {slowest:.1f} s, largest {largest:.0f} MiB")
    return int(as_said != len(cases))


def check(folder: pathlib.Path, case: dict[str, Any]) -> Outcome:
    """Read one log in a process of its own."""
    limits = case["limits"]
    with tempfile.TemporaryDirectory() as own, tempfile.TemporaryFile() as out, tempfile.TemporaryFile() as err:
        log = _in_our_terms(folder / case["file"], case, pathlib.Path(own))
        started = time.monotonic()
        process = subprocess.Popen(
            [*REPLAY, "info", "--json", str(log)],
            stdin=subprocess.DEVNULL,
            stdout=out,
            stderr=err,
            preexec_fn=lambda: resource.setrlimit(resource.RLIMIT_AS, (ADDRESS_SPACE, ADDRESS_SPACE)),
        )
        rss_mib = _watch(process, started + limits["seconds"] + START_S)
        seconds = time.monotonic() - started
        out.seek(0)
        err.seek(0)
        said, spoken = out.read().decode(errors="replace"), err.read().decode(errors="replace")
    wrong = [f"took {seconds:.0f} s"] if rss_mib is None else []
    wrong += _compare(case, process.returncode, said, spoken)
    if rss_mib is not None and rss_mib > limits["rss_mib"]:
        wrong.append(f"{rss_mib:.0f} MiB of memory, at most {limits['rss_mib']} allowed")
    return Outcome(wrong=tuple(wrong), code=_code(said), seconds=seconds, rss_mib=rss_mib or 0.0)


def _in_our_terms(log: pathlib.Path, case: dict[str, Any], own: pathlib.Path) -> pathlib.Path:
    """The log, or a copy of it in the folder `own` that names its vehicle where `replay` looks for it."""
    if case["layer"] not in VEHICLE_LAYERS or not log.is_file():
        return log
    data = log.read_bytes()
    payload = vehicle_message(data)
    if payload is None:
        return log
    copy = own / log.name
    copy.write_bytes(with_vehicle(data, payload))
    return copy


def _watch(process: subprocess.Popen[bytes], deadline: float) -> float | None:
    """Wait; the largest resident memory seen [MiB], or None if the process had to be ended."""
    largest = 0.0
    status = pathlib.Path(f"/proc/{process.pid}/status")
    while process.poll() is None:
        if time.monotonic() > deadline:
            process.kill()
            process.wait()
            return None
        try:
            peak = re.search(r"VmHWM:\s+(\d+) kB", status.read_text())
        except OSError:
            peak = None
        largest = max(largest, int(peak[1]) / 1024.0 if peak else 0.0)
        time.sleep(0.01)
    return largest


def _document(said: str) -> dict[str, Any]:
    try:
        return json.loads(said)["logs"][0]
    except (ValueError, KeyError, IndexError):
        return {}


def _code(said: str) -> str:
    found = _CODE.search(_document(said).get("error") or "")
    return found[1] if found else ""


def _compare(case: dict[str, Any], status: int, said: str, spoken: str) -> list[str]:
    """What differs from what the manifest says of a case."""
    log = _document(said)
    wrong = _manners(status, spoken)
    if not log:
        return [*wrong, "no document"]
    error = log.get("error")
    if error and ("\n" in error or not _code(said)):
        wrong.append(f"not an error of one line with a code: {error!r}")
    read = sum(channel["messages"] for channel in log["channels"])
    if case["name"] in OWN_RULE:
        return wrong + _compare_own(case, status, log, read)
    if case["class"] == "accepts":
        return wrong + _compare_accepted(case, status, log, read)
    if case["class"] == "recovers":
        return wrong + _compare_recovered(case, log, read, spoken)
    return [*wrong, f"not refused, {case['code']} expected"] if status == 0 else wrong


def _manners(status: int, spoken: str) -> list[str]:
    """What no log at all may lead to."""
    wrong = [f"exit status {status}"] if status not in (0, 2, 3) else []
    if "Traceback" in spoken or "internal error" in spoken:
        wrong.append("a traceback or an internal error")
    if any(ord(letter) < 32 and letter not in "\n\t" for letter in spoken):
        wrong.append("control characters on standard error")
    return wrong


def _compare_accepted(case: dict[str, Any], status: int, log: dict[str, Any], read: int) -> list[str]:
    wrong = [f"not accepted (status {status}): {log.get('error')}"] if status != 0 or log["lost"] else []
    return wrong if read == case["messages"] else [*wrong, f"{read} messages, {case['messages']} expected"]


def _compare_recovered(case: dict[str, Any], log: dict[str, Any], read: int, spoken: str) -> list[str]:
    counted = case["messages"] is None or read == case["messages"]
    wrong = [] if counted else [f"{read} messages, {case['messages']} expected"]
    remarked = log.get("error") or spoken.strip() or any(part["read"]["notes"] for part in log["cases"])
    return wrong if remarked else [*wrong, "no remark"]


def _compare_own(case: dict[str, Any], status: int, log: dict[str, Any], read: int) -> list[str]:
    """What differs from the rule of `OWN_RULE`."""
    wrong = [f"{read} messages, {case['messages']} expected"] if read != case["messages"] or log["lost"] else []
    error = log.get("error") or ""
    if case["name"] == "map_after_path":
        notes = [note for part in log["cases"] for note in part["read"]["notes"]]
        said = status == 0 and any("logged after the path" in note for note in notes)
    elif case["name"] == "control_rotated_map_origin":  # x = 30 m - y', y = -10 m + x' of the map's own axes
        said = status == 2 and error.endswith("[E_START_COLLISION]") and "(-6.00, 0.60) m" in error
    else:
        said = status == 2 and error.endswith("[E_NO_PATH]")
    return wrong if said else [*wrong, f"against the rule: {OWN_RULE[case['name']]}"]
