"""Runs to draw: a truck that reverses between parked trailers, and methods that hand over paths prepared here."""

import dataclasses
import functools
import math
import pathlib
from collections.abc import Mapping, Sequence

import numpy as np

from optim.model.kinematics import roll_out
from optim.model.method import Method
from optim.model.objective import objective
from optim.model.path import Path, Segment, merge, reverse, roll_out_segment, segment_from_states
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from optim.model.scene import Scene, make_scene
from optim.model.vehicle import Vehicle
from replay.run.case import Case, MapImage, ReadReport
from replay.run.judge import run_case
from replay.run.outcome import Run

VEHICLE = Vehicle()
START = np.array([-21.0, 27.0, 0.0, 0.0])
GOAL = np.array([0.0, 13.2, np.pi / 2, 0.0])
RESIDUALS = ("defect", "violation", "step")
BAY = 3.7  # [m] between parked trailers


def box(x: float, y: float, length: float, width: float, yaw: float = 0.0) -> np.ndarray:
    """A rectangle round (x, y), counter-clockwise. Shape (4, 2)."""
    corners = np.array([[-length, -width], [length, -width], [length, width], [-length, width]]) / 2
    c, s = np.cos(yaw), np.sin(yaw)
    return corners @ np.array([[c, s], [-s, c]]) + [x, y]


@functools.cache
def yard() -> Scene:
    """Eight trailers in their bays, two parked trucks and a kiosk inside four walls."""
    parked = [box(k * BAY, 7.6, 13.6, 2.55, np.pi / 2) for k in (-4, -3, -2, -1, 1, 2, 3, 4)]
    others = [box(-20.0, 43.0, 6.0, 2.5, 0.2), box(27.0, 20.0, 2.5, 6.0, 0.4), box(-28.0, 10.0, 5.0, 5.0)]
    boundary = np.array([[-36.0, 0.0], [38.0, 0.0], [38.0, 50.0], [-36.0, 50.0]])
    return make_scene([*parked, *others], boundary=boundary)


def steer_to(start: np.ndarray, end: np.ndarray, wiggle: float, seed: int) -> Segment:
    """A forward segment between two states, found by Newton's method on twelve steering angles and the length."""
    rng = np.random.default_rng(seed)
    unknown = np.append(wiggle * rng.uniform(-1.0, 1.0, 12), 1.05 * np.hypot(*(end - start)[:2]))

    def drive(values: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        s = np.linspace(0.0, values[-1], 600)
        return s, np.interp(s, np.linspace(0.0, values[-1], 14), np.concatenate([[0.0], values[:-1], [0.0]]))

    def miss(values: np.ndarray) -> np.ndarray:
        return roll_out(VEHICLE, start, *drive(values), 1)[-1] - end

    for _ in range(60):
        error = miss(unknown)
        if np.abs(error).max() < 1e-12:
            break
        jacobian = np.stack([(miss(unknown + h) - error) / 1e-6 for h in 1e-6 * np.eye(len(unknown))], axis=1)
        step = -np.linalg.pinv(jacobian) @ error
        unknown = unknown + step * min(1.0, 0.2 / np.abs(step[:-1]).max())
    s, phi = drive(unknown)
    states = roll_out(VEHICLE, start, s, phi, 1)
    states[-1] = end  # a cusp is the same numbers on both sides
    return segment_from_states(1, s, states, phi)


@functools.cache
def manoeuvre(reach: float, turn: float, wiggle: float = 0.0, seed: int = 0) -> Path:
    """Forward past the bay, then back into it: `reach` [m] past the bend before the cusp, sharper `turn` [rad]."""
    lengths = np.cumsum([0.0, 7.0, 4.0, 15.0 * 0.32 / turn, 4.0, reach])
    angles = np.array([0.0, 0.0, -turn, -turn, 0.0, 0.0])
    s = np.linspace(0.0, lengths[-1], 700)
    rng = np.random.default_rng(seed)
    noise = np.interp(s, np.linspace(0.0, lengths[-1], 14), [0.0, *(0.6 * wiggle * rng.uniform(-1.0, 1.0, 12)), 0.0])
    out = roll_out_segment(VEHICLE, GOAL, 1, s, np.interp(s, lengths, angles) + noise)
    approach = steer_to(START, out.states[-1], wiggle, seed)
    return merge([approach, *reverse(Path((out,))).segments])


def with_retrace(path: Path, count: int) -> Path:
    """The path with two more gear changes: part of its last segment is driven twice more, forth and back."""
    last = path.segments[-1]
    head, tail = _split(last, count)
    again, _ = _split(reverse(Path((head,))).segments[0], count // 2)
    back = reverse(Path((again,)))
    return merge([*path.segments[:-1], head, again, *back.segments, tail])


def _split(segment: Segment, at: int) -> tuple[Segment, Segment]:
    def part(rows: slice) -> Segment:
        values = {name: getattr(segment, name)[rows] for name in ("s", "x", "y", "theta", "alpha", "phi")}
        return Segment(direction=segment.direction, **values | {"s": values["s"] - values["s"][0]})

    return part(slice(None, at + 1)), part(slice(at, None))


class Prepared:
    """A method that hands over what it was given; not a dataclass, since its fields are not options."""

    def __init__(
        self,
        path: Path | None = None,
        iterates: Sequence[Path] = (),
        stop: Stop = Stop.CONVERGED,
        reason: str = "No shorter connection was found in 200 attempts.",
        violation: float = 0.0,
    ) -> None:
        self.path, self.iterates = path, iterates
        self.stop, self.reason, self.violation = stop, reason, violation

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        paths = [*self.iterates, *([self.path] if self.path is not None else [])]
        for k, path in enumerate(paths):
            violation = self.violation * 0.5**k
            on_iterate(
                Iterate(iteration=3 * k, path=path, objective=objective(path, problem.weights), violation=violation)
            )
        return Result(path=self.path or problem.recorded, stop=self.stop, reason=self.reason, iterations=3 * len(paths))


class Iterative:
    """A method as SCP is one: accepted steps with residuals, a trust region and solver times, and rejected trials.

    Every third iteration is such a trial; its path and its J are the result's, which nothing should show early.
    """

    def __init__(self, path: Path, iterates: Sequence[Path], seed: int = 0, names: Sequence[str] = RESIDUALS) -> None:
        self.path, self.iterates, self.seed, self.names = path, iterates, seed, names

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        rng = np.random.default_rng(self.seed)
        paths, radius, number = [*self.iterates, self.path], 1.0, 0
        for k, path in enumerate(paths):
            turned_down = k % 2 == 1
            for accepted in (False, True) if turned_down else (True,):
                sizes = 10.0 ** (3.0 - 4.0 * k / len(paths) - 0.4 * np.arange(len(self.names)) + 0.3 * rng.normal())
                radius *= 1.3 if accepted else 0.4
                shown = path if accepted else self.path
                on_iterate(
                    Iterate(
                        iteration=number,
                        path=shown,
                        objective=objective(shown, problem.weights),
                        violation=0.5 * 0.3**k,
                        step=radius,
                        residuals=dict(zip(self.names, sizes.tolist(), strict=True)),
                        accepted=accepted,
                        trust_region=radius if number else 1.0,
                        solver_s=0.02 + 0.004 * rng.random() if number else math.nan,
                    )
                )
                number += 1
        return Result(path=self.path, stop=Stop.CONVERGED, reason="All residuals are small.", iterations=number - 1)


@functools.cache
def recorded_path() -> Path:
    return with_retrace(manoeuvre(15.0, 0.30, wiggle=0.06, seed=3), 300)


def towards(best: tuple[float, float], num: int) -> list[Path]:
    """Manoeuvres on the way from the recorded one to the best one."""
    shares = np.linspace(0.0, 1.0, num)
    return [manoeuvre(15.0 + w * (best[0] - 15.0), 0.30 + w * (best[1] - 0.30), 0.06 * (1 - w), seed=3) for w in shares]


def grid(scene: Scene, resolution: float = 0.2) -> MapImage:
    """The scene as an occupancy grid with a patch of unknown cells."""
    cells = np.zeros((260, 380), np.int8)
    y, x = np.mgrid[0:260, 0:380] * resolution + resolution / 2
    x, y = x - 37.0, y - 1.0
    for polygon in scene.polygons:
        inside = np.ones(cells.shape, bool)
        for a, b in zip(polygon, np.roll(polygon, -1, axis=0), strict=True):
            inside &= (b[0] - a[0]) * (y - a[1]) - (b[1] - a[1]) * (x - a[0]) >= 0.0
        cells[inside] = 100
    cells[:60, :40] = -1
    cells.flags.writeable = False
    return MapImage(cells=cells, resolution=resolution, origin=(-37.0, -1.0, 0.0))


def case(
    scene: Scene | None = None, recorded: Path | None = None, name: str = "bay_01/0", with_grid: bool = False
) -> Case:
    scene = scene if scene is not None else yard()
    recorded = recorded if recorded is not None else recorded_path()
    read = ReadReport(
        poses=412,
        hitch="reconstructed",
        max_deviation_m=0.012,
        max_deviation_rad=0.004,
        notes=("The hitch angle was integrated from the first pose, which was taken as 0.",),
    )
    return Case(
        name=name,
        log=pathlib.Path("bay_01.mcap"),
        sha256="5f" * 32,
        problem=Problem(vehicle=VEHICLE, scene=scene, recorded=recorded),
        read=read,
        map=grid(scene) if with_grid else None,
        frame="map",
    )


def make_run(methods: Mapping[str, Method] | None = None, **case_options: object) -> Run:
    """A run of the prepared methods; one that improves the path by default."""
    chosen = methods if methods is not None else {"shortcut": Prepared(manoeuvre(8.0, 0.34), towards((8.0, 0.34), 8))}
    run = run_case(case(**case_options), chosen)  # pyright: ignore[reportArgumentType]
    return dataclasses.replace(run, options={name: {"attempts": 200, "spacing": 0.05} for name in chosen})
