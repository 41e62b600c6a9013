"""Logs with wrong or missing parts, and one that cannot be improved: what must come of each is stated here."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from types import MappingProxyType
from typing import Final

import numpy as np

from optim.model.flat_map import state_from_flat
from optim.model.vehicle import Vehicle
from optim.planning.protocol import Area
from optim.steering.flat import Flat
from tools.corpus.build import Built, Poses, build
from tools.corpus.site import Box, Shapes, Site
from tools.corpus.write import to_bytes

_BASE = Site(
    name="odd",
    title="open ground",
    special="",
    obstacles=(Box(x=0.0, y=-9.0, length=12.0, width=2.5, yaw=0.2, kind="container"),),
    bounds=(-40.0, -20.0, 40.0, 20.0),
    start=Flat(-24.0, 0.0, 0.0, 0.0),
    goal=Flat(-10.0, 6.0, 0.0, 0.0),
    areas=(Area(box=(-25.0, -14.0, 25.0, 14.0)),),
    map=Shapes(),
    length=(20.0, 200.0),
    seed=3,
    noise=500,
)


@dataclass(frozen=True, kw_only=True)
class Odd:
    """One such log."""

    title: str
    expect: str
    """improved, kept, or the code of the error."""
    write: Callable[[Built], bytes]


def _without(*parts: str) -> Callable[[Built], bytes]:
    return lambda built: to_bytes(built, without=parts)


def _moved(change: Callable[[np.ndarray], None]) -> Callable[[Built], bytes]:
    """The log with other truck poses."""

    def write(built: Built) -> bytes:
        truck = built.poses.truck.copy()
        change(truck)
        return to_bytes(dataclasses.replace(built, poses=built.poses._replace(truck=truck)), without=("trailer",))

    return write


def _with_nan(truck: np.ndarray) -> None:
    truck[7, 0] = np.nan


def _in_millimetres(truck: np.ndarray) -> None:
    truck[:, :2] *= 1000.0


def _with_a_jump(truck: np.ndarray) -> None:
    truck[len(truck) // 2 :, 1] += 5.0


def _start_blocked(built: Built) -> bytes:
    x, y, _ = built.poses.truck[0].tolist()
    box = Box(x=x, y=y, length=3.0, width=3.0, kind="container")
    site = dataclasses.replace(built.site, obstacles=(*built.site.obstacles, box))
    return to_bytes(dataclasses.replace(built, site=site))


def _negative_wheelbase(built: Built) -> bytes:
    return to_bytes(built, vehicle_changes={"wheelbase": "-3.6"})


def _cut(share: float) -> Callable[[Built], bytes]:
    def write(built: Built) -> bytes:
        data = to_bytes(built)
        return data[: round(share * len(data))]

    return write


def _straight(built: Built) -> bytes:
    """A straight drive between the two ends of a line: nothing is shorter."""
    s = np.arange(0.0, 30.0 + 1e-9, 0.25)
    flats = np.stack([s - 20.0, np.zeros_like(s), np.zeros_like(s), np.zeros_like(s), np.zeros_like(s)], axis=1)
    states, _ = state_from_flat(Vehicle(), flats)
    poses = Poses(states[:, :3].round(6), flats[:, :3], [0, len(s) - 1])
    return to_bytes(dataclasses.replace(built, poses=poses, length=30.0, num_cusps=0))


ODD: Final[Mapping[str, Odd]] = MappingProxyType(
    {
        "odd_no_map": Odd(title="no map", expect="E_NO_MAP", write=_without("map")),
        "odd_no_path": Odd(title="no path", expect="E_NO_PATH", write=_without("plan", "trailer")),
        "odd_nan": Odd(title="a pose that is no number", expect="E_NONFINITE", write=_moved(_with_nan)),
        "odd_millimetres": Odd(title="a path in millimetres", expect="E_RANGE", write=_moved(_in_millimetres)),
        "odd_jump": Odd(title="a path that jumps by 5 m", expect="E_PATH_DISCONTINUOUS", write=_moved(_with_a_jump)),
        "odd_blocked": Odd(title="start inside an obstacle", expect="E_START_COLLISION", write=_start_blocked),
        "odd_vehicle": Odd(title="a negative wheelbase", expect="E_VEHICLE", write=_negative_wheelbase),
        "odd_cut": Odd(title="cut off in its only chunk", expect="E_TRUNCATED", write=_cut(0.4)),
        "odd_tail": Odd(title="cut off in its index", expect="improved", write=_cut(0.97)),
        "odd_straight": Odd(title="a straight drive", expect="kept", write=_straight),
    }
)


def make_odd(name: str) -> tuple[Built, bytes]:
    """What an odd log was made of, and its bytes."""
    built = build(dataclasses.replace(_BASE, name=name))
    return built, ODD[name].write(built)
