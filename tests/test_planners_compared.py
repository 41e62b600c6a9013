"""The comparison of the planners: how its table is made of rows, and where in the README it goes."""

import argparse

import pytest

from tools.compare_planners import PLANNERS, README, first_free, table, with_table
from tools.corpus.families import CLASSES

OPTIONS = argparse.Namespace(sites=1, seeds=2, time_limit=10.0, jobs=2)


def rows_of(found: dict[str, tuple[bool, bool]], objective: dict[str, float]) -> list[dict]:
    return [
        {
            "class": kind,
            "site": f"{kind}_01",
            "seed": seed,
            "planner": planner.name,
            "seconds": 1.0 + seed,
            "found": found[planner.name][seed],
            "audit": True,
            "objective": objective[planner.name] + seed,
            "length": 50.0,
            "cusps": 2,
        }
        for kind in CLASSES
        for seed in (0, 1)
        for planner in PLANNERS
    ]


def test_only_searches_that_all_planners_solve_are_compared_by_their_paths() -> None:
    found = {"RRT": (True, True), "CL-RRT": (True, False), "Hybrid A*": (True, True)}
    text = table(rows_of(found, {"RRT": 100.0, "CL-RRT": 80.0, "Hybrid A*": 60.0}), OPTIONS)
    assert "| `open` | RRT | 100 % | 1.50 | 100.0 (1) | 50.0 | 2.0 |" in text
    assert "| `open` | CL-RRT | 50 % | at the limit | 80.0 (1) | 50.0 | 2.0 |" in text
    assert "| `all` | Hybrid A* | 100 % | 1.50 | 60.0 (6) | 50.0 | 2.0 |" in text
    assert "0 paths were found and failed the audit" in text


def test_where_nothing_is_common_no_figure_stands() -> None:
    found = {"RRT": (True, False), "CL-RRT": (False, True), "Hybrid A*": (True, True)}
    text = table(rows_of(found, dict.fromkeys(found, 70.0)), OPTIONS)
    assert "| `cusps` | RRT | 50 % | at the limit | – (0) | – | – |" in text


def test_the_table_takes_the_place_between_the_markers() -> None:
    readme = README.read_text(encoding="utf-8")
    changed = with_table(readme, "new text")
    assert changed != readme
    assert "\nnew text\n" in changed
    assert with_table(changed, "new text") == changed
    with pytest.raises(ValueError, match="has no"):
        with_table("nothing here", "text")


def test_sites_are_chosen_without_asking_a_planner() -> None:
    for kind in CLASSES:
        assert first_free(kind, 1).name == f"{kind}_01"
