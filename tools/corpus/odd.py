"""Logs with wrong or missing parts, and one that cannot be improved: `scenes/odd.toml` says what each is to give."""

import dataclasses
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import cache
from types import MappingProxyType

import numpy as np

from optim.model.flat_map import state_from_flat
from optim.model.vehicle import Vehicle
from tools.corpus.build import Built, Poses, build
from tools.corpus.read import read, site_of
from tools.corpus.site import Box
from tools.corpus.write import to_bytes


@dataclass(frozen=True, kw_only=True)
class Odd:
    """One such log."""

    title: str
    expect: str
    """improved, kept, or the code of the error."""
    without: tuple[str, ...] = ()
    """Parts that are left out."""
    vehicle: Mapping[str, str] | None = None
    """Values of the vehicle's record that are replaced."""
    keep: float = 1.0
    """Share of the bytes that are kept."""
    spoil: str = ""
    """What is done to the built site before: a function of `SPOILT`."""


@cache
def odd_logs() -> Mapping[str, Odd]:
    """All of them by name."""
    return MappingProxyType({name: Odd(**fields) for name, fields in read("odd")["logs"].items()})


def make_odd(name: str) -> tuple[Built, bytes]:
    """What an odd log was made of, and its bytes."""
    odd, built = odd_logs()[name], build(site_of(name, read("odd")["base"]))
    spoilt = SPOILT[odd.spoil](built) if odd.spoil else built
    data = to_bytes(spoilt, without=odd.without, vehicle_changes=odd.vehicle)
    return built, data[: round(odd.keep * len(data))]


def _moved(built: Built, change: Callable[[np.ndarray], None]) -> Built:
    """The site with other truck poses."""
    truck = built.poses.truck.copy()
    change(truck)
    return dataclasses.replace(built, poses=built.poses._replace(truck=truck))


def with_nan(built: Built) -> Built:
    def change(truck: np.ndarray) -> None:
        truck[7, 0] = np.nan

    return _moved(built, change)


def in_millimetres(built: Built) -> Built:
    def change(truck: np.ndarray) -> None:
        truck[:, :2] *= 1000.0

    return _moved(built, change)


def with_a_jump(built: Built) -> Built:
    def change(truck: np.ndarray) -> None:
        truck[len(truck) // 2 :, 1] += 5.0

    return _moved(built, change)


def start_blocked(built: Built) -> Built:
    x, y, _ = built.poses.truck[0].tolist()
    box = Box(x=x, y=y, length=3.0, width=3.0, kind="container")
    site = dataclasses.replace(built.site, obstacles=(*built.site.obstacles, box))
    return dataclasses.replace(built, site=site)


def straight(built: Built) -> Built:
    """A straight drive between the two ends of a line: nothing is shorter."""
    s = np.arange(0.0, 30.0 + 1e-9, 0.25)
    flats = np.stack([s - 20.0, np.zeros_like(s), np.zeros_like(s), np.zeros_like(s), np.zeros_like(s)], axis=1)
    states, _ = state_from_flat(Vehicle(), flats)
    poses = Poses(states[:, :3].round(6), flats[:, :3], [0, len(s) - 1])
    return dataclasses.replace(built, poses=poses, length=30.0, num_cusps=0)


SPOILT = {each.__name__: each for each in (with_nan, in_millimetres, with_a_jump, start_blocked, straight)}
