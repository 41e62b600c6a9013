"""What a recording shows of iterates: residuals, costs, rejected trials, signals by iteration."""

import numpy as np
import pytest
import recording_factory as factory
from recording_reading import Contents, written

from replay.recording.overview import convergence_help
from replay.recording.tracks import tracks_of
from replay.run.outcome import Run


def test_violations_are_plotted_only_of_methods_that_have_any(five_read: Contents, one_read: Contents) -> None:
    assert "/solver/violation_log10/cpo" in five_read.tables
    assert "/solver/violation_log10/shortcut" not in five_read.tables
    assert not any(entity.startswith("/solver/violation") for entity in one_read.tables)


@pytest.fixture(scope="module")
def iterative() -> Run:
    """SCP as it reports itself, and a chain that ends with it."""
    steps = factory.towards((8.0, 0.34), 8)
    methods = {
        "scp": factory.Iterative(steps[-1], steps[:-1]),
        "shortcut+scp": factory.Iterative(steps[-2], steps[:3], seed=1),
    }
    return factory.make_run(methods)


@pytest.fixture(scope="module")
def iterative_read(iterative: Run, tmp_path_factory: pytest.TempPathFactory) -> Contents:
    return Contents(written(iterative, tmp_path_factory.mktemp("iterative")))


def plotted(contents: Contents, entity: str) -> tuple[list[int], np.ndarray]:
    """Iterations and values of a curve."""
    values = np.concatenate(contents.rows(entity, "Scalars:scalars", "iteration"))
    return contents.times(entity, "iteration"), values


def test_residuals_are_plotted_of_accepted_iterates_with_their_tolerance_as_a_level(
    iterative: Run, iterative_read: Contents
) -> None:
    rows = [row for row in iterative.methods[0].history if row.accepted]
    numbers, largest = plotted(iterative_read, "/solver/largest_residual_log10/scp")
    assert numbers == [row.iteration for row in rows]
    np.testing.assert_allclose(largest, [np.log10(max(row.residuals.values())) for row in rows])
    for name in factory.RESIDUALS:
        _, values = plotted(iterative_read, f"/solver/residuals_log10/{name}/scp")
        np.testing.assert_allclose(values, [np.log10(max(row.residuals[name], 1e-3)) for row in rows])
        numbers, level = plotted(iterative_read, f"/solver/residuals_log10/{name}/level")
        assert numbers == [0, rows[-1].iteration]
        assert level.tolist() == [0.0, 0.0]


def test_trust_region_and_solver_time_are_plotted_of_every_iterate(iterative: Run, iterative_read: Contents) -> None:
    history = iterative.methods[0].history
    numbers, radii = plotted(iterative_read, "/solver/trust_region_log10/scp")
    assert numbers == [row.iteration for row in history]
    np.testing.assert_allclose(radii, [np.log10(row.trust_region) for row in history])
    numbers, times = plotted(iterative_read, "/solver/solver_ms/scp")
    assert numbers == [row.iteration for row in history[1:]], "nothing was solved before the first one"
    np.testing.assert_allclose(times, [1e3 * row.solver_s for row in history[1:]])


def test_a_trial_that_was_turned_down_is_marked_and_moves_neither_the_path_nor_its_cost(
    iterative: Run, iterative_read: Contents
) -> None:
    history = iterative.methods[0].history
    turned_down = [row.iteration for row in history if not row.accepted]
    assert turned_down
    assert not set(turned_down) & set(iterative_read.times("/scene/scp/iterate", "iteration"))
    _, costs = plotted(iterative_read, "/solver/objective/scp")
    numbers, marks = plotted(iterative_read, "/solver/objective/scp/turned_down")
    assert numbers == turned_down
    for k, mark in zip(turned_down, marks, strict=True):
        assert mark == costs[k] == costs[k - 1] == history[k - 1].objective
    assert "rejected trial" in iterative_read.text("/report/convergence")


def test_a_rise_of_j_is_explained_where_a_method_began_anew(iterative: Run, iterative_read: Contents) -> None:
    explanation = "a method started again"
    assert explanation not in iterative_read.text("/report/convergence")
    steps = factory.towards((8.0, 0.34), 4)
    repeated = factory.make_run({"scp": factory.Iterative(steps[-1], [*steps[:-1], *steps[:-1]])})
    assert explanation in convergence_help(tracks_of(repeated))


def test_a_chain_has_entities_under_its_whole_name(iterative_read: Contents) -> None:
    for parent in ("scene", "signals/steering_deg", "solver/objective", "gear"):
        assert any(entity.startswith(f"/{parent}/shortcut-scp") for entity in iterative_read.tables)
    assert "Shortcut + SCP" in iterative_read.text("/report/summary")
    assert "| shortcut+scp.attempts | 200 |" in iterative_read.text("/report/run")


def test_on_the_timeline_of_iterations_signals_are_those_of_each_iterate(one: Run, one_read: Contents) -> None:
    iterates = one.methods[0].iterates
    numbers, angles = plotted(one_read, "/signals/steering_deg/shortcut")
    assert numbers == list(range(len(iterates)))
    np.testing.assert_allclose(angles, [np.degrees(np.abs(i.path.samples.phi).max()) for i in iterates])
    _, clearances = plotted(one_read, "/signals/clearance_m/shortcut")
    assert clearances[-1] == pytest.approx(one.methods[0].metrics.min_clearance, abs=0.01)
    for name in ("recorded", "limit"):
        numbers, _ = plotted(one_read, f"/signals/clearance_m/{name}")
        assert numbers == [0, len(iterates) - 1]


def test_on_iterations_the_gear_strip_counts_the_gear_changes_of_each_iterate(five: Run, five_read: Contents) -> None:
    assert five_read.rows("/gear/recorded", "StateChange:state", "iteration") == [["3 gear changes"]]
    shortcut = next(method for method in five.methods if method.name == "shortcut")
    first = shortcut.iterates[0].path.num_cusps
    assert five_read.rows("/gear/shortcut", "StateChange:state", "iteration")[0] == [f"{first} gear change"]
