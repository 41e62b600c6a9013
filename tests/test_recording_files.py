"""Recordings as files, whole or not there; colours, shapes and texts that they are made of."""

import pathlib
import resource
import subprocess
import sys

import numpy as np
import pytest
import recording_factory as factory
import rerun as rr
import shapely
from hypothesis import given, settings
from hypothesis import strategies as st
from recording_reading import Contents, names_in_blueprint, written

from optim.audit.data import Place
from optim.audit.report import Check
from optim.model.path import Path
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle, body_corners
from replay.base.errors import ReplayError
from replay.base.style import ALARM, RECORDED, styles
from replay.recording import picture, text, write_recording
from replay.recording.tracks import chosen_rows, tracks_of
from replay.recording.writing import Unwritable, recording_id, verify
from replay.run.outcome import Run


def test_the_same_results_have_the_same_identity_and_others_have_another(one: Run, five: Run) -> None:
    assert recording_id(one) == recording_id(factory.make_run())
    assert recording_id(one) != recording_id(five)


def test_rerun_is_left_as_it_was(one: Run, tmp_path: pathlib.Path) -> None:
    assert not rr.strict_mode()
    written(one, tmp_path)
    assert not rr.strict_mode()
    assert rr.get_global_data_recording() is None


def test_writing_over_a_recording_replaces_it_as_a_whole(one: Run, tmp_path: pathlib.Path) -> None:
    path = tmp_path / "run.rrd"
    path.write_bytes(b"older")
    write_recording(one, path)
    assert len(Contents(path).recordings) == 1
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.rrd"]


def test_a_missing_directory_is_one_line_for_the_user(one: Run, tmp_path: pathlib.Path) -> None:
    with pytest.raises(ReplayError, match=r"nowhere.run\.rrd: cannot be written"):
        write_recording(one, tmp_path / "nowhere" / "run.rrd")
    assert list(tmp_path.iterdir()) == []


@pytest.mark.parametrize("limit", [1_000, 100_000, 400_000])
def test_a_full_disk_leaves_the_older_recording_and_nothing_else(one: Run, tmp_path: pathlib.Path, limit: int) -> None:
    path = tmp_path / "run.rrd"
    path.write_bytes(b"older")
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (limit, before[1]))
    try:
        with pytest.raises(ReplayError, match=r"run\.rrd: cannot be written"):
            write_recording(one, path)
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)
    assert path.read_bytes() == b"older"
    assert [entry.name for entry in tmp_path.iterdir()] == ["run.rrd"]
    assert not rr.strict_mode()


@pytest.mark.parametrize("share", [0.0, 0.3, 0.7, 0.99])
def test_a_cut_file_is_not_taken_for_a_recording(
    share: float, one: Run, one_file: pathlib.Path, tmp_path: pathlib.Path
) -> None:
    tracks = tracks_of(one)
    verify(one_file, tracks)
    cut = tmp_path / "cut.rrd"
    whole = one_file.read_bytes()
    cut.write_bytes(whole[: int(share * len(whole))])
    with pytest.raises(Unwritable):
        verify(cut, tracks)


def test_a_recording_of_other_paths_is_not_taken_for_this_one(five: Run, one_file: pathlib.Path) -> None:
    with pytest.raises(Unwritable, match="has 0 rows, expected"):
        verify(one_file, tracks_of(five))


def test_importing_the_package_does_not_load_rerun() -> None:
    code = "import sys, replay.recording; sys.exit('rerun' in sys.modules)"
    assert subprocess.run([sys.executable, "-c", code], check=False).returncode == 0


def test_methods_keep_their_colours_whatever_else_ran() -> None:
    everything = styles(["shortcut", "cpo", "ddp", "nlp", "scp", "x", "y"])
    assert len({style.colour for style in everything.values()} | {RECORDED.colour}) == 8
    assert styles(["scp"])["scp"] == everything["scp"]


def test_a_chain_has_a_colour_of_its_own_that_its_name_decides() -> None:
    chains = [f"{a}+{b}" for a in ("shortcut", "cpo", "ddp") for b in ("nlp", "scp")]
    fixed = styles(["shortcut", "cpo", "ddp", "nlp", "scp"])
    for name in chains:
        (alone,) = styles([name]).values()
        assert styles([*fixed, name])[name] == alone
        assert alone.colour not in {style.colour for style in fixed.values()} | {RECORDED.colour, ALARM}
    assert len({style.colour for style in styles(chains).values()}) == len(chains)
    assert styles(["shortcut+scp"])["shortcut+scp"].label == "Shortcut + SCP"


def _lightness_and_hue(colour: tuple[int, int, int]) -> np.ndarray:
    """CIE L*a*b* of an sRGB colour under D65."""
    share = np.array(colour) / 255.0
    linear = np.where(share > 0.04045, ((share + 0.055) / 1.055) ** 2.4, share / 12.92)
    primaries = np.array([[0.4124, 0.3576, 0.1805], [0.2126, 0.7152, 0.0722], [0.0193, 0.1192, 0.9505]])
    x, y, z = np.cbrt(primaries @ linear / [0.9505, 1.0, 1.089])
    return np.array([116.0 * y - 16.0, 500.0 * (x - y), 200.0 * (y - z)])


def test_all_colours_can_be_told_apart() -> None:
    names = ["shortcut", "cpo", "ddp", "nlp", "scp", *(f"other {k}" for k in range(6))]
    colours = [RECORDED.colour, ALARM, *(style.colour for style in styles(names).values())]
    places = [_lightness_and_hue(colour) for colour in colours]
    apart = [np.linalg.norm(a - b) for k, a in enumerate(places) for b in places[:k]]
    assert min(apart) > 25.0


@settings(max_examples=25, deadline=None)
@given(seed=st.integers(0, 10_000), resolution=st.sampled_from([0.05, 0.11, 0.3]))
def test_filling_marks_exactly_the_cells_whose_centres_are_inside(seed: int, resolution: float) -> None:
    rng = np.random.default_rng(seed)
    shape = shapely.union_all(shapely.buffer(shapely.points(rng.uniform(0, 6, (4, 2))), 1.0, quad_segs=2))
    shape = shapely.difference(shape, shapely.box(2.03, 2.03, 3.07, 3.07))
    frame = picture.Frame(1.0, 0.5, 5.5, 6.0)
    marked = picture.fill(shape, frame, resolution)
    y, x = np.mgrid[0 : marked.shape[0], 0 : marked.shape[1]]
    x, y = frame.x0 + (x + 0.5) * resolution, frame.y0 + (y + 0.5) * resolution
    clear = shapely.distance(shapely.boundary(shape), shapely.points(x, y)) > 1e-9
    assert (marked == shapely.contains_xy(shape, x, y))[clear].all()


@pytest.mark.parametrize("path", [factory.manoeuvre(8.0, 0.34), factory.recorded_path()])
def test_the_swept_area_covers_every_footprint(path: Path) -> None:
    area = shapely.buffer(picture.swept_area(factory.VEHICLE, path), 0.02)
    corners = body_corners(Vehicle(), path.samples.states).reshape(-1, 4, 2)
    assert shapely.contains(area, shapely.polygons(corners)).all()


def test_the_frame_shows_the_manoeuvre_and_not_a_whole_town() -> None:
    area = picture.swept_area(factory.VEHICLE, factory.manoeuvre(8.0, 0.34))
    for scene in (make_scene([]), factory.yard(), make_scene([factory.box(900.0, -700.0, 5.0, 5.0)])):
        frame = picture.frame_around(scene, [area])
        assert shapely.contains(frame.box, area)
        assert frame.size < 160.0
        assert 0.85 < frame.width / frame.height < 2.6


def test_rows_keep_both_sides_of_every_cusp() -> None:
    samples = factory.recorded_path().samples
    rows = chosen_rows(samples, extra=17)
    after = np.flatnonzero(np.diff(samples.segment)) + 1
    assert set(after) | set(after - 1) | {0, 17, len(samples.s) - 1} <= set(rows.tolist())
    assert np.diff(samples.s[rows]).max() < 0.3


@pytest.mark.parametrize(
    ("value", "digits", "expected"),
    [(-0.5, 2, "−0.50"), (-0.001, 2, "0.00"), (None, 1, "–"), (float("inf"), 1, "–"), (12.34, 1, "12.3")],
)
def test_numbers_are_written_as_people_read_them(value: float | None, digits: int, expected: str) -> None:
    assert text.number(value, digits) == expected


@pytest.mark.parametrize(
    ("before", "after", "expected"),
    [(100, 80, "−20 %"), (100, 130, "+30 %"), (100, 99.6, "−0.4 %"), (0, 1, "–"), (3, 3, "±0 %"), (1e-320, 1, "–")],
)
def test_changes_are_signed_percentages(before: float, after: float, expected: str) -> None:
    assert text.change(before, after) == expected


@given(st.text())
def test_any_text_becomes_one_harmless_table_cell(raw: str) -> None:
    shown = text.cell(raw)
    assert "\n" not in shown
    assert all(text.is_safe(character) for character in shown)
    assert "|" not in shown.replace("\\|", "")


def test_an_audits_value_is_shown_in_degrees_or_metres() -> None:
    steer = Check(passed=True, sentence="", values={"steer_rad": 0.34}, limits={"steer_rad": 0.55})
    clearance = Check(
        passed=False,
        sentence="",
        values={"truck_m": 1.15, "trailer_m": -0.123},
        limits={"truck_m": 0.0, "trailer_m": 0.0},
        place=Place(segment=0, s=0.0, body="trailer"),
    )
    assert text.measured(steer) == "19.5°"
    assert text.measured(clearance) == "−0.123 m"
    assert text.measured(Check(passed=True, sentence="", values={}, limits={})) == ""


def test_the_blueprint_names_every_tab(one_file: pathlib.Path) -> None:
    assert {"Overview", "Side by side", "Signals", "Convergence"} <= names_in_blueprint(one_file)


def test_there_is_no_plot_without_data(one_file: pathlib.Path, tmp_path: pathlib.Path) -> None:
    over_iterations = {"Largest residual, log10", "Constraint violation, log10", "Trust region / first, log10"}
    over_iterations |= {"Time in the solver [ms]", "Residuals"}
    assert "Objective J [-]" in names_in_blueprint(one_file)
    assert not over_iterations & names_in_blueprint(one_file)
    named = {"defect", "step"}
    path = factory.manoeuvre(8.0, 0.34)
    iterative = written(factory.make_run({"scp": factory.Iterative(path, [path] * 3)}), tmp_path)
    assert over_iterations | named <= names_in_blueprint(iterative)
    lone = written(factory.make_run({"scp": factory.Iterative(path, [path] * 3, names=("step",))}), tmp_path)
    assert "Residuals" not in names_in_blueprint(lone), "the largest one is the only one"


def test_a_chain_has_entities_without_an_escaped_plus(tmp_path: pathlib.Path) -> None:
    path = factory.manoeuvre(8.0, 0.34)
    contents = Contents(written(factory.make_run({"shortcut+scp": factory.Prepared(path)}), tmp_path))
    assert contents.rows("/gear/shortcut-scp", "StateChange:state", "progress")
    assert "Shortcut + SCP: J" in contents.rows("/scene/legend/paths", "LineStrips2D:labels")[0][1]


def test_the_summary_names_methods_that_are_as_good(tmp_path: pathlib.Path) -> None:
    path, worse = factory.manoeuvre(8.0, 0.34), factory.manoeuvre(9.0, 0.34)
    methods = {"ddp": factory.Prepared(path), "cpo": factory.Prepared(worse), "scp": factory.Prepared(path)}
    summary = Contents(written(factory.make_run(methods), tmp_path)).text("/report/summary")
    lines = summary.splitlines()
    best, other = ("DDP", "SCP") if "DDP" in lines[0] else ("SCP", "DDP")
    assert lines[0].startswith(f"# ✓ {best} improved the path")
    assert lines[6] == f"Equally good (within 0.1 %): {other}"
