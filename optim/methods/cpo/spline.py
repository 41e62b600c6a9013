"""A curve of the trailer's axle by its curvature: cubic B-splines of the share t in [0, 1] of its length L.

Headings are integrals of splines, exact; positions are integrals of their cosine and sine by Gauss-Legendre
quadrature with four nodes in each of P panels.
"""

import math
from typing import TYPE_CHECKING, NamedTuple

import numpy as np

from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64

if TYPE_CHECKING:
    from scipy.interpolate import BSpline

_GAUSS_X = 0.5 + 0.5 * np.array([-0.8611363115940526, -0.3399810435848563, 0.3399810435848563, 0.8611363115940526])
GAUSS_W = 0.5 * np.array([0.3478548451374538, 0.6521451548625461, 0.6521451548625461, 0.3478548451374538])
_PANELS = 2  # of the quadrature per interval of the spline: 0.25 m, where four nodes are exact to rounding


class Basis(NamedTuple):
    """The m splines of the basis at the P + 1 ends of the panels and at their 4 P Gauss nodes."""

    ends: Float64[Array, "P_1 m"]
    slope: Float64[Array, "P_1 m"]  # by t
    curl: Float64[Array, "P_1 m"]  # second derivative by t
    turn: Float64[Array, "P_1 m"]  # integral from t = 0
    turn_nodes: Float64[Array, "nodes m"]  # the same at the Gauss nodes


def spline(c: Array) -> "BSpline":
    """Curvature by t; c: (m,) coefficients or (m, m), each column a spline."""
    from scipy.interpolate import BSpline  # takes a quarter of a second to load

    count = len(c) - 3
    knots = np.concatenate([[0.0] * 3, np.linspace(0.0, 1.0, count + 1), [1.0] * 3])
    return BSpline(knots, c, 3)


def basis(count: int) -> Basis:
    """For `count` intervals of the spline."""
    each, panels = spline(np.eye(count + 3)), _PANELS * count
    ends, nodes, turn = np.linspace(0.0, 1.0, panels + 1), _gauss_nodes(panels), each.antiderivative()
    return Basis(each(ends), each(ends, 1), each(ends, 2), turn(ends), turn(nodes))


def positions(start: Array, turn: Array, length: float) -> Array:
    """Positions at the ends of the panels from the turns at their Gauss nodes. Shape (P + 1, 2)."""
    heading = start[2] + turn
    steps = np.tile(GAUSS_W, len(turn) // 4) * length / (len(turn) // 4)
    moves = (steps[:, None] * np.stack([np.cos(heading), np.sin(heading)], axis=1)).reshape(-1, 4, 2).sum(axis=1)
    return start[:2] + np.concatenate([np.zeros((1, 2)), np.cumsum(moves, axis=0)])


def sampled(vehicle: Vehicle, c: Array, length: float, start: Array, spacing: float) -> tuple[Array, Array]:
    """Samples of the curve: the truck's distance [m], shape (n,), at most `spacing` apart, and flat states (n, 5)."""
    kappa = spline(c)
    turn = kappa.antiderivative()
    # the truck's distance by the axle's is 1 / cos(alpha), at most that of the largest coefficient
    panels = math.ceil(length * math.hypot(1.0, vehicle.hitch_to_axle * np.abs(c).max()) / spacing)
    nodes, ends = _gauss_nodes(panels), np.linspace(0.0, 1.0, panels + 1)
    stretch = np.hypot(1.0, vehicle.hitch_to_axle * kappa(nodes)).reshape(-1, 4) @ GAUSS_W
    s = np.concatenate([[0.0], np.cumsum(stretch)]) * length / panels
    position = positions(start, length * (turn(nodes) - turn(0.0)), length)
    heading = start[2] + length * (turn(ends) - turn(0.0))
    return s, np.column_stack([position, heading, kappa(ends), kappa(ends, 1) / length])


def _gauss_nodes(panels: int) -> Array:
    """Gauss nodes of all panels of [0, 1], in order. Shape (4 panels,)."""
    return ((np.arange(panels)[:, None] + _GAUSS_X) / panels).ravel()
