"""From a site to the path that its log holds: the map as a reader will see it, the plan, the logged poses."""

import dataclasses
import itertools
import math
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final, NamedTuple

import numpy as np

from optim.geometry.cover import cover_cells
from optim.model.path import sample_segment
from optim.model.scene import Scene, make_scene
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array
from optim.planning.closed_loop import ClosedLoopRrt
from optim.planning.hybrid import HybridAStar
from optim.planning.protocol import PlannedPath, Planner, PlanningProblem, place_flat
from optim.planning.rrt import Found, Rrt
from tools.corpus.grid import Cells, draw_grid
from tools.corpus.site import Site, footprints, ground
from tools.corpus.tables import kept_table

MAX_SEEDS = 100
"""Maximum number of searches for a site."""
MIN_EDGES = 4
"""Paths of fewer edges leave nothing to cut short."""
RRT: Final = Rrt()
PLANNERS: Final[Mapping[str, Planner]] = MappingProxyType(
    {
        planner.name: planner
        for planner in (
            ClosedLoopRrt(max_iterations=1500, table=kept_table),
            HybridAStar(max_nodes=120_000, table=kept_table),
        )
    }
)
"""The planners beside the RRT, which `build` uses; bounded by effort, never by time."""


class Poses(NamedTuple):
    """What the log says of the path, map frame. N poses; a cusp and a planner's node is one pose."""

    truck: Array  # (N, 3) rear axle x [m], y [m] and heading [rad]
    trailer: Array  # (N, 3) trailer axle x [m], y [m] and heading [rad]
    nodes: list[int]  # indices of the planner's nodes, start and goal included


@dataclass(frozen=True, eq=False, kw_only=True)
class Built:
    """A site with everything its log needs."""

    site: Site
    cells: Cells | None
    """The occupancy grid, or None where the log holds shapes."""
    poses: Poses
    seed: int
    """The planner's seed that gave the path."""
    iterations: int
    length: float
    """Distance driven by the truck's rear axle [m]."""
    num_cusps: int


def planner_vehicle(vehicle: Vehicle) -> Vehicle:
    """The vehicle with tighter limits: rounded poses, read back, then still keep the true ones."""
    return dataclasses.replace(
        vehicle,
        max_steer=0.92 * vehicle.max_steer,
        max_hitch=0.92 * vehicle.max_hitch,
        max_steer_rate=0.8 * vehicle.max_steer_rate,
    )


def planner_scene(site: Site, cells: Cells | None) -> Scene:
    """The obstacles as a reader of the log will see them, and the edge of the site's ground."""
    if cells is None:
        return make_scene(footprints(site), boundary=ground(site))
    return make_scene(cover_cells(cells.blocked, cells.resolution, cells.origin), boundary=ground(site))


def problem_of(site: Site, cells: Cells | None) -> PlanningProblem:
    """The site as planners take it."""
    start, goal = (place_flat(flat, site.pose) for flat in (site.start, site.goal))
    return PlanningProblem(
        vehicle=planner_vehicle(site.vehicle),
        scene=planner_scene(site, cells),
        start=start,
        goal=goal,
        areas=site.areas,
        pose=site.pose,
        margin=site.clearance,
    )


class _Drive(NamedTuple):
    """What a planner found for a site."""

    poses: Poses
    iterations: int
    length: float  # [m]
    num_cusps: int


def build(site: Site, planner: Rrt = RRT, max_seeds: int = MAX_SEEDS) -> Built:
    """Plan the site's path by the RRT; seeds are tried in order until one gives a path within the site's ranges.

    Raises RuntimeError when none does.
    """
    cells = draw_grid(site)
    problem = problem_of(site, cells)

    def drive(seed: int) -> _Drive | None:
        found = planner.search(problem, seed)
        if found is None or len(found.edges) < MIN_EDGES:
            return None
        length = sum(edge.truck_length for edge in found.edges)
        return _Drive(logged_poses(found, site.spacing), found.iterations, length, num_cusps(found))

    return _first_wanted(site, cells, drive, max_seeds)


def build_with(site: Site, max_seeds: int = MAX_SEEDS) -> Built:
    """As `build`, by the planner that the site names, without a least number of edges."""
    cells = draw_grid(site)
    problem, planner = problem_of(site, cells), PLANNERS[site.planner]

    def drive(seed: int) -> _Drive | None:
        found = planner.plan(problem, seed)
        if found is None:
            return None
        poses = poses_of_plan(problem.vehicle, found, site.spacing)
        return _Drive(poses, found.effort, found.path.length, found.path.num_cusps)

    return _first_wanted(site, cells, drive, max_seeds)


def _first_wanted(site: Site, cells: Cells | None, drive: Callable[[int], _Drive | None], max_seeds: int) -> Built:
    """The first drive within the site's ranges. Raises RuntimeError where no seed gives one."""
    for seed in range(site.seed, site.seed + max_seeds):
        found = drive(seed)
        if found is None:
            continue
        if site.length[0] <= found.length <= site.length[1] and site.cusps[0] <= found.num_cusps <= site.cusps[1]:
            return Built(
                site=site,
                cells=cells,
                poses=_with_noise(found.poses, site),
                seed=seed,
                iterations=found.iterations,
                length=found.length,
                num_cusps=found.num_cusps,
            )
    last = site.seed + max_seeds - 1
    raise RuntimeError(f"{site.name}: {site.planner} has no path with seeds {site.seed} to {last}")


def poses_of_plan(vehicle: Vehicle, plan: PlannedPath, spacing: float) -> Poses:
    """Poses at equal distances between the planner's nodes, rounded as those of `logged_poses`."""
    states, nodes, begin = [], [0], 0.0
    for segment in plan.path.segments:
        inside = plan.nodes[(plan.nodes > begin + 1e-6) & (plan.nodes < begin + segment.length - 1e-6)] - begin
        stops = [0.0, *inside.tolist(), segment.length]
        for a, b in itertools.pairwise(stops):
            count = max(1, math.ceil((b - a) / spacing - 1e-9))
            found, _ = sample_segment(vehicle, segment, np.linspace(a, b, count + 1))
            states.append(found if not states else found[1:])
            nodes.append(nodes[-1] + count)
        begin += segment.length
    x, y, theta, alpha = np.concatenate(states).T
    heading, l_t = theta + alpha, vehicle.hitch_to_axle
    trailer = np.stack([x - l_t * np.cos(heading), y - l_t * np.sin(heading), heading], axis=1)
    return Poses(_rounded([np.stack([x, y, theta], axis=1)]), _rounded([trailer]), nodes)


def num_cusps(found: Found) -> int:
    """Gear changes between the edges."""
    gears = [edge.direction for edge in found.edges]
    return sum(a != b for a, b in itertools.pairwise(gears))


def logged_poses(found: Found, spacing: float) -> Poses:
    """Poses at equal distances within each edge, rounded to 1e-6 m and 1e-7 rad."""
    truck, trailer, nodes = [], [], [0]
    for edge in found.edges:
        keep = slice(0 if not truck else 1, None)
        flat, states = edge.flat(spacing), edge.sample(spacing).states
        trailer.append(flat[keep, :3])
        truck.append(states[keep, :3])
        nodes.append(nodes[-1] + len(flat) - 1)
    return Poses(_rounded(truck), _rounded(trailer), nodes)


def _with_noise(poses: Poses, site: Site) -> Poses:
    """The poses as a localisation would have them."""
    if site.pose_noise == 0.0:
        return poses
    rng = np.random.default_rng(site.noise)
    scale = site.pose_noise * np.array([1.0, 1.0, 0.26])
    truck, trailer = (each + scale * rng.standard_normal(each.shape) for each in (poses.truck, poses.trailer))
    return Poses(_rounded([truck]), _rounded([trailer]), poses.nodes)


def _rounded(parts: list[Array]) -> Array:
    poses = np.concatenate(parts)
    heading = np.mod(poses[:, 2] + math.pi, 2.0 * math.pi) - math.pi
    return np.column_stack([np.round(poses[:, :2], 6), np.round(heading, 7)]) + 0.0
