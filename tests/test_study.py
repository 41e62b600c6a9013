"""The study: what the scarcer descriptions of obstacles hold, and what its report says of the rows it is given."""

from pathlib import Path
from typing import Any

import numpy as np

from optim.methods.shortcut import Shortcut
from optim.model.clearance import clearance
from optim.model.metrics import UNITS
from optim.model.scene import make_scene
from optim.model.vehicle import Vehicle
from replay.logs import read_cases
from tools.study import CHAINS, DESCRIBED, variants
from tools.study_descriptions import SHOWN, lost, obstacles_report
from tools.study_report import report
from tools.study_rows import METHODS, Rows
from tools.study_scenes import POINT_SPACING, Described, described, discs, points

RECORDINGS = Path(__file__).resolve().parent.parent / "recordings"
SCENE = make_scene(
    [
        [[0.0, 0.0], [12.0, 0.0], [12.0, 2.5], [0.0, 2.5]],
        [[20.0, 5.0], [24.0, 9.0], [18.0, 12.0]],
        [[-9.0, -3.0], [1.0, 7.0], [0.9, 7.1], [-9.1, -2.9]],
    ]
)


def inside(polygons: Any, point: np.ndarray) -> bool:
    """Whether some convex counter-clockwise polygon contains the point."""
    for polygon in polygons:
        edge, away = np.roll(polygon, -1, axis=0) - polygon, point - polygon
        if (edge[:, 0] * away[:, 1] - edge[:, 1] * away[:, 0] >= -1e-9).all():
            return True
    return False


def test_discs_contain_the_obstacles_and_protrude() -> None:
    shown, rng = discs(SCENE), np.random.default_rng(0)
    for polygon in SCENE.polygons:
        for weights in rng.dirichlet(np.full(len(polygon), 0.3), 200):
            assert inside(shown.polygons, weights @ polygon)
    state = np.array([[6.0, 5.0, 0.0, 0.0]])
    vehicle = Vehicle()
    truck = 0
    assert 0.3 < clearance(shown, vehicle, state)[0, truck] < clearance(SCENE, vehicle, state)[0, truck] - 0.3


def test_points_lie_on_the_outlines_at_most_a_metre_apart() -> None:
    shown = points(SCENE)
    centres = np.array([polygon.mean(axis=0) for polygon in shown.polygons])
    for polygon in SCENE.polygons:
        for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            for share in np.linspace(0.0, 1.0, 20):
                nearest = np.hypot(*(centres - (a + share * (b - a))).T).min()
                assert nearest <= POINT_SPACING / 2.0 + 1e-6
    middle = np.array([6.0, 1.2])
    assert inside(SCENE.polygons, middle)
    assert not inside(shown.polygons, middle)


def test_a_method_that_is_shown_a_description_sees_it_and_keeps_the_recorded_path() -> None:
    (case,) = read_cases(RECORDINGS / "bay_01.mcap")
    problem = case.problem
    seen = described(problem, "discs")
    assert seen.recorded is problem.recorded
    assert len(seen.scene.polygons) > len(problem.scene.polygons)
    assert seen.recorded_clearance < problem.recorded_clearance
    method = Described(method=Shortcut(tries=20), description="points")
    result = method.solve(problem)
    expected = Shortcut(tries=20).solve(described(problem, "points"))
    assert (result.path.samples.states == expected.path.samples.states).all()


def test_every_variant_that_the_reports_ask_for_is_run() -> None:
    assert {*METHODS, *CHAINS, "shortcut by trailer length"} <= set(variants("methods"))
    assert {name for shown in SHOWN.values() for name in shown.values()} == set(variants("obstacles"))
    assert set(DESCRIBED) == {method for method, shown in SHOWN.items() if "polygons" in shown}


def made_rows(statuses: dict[str, str], part: str) -> list[dict[str, Any]]:
    """Rows of four logs: J is 60 where a method improves, else that of the recorded path, 100."""
    rows = []
    for log, kind in (("open_01", "open"), ("open_02", "open"), ("narrow_01", "narrow"), ("bay_01", "bay")):
        for name in ("recorded", *variants(part)):
            status = "recorded" if name == "recorded" else statuses.get(f"{kind} {name}", "improved")
            figures = dict.fromkeys(UNITS, 1.0) | {"objective": 60.0 if status == "improved" else 100.0}
            row = {"log": log, "class": kind, "map": "grid", "method": name, "status": status, "metrics": figures}
            row |= {"stop": "time limit" if name == "scp" else "converged"} if name != "recorded" else {}
            rows.append(row | {"feasible": True, "wall_s": 1.0, "rejected": status == "kept"})
    return rows


HEAD = {"commit": "abc", "machine": "m", "versions": {"numpy": "2"}, "jobs": 2, "time_limit": 20.0}


def test_the_report_counts_what_scarce_descriptions_lose() -> None:
    kept = {f"narrow {method} by discs": "kept" for method in ("shortcut", "ddp", "scp")}
    made = made_rows(kept, "obstacles")
    assert lost(Rows(made), ["narrow_01"], "ddp", "discs") == (1, 1)
    assert lost(Rows(made), ["open_01", "open_02"], "ddp", "discs") == (0, 2)
    text = obstacles_report({"head": HEAD, "rows": made})
    assert "- *discs*: narrow 3 of 3, open 0 of 6, sample logs 0 of 3, all 3 of 12." in text
    assert (
        "with *discs* 100 % are lost in narrow scenes, 0 % in open ones: that they fail in narrow ones is supp" in text
    )
    assert "0/1 1.000 (1)" in text
    assert "which ended 4 of 44 runs" in text
    assert "Not measured in this run: `nlp`." in text
    some = [row for row in made if not row["method"].startswith("scp")]
    assert "Not measured in this run: `scp`, `nlp`." in obstacles_report({"head": HEAD, "rows": some})


def test_the_report_names_logs_that_no_method_improves() -> None:
    kept = {f"narrow {name}": "kept" for name in variants("methods")}
    text, figure = report({"head": HEAD, "rows": made_rows(kept, "methods")})
    assert "3 of the 4 logs whose recorded path is feasible: 75.0 %" in text
    assert "(not on narrow_01)" in text
    assert figure.startswith("<?xml")
    assert Rows(made_rows(kept, "methods")).ratio(["narrow_01"], "ddp") == 1.0
