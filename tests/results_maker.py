"""A run with every kind of outcome, and its results file."""

import dataclasses
import json
import math
import pathlib
from typing import Any

import numpy as np
from paths import straight

from optim.model.path import Path
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle
from replay.base.documents import to_bytes
from replay.base.schemas.results import ResultsDocument
from replay.run.case import Case, ReadReport
from replay.run.judge import run_case
from replay.run.outcome import Run

Document = dict[str, Any]
VEHICLE = Vehicle()


@dataclasses.dataclass(frozen=True, kw_only=True)
class Answer:
    """A method that knows its answer."""

    path: Path
    stop: Stop = Stop.CONVERGED

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        residuals = {"defect": 12.5, "step": math.inf}
        on_iterate(Iterate(iteration=0, path=problem.recorded, objective=30.0, step=math.inf, residuals=residuals))
        return Result(path=self.path, stop=self.stop, reason="Nothing was left to do.", iterations=1)


RECORDED = straight(10.0, -5.0, 5.0)


def make_run(log: str = "bay_01.mcap", boundary: Any = None) -> Run:
    """A better path, the recorded one, one that misses the goal, and a method that failed."""
    polygons = [
        np.array([[-5.0, 3.0], [20.0, 3.0], [20.0, 4.0], [-5.0, 4.0]]),
        np.array([[0.0, -9.0], [1.0, -9.0], [0.0, -8.0]]),
    ]
    problem = Problem(vehicle=VEHICLE, scene=make_scene(polygons, boundary=boundary), recorded=RECORDED)
    read = ReadReport(poses=41, hitch="reconstructed", max_deviation_m=0.01, max_deviation_rad=0.001, notes=("odd",))
    case = Case(
        name="bay_01/0", log=pathlib.Path(log), sha256="ab" * 32, problem=problem, read=read, map=None, frame="map"
    )
    methods = {
        "better": Answer(path=straight(10.0)),
        "same": Answer(path=RECORDED),
        "wrong": Answer(path=straight(9.0)),
        "broken": Answer(path=RECORDED, stop=Stop.FAILED),
    }
    run = run_case(case, methods)
    return dataclasses.replace(run, options={"better": {"window": 3.0, "kind": ("a", "b")}}, seed=7)


def written(tmp_path: pathlib.Path, document: Document | ResultsDocument) -> pathlib.Path:
    """Its file."""
    path = tmp_path / "bay_01.results.json"
    path.write_bytes(to_bytes(document))
    return path


def results_data(file: pathlib.Path) -> Document:
    """A results file as plain data."""
    return json.loads(file.read_text(encoding="utf-8"))
