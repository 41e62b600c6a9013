"""Contenders on whole logs: every one solves every log, is audited, and its CPU time compared with ours.

Each verdict is a file of its own, so that a run that was interrupted goes on where it stopped. On each log the
contenders take turns, and what is quick is run again after each that is slow, the least time kept: a neighbour's load
then falls on all of them.
"""

import dataclasses
import importlib.util
import json
import pathlib
from typing import Any

from optim.methods import METHODS
from optim.methods.chain import named
from optim.methods.scp.statement import statement
from optim.model.objective import objective
from optim.model.problem import Problem
from replay.base.files import atomic_write
from replay.logs import read_cases
from tools.bench.peers import dolgov, hyperplane, obca, openscvx_peer
from tools.bench.peers.common import Answer, Contender, Verdict, measure

Row = dict[str, Any]

QUICK = 3.0
"""What takes less CPU time than this [s] is run again, `REPEATS` times in all."""
REPEATS = 3


def ours(name: str) -> Contender:
    """A method of ours with its default options; scp states its sub-problem anew, as a peer does its problem."""
    method = named(name, METHODS)

    def solve(problem: Problem) -> Answer:
        statement.cache_clear()
        result = method.solve(problem)
        return Answer(path=result.path, word=result.stop.value, iterations=result.iterations)

    return solve


def contenders() -> dict[str, Contender]:
    """All by name, without the peers that are not installed."""
    return {
        "scp": ours("scp"),
        "ddp": ours("ddp"),
        "OBCA, all pairs, IPOPT": obca.solve,
        "nlp": ours("nlp"),
        "hyperplanes, all pairs, IPOPT": hyperplane.solve_ipopt,
        "hyperplanes within 3 m, IPOPT": hyperplane.solve_near,
        "hyperplanes within 3 m, fatrop": hyperplane.solve_fatrop,
        **({"OpenSCvx": openscvx_peer.solve} if importlib.util.find_spec("openscvx") else {}),
        "cpo": ours("cpo"),
        "Dolgov's smoother, CG": dolgov.solve,
    }


def run(logs: list[pathlib.Path], folder: pathlib.Path) -> None:
    """Measure what is not measured yet."""
    chosen = contenders()
    folder.mkdir(parents=True, exist_ok=True)
    for log in logs:
        case = read_cases(log)[0]
        todo = {name: chosen[name] for name in chosen if not _file(folder, log.stem, name).exists()}
        best: dict[str, Verdict] = {}
        for turn in range(REPEATS):
            for name, contender in todo.items():
                if turn and best[name].cpu_s > QUICK:
                    continue
                verdict = measure(case, contender)
                if name not in best or verdict.cpu_s < best[name].cpu_s:
                    best[name] = verdict
                    row = dataclasses.asdict(verdict) | {"log": log.stem, "name": name}
                    row["recorded"] = objective(case.problem.recorded, case.problem.weights)
                    with atomic_write(_file(folder, log.stem, name)) as temporary:
                        temporary.write_text(json.dumps(row, indent=1), encoding="utf-8")
                if turn == 0:
                    seen = f"{verdict.status:<9}{verdict.objective:9.3f}{verdict.cpu_s:9.2f} s {verdict.word}"
                    print(f"{log.stem:<13}{name:<32}{seen}", flush=True)


def _file(folder: pathlib.Path, log: str, name: str) -> pathlib.Path:
    return folder / f"{log}.{''.join(c if c.isalnum() else '_' for c in name)}.json"
