"""Metrics of a path, from whatever method: the yardstick of `replay.results/1`, under its key `metrics`."""

from dataclasses import dataclass
from typing import Final

import numpy as np

from optim.model.objective import Weights, cusp_jumps, objective
from optim.model.path import Path
from optim.model.problem import path_clearance
from optim.model.scene import Scene
from optim.model.vehicle import Vehicle


@dataclass(frozen=True, kw_only=True)
class Metrics:
    """All metrics of one path; NaN where a results file of an older version lacks one."""

    objective: float
    """J [-]."""
    length: float
    """Distance driven by the truck's rear axle [m]."""
    trailer_length: float
    """Distance driven by the trailer's axle [m]."""
    reverse_length: float
    """Part of `length` driven in reverse [m]."""
    cusps: int
    """Number of gear changes."""
    max_abs_phi: float
    """Largest steering angle [rad]."""
    max_abs_alpha: float
    """Largest hitch angle [rad]."""
    max_abs_kappa: float
    """Largest curvature of the trailer axle's path [1/m]."""
    max_abs_dphi_ds: float
    """Largest steering rate [rad/m]."""
    steering_effort: float
    """Integral of phi^2 over the length [rad^2 m]."""
    steering_variation: float
    """Integral of |dphi/ds| over the length, and the jumps at gear changes [rad]."""
    min_clearance: float
    """Least distance of both swept bodies from every obstacle [m]; inf in an empty scene, negative on overlap."""


UNITS: Final = {
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
"""Unit of each field of `Metrics`, in their order."""


def metrics(vehicle: Vehicle, scene: Scene, path: Path, weights: Weights) -> Metrics:
    """Measure a path."""
    samples = path.samples
    slopes = [np.diff(seg.phi) / np.diff(seg.s) for seg in path.segments]
    return Metrics(
        objective=objective(path, weights),
        length=path.length,
        trailer_length=path.trailer_length,
        reverse_length=float(sum(seg.length for seg in path.segments if seg.direction < 0)),
        cusps=path.num_cusps,
        max_abs_phi=float(np.abs(samples.phi).max()),
        max_abs_alpha=float(np.abs(samples.states[:, 3]).max()),
        max_abs_kappa=float(np.tan(np.abs(samples.states[:, 3])).max() / vehicle.hitch_to_axle),
        max_abs_dphi_ds=float(max(np.abs(slope).max() for slope in slopes)),
        steering_effort=objective(path, Weights(length=0, steer=1, rate=0, cusp=0, jump=0)),
        steering_variation=float(sum(np.abs(np.diff(seg.phi)).sum() for seg in path.segments))
        + float(np.abs(cusp_jumps(path)).sum()),
        min_clearance=path_clearance(vehicle, scene, path),
    )
