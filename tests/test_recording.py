"""What a recording shows: paths, vehicles, signals, iterates, words; read back from the file."""

import pathlib
from typing import Any

import numpy as np
import pytest
import recording_factory as factory
from recording_reading import Contents, written

from optim.model.path import Path
from optim.model.result import Stop
from optim.model.scene import make_scene
from replay.recording import picture, text
from replay.recording.local import moved
from replay.recording.tracks import PROGRESS, chosen_rows, progress
from replay.run.outcome import Run


def test_a_recording_has_its_three_timelines_and_its_blueprint(one_read: Contents) -> None:
    assert one_read.timelines == {"progress", "arc_cm", "iteration"}
    assert len(one_read.recordings) == 1
    assert one_read.recordings[0].application_id == "replay"
    assert len(one_read.blueprints) == 1


def test_truck_and_trailer_stand_where_the_path_says(one: Run, one_read: Contents) -> None:
    path, vehicle = one.methods[0].path, one.case.problem.vehicle
    for body, turn in (("truck", 0.0), ("trailer", 1.0)):
        entity = f"/scene/shortcut/vehicle/{body}"
        places = np.array(one_read.rows(entity, "Transform3D:translation", "arc_cm"))[:, 0]
        turns = np.array(one_read.rows(entity, "Transform3D:quaternion", "arc_cm"))[:, 0]
        arc = np.array(one_read.times(entity, "arc_cm")) / 100.0
        samples = path.samples
        heading = samples.states[:, 2] + turn * samples.states[:, 3]
        assert len(arc) > 0.8 * path.length / 0.25
        assert arc[-1] == pytest.approx(path.length, abs=0.006)
        for k in (0, len(arc) // 3, len(arc) // 2, -1):
            nearest = int(np.argmin(np.abs(samples.states[:, 0] - places[k, 0]) + np.abs(samples.s - arc[k])))
            np.testing.assert_allclose(places[k, :2], samples.states[nearest, :2], atol=1e-5)
            yaw = 2.0 * np.arctan2(turns[k, 2], turns[k, 3])
            assert np.cos(yaw - heading[nearest]) == pytest.approx(1.0, abs=1e-9)
    assert vehicle.hitch_offset == 0.0


def test_the_outlines_that_the_transforms_move_are_the_vehicles(one: Run, one_read: Contents) -> None:
    (strips,) = one_read.rows("/scene/shortcut/vehicle/trailer", "LineStrips2D:strips")
    np.testing.assert_allclose(np.array(strips[0])[:4], one.case.problem.vehicle.outlines[1], atol=1e-5)


def test_signals_are_those_of_the_path(one: Run, one_read: Contents) -> None:
    samples = one.methods[0].path.samples
    for name, values in {
        "steering_deg": np.degrees(samples.phi),
        "hitch_deg": np.degrees(samples.states[:, 3]),
        "curvature_per_m": -np.tan(samples.states[:, 3]) / one.case.problem.vehicle.hitch_to_axle,
    }.items():
        shown = np.array(one_read.rows(f"/signals/{name}/shortcut", "Scalars:scalars", "progress"))[:, 0]
        rows = chosen_rows(samples, 0)
        assert shown[[0, -1]] == pytest.approx(values[[0, -1]])
        assert np.abs(shown).max() == pytest.approx(np.abs(values[rows]).max(), rel=0.02, abs=1e-6)
    clearance = np.array(one_read.rows("/signals/clearance_m/shortcut", "Scalars:scalars", "progress"))
    assert clearance.min() == pytest.approx(one.methods[0].metrics.min_clearance, abs=0.01)


def test_limits_are_drawn_from_end_to_end(one: Run, one_read: Contents) -> None:
    limit = np.degrees(one.case.problem.vehicle.max_steer)
    rows = one_read.rows("/signals/steering_deg/limit", "Scalars:scalars", "progress")
    assert rows == [pytest.approx([-limit, limit])] * 2
    assert one_read.times("/signals/steering_deg/limit", "progress") == [0, PROGRESS]


def test_paths_with_as_many_gear_changes_shift_together() -> None:
    recorded, other = factory.manoeuvre(15.0, 0.30), factory.manoeuvre(8.0, 0.34)
    at_cusp = [progress(path, recorded)[path.segments[0].num_samples] for path in (recorded, other)]
    assert at_cusp[0] == at_cusp[1]
    assert 0 < at_cusp[0] < PROGRESS


@pytest.mark.parametrize(
    "path", [factory.manoeuvre(15.0, 0.30), factory.with_retrace(factory.manoeuvre(15.0, 0.30), 300)]
)
def test_progress_runs_from_0_to_1000_and_never_back(path: Path) -> None:
    values = progress(path, factory.manoeuvre(8.0, 0.34))
    assert values[0] == 0
    assert values[-1] == PROGRESS
    assert (np.diff(values) >= 0).all()


def test_a_line_shows_the_distance_only_where_an_obstacle_is_near(one: Run, one_read: Contents) -> None:
    entity = "/scene/shortcut/whisker"
    distance = np.concatenate(one_read.rows("/signals/clearance_m/shortcut", "Scalars:scalars", "progress"))
    strips = one_read.rows(entity, "LineStrips2D:strips", "progress")
    labels = one_read.rows(entity, "LineStrips2D:labels", "progress")
    assert 0 < sum(map(len, strips)) < len(strips)
    for value, strip, label in zip(distance, strips, labels, strict=True):
        assert len(strip) == (value < 3.0)
        if strip:
            assert np.hypot(*(np.array(strip[0][0]) - strip[0][1])) == pytest.approx(value, abs=1e-4)
            assert label == [f"{value:.2f} m"]


def test_every_iterate_is_played_back_on_both_timelines(one: Run, one_read: Contents) -> None:
    entity, iterates = "/scene/shortcut/iterate", one.methods[0].iterates
    assert [iterate.iteration for iterate in iterates] == list(range(0, 3 * len(iterates), 3)), "as of tries"
    assert one_read.times(entity, "iteration") == list(range(len(iterates))), "one step is one iterate"
    assert one_read.times(entity, "progress")[0] == 0
    assert one_read.times(entity, "progress")[-1] == PROGRESS
    last = np.array(one_read.rows(entity, "LineStrips2D:strips")[len(iterates) - 1][0])
    np.testing.assert_allclose(last[[0, -1]], [iterates[-1].path.start[:2], iterates[-1].path.goal[:2]], atol=1e-5)
    values = np.concatenate(one_read.rows("/solver/objective/shortcut", "Scalars:scalars", "iteration"))
    np.testing.assert_allclose(values, [iterate.objective for iterate in iterates])


def test_gears_change_where_the_path_does(one: Run, one_read: Contents) -> None:
    gears = ["forward" if segment.direction > 0 else "reverse" for segment in one.case.problem.recorded.segments]
    assert [row[0] for row in one_read.rows("/gear/recorded", "StateChange:state", "arc_cm")] == gears
    starts = np.cumsum([0.0, *(segment.length for segment in one.case.problem.recorded.segments)])[:-1]
    np.testing.assert_allclose(one_read.times("/gear/recorded", "arc_cm"), 100.0 * starts, atol=0.51)


def test_reverse_segments_are_dashed_and_forward_ones_are_not() -> None:
    path = factory.manoeuvre(8.0, 0.34)
    forward, reverse = picture.strips(path.segments, dash=1.0)
    assert len(forward) == 1
    assert len(reverse) == int(np.ceil(path.segments[1].length / 1.6))
    drawn = sum(float(np.hypot(*np.diff(strip, axis=0).T).sum()) for strip in reverse)
    assert drawn == pytest.approx(path.segments[1].length / 1.6, rel=0.05)


def test_the_summary_begins_with_the_verdict(one: Run, one_read: Contents) -> None:
    lines = one_read.text("/report/summary").splitlines()
    before, after = one.recorded_metrics, one.methods[0].metrics
    assert lines[0].startswith("# ✓ Shortcut improved the path: J −")
    assert f"J {before.objective:.1f} → {after.objective:.1f}" in lines[2]
    assert f"{before.length:.1f} → {after.length:.1f} m, 3 → 1 gear change" in lines[2]
    assert lines[4] == f"**✓ Safe: audit passed, clearance {after.min_clearance:.2f} m (required: 0.10 m)**"


def test_kept_and_rejected_methods_say_so_with_their_reasons(five_read: Contents) -> None:
    summary = five_read.text("/report/summary")
    assert "**SCP** kept the recorded path (stalled, 0 iterations)" in summary
    assert "The trust region shrank to nothing." in summary
    assert "✗ rejected" in summary
    legend = five_read.rows("/scene/legend/paths", "LineStrips2D:labels")[0]
    assert [label.partition(":")[0] for label in legend] == ["Recorded", "Shortcut", "CPO", "DDP", "NLP", "SCP"]
    assert legend[-2:] == ["NLP: rejected", "SCP: kept"]


def test_a_rejected_path_is_drawn_with_a_mark_where_its_audit_failed(five: Run, five_read: Contents) -> None:
    rejected = five.methods[3]
    assert rejected.rejected is not None
    assert rejected.rejected_path is not None
    place = rejected.rejected.clearance.place
    assert place is not None
    segment = rejected.rejected_path.segments[place.segment]
    (points,) = five_read.rows("/scene/nlp/rejected/audit", "Points2D:positions")
    (labels,) = five_read.rows("/scene/nlp/rejected/audit", "Points2D:labels")
    x, y = np.interp(place.s, segment.s, segment.x), np.interp(place.s, segment.s, segment.y)
    assert np.hypot(points[0][0] - x, points[0][1] - y) < 0.1
    assert labels == ["✗ clearance: −0.854 m"]
    assert five_read.rows("/scene/nlp/rejected/path", "LineStrips2D:strips")


def test_properties_hold_what_a_table_of_recordings_sorts_by(one: Run, one_read: Contents) -> None:
    def value(name: str) -> Any:
        return one_read.rows("/__properties/replay", name)[0][0]

    assert value("best_method") == "shortcut"
    assert value("status") == "improved"
    assert value("objective_before") == pytest.approx(one.recorded_metrics.objective)
    assert value("objective_after") == pytest.approx(one.methods[0].metrics.objective)
    assert (value("cusps_before"), value("cusps_after")) == (3, 1)
    assert value("log_sha256") == one.case.sha256
    assert value("tool_version")


def test_vehicle_and_options_are_shown_in_peoples_units(one_read: Contents) -> None:
    sheet = one_read.text("/report/vehicle")
    assert "| Wheelbase | 3.60 m |" in sheet
    assert "| Largest steering angle | 31.5° |" in sheet
    assert "| shortcut.attempts | 200 |" in one_read.text("/report/run")


def test_every_method_has_all_its_entities(five: Run, five_read: Contents) -> None:
    for name in ("recorded", "shortcut", "cpo", "ddp"):
        for part in ("path", "cusps", "swept/outline", "swept/filling", "vehicle/truck", "vehicle/trailer", "whisker"):
            assert f"/scene/{name}/{part}" in five_read.tables
    assert "/scene/scp/path" not in five_read.tables  # it is the recorded one


def test_five_methods_take_less_than_five_megabytes(five_file: pathlib.Path) -> None:
    assert five_file.stat().st_size < 5e6


def test_the_map_is_drawn_from_the_grid_with_its_bottom_row_first(five: Run, five_read: Contents) -> None:
    (buffer,), (form,) = five_read.rows("/scene/map", "Image:buffer"), five_read.rows("/scene/map", "Image:format")
    pixels = np.frombuffer(bytes(buffer[0]), np.uint8).reshape(form[0]["height"], form[0]["width"])
    grid = five.case.map
    assert grid is not None
    (translation,) = five_read.rows("/scene/map", "Transform3D:translation")
    column, row = (np.array(translation[0][:2]) - grid.origin[:2]) / grid.resolution
    part = grid.cells[round(row) :, round(column) :][: pixels.shape[0], : pixels.shape[1]]
    assert pixels.shape == part.shape
    for kind in (part < 0, part == 0, part == 100):
        assert len(np.unique(pixels[kind])) == 1


@pytest.mark.parametrize("count", [0, 6])
def test_any_number_of_methods_is_recorded(count: int, tmp_path: pathlib.Path) -> None:
    names = ["shortcut", "cpo", "ddp", "nlp", "scp", "another"][:count]
    path = factory.manoeuvre(8.0, 0.34)
    contents = Contents(written(factory.make_run({name: factory.Prepared(path) for name in names}), tmp_path))
    assert all(f"/scene/{name}/vehicle/truck" in contents.tables for name in ["recorded", *names])


def test_a_scene_without_obstacles_is_recorded_without_clearance(tmp_path: pathlib.Path) -> None:
    contents = Contents(written(factory.make_run(scene=make_scene([])), tmp_path))
    assert not any("clearance" in entity or "whisker" in entity for entity in contents.tables)
    assert "no obstacles" in contents.text("/report/summary")


def test_a_run_in_which_nothing_improved_says_so_first(tmp_path: pathlib.Path) -> None:
    contents = Contents(written(factory.make_run({"shortcut": factory.Prepared()}), tmp_path))
    assert contents.text("/report/summary").startswith("# ✗ Not improved: the recorded path stands")
    assert contents.rows("/__properties/replay", "best_method") == [["none"]]


def test_strange_names_and_reasons_reach_no_markup_and_no_missing_glyph(tmp_path: pathlib.Path) -> None:
    strange = "a b/c|*d*_漢😀\n# e"
    failed = factory.Prepared(stop=Stop.FAILED, reason=f"Because | of `{strange}`")
    run = factory.make_run({strange: failed, "β": factory.Prepared(factory.manoeuvre(8.0, 0.34))}, name=strange)
    contents = Contents(written(run, tmp_path))
    assert all(text.is_safe(character) for string in contents.strings() for character in string)
    assert "/scene/β/vehicle/truck" in contents.tables
    table = [line for line in contents.text("/report/summary").splitlines() if line.startswith("| ")]
    assert len({line.replace("\\|", "").count("|") for line in table}) == 1


def test_all_text_can_be_drawn(five_read: Contents) -> None:
    assert all(text.is_safe(character) for string in five_read.strings() for character in string)


def test_far_coordinates_are_shown_relative_to_a_round_offset(tmp_path: pathlib.Path) -> None:
    offset = np.array([512_345.0, 5_412_345.0])
    near = factory.recorded_path()
    far = moved(near, -offset)
    scene = make_scene([factory.box(20.0, 10.0, 3.0, 2.0) + offset])
    run = factory.make_run({"shortcut": factory.Prepared(reason="No.")}, scene=scene, recorded=far)
    contents = Contents(written(run, tmp_path))
    places = np.array(contents.rows("/scene/recorded/vehicle/truck", "Transform3D:translation", "progress"))[:, 0, :2]
    assert np.abs(places).max() < 200.0
    np.testing.assert_allclose(np.ptp(places, axis=0), np.ptp(near.samples.states[:, :2], axis=0), atol=0.1)
    assert "(512300, 5412400) m" in contents.text("/report/run")
