"""The main job on every sample log: read, improve, audit."""

from pathlib import Path

import pytest

from optim.methods import METHODS
from replay.logs import read_cases
from replay.run import run_case

LOGS = sorted((Path(__file__).parents[1] / "recordings").glob("*.mcap"))


@pytest.mark.parametrize("log", LOGS, ids=lambda log: log.stem)
def test_a_sample_log_is_improved_and_passes_the_audit(log: Path) -> None:
    for case in read_cases(log):
        run = run_case(case, METHODS)
        assert run.recorded_audit["passed"]
        shortcut = next(method for method in run.methods if method.name == "shortcut")
        assert shortcut.status == "improved", shortcut.reason
        for method in run.methods:
            assert method.status in ("improved", "kept")
            assert method.audit["passed"]
            assert method.metrics["min_clearance"] >= case.problem.required_clearance - 1e-4
            assert method.metrics["cusps"] <= run.recorded_metrics["cusps"]


def test_there_are_twelve_sample_logs() -> None:
    assert len(LOGS) == 12
