"""The section on collision: bodies against obstacles, by us, shapely, python-fcl and coal, per pair.

*Every pair*: each body of each pose with each obstacle, no culling by anyone: the price of one test. *Culled*: the
answer for each pose, by whatever tree each has. All are called as a user of Python calls them: shapely with whole
arrays, fcl and coal once for each pair or body, since that is what their bindings offer. Shapes are made beforehand,
prisms of height 1 for those who know only three dimensions; poses are set within the time, as we set ours.
"""

import importlib
import importlib.util
import json
import pathlib
from typing import Any

import numpy as np
import shapely
from numba import njit

from optim.geometry.collision import box_distance, rectangle, separating_gap, signed_distance
from optim.model.clearance import clearance, collides
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle, body_corners, body_poses
from optim.numerics.arrays import Array, BoolArray, IntArray
from replay.base.files import atomic_write
from replay.logs import read_cases
from tools.bench.timing import least

POSES = 2000
FEWER = 100
"""Poses for those who are called once for each pair."""
Row = dict[str, Any]


@njit(cache=True)
def every_pair(scene, footprints, offset, states, hit):
    """Box, then separating axes, for every body and polygon, one after the other: no tree."""
    for i in range(states.shape[0]):
        for body in range(2):
            rect = rectangle(scene, footprints, offset, states, i, body)
            for node in range(scene.item.size):
                k = scene.item[node]
                if k >= 0:
                    near = box_distance(scene, node, rect) <= 0.0
                    hit[i, body, k] = near and separating_gap(scene, k, rect, 0.0) < 0.0


@njit(cache=True)
def every_distance(scene, footprints, offset, states, out):
    """Signed distance for every body and polygon."""
    for i in range(states.shape[0]):
        for body in range(2):
            rect = rectangle(scene, footprints, offset, states, i, body)
            for k in range(scene.first.size - 1):
                out[i, body, k] = signed_distance(scene, k, rect)[0]


class Shapely:
    """Prepared polygons and arrays of polygons."""

    def __init__(self, scene: Scene, vehicle: Vehicle, states: Array) -> None:
        self.obstacles = np.array([shapely.Polygon(polygon) for polygon in scene.polygons])
        self.corners = body_corners(vehicle, states).reshape(-1, 4, 2)
        self.tree = shapely.STRtree(self.obstacles)
        shapely.prepare(self.obstacles)

    def bodies(self) -> Any:
        return np.asarray(shapely.polygons(self.corners))

    def hits(self) -> BoolArray:
        bodies = self.bodies()
        return np.stack([shapely.intersects(obstacle, bodies) for obstacle in self.obstacles], axis=1)

    def distances(self) -> Array:
        bodies = self.bodies()
        return np.stack([shapely.distance(obstacle, bodies) for obstacle in self.obstacles], axis=1)

    def culled(self) -> BoolArray:
        bodies = self.bodies()
        hit = np.zeros(len(bodies), dtype=bool)
        hit[self.tree.query(bodies, predicate="intersects")[0]] = True
        return np.asarray(hit.reshape(-1, 2).any(axis=1))


def prism(polygon: Array) -> tuple[Array, IntArray]:
    """Vertices (2 n, 3) and corners of triangles (m, 3) of a polygon of height 1."""
    n = len(polygon)
    points = np.concatenate([np.column_stack([polygon, np.full(n, z)]) for z in (-0.5, 0.5)])
    sides = [(i, (i + 1) % n, n + i) for i in range(n)] + [((i + 1) % n, n + (i + 1) % n, n + i) for i in range(n)]
    caps = [(0, i + 1, i) for i in range(1, n - 1)] + [(n, n + i, n + i + 1) for i in range(1, n - 1)]
    return points, np.array(sides + caps, dtype=np.int64)


def turns(vehicle: Vehicle, states: Array) -> tuple[Array, Array]:
    """Rotations (N, 2, 3, 3) and centres (N, 2, 3) of both bodies."""
    pose = body_poses(vehicle, states)
    c, s = np.cos(pose[..., 2]), np.sin(pose[..., 2])
    rotation = np.zeros((*pose.shape[:2], 3, 3))
    rotation[..., 0, 0], rotation[..., 1, 1], rotation[..., 2, 2] = c, c, 1.0
    rotation[..., 0, 1], rotation[..., 1, 0] = -s, s
    middle = 0.5 * (vehicle.footprints[:, 0] - vehicle.footprints[:, 1])
    centre = np.zeros((*pose.shape[:2], 3))
    centre[..., 0], centre[..., 1] = pose[..., 0] + middle * c, pose[..., 1] + middle * s
    return rotation, centre


class Fcl:
    """python-fcl: boxes against convex prisms."""

    def __init__(self, scene: Scene, vehicle: Vehicle, states: Array) -> None:
        self.fcl: Any = importlib.import_module("fcl")
        fcl = self.fcl
        self.rotation, self.centre = turns(vehicle, states)
        boxes = [fcl.Box(front + rear, 2.0 * half, 1.0) for front, rear, half in vehicle.footprints.tolist()]
        self.bodies = [fcl.CollisionObject(box, fcl.Transform()) for box in boxes]
        self.obstacles = []
        for polygon in scene.polygons:
            points, triangles = prism(polygon)
            faces = np.column_stack([np.full(len(triangles), 3), triangles]).ravel()
            self.obstacles.append(fcl.CollisionObject(fcl.Convex(points, len(triangles), faces), fcl.Transform()))
        self.manager = fcl.DynamicAABBTreeCollisionManager()
        self.manager.registerObjects(self.obstacles)
        self.manager.setup()

    def _places(self) -> Any:
        for i in range(len(self.rotation)):
            for body in range(2):
                self.bodies[body].setTransform(self.fcl.Transform(self.rotation[i, body], self.centre[i, body]))
                yield self.bodies[body]

    def hits(self) -> BoolArray:
        fcl, request = self.fcl, self.fcl.CollisionRequest()
        found = []
        for body in self._places():
            found.append([fcl.collide(body, other, request, fcl.CollisionResult()) > 0 for other in self.obstacles])
        return np.array(found)

    def distances(self) -> Array:
        fcl, request = self.fcl, self.fcl.DistanceRequest()
        found = []
        for body in self._places():
            found.append([fcl.distance(body, other, request, fcl.DistanceResult()) for other in self.obstacles])
        return np.array(found)

    def culled(self) -> BoolArray:
        fcl, found = self.fcl, []
        for body in self._places():
            data = fcl.CollisionData()
            self.manager.collide(body, data, fcl.defaultCollisionCallback)
            found.append(data.result.is_collision)
        return np.asarray(np.array(found).reshape(-1, 2).any(axis=1))


class Coal:
    """coal, the successor of hpp-fcl: boxes against convex prisms."""

    def __init__(self, scene: Scene, vehicle: Vehicle, states: Array) -> None:
        self.coal: Any = importlib.import_module("coal")
        coal = self.coal
        self.rotation, self.centre = turns(vehicle, states)
        boxes = [coal.Box(front + rear, 2.0 * half, 1.0) for front, rear, half in vehicle.footprints.tolist()]
        self.bodies = [coal.CollisionObject(box) for box in boxes]
        self.obstacles = []
        for polygon in scene.polygons:
            points = coal.StdVec_Vec3s()
            for point in prism(polygon)[0]:
                points.append(point)
            self.obstacles.append(coal.CollisionObject(coal.Convex.convexHull(points, False, "")))
        self.manager = coal.DynamicAABBTreeCollisionManager()
        for obstacle in self.obstacles:
            self.manager.registerObject(obstacle)
        self.manager.setup()

    def _places(self) -> Any:
        for i in range(len(self.rotation)):
            for body in range(2):
                self.bodies[body].setTransform(self.coal.Transform3s(self.rotation[i, body], self.centre[i, body]))
                self.bodies[body].computeAABB()
                yield self.bodies[body]

    def hits(self) -> BoolArray:
        coal, request = self.coal, self.coal.CollisionRequest()
        found = []
        for body in self._places():
            found.append([coal.collide(body, other, request, coal.CollisionResult()) > 0 for other in self.obstacles])
        return np.array(found)

    def distances(self) -> Array:
        coal, request = self.coal, self.coal.DistanceRequest()
        found = []
        for body in self._places():
            found.append([coal.distance(body, other, request, coal.DistanceResult()) for other in self.obstacles])
        return np.array(found)

    def culled(self) -> BoolArray:
        coal, found = self.coal, []
        for body in self._places():
            data = coal.CollisionCallBackDefault()
            self.manager.collide(body, data)
            found.append(data.data.result.isCollision())
        return np.asarray(np.array(found).reshape(-1, 2).any(axis=1))


PEERS: dict[str, tuple[str, Any, int]] = {
    "shapely": ("shapely", Shapely, POSES),
    "python-fcl": ("fcl", Fcl, FEWER),
    "coal": ("coal", Coal, FEWER),
}


def run(logs: list[pathlib.Path], folder: pathlib.Path) -> None:
    folder.mkdir(parents=True, exist_ok=True)
    for log in logs:
        file = folder / f"{log.stem}.json"
        if file.exists():
            continue
        problem = read_cases(log)[0].problem
        states = problem.recorded.samples.states
        states = np.ascontiguousarray(np.resize(states, (max(POSES, len(states)), 4))[:POSES])
        row = measure(problem.scene, problem.vehicle, states)
        print(f"{log.stem:<13}{row}", flush=True)
        with atomic_write(file) as temporary:
            temporary.write_text(json.dumps(row, indent=1), encoding="utf-8")


def measure(scene: Scene, vehicle: Vehicle, states: Array) -> Row:
    """Nanoseconds per pair, or per pose and obstacle where culled; and how many answers differ from ours."""
    count = len(scene.polygons)
    place = (scene.packed, vehicle.footprints, vehicle.hitch_offset, states)
    hit, distance = np.zeros((len(states), 2, count), dtype=np.bool_), np.empty((len(states), 2, count))
    every_pair(*place, hit)
    every_distance(*place, distance)
    any_hit = collides(scene, vehicle, states)
    clearance(scene, vehicle, states[:2])
    pairs = 2.0 * len(states) * count
    row: Row = {
        "obstacles": count,
        "ours": {
            "hits": 1e9 * least(lambda: every_pair(*place, hit), 5) / pairs,
            "distances": 1e9 * least(lambda: every_distance(*place, distance), 5) / pairs,
            "culled": 1e9 * least(lambda: collides(scene, vehicle, states), 5) / pairs,
        },
    }
    for name, (module, peer, poses) in PEERS.items():
        if importlib.util.find_spec(module) is None:
            continue
        theirs = peer(scene, vehicle, states[:poses])
        pairs = 2.0 * poses * count
        times = {what: 1e9 * least(getattr(theirs, what), 3) / pairs for what in ("hits", "distances", "culled")}
        differ = int((theirs.hits().reshape(-1) != hit[:poses].reshape(-1)).sum())
        off = np.abs(np.maximum(theirs.distances().reshape(-1), 0.0) - np.maximum(distance[:poses].reshape(-1), 0.0))
        other = int((theirs.culled() != any_hit[:poses]).sum())
        row[name] = times | {"differ": differ + other, "off": float(off.max())}
    return row


def report(folder: pathlib.Path) -> str:
    rows = [json.loads(path.read_text(encoding="utf-8")) for path in sorted(folder.glob("*.json"))]
    lines = [
        "## Collision",
        "",
        f"Both bodies at {POSES} poses of each recorded path ({FEWER} for python-fcl and coal) against all obstacles "
        "of its map; nanoseconds for a pair, median over the logs, and in brackets the median of that peer's time by "
        "ours on the same log. `Every pair` is without a tree, though all but fcl look at boxes first; `culled` is the "
        "answer for whole poses with each one's own tree, by the same number of pairs. fcl and coal are called once "
        "for each pair (or body), as their bindings have it: most of their time is the call.",
        "",
        "| | overlap, every pair [ns] | distance, every pair [ns] | overlap, culled [ns] | answers that differ | "
        "distances apart by [m] |",
        "|---|--:|--:|--:|--:|--:|",
    ]
    for name in ("ours", *PEERS):
        mine = [row for row in rows if name in row]
        if not mine:
            continue
        cells = []
        for what in ("hits", "distances", "culled"):
            ratio = np.median([row[name][what] / row["ours"][what] for row in mine])
            value = f"{np.median([row[name][what] for row in mine]):.3g}"
            cells.append(value if name == "ours" else f"{value} ({ratio:.0f} ×)")
        differ = "" if name == "ours" else str(sum(row[name]["differ"] for row in mine))
        off = "" if name == "ours" else f"{max(row[name]['off'] for row in mine):.1e}"
        lines.append(f"| {name} | {' | '.join(cells)} | {differ} | {off} |")
    lines += ["", "Asked for: 5 × against shapely, 10 × against python-fcl."]
    return "\n".join(lines)
