"""Speed of the collision kernels beside shapely's, one core, same poses, same answer required.

    python tools/bench/collision.py [LOG.mcap ...] [--json]

Pairs are poses x 2 bodies x obstacles, culled or not. shapely is given its best forms: an STRtree of the obstacles
queried with all bodies at once, and prepared obstacles against all bodies; making its polygons is not counted.
Without logs, the scenes are yards with parked trucks, walls and debris, and poses of drives through them.
"""

import argparse
import functools
import json
import os
import pathlib
import time
from collections.abc import Iterator
from typing import Any

import numpy as np
import shapely

from optim.model.clearance import clearance, collides, first_violation, swept_clearance
from optim.model.kinematics import roll_out
from optim.model.scene import Scene, make_scene
from optim.model.vehicle import Vehicle, body_corners
from replay.base.kernels import drop_stale
from tools.bench.timing import least
from tools.script import existing, run

NUM_POSES = 20_000
SPACING = 0.1  # [m] between poses of a drive


def yard(num_obstacles: int, seed: int) -> Scene:
    """A walled yard whose size grows with the number of obstacles: parked trailers in rows, convex debris between."""
    rng = np.random.default_rng(seed)
    side = 25.0 * max(1.0, np.sqrt(num_obstacles / 8.0))
    obstacles: list[np.ndarray] = []
    for k in range(num_obstacles - 4):
        centre = rng.uniform(-side, side, 2)
        if k % 3:
            angle = rng.normal(0.0, 0.1)
            box = np.array([[-6.8, -1.3], [6.8, -1.3], [6.8, 1.3], [-6.8, 1.3]])
        else:
            angle = rng.uniform(0.0, 6.3)
            turn = np.sort(rng.uniform(0.0, 2.0 * np.pi, 8))
            box = rng.uniform(0.3, 2.0) * np.stack([np.cos(turn), np.sin(turn)], axis=1)
        c, s = np.cos(angle), np.sin(angle)
        obstacles.append(centre + box @ np.array([[c, s], [-s, c]]))
    outline = side * np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
    return make_scene(obstacles, boundary=outline)


def drives(vehicle: Vehicle, scene: Scene, seed: int) -> list[tuple[np.ndarray, np.ndarray]]:
    """(s, states) of forward drives from random places of the yard, NUM_POSES poses in total."""
    rng = np.random.default_rng(seed)
    assert scene.boundary is not None
    side = 0.7 * scene.boundary.max()
    s = SPACING * np.arange(200.0)
    found = []
    for _ in range(NUM_POSES // len(s)):
        start = np.array([*rng.uniform(-side, side, 2), rng.uniform(-np.pi, np.pi), 0.0])
        phi = 0.4 * np.sin(rng.uniform(0.05, 0.3) * s + rng.uniform(0.0, 6.0))
        found.append((s, roll_out(vehicle, start, s, phi, 1)))
    return found


def measure(name: str, vehicle: Vehicle, scene: Scene, paths: list[tuple[np.ndarray, np.ndarray]]) -> dict[str, Any]:
    """One row of the table."""
    states = np.concatenate([path for _, path in paths])
    pairs = len(states) * 2 * len(scene.polygons)
    bodies = np.asarray(shapely.polygons(body_corners(vehicle, states).reshape(-1, 4, 2)))
    obstacles = np.array([shapely.Polygon(polygon) for polygon in scene.polygons])
    tree = shapely.STRtree(obstacles)
    shapely.prepare(obstacles)

    def by_tree() -> np.ndarray:
        hit = np.zeros(len(bodies), dtype=bool)
        hit[tree.query(bodies, predicate="intersects")[0]] = True
        return np.asarray(hit.reshape(-1, 2).any(axis=1))

    def by_prepared() -> np.ndarray:
        return np.asarray(np.array([shapely.intersects(obstacle, bodies) for obstacle in obstacles]).any(axis=0))

    ours = collides(scene, vehicle, states)
    clearance(scene, vehicle, states[:2])
    margin = 0.1
    for s, path in paths[:1]:
        swept_clearance(scene, vehicle, s, path)
        first_violation(scene, vehicle, s, path, margin)
    wall = functools.partial(least, clock=time.perf_counter)
    differ = int((ours != by_tree()).sum())
    own = wall(lambda: collides(scene, vehicle, states), 5)
    peer = wall(by_tree, 2)
    prepared = wall(by_prepared, 1) if pairs < 2e7 else float("nan")
    exact = wall(lambda: clearance(scene, vehicle, states), 2)
    swept = wall(lambda: [swept_clearance(scene, vehicle, s, path) for s, path in paths], 2)
    checked = wall(lambda: [first_violation(scene, vehicle, s, path, margin) for s, path in paths], 2)
    free = [path for path in paths if first_violation(scene, vehicle, *path, margin) < 0]
    checked_free = wall(lambda: [first_violation(scene, vehicle, *path, margin) for path in free], 2)
    return {
        "scene": name,
        "obstacles": len(scene.polygons),
        "hit_percent": 100.0 * float(ours.mean()),
        "differ": differ,
        "collides_mpairs_s": pairs / own / 1e6,
        "strtree_mpairs_s": pairs / peer / 1e6,
        "prepared_mpairs_s": pairs / prepared / 1e6,
        "ratio": peer / own,
        "collides_us": 1e6 * own / len(states),
        "clearance_us": 1e6 * exact / len(states),
        "swept_us": 1e6 * swept / len(states),
        "path_check_us": 1e6 * checked / len(paths),
        "free_path_check_us": 1e6 * checked_free / max(1, len(free)),
    }


def cases(logs: list[pathlib.Path]) -> Iterator[tuple[str, Vehicle, Scene, list[tuple[np.ndarray, np.ndarray]]]]:
    """What to measure: the recorded paths of the logs, or the built-in yards."""
    if logs:
        from replay.logs import read_cases

        for log in logs:
            for case in read_cases(log):
                problem = case.problem
                paths = [(segment.s, segment.states) for segment in problem.recorded.segments]
                repeats = max(1, NUM_POSES // sum(len(s) for s, _ in paths))
                yield case.name, problem.vehicle, problem.scene, paths * repeats
        return
    vehicle = Vehicle()
    for count in (10, 30, 60, 500, 2000):
        scene = yard(count, seed=count)
        yield f"yard {count}", vehicle, scene, drives(vehicle, scene, seed=1)


def main() -> None:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("logs", nargs="*", type=existing, metavar="LOG", help="default: yards made here")
    parser.add_argument("--json", action="store_true", help="print the rows as JSON")
    options = parser.parse_args()
    drop_stale()
    if hasattr(os, "sched_setaffinity"):
        os.sched_setaffinity(0, {min(os.sched_getaffinity(0))})
    rows = [measure(*case) for case in cases(options.logs)]
    if options.json:
        print(json.dumps(rows, indent=1))
        return
    print(f"{'scene':<20}{'obst.':>6}{'hit %':>7}{'differ':>7} | {'M pairs/s':>9}{'STRtree':>9}{'prepared':>9}", end="")
    print(f"{'ratio':>7} | us/pose {'collides':>8}{'clear.':>8}{'swept':>8} | us/path {'all':>8}{'free':>8}")
    for row in rows:
        print(f"{row['scene']:<20}{row['obstacles']:>6}{row['hit_percent']:>7.1f}{row['differ']:>7} | ", end="")
        print(
            f"{row['collides_mpairs_s']:>9.1f}{row['strtree_mpairs_s']:>9.2f}{row['prepared_mpairs_s']:>9.2f}", end=""
        )
        print(f"{row['ratio']:>7.1f} |         {row['collides_us']:>8.2f}{row['clearance_us']:>8.2f}", end="")
        print(f"{row['swept_us']:>8.2f} |         {row['path_check_us']:>8.1f}{row['free_path_check_us']:>8.1f}")


if __name__ == "__main__":
    run(main)
