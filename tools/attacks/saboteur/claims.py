"""What kinds of sabotage are made of: each takes a sound claim and random numbers, and spoils it.

A claim is what `optim.audit.checks.audit_path` takes, by name, with arrays for the columns of paths; `as_json` gives
what a file would hold. Amounts are the tolerance of the check times `excess`: half of them 1.05, the rest up to 20.
"""

import copy
import dataclasses
import math
from collections.abc import Callable
from dataclasses import dataclass
from typing import Any

import numpy as np

from optim.audit.checks import Tolerances
from optim.audit.data import COLUMNS
from optim.model.objective import Weights, objective
from optim.model.path import Path
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle, body_corners

Claim = dict[str, Any]
Rng = np.random.Generator
Damage = Callable[[Claim, Rng], bool]
"""Changes a claim in place; False where that kind of damage cannot be done to it."""
TOLERANCES = Tolerances()


@dataclass(frozen=True, kw_only=True)
class Kind:
    """One kind of sabotage."""

    name: str
    check: str
    """The check that must notice."""
    alone: bool
    """No other check notices: without its own it passes."""
    damage: Damage


KINDS: list[Kind] = []


def kind(name: str, check: str, *, alone: bool = False) -> Callable[[Damage], Damage]:
    """Enters a kind into the list."""

    def enter(damage: Damage) -> Damage:
        KINDS.append(Kind(name=name, check=check, alone=alone, damage=damage))
        return damage

    return enter


def claim_of(vehicle: Vehicle, scene: Scene, recorded: Path, path: Path, weights: Weights) -> Claim:
    """The claim that `path` improves `recorded`, with its right J."""
    return {
        "vehicle": dataclasses.asdict(vehicle),
        "scene": {
            "polygons": [np.asarray(polygon) for polygon in scene.polygons],
            "boundary": None if scene.boundary is None else np.asarray(scene.boundary),
        },
        "recorded": _columns(recorded),
        "path": _columns(path),
        "weights": dataclasses.asdict(weights),
        "reported_objective": objective(path, weights),
    }


def _columns(path: Path) -> dict[str, Any]:
    parts = [
        {"direction": part.direction} | {key: np.array(getattr(part, key)) for key in COLUMNS} for part in path.segments
    ]
    return {"segments": parts}


def copied(claim: Claim) -> Claim:
    """A copy whose paths, vehicle, scene and weights can be changed."""
    scene = claim["scene"] | {"polygons": list(claim["scene"]["polygons"])}
    return (
        claim
        | {"scene": scene}
        | {key: copy.deepcopy(claim[key]) for key in ("vehicle", "path", "recorded", "weights")}
    )


def as_json(value: Any) -> Any:
    """Arrays to lists, and dictionaries of them."""
    if isinstance(value, np.ndarray):
        return value.tolist()
    if isinstance(value, dict):
        return {key: as_json(part) for key, part in value.items()}
    return [as_json(part) for part in value] if isinstance(value, list) else value


def excess(rng: Rng) -> float:
    """By what factor a tolerance is exceeded."""
    return 1.05 if rng.random() < 0.5 else float(rng.uniform(1.05, 20.0))


def segments(claim: Claim, path: str = "path") -> list[dict[str, Any]]:
    """Of the path of a claim, or of its recorded one; to be changed in place."""
    return claim[path]["segments"]


def some_segment(claim: Claim, rng: Rng, path: str = "path") -> dict[str, Any]:
    """One with an inner sample; likelier a long one."""
    parts = segments(claim, path)
    lengths = np.array([len(part["s"]) - 2.0 for part in parts])
    return parts[int(rng.choice(len(parts), p=lengths / lengths.sum()))]


def inner(part: dict[str, Any], rng: Rng) -> int:
    """A sample of a segment that is none of its ends."""
    return int(rng.integers(1, len(part["s"]) - 1))


def direction(rng: Rng) -> Any:
    """A unit vector, any way. Shape (2,)."""
    angle = rng.uniform(0.0, math.tau)
    return np.array([math.cos(angle), math.sin(angle)])


def sign(rng: Rng) -> int:
    """1 or -1."""
    return int(rng.choice([-1, 1]))


def states_of(part: dict[str, Any]) -> Any:
    """States of a segment at its samples. Shape (N, 4)."""
    return np.stack([part[key] for key in ("x", "y", "theta", "alpha")], axis=1)


def set_states(part: dict[str, Any], states: Any) -> None:
    """Give a segment other states (N, 4)."""
    for row, key in enumerate(("x", "y", "theta", "alpha")):
        part[key] = states[:, row].copy()


def vehicle_of(claim: Claim) -> Vehicle:
    """The vehicle that a claim names."""
    return Vehicle(**claim["vehicle"])


def corners(claim: Claim) -> Any:
    """Corners of both bodies at all samples. Shape (N, 2, 4, 2)."""
    states = np.concatenate([states_of(part) for part in segments(claim)])
    return body_corners(vehicle_of(claim), states)
