"""From the poorest log to a better path: a grid and a noisy truck path are all that there is."""

from pathlib import Path

import logs_maker as make
import numpy as np
import pytest
from scipy.spatial import KDTree

from optim.methods import METHODS
from optim.model.kinematics import roll_out
from optim.model.vehicle import Vehicle
from replay.logs import read_cases
from replay.run.case import Case
from replay.run.judge import run_case

VEHICLE = Vehicle()


def _drive(step: float) -> np.ndarray:
    """States of the manoeuvre: 20 m forward in an S, and 14 m back with the trailer straightened. Shape (n, 4)."""
    s = np.arange(0.0, 20.0 + 1e-9, step)
    states = list(roll_out(VEHICLE, np.array([20.0, 18.0, 0.1, 0.0]), s, 0.3 * np.sin(np.pi * s / 10.0), 1))
    for _ in range(round(14.0 / step)):
        _, _, theta, alpha = states[-1]
        steer = np.clip(-1.5 * (alpha + 0.5 * (theta + alpha)), -0.4, 0.4)
        states.append(roll_out(VEHICLE, states[-1], np.array([0.0, step]), np.full(2, steer), -1)[-1])
    return np.array(states)


FINE = _drive(0.02)
TRUTH = FINE[::25]


def _noisy(truth: np.ndarray, position: float = 0.02, heading: float = 0.005, seed: int = 2) -> np.ndarray:
    sigma = [position, position, heading]
    return truth[:, :3] + np.random.default_rng(seed).normal(0.0, 1.0, (len(truth), 3)) * sigma


def _cells() -> np.ndarray:
    """The yard, with blocks about a metre beside the lane."""
    cells = make.yard()
    for x, y, length, width in ((22.0, 10.0, 2.0, 2.6), (30.0, 26.5, 3.0, 3.0), (30.0, 15.0, 2.0, 3.0)):
        cells[round(5 * y) : round(5 * (y + width)), round(5 * x) : round(5 * (x + length))] = 100
    return cells


@pytest.fixture(scope="module")
def noisy_case(tmp_path_factory: pytest.TempPathFactory) -> Case:
    """Case of a log of an OccupancyGrid and a Path alone, every 0.5 m with 2 cm and 0.3 degrees of noise."""
    file = tmp_path_factory.mktemp("noisy") / "noisy.mcap"
    make.LogMaker().add("/map", make.grid(_cells()), 1).add("/plan", make.path(_noisy(TRUTH)), 2).write(file)
    (case,) = read_cases(file)
    return case


def test_the_repaired_path_is_near_the_true_one_and_its_ends_are_the_logs(noisy_case: Case) -> None:
    path = noisy_case.problem.recorded
    assert [segment.direction for segment in path.segments] == [1, -1]
    np.testing.assert_allclose([path.start[:3], path.goal[:3]], _noisy(TRUTH)[[0, -1]], atol=1e-8)
    off = KDTree(FINE[:, :2]).query(path.samples.states[:, :2])[0]
    assert np.sqrt(np.mean(off**2)) < 0.02
    assert off.max() < 0.06
    assert abs(path.goal[3] - TRUTH[-1, 3]) < 3.0 * noisy_case.read.goal_hitch_sigma


@pytest.mark.parametrize("method", ["ddp", "scp"])
def test_a_noisy_log_is_improved_and_its_repair_is_told(noisy_case: Case, method: str) -> None:
    run = run_case(noisy_case, {method: METHODS[method]})
    assert run.recorded_audit.passed, run.recorded_audit
    (made,) = run.methods
    assert made.status == "improved", made.reason
    assert made.audit.passed
    assert made.metrics.objective < 0.98 * run.recorded_metrics.objective
    read = run.case.read
    assert 0.01 < read.rms_deviation_m < 0.03
    assert read.rms_deviation_m < read.max_deviation_m < 0.08
    assert 0.002 < read.rms_deviation_rad < 0.01
    assert 0.0 < read.goal_hitch_sigma < 0.1
    assert read.hitch == "reconstructed"
    notes = "; ".join(read.notes)
    assert "its poses have noise of" in notes
    assert "no vehicle" in notes or "default" in notes


def test_an_exact_log_has_no_deviation_to_tell(tmp_path: Path) -> None:
    (case,) = make.read_log(tmp_path / "exact.mcap", make.sound_log())
    assert case.read.rms_deviation_m <= case.read.max_deviation_m < 1e-4
    assert case.read.goal_hitch_sigma == 0.0


def test_what_cannot_be_repaired_is_an_error_with_place_and_amount(tmp_path: Path) -> None:
    truck = make.drive(step=0.5)[0]
    truck[20:, :2] += 1.0 * np.array([-np.sin(truck[20, 2]), np.cos(truck[20, 2])])
    error = make.refusal_of(tmp_path / "jump.mcap", make.log_of(truck))
    assert error.code == "E_KINEMATICS"
    assert "it jumps sideways by 1.00 m from pose 19 at (29." in str(error)
    assert "9.50 m from the start, to pose 20, expected at most 0.5 m" in str(error)


def test_a_long_way_in_reverse_is_said_to_amplify_an_error_of_the_first_hitch_angle(tmp_path: Path) -> None:
    straight = np.linspace([50.0, 20.0, 0.0], [26.0, 20.0, 0.0], 49)
    (case,) = make.read_log(tmp_path / "reverse.mcap", make.log_of(straight))
    assert any(
        "an error of the initial hitch angle (--initial-hitch) is 20.1 times as large" in n for n in case.read.notes
    )
    wild = _noisy(straight, 0.05, 0.02)
    (noisy,) = make.read_log(tmp_path / "noisy.mcap", make.log_of(wild))
    assert noisy.read.goal_hitch_sigma > 0.02
    assert any("the hitch angle at the goal is known to within" in note for note in noisy.read.notes)


def test_a_stretch_without_poses_is_bridged_and_told(tmp_path: Path) -> None:
    gap = np.delete(TRUTH[:, :3], slice(10, 15), axis=0)
    (case,) = make.read_log(tmp_path / "gap.mcap", make.log_of(gap))
    (note,) = [note for note in case.read.notes if "it has no poses for" in note]
    assert "from pose 9 at (24." in note
    off = KDTree(case.problem.recorded.samples.states[:, :2]).query(FINE[:, :2])[0]
    assert off.max() < 0.06  # samples are 0.1 m apart
    error = make.refusal_of(tmp_path / "long.mcap", make.log_of(np.delete(TRUTH[:, :3], slice(10, 24), axis=0)))
    assert error.code == "E_PATH_DISCONTINUOUS"


def test_a_jump_that_can_be_smoothed_is_told_with_its_place(tmp_path: Path) -> None:
    truck = TRUTH[:, :3].copy()
    truck[20:, :2] += 0.25 * np.array([-np.sin(truck[20, 2]), np.cos(truck[20, 2])])
    (case,) = make.read_log(tmp_path / "jump.mcap", make.log_of(truck))
    assert any("it jumps sideways by 0.2" in note and "from pose 19 at" in note for note in case.read.notes)
    assert case.read.max_deviation_m > 0.02
