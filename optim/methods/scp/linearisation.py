"""Data of the sub-problem: everything about the knots that is linear or quadratic in a small step, scaled.

Scaled units: positions in `Scales.length`, angles in `Scales.angle`, step lengths in `Scales.step`, J in
`Scales.cost`; everything is then of order one whatever the size of vehicle and map.
"""

from dataclasses import dataclass
from functools import cached_property

import numpy as np

from optim.knots.transcription import Knots, defects, dynamics_curvature, objective_gradient
from optim.model.clearance import Separations, separations
from optim.model.objective import Weights
from optim.model.problem import Problem
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64, frozen

_LEAST_CURVATURE = 1e-4  # of every direction in scaled units; keeps step lengths from drifting along flat valleys


@dataclass(frozen=True, kw_only=True)
class Scales:
    """Units of the sub-problem."""

    length: float
    """Unit of positions [m]."""
    angle: float
    """Unit of headings, hitch and steering angles [rad]."""
    step: float
    """Unit of step lengths [m]."""
    cost: float
    """Unit of J [-]."""

    @cached_property
    def state(self) -> Array:
        """Shape (4,)."""
        return frozen([self.length, self.length, self.angle, self.angle])

    @cached_property
    def block(self) -> Array:
        """Units of (theta, alpha, phi_k, phi_{k+1}, h). Shape (5,)."""
        return frozen([self.angle] * 4 + [self.step])

    @staticmethod
    def of(vehicle: Vehicle, weights: Weights, spacing: float) -> "Scales":
        """Units that go with the size of the vehicle and the weights of J."""
        length, angle = 0.3 * vehicle.wheelbase, 0.2
        cost = weights.length * length + weights.steer * length * angle**2 + weights.rate * angle**2 / length
        return Scales(length=length, angle=angle, step=spacing, cost=cost if cost > 0.0 else 1.0)


@dataclass(frozen=True, eq=False)
class Linearisation:
    """The problem near some knots."""

    knots: Knots
    objective: float
    """J / Scales.cost."""
    g_phi: Float64[Array, " K"]
    """Derivative of the objective by scaled phi. Shape (K,)."""
    g_h: Float64[Array, " K-1"]
    """Derivative by scaled h. Shape (K - 1,)."""
    defects: Float64[Array, "K-1 4"]
    """Scaled. Shape (K - 1, 4)."""
    jacobian: Float64[Array, "K-1 4 7"]
    """Derivatives of the steps, scaled, by (x, y, theta, alpha, phi_k, phi_{k+1}, h). Shape (K - 1, 4, 7)."""
    factor: Float64[Array, "K-1 5 5"]
    """F with F'F the curvature of the Lagrangian by (theta, alpha, phi_k, phi_{k+1}, h), upper. (K - 1, 5, 5)."""
    rows: Separations
    """Near distances, unscaled."""


def linearise(problem: Problem, knots: Knots, scales: Scales, multipliers: Array, reach: float) -> Linearisation:
    """The problem near the knots.

    multipliers: of the scaled dynamics, shape (K - 1, 4). reach: obstacles farther than this [m] are left out.
    """
    vehicle = problem.vehicle
    value, (by_phi, by_h) = objective_gradient(knots, problem.weights)
    gaps, jacobian = defects(vehicle, knots)
    columns = np.concatenate([scales.state, scales.block[2:]])
    hessian = objective_curvature(knots, problem.weights) / scales.cost
    hessian += dynamics_curvature(vehicle, knots, multipliers / scales.state)
    return Linearisation(
        knots=knots,
        objective=value / scales.cost,
        g_phi=by_phi * scales.angle / scales.cost,
        g_h=by_h * scales.step / scales.cost,
        defects=gaps / scales.state,
        jacobian=jacobian * columns / scales.state[:, None],
        factor=convex_factor(hessian * scales.block[:, None] * scales.block),
        rows=separations(problem.scene, vehicle, knots.states, reach),
    )


def objective_curvature(knots: Knots, weights: Weights) -> Array:
    """Second derivatives of J by (theta, alpha, phi_k, phi_{k+1}, h), interval by interval. Shape (K - 1, 5, 5)."""
    drives = knots.gear != 0
    h, left, right = np.where(drives, knots.h, 1.0), knots.phi[:-1], knots.phi[1:]
    rate = (right - left) / h
    out = np.zeros((len(h), 5, 5))
    # (dphi)^2 / h: its curvature is that of (d(dphi) - rate dh)^2 / h, of rank one
    bend = np.where(drives, 2.0 * weights.rate / h, 2.0 * weights.jump)
    direction = np.zeros((len(h), 5))
    direction[:, 2], direction[:, 3], direction[:, 4] = -1.0, 1.0, np.where(drives, -rate, 0.0)
    out += bend[:, None, None] * direction[:, :, None] * direction[:, None, :]
    steer = np.where(drives, weights.steer / 3.0, 0.0)
    out[:, 2, 2] += 2.0 * steer * h
    out[:, 3, 3] += 2.0 * steer * h
    out[:, 2, 3] += steer * h
    out[:, 3, 2] += steer * h
    for row, value in ((2, 2.0 * left + right), (3, left + 2.0 * right)):
        out[:, row, 4] += steer * value
        out[:, 4, row] += steer * value
    return out


def convex_factor(hessian: Array) -> Array:
    """Upper triangular F with F'F the nearest positive definite matrix, for matrices of shape (N, n, n)."""
    values, vectors = np.linalg.eigh(hessian)
    values = np.maximum(values, _LEAST_CURVATURE)
    convex = np.einsum("kij,kj,klj->kil", vectors, values, vectors)
    return np.linalg.cholesky(convex).transpose(0, 2, 1)
