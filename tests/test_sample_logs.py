"""The main job on every sample log: read, improve, audit."""

from pathlib import Path

import logs_maker as make
import numpy as np
import pytest

from optim.methods import METHODS
from optim.model.path import Path as DrivenPath
from replay.logs import read_cases
from replay.run.judge import run_case

LOGS = sorted((Path(__file__).parents[1] / "recordings").glob("*.mcap"))

QUICK = {name: method for name, method in METHODS.items() if name != "nlp"}
"""nlp takes up to 50 s a log, which is for the benchmark; the contract tests have it on smaller problems."""


@pytest.mark.slow
@pytest.mark.parametrize("log", LOGS, ids=lambda log: log.stem)
def test_a_sample_log_is_improved_and_passes_the_audit(log: Path) -> None:
    for case in read_cases(log):
        run = run_case(case, QUICK)
        assert run.recorded_audit.passed
        shortcut = next(method for method in run.methods if method.name == "shortcut")
        assert shortcut.status == "improved", shortcut.reason
        for method in run.methods:
            assert method.status in ("improved", "kept")
            assert method.audit.passed
            assert method.metrics.min_clearance >= case.problem.required_clearance - 1e-4
            assert method.metrics.cusps <= run.recorded_metrics.cusps


def test_there_are_twelve_sample_logs() -> None:
    assert len(LOGS) == 12


@pytest.mark.slow
@pytest.mark.parametrize("stem", ["bay_02", "lot_01", "angled_02"])
def test_coarse_and_noisy_poses_without_trailer_and_vehicle_are_improved_too(stem: str, tmp_path: Path) -> None:
    (case,) = read_cases(LOGS[0].with_name(f"{stem}.mcap"))
    assert case.map is not None
    poses = _noisy_poses(case.problem.recorded, spacing=0.5, seed=1)
    cells = make.grid(case.map.cells, resolution=case.map.resolution, origin=case.map.origin)
    log = make.LogMaker().add("/map", cells, 1).add("/plan", make.path(poses), 2).write(tmp_path / "noisy.mcap")
    (noisy,) = read_cases(log)
    run = run_case(noisy, QUICK)
    assert run.recorded_audit.passed, run.recorded_audit
    assert all(method.status == "improved" for method in run.methods)
    hitch = [np.abs(problem.recorded.samples.states[:, 3]).max() for problem in (case.problem, noisy.problem)]
    assert hitch[1] == pytest.approx(hitch[0], abs=0.03)


def _noisy_poses(path: DrivenPath, spacing: float, seed: int) -> np.ndarray:
    """x, y, heading about every `spacing` [m], with 2 cm and 0.3 degrees of noise but at the ends."""
    rows = [path.start[None]]
    for segment in path.segments:
        at = np.linspace(0.0, segment.length, max(2, int(segment.length / spacing) + 1))[1:]
        rows.append(segment.states[[int(np.argmin(np.abs(segment.s - s))) for s in at]])
    poses = np.concatenate(rows)[:, :3]
    noise = np.random.default_rng(seed).normal(0.0, 1.0, poses.shape) * [0.02, 0.02, 0.005]
    noise[[0, -1]] = 0.0
    return poses + noise
