import numpy as np
import pytest
from paths import random_path

from optim.model.kinematics import roll_out
from optim.model.path import Path, Segment, merge, resample, reverse, roll_out_segment, segment_from_states
from optim.model.vehicle import Vehicle

VEHICLE = Vehicle()


def _segment(**changes) -> Segment:
    columns = {name: np.zeros(3) for name in ("x", "y", "theta", "alpha", "phi")}
    return Segment(**{"direction": 1, "s": np.array([0.0, 1.0, 2.0]), **columns, **changes})


def _halves(segment: Segment) -> list[Segment]:
    """The segment in two, which share its middle sample."""
    middle = segment.num_samples // 2
    return [
        segment_from_states(segment.direction, segment.s[part], segment.states[part], segment.phi[part])
        for part in (slice(middle + 1), slice(middle, None))
    ]


@pytest.mark.parametrize(
    ("changes", "message"),
    [
        ({"direction": 0}, "direction is 0"),
        ({"s": np.array([0.0, 1.0, 1.0])}, "increase strictly"),
        ({"s": np.array([1.0, 2.0, 3.0])}, "start at 0"),
        ({"x": np.zeros(2)}, "x has shape"),
        ({"phi": np.array([0.0, np.nan, 0.0])}, r"phi\[1\] is not finite"),
    ],
)
def test_a_segment_that_is_none_is_refused_with_what_is_wrong(changes, message):
    with pytest.raises(ValueError, match=message):
        _segment(**changes)


def test_arrays_of_a_segment_cannot_be_written():
    segment = _segment()
    with pytest.raises(ValueError, match="read-only"):
        segment.x[0] = 1.0
    with pytest.raises(ValueError, match="read-only"):
        segment.states[0, 0] = 1.0


def test_an_empty_path_is_refused():
    with pytest.raises(ValueError, match="no segments"):
        Path(())


def test_samples_repeat_cusps_and_run_on_in_arc_length():
    path = random_path(VEHICLE, (10, 5, 7), seed=2)
    samples = path.samples
    assert len(samples.s) == sum(segment.num_samples for segment in path.segments)
    assert samples.s[-1] == pytest.approx(22.0)
    cusps = np.flatnonzero(np.diff(samples.segment))
    np.testing.assert_array_equal(samples.states[cusps], samples.states[cusps + 1])
    assert (np.diff(samples.s) >= 0).all()
    assert path.num_cusps == 2


@pytest.mark.parametrize("seed", range(5))
def test_a_reversed_path_is_a_path_of_the_same_kinematics(seed):
    path = reverse(random_path(VEHICLE, (12, 8), seed=seed))
    for segment in path.segments:
        for k in range(0, segment.num_samples - 1, 7):
            end = roll_out(VEHICLE, segment.states[k], segment.s[k : k + 2], segment.phi[k : k + 2], segment.direction)
            np.testing.assert_allclose(end[-1], segment.states[k + 1], atol=1e-9)


def test_reversing_twice_gives_the_path_back():
    path = random_path(VEHICLE, (12, 8), seed=1)
    again = reverse(reverse(path))
    np.testing.assert_allclose(again.samples.states, path.samples.states, atol=1e-12)
    np.testing.assert_allclose(again.samples.s, path.samples.s, atol=1e-12)
    np.testing.assert_array_equal(again.samples.direction, path.samples.direction)


def test_resampling_keeps_the_samples_that_were_there():
    coarse = random_path(VEHICLE, (6, 4), seed=5, spacing=0.5)
    fine = resample(VEHICLE, coarse, 0.05)
    for before, after in zip(coarse.segments, fine.segments, strict=True):
        assert np.diff(after.s).max() <= 0.05 + 1e-12
        at = [int(np.argmin(np.abs(after.s - s))) for s in before.s]
        np.testing.assert_allclose(after.states[at], before.states, atol=1e-12)
        exact = roll_out_segment(VEHICLE, before.states[0], before.direction, after.s, after.phi)
        np.testing.assert_allclose(after.states, exact.states, atol=1e-7)


def test_merging_joins_equal_gears_and_leaves_cusps():
    path = random_path(VEHICLE, (6, 4), seed=6)
    merged = merge([*_halves(path.segments[0]), path.segments[1]])
    assert [segment.direction for segment in merged.segments] == [1, -1]
    np.testing.assert_allclose(merged.samples.s, path.samples.s, atol=1e-12)
    np.testing.assert_array_equal(merged.samples.states, path.samples.states)
    np.testing.assert_array_equal(merged.samples.phi, path.samples.phi)


def test_a_jump_of_steering_in_one_gear_is_no_joint():
    first, second = _halves(random_path(VEHICLE, (6,), seed=6).segments[0])
    steered = roll_out_segment(VEHICLE, second.states[0], second.direction, second.s, second.phi + 0.05)
    assert len(merge([first, steered]).segments) == 2
    assert len(merge([first, second]).segments) == 1


def test_the_trailer_travels_the_length_of_its_axle_curve():
    path = random_path(VEHICLE, (20,), seed=7)
    x, y, theta, alpha = path.segments[0].states.T
    heading = theta + alpha
    axle = np.stack([x - 8 * np.cos(heading), y - 8 * np.sin(heading)])
    assert path.trailer_length == pytest.approx(np.hypot(*np.diff(axle)).sum(), rel=1e-4)
