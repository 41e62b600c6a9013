"""Spoil sound results in many ways and see that the audit rejects every one, by the check that is meant to notice.

Usage: python -m tools.attacks sabotage LOG... [--seeds N] [--methods A,B] [--only TEXT] [--jobs N]

Sound claims are the recorded path of each log and what the methods make of it; those that pass the audit with some
room are spoiled, `--seeds` times in each way, each time another path, another place, another amount. Then the check
that noticed is switched off: what no other check is meant to see must pass. A table says how that went; the exit
status is 1 if anything went otherwise.
"""

import argparse
import collections
import pathlib
import sys
import time
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context

from optim.audit.checks import ALL
from optim.methods import METHODS
from optim.methods.chain import named
from optim.model.path import Path
from optim.model.problem import Problem
from replay.base.errors import LogError, UsageError
from replay.base.kernels import drop_stale
from replay.logs import read_cases
from replay.run.judge import run_case
from tools.attacks.saboteur.claims import KINDS, Claim, claim_of
from tools.attacks.saboteur.trial import Outcome, report_of, trial
from tools.script import existing, from_one, method_name

ROOM = 0.02
"""Least swept clearance of the paths to be spoiled [m]: small damage shall not be seen by a collision."""
_sound: list[Claim] = []


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("logs", type=existing, nargs="+", metavar="LOG")
    parser.add_argument("--seeds", type=from_one, default=100, help="for each kind (default: %(default)s)")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--methods", type=_methods, default="shortcut,ddp", help="whose results are spoiled too")
    parser.add_argument("--only", default="", help="kinds whose name contains this")
    parser.add_argument("--part", type=_part, default="1/1", help="K/N: of N parts of the kinds, the K-th")
    parser.add_argument("--jobs", type=from_one, default=1, help="processes (default: %(default)s)")


def main(arguments: argparse.Namespace) -> int:
    """Exit status: 0 where all is as it should be, else 1."""
    part, parts = arguments.part
    kinds = [number for number, kind in enumerate(KINDS) if arguments.only in kind.name][part - 1 :: parts]
    if not kinds:
        raise UsageError(f"no kind has {arguments.only!r} in its name, or none is in part {part} of {parts}")
    drop_stale()
    started = time.monotonic()
    sound = [claim for log in arguments.logs for claim in sound_claims(log, arguments.methods)]
    print(f"{len(sound)} sound paths of {len(arguments.logs)} logs; {time.monotonic() - started:.0f} s", flush=True)
    if not sound:
        raise UsageError("none of the logs holds a sound path that could be spoiled")
    _sound.extend(sound)  # inherited by the processes that are forked
    wrong = 0
    print(f"{'kind':52} {'check':11} {'rejected':>9} {'by it':>6} {'passes without':>15}")
    with ProcessPoolExecutor(arguments.jobs, mp_context=get_context("fork")) as pool:
        for number in kinds:
            tasks = [(number, seed) for seed in range(arguments.first, arguments.first + arguments.seeds)]
            wrong += not _row(number, list(pool.map(_one, tasks, chunksize=5)))
    seconds, count = time.monotonic() - started, len(kinds) * arguments.seeds
    print(f"{len(kinds)} kinds, {count} spoiled claims, {seconds:.0f} s; {wrong} kinds not as meant")
    return int(wrong > 0)


def _methods(text: str) -> list[str]:
    return [method_name(name) for name in text.split(",") if name]


def _part(text: str) -> tuple[int, int]:
    part, _, parts = text.partition("/")
    if not (part.isdigit() and parts.isdigit() and 1 <= int(part) <= int(parts)):
        raise argparse.ArgumentTypeError(f"{text!r} is not K/N with whole numbers, K from 1 to N")
    return int(part), int(parts)


def sound_claims(log: pathlib.Path, methods: list[str]) -> list[Claim]:
    """The claims of a log that the audit accepts with some room; none of a log that is refused, which is said."""
    try:
        cases = read_cases(log)
    except LogError as error:
        print(f"left out: {error}", file=sys.stderr)
        return []
    found = []
    for case in cases:
        run = run_case(case, {name: named(name, METHODS) for name in methods})
        paths: list[Path] = [case.problem.recorded]
        paths += [method.path for method in run.methods if method.status == "improved"]
        found += [claim for path in paths if _is_sound(claim := _claim(case.problem, path))]
    return found


def _claim(problem: Problem, path: Path) -> Claim:
    return claim_of(problem.vehicle, problem.scene, problem.recorded, path, problem.weights)


def _is_sound(claim: Claim) -> bool:
    report = report_of(claim, ALL)
    return report.passed and min(report.checks["clearance"].values.values()) >= ROOM


def _one(task: tuple[int, int]) -> Outcome:
    number, seed = task
    return trial(KINDS[number], _sound, seed)


def _row(number: int, found: list[Outcome]) -> bool:
    """Print what became of a kind; whether that is what is meant."""
    kind = KINDS[number]
    rejected, named = sum(o.rejected for o in found), sum(o.by_name for o in found)
    without = sum(bool(o.passes_without) for o in found)
    shown = f"{without}" if kind.alone else "-"
    print(f"{kind.name:52} {kind.check:11} {rejected:9} {named:6} {shown:>15}", flush=True)
    right = rejected == named == len(found) and (without == len(found) or not kind.alone)
    if not right:
        for failed, times in collections.Counter(outcome.failed for outcome in found).items():
            print(f"    {times} times noticed by: {', '.join(failed) or 'none'}")
    return right
