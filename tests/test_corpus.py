"""The sample corpus: what is in the folder, that each log is a drivable request, and that logs can be made again."""

import hashlib
import io
import itertools
import math
from dataclasses import asdict
from pathlib import Path

import numpy as np
import pytest
from mcap.reader import make_reader
from mcap_ros2.decoder import DecoderFactory

from optim.audit.checks import audit_recorded
from optim.methods.ddp.method import Ddp
from optim.model.clearance import collides, first_violation
from optim.model.flat_map import state_from_flat
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle
from optim.planning.protocol import Area, PlanningProblem
from optim.planning.rrt import Found, Rrt, ramp_ends
from optim.steering.flat import Flat
from replay.base.errors import LogError
from replay.logs import read_cases
from replay.run.judge import run_case
from replay.run.plain import path_to_document, scene_to_document
from tools.corpus.build import PLANNERS
from tools.corpus.catalogue import Made, difference, full_names, make, make_log, read_list, write_list
from tools.corpus.grid import draw_grid
from tools.corpus.odd import odd_logs
from tools.corpus.read import sites
from tools.corpus.site import Box, Grid, Site, Wall, footprints
from tools.corpus.write import content_digest

FOLDER = Path(__file__).resolve().parent.parent / "recordings"
LISTED = read_list(FOLDER)
SITES, PUBLIC, ODD = sites("sample"), sites("public"), odd_logs()


def test_the_folder_holds_the_listed_logs_and_no_others() -> None:
    assert set(LISTED) == set(SITES) == {path.stem for path in FOLDER.glob("*.mcap")}
    for name, entry in LISTED.items():
        data = (FOLDER / f"{name}.mcap").read_bytes()
        assert hashlib.sha256(data).hexdigest() == entry["sha256"], f"{name}.mcap has been changed"
        assert len(data) <= 100_000


def test_the_corpus_has_a_bit_of_everything() -> None:
    entries = LISTED.values()
    assert len(entries) >= 12
    assert all(sum(e["class"] == kind for e in entries) >= 2 for kind in {e["class"] for e in entries})
    assert all(sum(e["map"] == kind for e in entries) >= 5 for kind in ("grid", "shapes"))
    assert {e["cusps"] for e in entries} >= {1, 2, 3, 5}
    assert all(40.0 <= e["length_m"] <= 150.0 and e["edges"] >= 4 for e in entries)
    for key in ("trailer_path", "path_nodes"):
        assert {e[key] for e in entries} == {True, False}
    assert {e["vehicle"] for e in entries} == {"default", "own"}


@pytest.mark.parametrize("name", SITES)
def test_a_log_reads_as_one_drivable_and_free_path_as_listed(name: str) -> None:
    (case,) = read_cases(FOLDER / f"{name}.mcap")
    problem, entry = case.problem, LISTED[name]
    scene, path = scene_to_document(problem.scene), path_to_document(problem.recorded)
    report = audit_recorded(asdict(problem.vehicle), scene, path)
    assert report.passed, report.failures
    assert problem.recorded_clearance >= problem.margin
    assert problem.recorded.num_cusps == entry["cusps"]
    assert problem.recorded.length == pytest.approx(entry["length_m"], abs=0.05)
    assert case.read.poses == entry["poses"]
    assert case.read.hitch == ("trailer path" if entry["trailer_path"] else "reconstructed")
    assert (None if problem.nodes is None else len(problem.nodes) - 1) == (
        entry["edges"] if entry["path_nodes"] else None
    )


@pytest.mark.parametrize("name", ["bay_01", "bay_02", "dock_02"])
def test_an_independent_reader_understands_the_messages(name: str) -> None:
    data = (FOLDER / f"{name}.mcap").read_bytes()
    reader = make_reader(io.BytesIO(data), validate_crcs=True, decoder_factories=[DecoderFactory()])
    assert reader.get_header().profile == "ros2"
    messages = {channel.topic: message for _, channel, _, message in reader.iter_decoded_messages()}
    assert len(messages["/plan"].poses) == LISTED[name]["poses"]
    assert {pose.header.frame_id for pose in messages["/plan"].poses} == {"map"}
    assert ("/plan/trailer" in messages) == LISTED[name]["trailer_path"]
    if LISTED[name]["map"] == "grid":
        info = messages["/map"].info
        assert len(messages["/map"].data) == info.width * info.height
    else:
        assert len(messages["/obstacles"].markers) == len(SITES[name].obstacles)


FULL_LISTED = read_list(FOLDER / "full")


def test_the_full_corpus_holds_the_listed_logs_and_no_others() -> None:
    assert set(FULL_LISTED) == set(full_names()) == {path.stem for path in (FOLDER / "full").glob("*.mcap")}
    for name, entry in FULL_LISTED.items():
        data = (FOLDER / "full" / f"{name}.mcap").read_bytes()
        assert hashlib.sha256(data).hexdigest() == entry["sha256"], f"{name}.mcap has been changed"
        assert len(data) <= 100_000


def test_the_full_corpus_has_classes_vehicles_and_kinds_of_map() -> None:
    entries = [*LISTED.values(), *FULL_LISTED.values()]
    assert len(entries) >= 60
    kinds = {"open", "constrained", "narrow", "cluttered", "reverse", "cusps"}
    assert all(sum(entry["class"] == kind for entry in entries) >= 9 for kind in kinds)
    assert {entry["vehicle"] for entry in FULL_LISTED.values()} >= {"default", "source", "tractor", "city"}
    assert all(entry["cusps"] >= 3 for entry in entries if entry["class"] == "cusps")
    assert {entry["map"] for entry in FULL_LISTED.values()} == {"grid", "shapes"}


def test_logs_of_public_scenes_name_source_and_licence_and_come_from_all_planners() -> None:
    entries = {name: FULL_LISTED[name] for name in PUBLIC}
    assert len(entries) >= 8
    for name, entry in entries.items():
        assert entry["source"].startswith("github.com/"), name
        assert entry["licence"] in ("MIT", "Apache-2.0", "BSD-2-Clause")
        assert entry["planner"] == PUBLIC[name].planner
    assert not any("source" in entry for name, entry in FULL_LISTED.items() if name not in PUBLIC)
    assert {entry.get("planner", "RRT") for entry in FULL_LISTED.values()} == {"RRT", *PLANNERS}


@pytest.mark.parametrize("name", ["public_03", "public_07", "narrow_03"])
def test_a_log_of_another_planner_is_a_drivable_and_free_path_as_listed(name: str) -> None:
    (case,) = read_cases(FOLDER / "full" / f"{name}.mcap")
    problem, entry = case.problem, FULL_LISTED[name]
    scene, path = scene_to_document(problem.scene), path_to_document(problem.recorded)
    report = audit_recorded(asdict(problem.vehicle), scene, path)
    assert report.passed, report.failures
    assert problem.recorded.num_cusps == entry["cusps"]
    assert problem.recorded.length == pytest.approx(entry["length_m"], abs=0.05)


@pytest.mark.parametrize("name", ODD)
def test_an_odd_log_ends_as_its_entry_says(name: str) -> None:
    expect, path = FULL_LISTED[name]["expect"], FOLDER / "full" / f"{name}.mcap"
    assert expect == ODD[name].expect
    if expect.startswith("E_"):
        with pytest.raises(LogError) as caught:
            read_cases(path)
        assert caught.value.code == expect
        return
    (case,) = read_cases(path)
    (run,) = run_case(case, {"ddp": Ddp()}).methods
    assert run.status == expect
    assert case.read.notes if name == "odd_tail" else not case.read.lost


@pytest.mark.parametrize("name", ["constrained_04", "open_04"])
def test_a_drawn_log_made_again_has_the_same_bytes(name: str) -> None:
    assert difference(make(name), FULL_LISTED[name]) is None


SMALL = Site(
    name="small_01",
    title="open ground",
    special="",
    obstacles=(Box(x=0.0, y=-9.0, length=12.0, width=2.5, yaw=0.2),),
    bounds=(-40.0, -20.0, 40.0, 20.0),
    start=Flat(-24.0, 0.0, 0.0, 0.0),
    goal=Flat(-10.0, 6.0, 0.0, 0.0),
    areas=(Area(box=(-25.0, -14.0, 25.0, 14.0)),),
    map=Grid(resolution=0.25, speckles=5),
    length=(20.0, 200.0),
)


def test_a_log_made_again_has_the_same_bytes() -> None:
    first, second = make_log(SMALL), make_log(SMALL)
    assert first.data == second.data
    assert difference(second, first.entry) is None


def test_the_comparison_tells_other_content_from_other_compression() -> None:
    data = (FOLDER / "bay_01.mcap").read_bytes()
    made = Made(name="bay_01", data=data, entry=LISTED["bay_01"])
    assert made.entry["content"] == content_digest(data)
    assert difference(made, None) == "not in the list"
    assert "compressed differently" in (difference(made, made.entry | {"sha256": "0"}) or "")
    other = made.entry | {"sha256": "0", "content": "0", "poses": 7}
    assert f"poses {made.entry['poses']} instead of 7" in (difference(made, other) or "")


def test_the_list_is_read_as_it_was_written(tmp_path: Path) -> None:
    write_list(tmp_path, LISTED)
    assert read_list(tmp_path) == LISTED
    assert (tmp_path / "corpus.toml").read_bytes() == (FOLDER / "corpus.toml").read_bytes()


def test_the_readme_shows_the_figures_of_the_list() -> None:
    rows = [
        line.split("|")
        for line in (FOLDER / "README.md").read_text().splitlines()
        if line.startswith("| `") and line.count("|") == 7
    ]
    shown = {row[1].strip(" `"): (float(row[4]), int(row[5])) for row in rows}
    assert shown == {name: (round(entry["length_m"]), entry["cusps"]) for name, entry in LISTED.items()}


@pytest.mark.parametrize("name", [name for name, site in SITES.items() if isinstance(site.map, Grid)])
def test_every_point_of_an_obstacle_lies_in_a_blocked_cell(name: str) -> None:
    site = SITES[name]
    cells, rng = draw_grid(site), np.random.default_rng(1)
    assert cells is not None
    x, y, yaw = cells.origin
    for polygon in footprints(site):
        weights = rng.dirichlet(np.ones(len(polygon)), 200)
        away = weights @ polygon - [x, y]
        column = (math.cos(yaw) * away[:, 0] + math.sin(yaw) * away[:, 1]) / cells.resolution
        row = (math.cos(yaw) * away[:, 1] - math.sin(yaw) * away[:, 0]) / cells.resolution
        assert cells.blocked[row.astype(int), column.astype(int)].all()


def test_ramps_end_where_integration_says() -> None:
    start = Flat(3.0, -2.0, 2.2, 0.05)
    kappa, length = np.array([0.12, -0.08, 0.0, 0.1]), np.array([9.0, -12.0, 6.0, -4.0])
    ends = ramp_ends(start, kappa, length)
    for end, k, total in zip(ends, kappa, length, strict=True):
        u = np.linspace(0.0, 1.0, 4001)
        bend = start.kappa + (k - start.kappa) * (3 * u**2 - 2 * u**3)
        theta = start.theta + np.concatenate([[0.0], np.cumsum((bend[1:] + bend[:-1]) / 2)]) * total / 4000
        mid = (theta[1:] + theta[:-1]) / 2
        expected = [start.x + total * np.cos(mid).mean(), start.y + total * np.sin(mid).mean(), theta[-1], k, 0.0]
        np.testing.assert_allclose(end, expected, atol=1e-6)


VEHICLE = Vehicle()
START, GOAL = Flat(-20.0, 0.0, 0.0, 0.0), Flat(14.0, 3.0, 0.0, 0.0)
AREA = Area(box=(-25.0, -14.0, 25.0, 14.0))
OUTLINE = [[-40.0, -20.0], [40.0, -20.0], [40.0, 20.0], [-40.0, 20.0]]
RRT = Rrt()


def planned(walls: list[np.ndarray], seed: int, planner: Rrt = RRT) -> Found | None:
    scene = make_scene(walls, boundary=OUTLINE)
    problem = PlanningProblem(vehicle=VEHICLE, scene=scene, start=START, goal=GOAL, areas=[AREA], margin=0.3)
    return planner.search(problem, seed)


@pytest.mark.parametrize("seed", range(4))
def test_a_planned_path_is_continuous_free_and_ends_where_asked(seed: int) -> None:
    walls = Wall(points=((0.0, -20.0), (0.0, -5.0)), width=1.0).parts()
    found = planned(walls, seed)
    assert found is not None
    scene = make_scene(walls, boundary=OUTLINE)
    assert found.edges[0].start == START
    assert found.edges[-1].end == GOAL
    for edge, following in itertools.pairwise(found.edges):
        assert edge.end == following.start
        assert edge.end.sigma == 0.0
    for edge in found.edges:
        s, states, _ = edge.sample(0.2)
        assert first_violation(scene, VEHICLE, s, states, 0.3) < 0
        assert not collides(scene, VEHICLE, states, 0.3).any()


def test_the_same_seed_gives_the_same_path_and_another_seed_another() -> None:
    walls = Wall(points=((0.0, -20.0), (0.0, -5.0)), width=1.0).parts()
    first, again, other = (planned(walls, seed) for seed in (5, 5, 6))
    assert first is not None
    assert again is not None
    assert other is not None
    assert [edge.end for edge in first.edges] == [edge.end for edge in again.edges]
    assert [edge.end for edge in first.edges] != [edge.end for edge in other.edges]


def test_the_planner_gives_up_where_there_is_no_way() -> None:
    closed = Wall(points=((0.0, -20.0), (0.0, 20.0)), width=1.0).parts()
    assert planned(closed, 0, Rrt(max_iterations=60)) is None


def test_start_and_goal_of_every_site_are_limits_that_the_vehicle_keeps() -> None:
    for site in SITES.values():
        states, _ = state_from_flat(site.vehicle, np.array([site.start, site.goal]))
        assert (np.abs(states[:, 3]) < site.vehicle.max_hitch).all()
        assert site.has_trailer_path or states[0, 3] == 0.0, "a reader could not know the first hitch angle"
