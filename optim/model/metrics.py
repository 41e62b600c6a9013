"""The yardstick for every path, from whatever method: the keys of `metrics` in the results file."""

import numpy as np

from optim.model.objective import Weights, cusp_jumps, objective
from optim.model.path import Path
from optim.model.problem import path_clearance
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle

UNITS = {
    "objective": "-",
    "length": "m",
    "trailer_length": "m",
    "reverse_length": "m",
    "cusps": "-",
    "max_abs_phi": "rad",
    "max_abs_alpha": "rad",
    "max_abs_kappa": "1/m",
    "max_abs_dphi_ds": "rad/m",
    "steering_effort": "rad^2 m",
    "steering_variation": "rad",
    "min_clearance": "m",
}
"""The metrics and their units."""


def metrics(vehicle: Vehicle, scene: Scene, path: Path, weights: Weights) -> dict[str, float]:
    """Every metric of a path by name; `UNITS` has the units. `min_clearance` is inf in an empty scene."""
    samples = path.samples
    slopes = [np.diff(seg.phi) / np.diff(seg.s) for seg in path.segments]
    return {
        "objective": objective(path, weights),
        "length": path.length,
        "trailer_length": path.trailer_length,
        "reverse_length": float(sum(seg.length for seg in path.segments if seg.direction < 0)),
        "cusps": path.num_cusps,
        "max_abs_phi": float(np.abs(samples.phi).max()),
        "max_abs_alpha": float(np.abs(samples.states[:, 3]).max()),
        "max_abs_kappa": float(np.tan(np.abs(samples.states[:, 3])).max() / vehicle.hitch_to_axle),
        "max_abs_dphi_ds": float(max(np.abs(slope).max() for slope in slopes)),
        "steering_effort": objective(path, Weights(length=0, steer=1, rate=0, cusp=0, jump=0)),
        "steering_variation": float(sum(np.abs(np.diff(seg.phi)).sum() for seg in path.segments))
        + float(np.abs(cusp_jumps(path)).sum()),
        "min_clearance": path_clearance(vehicle, scene, path),
    }
