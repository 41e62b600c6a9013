"""Small logs, as many as are wanted: a short wavy drive past two boxes, so that a method has something to gain.

The same number gives the same log. Every tenth is cut off after a third, as logs are that a crash ended.
"""

import math
import pathlib

import numpy as np

from optim.model.flat_map import flat_from_state
from optim.model.kinematics import roll_out
from optim.model.vehicle import Vehicle
from optim.steering.flat import Flat
from tools.corpus.build import Built, Poses
from tools.corpus.site import Box, Shapes, Site
from tools.corpus.write import to_bytes

VEHICLE = Vehicle()
CUT_EVERY = 10
LIST_HEAD = 'schema = "replay.corpus/1"\n'


def write_corpus(folder: pathlib.Path, count: int, *, refused: bool = False) -> None:
    """A folder of small logs with their list; `refused`: all of them the same one, cut off."""
    folder.mkdir(parents=True, exist_ok=True)
    lines = [LIST_HEAD]
    same = small_log(0)
    for number in range(count):
        name, content = f"small_{number:05d}", same if refused else small_log(number)
        cut = refused or number % CUT_EVERY == CUT_EVERY - 1
        (folder / f"{name}.mcap").write_bytes(content[: len(content) // 3] if cut else content)
        expect = "E_TRUNCATED" if cut else "improved"
        lines.append(f'[logs.{name}]\nclass = "small"\nexpect = "{expect}"\n')
    (folder / "corpus.toml").write_text("\n".join(lines))


def small_log(number: int) -> bytes:
    """The bytes of one log."""
    rng = np.random.default_rng(number)
    length = rng.uniform(6.0, 10.0)
    s = np.linspace(0.0, length, 60)
    steer = rng.uniform(0.1, 0.2) * np.sin(2.0 * math.pi * s / length * rng.integers(1, 3))
    states = roll_out(VEHICLE, np.array([0.0, 0.0, rng.uniform(-math.pi, math.pi), 0.0]), s, steer, 1)
    axle = flat_from_state(VEHICLE, states, steer)[:, :3]
    chosen = np.unique(np.r_[0 : len(s) : 2, len(s) - 1])
    poses = Poses(truck=states[chosen, :3], trailer=axle[chosen], nodes=[0, len(chosen) // 2, len(chosen) - 1])
    return to_bytes(
        Built(site=_site(number, states), cells=None, poses=poses, seed=0, iterations=0, length=length, num_cusps=0)
    )


def _site(number: int, states: np.ndarray) -> Site:
    """Two boxes, one on either side of the drive."""
    x, y, heading, _ = states[len(states) // 2]
    across = np.array([-math.sin(heading), math.cos(heading)])
    boxes = tuple(
        Box(x=x + side * 4.5 * across[0], y=y + side * 4.5 * across[1], length=4.0, width=2.0, yaw=heading, kind="car")
        for side in (1.0, -1.0)
    )
    flat = flat_from_state(VEHICLE, states, np.zeros(len(states)))
    ends = [Flat(float(q[0]), float(q[1]), float(q[2]), 0.0, 0.0) for q in (flat[0], flat[-1])]
    return Site(
        name=f"small_{number:05d}",
        title="short drive",
        special="",
        obstacles=boxes,
        bounds=(-40.0, -40.0, 40.0, 40.0),
        start=ends[0],
        goal=ends[1],
        areas=(),
        map=Shapes(),
        noise=number % 24,
    )
