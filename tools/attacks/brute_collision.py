"""Compare the audit's bound on the area swept between samples with brute force: both bodies at every 0.1 mm.

Usage: python -m tools.attacks brute-collision [--scenes N] [--first SEED] [--jobs N]

Each scene is a random vehicle on a random drive past obstacles that touch, just miss or just hit what it sweeps, on
its outer and its inner side. Three things must hold in every scene: what brute force finds colliding is rejected; the
clearance that the audit tells is never more than brute force finds; and it is at most less by the bound that
`optim.audit.motion` proves. The exit status is 1 if one does not.
"""

import argparse
import dataclasses
import math
from concurrent.futures import ProcessPoolExecutor
from multiprocessing import get_context
from typing import Any

import numpy as np
import shapely

from optim.audit.checks import audit_recorded
from optim.audit.data import read_path, read_vehicle
from optim.audit.motion import excess, inflation
from optim.model.kinematics import roll_out
from optim.model.path import Path, Segment, roll_out_segment
from optim.model.vehicle import Vehicle, body_corners
from replay.base.kernels import drop_stale
from replay.run.plain import path_to_document
from tools.script import from_one

STEP = 1e-4
"""Between the poses of brute force [m]."""
COARSE = 50
"""Brute force looks at every so many poses first, and at the others where these come near."""


@dataclasses.dataclass(frozen=True, kw_only=True)
class Compared:
    """One scene by brute force and by the audit."""

    seed: int
    collides: bool
    """Some pose of brute force overlaps an obstacle."""
    accepted: bool
    """By the audit's check of clearance."""
    brute: float
    """Least distance at the poses of brute force [m]; 0 on overlap."""
    audited: float
    """Least clearance that the audit tells [m]; negative on overlap."""
    bound: float
    """What the audit may be short of the true clearance by [m]."""

    @property
    def wrong(self) -> str:
        """What does not hold; empty if all is well."""
        if self.collides and self.accepted:
            return "accepted, although brute force finds a collision"
        if not self.collides and self.audited > self.brute + 1e-9:
            return f"{self.audited:.6f} m of clearance told, brute force finds {self.brute:.6f} m"
        if not self.collides and not self.accepted and self.brute > self.bound + 1e-9:
            return f"rejected with {self.brute:.6f} m of clearance, the bound is {self.bound:.6f} m"
        return ""


def options(parser: argparse.ArgumentParser) -> None:
    """Add the options."""
    parser.add_argument("--scenes", type=from_one, default=1000, help="default: %(default)s")
    parser.add_argument("--first", type=int, default=0, help="the first seed")
    parser.add_argument("--jobs", type=from_one, default=1, help="processes (default: %(default)s)")


def main(arguments: argparse.Namespace) -> int:
    """Exit status: 0 where all is as it should be, else 1."""
    drop_stale()
    seeds = range(arguments.first, arguments.first + arguments.scenes)
    with ProcessPoolExecutor(arguments.jobs, mp_context=get_context("fork")) as pool:
        found = list(pool.map(compare, seeds, chunksize=10))
    for each in found:
        if each.wrong:
            print(f"scene {each.seed}: {each.wrong}")
    free = [each for each in found if not each.collides]
    false = [each for each in free if not each.accepted]
    used = max((each.brute / each.bound for each in false), default=0.0)
    missed = sum(each.collides and each.accepted for each in found)
    print(f"{len(found)} scenes: {len(found) - len(free)} collide, {missed} of them accepted")
    print(f"{len(free)} are free, {len(false)} of them rejected, with at most {used:.0%} of the bound for that")
    print(f"largest false rejection {1e3 * max((e.brute for e in false), default=0.0):.1f} mm")
    return int(any(each.wrong for each in found))


def compare(seed: int) -> Compared:
    """A random scene both ways."""
    rng = np.random.default_rng(seed)
    vehicle = random_vehicle(rng)
    path = random_drive(vehicle, rng)
    polygons = obstacles(vehicle, path, rng)
    brute = brute_clearance(vehicle, path, polygons)
    document = {"polygons": [polygon.tolist() for polygon in polygons]}
    data, drawn = dataclasses.asdict(vehicle), path_to_document(path)
    check = audit_recorded(data, document, drawn).checks["clearance"]
    truck, track = read_vehicle(data), read_path(drawn, "path")
    nothing = np.zeros((4, len(track.left)))
    bound = 2.0 * inflation(truck, track, nothing) + excess(truck, track)
    return Compared(
        seed=seed,
        collides=brute == 0.0,
        accepted=check.passed,
        brute=brute,
        audited=min(check.values.values()),
        bound=float(bound.max()),
    )


def random_vehicle(rng: np.random.Generator) -> Vehicle:
    """A combination of any usual size, its hitch on the axle or up to 0.8 m off it."""
    length = rng.uniform(3.0, 9.0)
    return Vehicle(
        wheelbase=rng.uniform(2.5, 5.0),
        hitch_to_axle=length,
        trailer_rear=length + rng.uniform(0.5, 5.0),
        hitch_offset=float(rng.choice([0.0, rng.uniform(-0.8, 0.8)])),
    )


def random_drive(vehicle: Vehicle, rng: np.random.Generator) -> Path:
    """One or two segments of 0.3 to 1.5 m, samples up to 0.1 m apart, steering as fast as it may."""
    state = np.array([*rng.uniform(-5, 5, 2), rng.uniform(-3, 3), rng.uniform(-1, 1) * 0.9 * vehicle.max_hitch])
    parts: list[Segment] = []
    for _ in range(int(rng.integers(1, 3))):
        gear = -parts[-1].direction if parts else int(rng.choice([-1, 1]))
        s = np.linspace(0.0, length := rng.uniform(0.3, 1.5), max(3, math.ceil(length / rng.uniform(0.05, 0.1)) + 1))
        steps = rng.uniform(-1, 1, len(s)) * vehicle.max_steer_rate * s[1]
        phi = np.clip(rng.uniform(-1, 1) * vehicle.max_steer + np.cumsum(steps), -vehicle.max_steer, vehicle.max_steer)
        parts.append(roll_out_segment(vehicle, state, gear, s, phi))
        state = parts[-1].states[-1]
    return Path(tuple(parts))


def obstacles(vehicle: Vehicle, path: Path, rng: np.random.Generator) -> list[np.ndarray]:
    """Triangles whose tips are -2 to 60 mm off the outline of what both bodies sweep."""
    states = np.concatenate([dense_states(vehicle, part, 1e-2) for part in path.segments])
    swept = shapely.union_all(shapely.polygons(body_corners(vehicle, states).reshape(-1, 4, 2)))
    outline = shapely.get_coordinates(shapely.get_exterior_ring(shapely.orient_polygons(swept)))
    starts = np.flatnonzero(np.hypot(*np.diff(outline, axis=0).T) > 1e-6)
    found = []
    for _ in range(int(rng.integers(1, 3))):
        side = int(rng.choice(starts))
        start, stop = outline[side : side + 2]
        along = (stop - start) / np.hypot(*(stop - start))
        outwards = np.array([along[1], -along[0]])
        gap = float(rng.choice([rng.uniform(-1e-3, 4e-3), rng.uniform(0.0, 0.06)]))
        tip = start + rng.uniform() * (stop - start) + gap * outwards
        width, depth = rng.uniform(1e-3, 0.3, 2)
        triangle = tip + np.outer([0, 1, 1], depth * outwards) + np.outer([0, -1, 1], width * along)
        if gap < 0.0 or not swept.intersects(shapely.Polygon(triangle)) or not found:
            found.append(triangle)
    return found


def dense_states(vehicle: Vehicle, part: Segment, step: float) -> Any:
    """States of a segment at most `step` apart, each interval from its stored start."""
    rows = [part.states[:1]]
    for k in range(part.num_samples - 1):
        s = np.linspace(part.s[k], part.s[k + 1], math.ceil((part.s[k + 1] - part.s[k]) / step) + 1)
        phi = np.interp(s, part.s, part.phi)
        rows.append(roll_out(vehicle, part.states[k], s, phi, part.direction)[1:])
    return np.concatenate(rows)


def brute_clearance(vehicle: Vehicle, path: Path, polygons: list[np.ndarray]) -> float:
    """Least distance of both bodies from the obstacles at poses 0.1 mm apart [m]; 0 on overlap."""
    areas = np.asarray(shapely.polygons(np.array(polygons)))
    shapely.prepare(areas)
    far = float(np.hypot(vehicle.outlines[..., 0], vehicle.outlines[..., 1]).max())
    turn = (math.sin(vehicle.max_hitch) + math.tan(vehicle.max_steer)) / min(vehicle.wheelbase, vehicle.hitch_to_axle)
    reach = COARSE * STEP * (1.0 + (far + abs(vehicle.hitch_offset)) * 2.0 * turn)
    least = math.inf
    for part in path.segments:
        states = dense_states(vehicle, part, STEP)
        coarse = _distances(vehicle, states[::COARSE], areas)
        near = np.flatnonzero(coarse <= coarse.min() + reach)
        rows = np.unique(np.clip(near[:, None] * COARSE + np.arange(-COARSE, COARSE + 1), 0, len(states) - 1))
        least = min(least, float(_distances(vehicle, states[rows], areas).min()))
    return least


def _distances(vehicle: Vehicle, states: Any, areas: Any) -> Any:
    """From the nearest obstacle, for each state the nearer body's [m]."""
    bodies = np.asarray(shapely.polygons(body_corners(vehicle, states).reshape(-1, 4, 2)))
    return shapely.distance(bodies[:, None], areas[None, :]).min(axis=1).reshape(-1, 2).min(axis=1)
