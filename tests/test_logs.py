"""From log files to cases: what is understood, and what is reported about it."""

from collections.abc import Callable

import logs_maker as make
import numpy as np
import pytest
from shapely import Polygon, union_all

from optim.model.vehicle import Vehicle
from replay.base.errors import LogError
from replay.logs.meaning.noisy_motion import heading_from_motion
from replay.logs.meaning.pairing import hitch_misfit, trailer_at_poses
from replay.logs.meaning.recorded_poses import recorded_poses
from replay.logs.messages.types import Header, PoseSeries
from replay.run.case import Case

Read = Callable[..., list[Case]]
TRUCK, AXLE = make.drive()


# ---- what is understood


def test_a_log_with_both_paths_becomes_a_case_with_the_hitch_angles_of_the_trailer(read: Read) -> None:
    (case,) = read(make.sound_log())
    recorded = case.problem.recorded
    assert (case.name, case.frame, case.read.poses, case.read.hitch) == ("yard/0", "map", len(TRUCK), "trailer path")
    assert recorded.num_cusps == 1
    assert recorded.length == pytest.approx(26.0, abs=1e-3)
    np.testing.assert_allclose(recorded.start, [*TRUCK[0], 0.0], atol=1e-6)
    np.testing.assert_allclose(recorded.goal, [*TRUCK[-1], AXLE[-1, 2] - TRUCK[-1, 2]], atol=1e-4)
    assert case.read.max_deviation_m < 1e-4
    assert not case.read.notes
    assert not case.read.lost
    assert case.map is not None
    assert case.map.resolution == 0.2  # float32 on the wire


def test_without_a_trailer_the_hitch_angle_is_integrated_from_the_initial_one(read: Read) -> None:
    (case,) = read(make.sound_log(trailer=False))
    assert case.read.hitch == "reconstructed"
    assert case.problem.recorded.goal[3] == pytest.approx(AXLE[-1, 2] - TRUCK[-1, 2], abs=1e-4)
    (bent,) = read(make.sound_log(trailer=False), initial_hitch=0.3)
    assert bent.problem.recorded.start[3] == pytest.approx(0.3)


@pytest.mark.parametrize(("first", "second"), [("/a", "/b"), ("/b", "/a")])
def test_the_trailer_is_the_path_that_follows_on_the_hitch_whatever_the_topics_are_called(
    read: Read, first: str, second: str
) -> None:
    maker = make.LogMaker().vehicle().add("/map", make.grid(make.yard()))
    maker.add(first, make.path(TRUCK), 1).add(second, make.path(AXLE), 1)
    (case,) = read(maker)
    np.testing.assert_allclose(case.problem.recorded.start[:3], TRUCK[0], atol=1e-9)
    assert case.read.hitch == "trailer path"


def test_trailer_poses_are_paired_by_stamp_where_stamps_differ(read: Read) -> None:
    times = (np.arange(len(TRUCK)) * 2e8).astype(int)
    every_third = np.unique([*range(0, len(TRUCK), 3), len(TRUCK) - 1])
    axle = make.path(AXLE[every_third], stamps=times[every_third].tolist())
    (case,) = read(make.log_of(make.path(TRUCK, stamps=times.tolist()), axle))
    assert case.read.hitch == "trailer path"
    assert case.read.max_deviation_m < 0.05


def test_a_trailer_path_that_ends_early_is_refused(refusal: Callable[..., LogError]) -> None:
    times = (np.arange(len(TRUCK)) * 2e8).astype(int)
    axle = make.path(AXLE[:40], stamps=times[:40].tolist())
    maker = make.log_of(make.path(TRUCK, stamps=times.tolist()), axle)
    error = refusal(maker, path_topic="/truck", trailer_topic="/trailer")
    assert error.code == "E_PATH_PAIR"
    assert "41 of 105 truck poses; pose 41 has none" in str(error)


def test_without_stamps_unequal_counts_are_arranged_along_both_paths() -> None:
    fine, axle = make.drive(step=0.05)
    coarse = np.unique([*range(0, len(axle), 7), len(axle) - 1])
    series = PoseSeries(header=Header(0, ""), stamps=np.zeros(9, np.int64), poses=np.zeros((9, 7)), frames=frozenset())
    found = trailer_at_poses(fine, series, axle[coarse], series, Vehicle())
    assert np.median(hitch_misfit(fine, found, Vehicle())) < 0.03
    assert np.abs(found - axle).max() < 0.1


def test_each_path_message_is_a_request_on_the_map_of_its_time(read: Read) -> None:
    changed = make.yard()
    changed[10:15, 10:15] = 100
    other = make.shifted(TRUCK, 0.0, 1.0)
    maker = make.LogMaker().vehicle()
    maker.add("/truck", make.path(TRUCK), 1).add("/map", make.grid(make.yard()), 2).add("/truck", make.path(other), 3)
    maker.add("/map", make.grid(changed), 4).add("/truck", make.path(TRUCK), 5).add("/truck", make.path(TRUCK), 6)
    cases = read(maker)
    assert [case.name for case in cases] == ["yard/0", "yard/1", "yard/2"]
    assert [len(case.problem.scene.polygons) for case in cases] == [8, 8, 9]
    assert "the map was logged after the path" in cases[0].read.notes
    assert any("repeat an earlier one" in note for note in cases[0].read.notes)
    np.testing.assert_allclose(cases[1].problem.recorded.start[:3], other[0], atol=1e-9)


def test_a_request_that_cannot_be_used_does_not_take_the_others_with_it(read: Read) -> None:
    maker = make.sound_log(trailer=False).add("/truck", make.path(make.shifted(TRUCK, 0.0, -16.0)), 3)
    (case,) = read(maker)
    assert case.read.lost
    assert any("E_START" in note or "overlaps obstacle" in note for note in case.read.notes)


def test_planner_nodes_are_found_again_after_poses_have_been_merged(read: Read) -> None:
    doubled = np.repeat(TRUCK, 2, axis=0)
    (case,) = read(make.log_of(doubled).nodes("[0, 20, 21, 160, 209]"))
    assert case.problem.nodes is not None
    np.testing.assert_allclose(case.problem.nodes, [0.0, 2.5, 20.0, 26.0], atol=1e-3)
    assert any("105 of 210 poses repeat" in note for note in case.read.notes)


def test_dense_poses_are_thinned_and_ends_and_cusps_stay(read: Read) -> None:
    dense, _ = make.drive(step=0.01)
    (case,) = read(make.log_of(dense))
    assert case.read.poses == len(dense)
    assert case.problem.recorded.num_cusps == 1
    assert case.problem.recorded.length == pytest.approx(26.0, abs=1e-3)
    assert case.read.max_deviation_m < 1e-3


def test_a_map_with_a_turned_origin_lies_where_its_cells_are(read: Read) -> None:
    cells = make.yard(40.0, 60.0)
    cells[50:55, 20:30] = 100
    (case,) = read(make.log_of(TRUCK, cells=cells, origin=(60.0, 0.0, np.pi / 2.0)), unknown="free")
    shape = union_all([Polygon(p) for p in case.problem.scene.polygons])
    for row in range(0, 300, 7):
        for column in range(0, 200, 7):
            x, y = (column + 0.5) * 0.2, (row + 0.5) * 0.2
            point = Polygon([(60.0 - y + dx, x + dy) for dx, dy in ((-0.05, -0.05), (0.05, -0.05), (0.0, 0.05))])
            if cells[row, column] == 100:
                assert shape.contains(point)
    assert case.problem.scene.boundary is None
    (walled,) = read(make.log_of(TRUCK, cells=cells, origin=(60.0, 0.0, np.pi / 2.0)))
    assert walled.problem.scene.boundary is not None
    assert Polygon(walled.problem.scene.boundary).bounds == pytest.approx((0.0, 0.0, 60.0, 40.0))


def test_unknown_cells_are_obstacles_unless_the_option_says_free(read: Read, refusal: Callable[..., LogError]) -> None:
    cells = make.yard()
    cells[80:100, 100:130] = -1
    error = refusal(make.log_of(TRUCK, cells=cells))
    assert error.code == "E_MAP_UNKNOWN"
    assert "--unknown free" in str(error)
    assert len(read(make.log_of(TRUCK, cells=cells), unknown="free")) == 1
    aside = make.yard()
    aside[10:20, 10:20] = -1
    assert len(read(make.log_of(TRUCK, cells=aside))[0].problem.scene.polygons) == 9
    assert len(read(make.log_of(TRUCK, cells=aside), unknown="free")[0].problem.scene.polygons) == 4


def test_the_threshold_decides_which_cells_are_obstacles(read: Read) -> None:
    cells = make.yard()
    cells[10:20, 10:20] = 50
    assert len(read(make.log_of(TRUCK, cells=cells))[0].problem.scene.polygons) == 8
    assert len(read(make.log_of(TRUCK, cells=cells), occupied_from=50)[0].problem.scene.polygons) == 9


def test_headings_that_are_missing_are_taken_from_the_motion(read: Read) -> None:
    flat = TRUCK.copy()
    flat[:, 2] = 0.0
    (case,) = read(make.log_of(flat))
    assert any("--start-direction" in note for note in case.read.notes)
    assert case.problem.recorded.num_cusps == 1
    assert [segment.direction for segment in case.problem.recorded.segments] == [1, -1]
    assert case.problem.recorded.start[2] == pytest.approx(TRUCK[0, 2], abs=0.02)
    (backward,) = read(make.log_of(flat), start_direction=-1, unknown="free")
    assert [segment.direction for segment in backward.problem.recorded.segments] == [-1, 1]


def test_headings_from_motion_are_exact_on_a_circle() -> None:
    angle = np.concatenate([np.linspace(0.0, 1.0, 20), np.linspace(0.97, 0.5, 12)])
    points = 10.0 * np.stack([np.sin(angle), 1.0 - np.cos(angle)], axis=1)
    np.testing.assert_allclose(heading_from_motion(points, 1), angle, atol=1e-6)
    np.testing.assert_allclose(heading_from_motion(points[:20], -1), angle[:20] + np.pi, atol=1e-9)


def test_a_change_of_gear_within_centimetres_is_noise() -> None:
    x = np.array([0.0, 0.5, 1.0, 0.99, 1.5, 2.0, 1.5, 1.0])
    found = recorded_poses(np.stack([x, np.zeros(8), np.zeros(8)], axis=1), 1)
    assert found.direction.tolist() == [1, 1, 1, 1, -1, -1]
    assert any("taken for noise" in note for note in found.notes)


def test_noise_in_the_poses_is_reported_by_its_size(read: Read) -> None:
    noisy = TRUCK + np.random.default_rng(1).normal(scale=[0.02, 0.02, 0.004], size=TRUCK.shape)
    (case,) = read(make.log_of(noisy))
    assert 0.01 < case.read.max_deviation_m < 0.2
    np.testing.assert_allclose(case.problem.recorded.goal[:3], noisy[-1], atol=1e-9)


# ---- damaged logs


def test_a_log_that_is_cut_off_after_map_and_path_is_read_and_said_to_be_incomplete(read: Read) -> None:
    data = make.sound_log(trailer=False, chunk_size=100).bytes()
    (whole,) = read(data)
    cut = data.index(b"vehicle") - 30  # in the metadata, after the chunks
    (case,) = read(data[:cut])
    assert case.read.lost
    assert not whole.read.lost
    assert any("cut off" in note for note in case.read.notes)
    np.testing.assert_array_equal(case.problem.recorded.samples.states, whole.problem.recorded.samples.states)


def test_a_log_that_is_cut_off_before_the_path_says_so(refusal: Callable[..., LogError]) -> None:
    data = make.sound_log(trailer=False, chunk_size=100).bytes()
    error = refusal(data[: len(data) // 2])
    assert error.code == "E_NO_PATH"
    assert "cut off" in str(error)


def test_damaged_payloads_name_topic_message_and_field(refusal: Callable[..., LogError]) -> None:
    sound = make.sound_log(trailer=False)
    name, kind, _, _, definition, data, time = sound.messages.pop()
    error = refusal(sound.add_raw(name, kind, data[:500], time, definition=definition))
    assert error.code == "E_PAYLOAD"
    assert "path topic '/truck', message 0: poses claims 105 elements" in str(error)
