"""Scenes and vehicles from the files in `tools/corpus/scenes`; `sample.toml` says how a scene is written."""

import math
import tomllib
from collections.abc import Iterator, Mapping
from functools import cache
from pathlib import Path
from types import MappingProxyType
from typing import Any

from optim.model.vehicle import Vehicle
from optim.planning.protocol import Area
from optim.steering.flat import Flat
from tools.corpus.site import (
    Block,
    Box,
    Grid,
    Obstacle,
    Shapes,
    Site,
    Wall,
    backed_up,
    parked_combination,
    parked_trailer,
)

FOLDER = Path(__file__).resolve().parent / "scenes"


@cache
def vehicles() -> Mapping[str, Vehicle]:
    """All vehicles by name."""
    return MappingProxyType({name: Vehicle(**fields) for name, fields in read("vehicles").items()})


@cache
def sites(file: str) -> Mapping[str, Site]:
    """The scenes of a file by name, in its order."""
    scenes = read(file)
    defaults = scenes.pop("defaults", {})
    return MappingProxyType(
        {name: site_of(name, defaults | scenes.get(scene.get("like"), {}) | scene) for name, scene in scenes.items()}
    )


def read(file: str) -> dict[str, Any]:
    """The content of a file, with tuples for arrays and radians for angles in degrees."""
    return _plain(tomllib.loads((FOLDER / f"{file}.toml").read_text(encoding="utf-8")))


def site_of(name: str, scene: Mapping[str, Any]) -> Site:
    """A scene as a site. Raises TypeError or ValueError where keys are missing or not known."""
    fields = {key: value for key, value in scene.items() if key not in ("like", "grid", "removed")}
    vehicle, goal = vehicles()[scene.get("vehicle", "default")], scene["goal"]
    removed = tuple(box for entry in scene.get("removed", ()) for box in _boxes(**entry))
    given = {
        "special": scene.get("special", ""),
        "vehicle": vehicle,
        "obstacles": tuple(obstacle for entry in scene["obstacles"] for obstacle in obstacles_of(entry)),
        "start": _flat(*scene["start"]),
        "goal": backed_up(*goal["rear"], vehicle=vehicle) if isinstance(goal, dict) else _flat(*goal),
        "areas": tuple(Area(**area) for area in scene["areas"]),
        "map": _grid(**scene["grid"]) if "grid" in scene else Shapes(removed=removed),
    }
    return Site(name=name, **(fields | given))


def obstacles_of(entry: Mapping[str, Any]) -> Iterator[Obstacle]:
    """The obstacles of one entry."""
    match entry:
        case {"boxes": _}:
            yield from _boxes(**entry)
        case {"wall": points, **rest}:
            yield Wall(points=points, **rest)
        case {"block": points}:
            yield Block(points=points)
        case {"rectangle": (x0, y0, x1, y1)}:
            yield Block(points=((x0, y0), (x1, y0), (x1, y1), (x0, y1)))
        case {"parked": "trailer", "at": places, **rest}:
            yield from (parked_trailer(x, y, **rest) for x, y in places)
        case {"parked": "combination", "at": places, **rest}:
            for x, y in places:
                yield from parked_combination(x, y, **rest)
        case _:
            raise ValueError(
                f"an obstacle has the keys {', '.join(entry)}, expected boxes, wall, block, rectangle, parked"
            )


def _boxes(boxes: tuple[tuple[float, ...], ...], **rest: Any) -> Iterator[Box]:
    for x, y, length, width, *yaw in boxes:
        yield Box(x=x, y=y, length=length, width=width, yaw=yaw[0] if yaw else 0.0, **rest)


def _grid(unknown: tuple[Mapping[str, Any], ...] = (), **fields: Any) -> Grid:
    return Grid(unknown=tuple(box for entry in unknown for box in _boxes(**entry)), **fields)


def _flat(x: float, y: float, heading: float, curvature: float = 0.0) -> Flat:
    return Flat(x, y, heading, curvature)


def _plain(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _plain(part) for key, part in value.items()}
    if isinstance(value, list):
        return tuple(map(_plain, value))
    if isinstance(value, str) and value.endswith(" deg"):
        return math.radians(float(value.removesuffix(" deg")))
    return value
