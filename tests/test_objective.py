import numpy as np
import pytest
from paths import random_path
from scipy.integrate import quad

from optim.model.objective import Weights, objective, terms
from optim.model.path import Path, roll_out_segment
from optim.model.vehicle import Vehicle

VEHICLE = Vehicle()


def test_the_terms_are_the_integrals_of_the_definition():
    path = random_path(VEHICLE, (9, 6), seed=3, spacing=0.5)
    steer = rate = 0.0
    for segment in path.segments:
        points = list(segment.s)
        steer += quad(lambda s, seg=segment: np.interp(s, seg.s, seg.phi) ** 2, 0, segment.length, points=points)[0]
        rate += sum(np.diff(segment.phi) ** 2 / np.diff(segment.s))
    jump = path.segments[1].phi[0] - path.segments[0].phi[-1]
    expected = {"length": 15.0, "steer": 0.5 * steer, "rate": 5 * rate, "cusp": 5.0, "jump": jump**2}
    assert terms(path, Weights()) == pytest.approx(expected, rel=1e-7)
    assert objective(path, Weights()) == pytest.approx(sum(expected.values()), rel=1e-7)


def test_a_straight_drive_costs_its_length():
    segment = roll_out_segment(VEHICLE, np.zeros(4), 1, np.linspace(0, 10, 11), np.zeros(11))
    assert objective(Path((segment,)), Weights()) == pytest.approx(10.0)


def test_j_does_not_depend_on_the_sampling():
    s = np.linspace(0, 10, 11)
    phi = 0.3 * np.sin(s)
    fine = np.linspace(0, 10, 101)
    paths = [Path((roll_out_segment(VEHICLE, np.zeros(4), 1, at, np.interp(at, s, phi)),)) for at in (s, fine)]
    assert objective(paths[0], Weights()) == pytest.approx(objective(paths[1], Weights()), rel=1e-12)


@pytest.mark.parametrize("value", [-1.0, float("nan"), float("inf")])
def test_weights_that_make_no_objective_are_refused(value):
    with pytest.raises(ValueError, match="weights: rate"):
        Weights(rate=value)
