"""What a recording draws in the plan view besides the paths: the poses as logged, a scale, places of failed checks."""

import dataclasses
import pathlib

import numpy as np
import pytest
import recording_factory as factory
from logs_maker import drive, log_of, path, read_log, shifted, yard
from recording_reading import Contents, names_in_blueprint, written

from optim.model.scene import make_scene
from replay.recording import plan_view
from replay.recording.picture import frame_around, swept_area
from replay.run.judge import run_case
from replay.run.outcome import Run

POSES = "/scene/recorded/logged_poses"


def run_of_log(tmp_path: pathlib.Path, noise: float, dx: float = 0.0) -> tuple[Run, np.ndarray]:
    """A run on a log whose positions have noise [m], moved by `dx` [m], and the poses that were logged, (n, 3)."""
    truck, _ = drive(step=0.5)
    deviation = np.random.default_rng(7).normal(0.0, 1.0, truck.shape) * [noise, noise, 0.25 * noise]
    logged = shifted(truck + deviation, dx)
    (case,) = read_log(tmp_path / "log.mcap", log_of(path(logged), cells=yard(), origin=(dx, 0.0, 0.0)))
    return run_case(case, {"shortcut": factory.Prepared()}), logged


def drawn(contents: Contents) -> np.ndarray:
    (places,) = contents.rows(POSES, "Points2D:positions")
    return np.array(places)


@pytest.mark.parametrize("dx", [0.0, 500_000.0], ids=["near the origin", "far from it"])
def test_noisy_poses_are_drawn_as_they_were_logged_beside_the_repaired_path(tmp_path: pathlib.Path, dx: float) -> None:
    run, logged = run_of_log(tmp_path, 0.02, dx)
    assert run.case.logged is not None
    np.testing.assert_allclose(run.case.logged, logged, atol=1e-9)
    file = written(run, tmp_path)
    contents = Contents(file)
    places = drawn(contents)
    np.testing.assert_allclose(places, logged[:, :2] - [dx, 0.0], atol=1e-4)
    (strips,) = contents.rows("/scene/recorded/path", "LineStrips2D:strips")
    line = np.concatenate(strips)
    off = np.hypot(*(places[:, None] - line[None]).transpose(2, 0, 1)).min(axis=1)
    assert off.max() > 0.01, "what is drawn is not the repaired path"
    assert any("logged poses" in name for name in names_in_blueprint(file))


def test_poses_that_the_path_meets_are_not_drawn(tmp_path: pathlib.Path) -> None:
    run, _ = run_of_log(tmp_path, 0.0)
    file = written(run, tmp_path)
    contents = Contents(file)
    assert POSES not in contents.tables
    assert not any("logged poses" in name for name in names_in_blueprint(file))


def test_of_very_many_poses_some_are_drawn_from_end_to_end(
    tmp_path: pathlib.Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    run, logged = run_of_log(tmp_path, 0.02)
    monkeypatch.setattr(plan_view, "_MOST_POSES", 20)
    places = drawn(Contents(written(run, tmp_path)))
    assert 10 < len(places) <= 20
    np.testing.assert_allclose(places[0], logged[0, :2], atol=1e-4)


def test_the_scale_is_as_long_as_it_says_and_a_round_length(one_read: Contents) -> None:
    ((bar,),) = one_read.rows("/scene/scale", "LineStrips2D:strips")
    ((text,),) = one_read.rows("/scene/scale/label", "Points2D:labels")
    length, unit = text.split()
    assert unit == "m"
    assert float(np.ptp(np.array(bar)[:, 0])) == pytest.approx(float(length), abs=1e-3)
    assert length.strip("0.") in ("1", "2", "5")


@pytest.mark.parametrize("side", [-1.0, 1.0], ids=["left", "right"])
def test_the_scale_is_in_the_lower_corner_that_is_farther_from_start_and_goal(
    tmp_path: pathlib.Path, side: float
) -> None:
    run, _ = run_of_log(tmp_path, 0.0)
    problem = run.case.problem
    ends = np.stack([problem.recorded.start, problem.recorded.goal])[:, :2]
    lowest, middle = ends[:, 1].min() - 5.0, ends[:, 0].mean()
    far = np.array([[-1.0, 0.0], [1.0, 0.0], [1.0, 1.0], [-1.0, 1.0]]) + [middle + side * 40.0, lowest]
    moved = dataclasses.replace(problem, scene=make_scene([far]))
    case = dataclasses.replace(run.case, problem=moved)
    contents = Contents(written(run_case(case, {"shortcut": factory.Prepared()}), tmp_path))
    ((bar,),) = contents.rows("/scene/scale", "LineStrips2D:strips")
    assert side * (np.array(bar)[:, 0].mean() - middle) > 0.0


def test_failed_checks_at_one_place_share_a_label(tmp_path: pathlib.Path) -> None:
    run = factory.make_run({"cpo": factory.Prepared(factory.manoeuvre(2.0, 0.5))})
    contents = Contents(written(run, tmp_path))
    (labels,) = contents.rows("/scene/cpo/rejected/audit", "Points2D:labels")
    (marks,) = contents.rows("/scene/cpo/rejected/audit/marks", "Points2D:positions")
    lines = [line for label in labels for line in label.split("\n")]
    assert len(labels) < len(lines) == len(marks)
    assert {line.split(":")[0] for line in lines} >= {"✗ steer", "✗ hitch"}


def test_the_best_path_is_drawn_over_the_others_and_all_over_the_recorded_one(five: Run, five_read: Contents) -> None:
    improved = [method for method in five.methods if method.status == "improved"]
    best = min(improved, key=lambda method: method.metrics.objective)
    names = ["recorded", *(method.name for method in improved)]
    orders = {name: five_read.rows(f"/scene/{name}/path", "LineStrips2D:draw_order")[0][0] for name in names}
    assert max(orders, key=orders.__getitem__) == best.name
    assert min(orders, key=orders.__getitem__) == "recorded"


def test_outlines_end_where_the_map_is_cut_off_so_that_none_crosses_the_legend(tmp_path: pathlib.Path) -> None:
    run, _ = run_of_log(tmp_path, 0.0)
    problem = run.case.problem
    far = (
        np.array([[-300.0, -2.0], [300.0, -2.0], [300.0, 2.0], [-300.0, 2.0]])
        + problem.recorded.start[:2]
        + [0.0, 25.0]
    )
    walls = make_scene([*problem.scene.polygons, far])
    case = dataclasses.replace(run.case, problem=dataclasses.replace(problem, scene=walls))
    contents = Contents(written(dataclasses.replace(run, case=case), tmp_path))
    (strips,) = contents.rows("/scene/obstacles", "LineStrips2D:strips")
    frame = frame_around(walls, [swept_area(problem.vehicle, problem.recorded)])
    places = np.concatenate([np.array(strip) for strip in strips])
    assert len(places) > 8
    assert places[:, 0].min() >= frame.x0 - 1e-3
    assert places[:, 0].max() <= frame.x1 + 1e-3
    assert places[:, 1].min() >= frame.y0 - 1e-3
    assert places[:, 1].max() <= frame.y1 + 1e-3


def test_in_plots_the_line_of_the_best_path_is_the_widest(five: Run, five_read: Contents) -> None:
    assert five.best is not None
    names = ["recorded", *(method.name for method in five.methods if method.status == "improved")]
    widths = {}
    for name in names:
        ((width,),) = five_read.rows(f"/signals/steering_deg/{name}", "SeriesLines:widths")
        widths[name] = width
    assert max(widths, key=lambda name: widths[name]) == five.best.name
    assert sorted(widths.values())[-2] < widths[five.best.name]
