"""The cost of a row of points, equation (17), with its gradient and the metric of its squares.

M points X of the trailer's axle in the order of its heading (a reverse segment is read from its end), nominally
h [m] apart; Delta_i = X_{i+1} - X_i, and the signed turn delta_i from Delta_{i-1} to Delta_i:

    kappa_i = 2 delta_i / (|Delta_{i-1}| + |Delta_i|)
    F = w_o h sum_ij b_j max(0, d_max - d_ij)^2                 obstacles: d_ij the distance of disc j at point i
      + w_k h sum_i max(0, |kappa_i| - kappa_max)^2            curvature beyond what hitch
            + w_k h sum_i max(0, |kappa^t_i| - kappa^t_max)^2    and steering allow
      + w_s / h^3 sum_i |Delta_i - Delta_{i-1}|^2               smoothness
      + w_g / h sum_i (kappa_{i+1} - kappa_i)^2                 change of curvature

kappa_max = tan(max_hitch) / l_t is that of the trailer's axle. The truck's axle has its own, tan(max_steer) / l, for

    kappa^t = (kappa + l_t sigma / q) / sqrt(q),   q = 1 + (l_t kappa)^2,  sigma the change of kappa by distance,

taken between neighbouring points. The source looks at the one axle only; points without the other's limit ask for
steering angles of 0.9 rad where the vehicle has 0.55.

The powers of h make each sum an integral over arc length, so that the weights hold for every spacing; with h = 1
they are the source's. Its turn |delta| hides a change of sign, where the curvature changes most: here it is signed.
Its curvature delta_i / |Delta_i| depends on which way the points are read: here both lengths count.

Every term is a sum of squares r^2, so 2 sum (dr)(dr)^T is a banded matrix close to the second derivatives: the
metric in which the points are moved (`optim.methods.cpo.descent`).
"""

import math
from dataclasses import dataclass

import numpy as np

from optim.geometry.field import DistanceField
from optim.methods.cpo.discs import Discs, obstacle_term
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array

_SHARE = 0.98
"""Share of a limit above which curvature costs: a penalty alone would leave the points a little beyond it."""
BAND = 8
"""Diagonals of the metric on and below the main one: two coordinates of four neighbouring points."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Terms:
    """Everything in F but the points."""

    vehicle: Vehicle
    discs: Discs
    field: DistanceField
    d_max: float
    """Discs nearer to an obstacle than this cost [m]."""
    obstacle: float
    """w_o [1/m^4]."""
    curvature: float
    """w_k [m]."""
    smoothness: float
    """w_s [m]."""
    change: float
    """w_g [m^3]."""
    spacing: float
    """h [m]."""

    def evaluate(self, points: Array, with_metric: bool = True) -> tuple[float, Array, Array | None]:
        """F, its gradient by the points, shape (M, 2), and the metric in the form of `cholesky_banded`, (BAND, 2 M)."""
        h, (kappa, by_kappa), (psi, by_psi) = self.spacing, bends(points), headings(points)
        count = len(points)
        gradient, metric = np.zeros(2 * count), np.zeros((BAND, 2 * count)) if with_metric else None
        value = 0.0

        bend = points[2:] - 2.0 * points[1:-1] + points[:-2]
        weight = self.smoothness / h**3
        value += weight * float(np.sum(bend**2))
        for coordinate in range(2):
            row = np.zeros((count - 2, 6))
            row[:, coordinate::2] = [1.0, -2.0, 1.0]
            _add(gradient, metric, row, weight * bend[:, coordinate], weight)

        weight = self.curvature * h
        limits = (_SHARE * self.vehicle.max_kappa, _SHARE * math.tan(self.vehicle.max_steer) / self.vehicle.wheelbase)
        axles = ((kappa, by_kappa), truck_bends(points, kappa, by_kappa, self.vehicle.hitch_to_axle))
        for (bent, by_bent), limit in zip(axles, limits, strict=True):
            beyond = np.maximum(0.0, np.abs(bent) - limit)
            value += weight * float(np.sum(beyond**2))
            _add(gradient, metric, by_bent, weight * beyond * np.sign(bent), np.where(beyond > 0.0, weight, 0.0))

        row = np.zeros((count - 3, 8))
        row[:, 2:] = by_kappa[1:]
        row[:, :6] -= by_kappa[:-1]
        step, weight = np.diff(kappa), self.change / h
        value += weight * float(np.sum(step**2))
        _add(gradient, metric, row, weight * step, weight)

        pose = np.column_stack([points[1:-1], psi, kappa])
        weights = np.full(count - 2, self.obstacle * h)
        near = obstacle_term(self.vehicle, self.discs, self.field, self.d_max, pose, weights, with_metric)
        value += near.value
        by_points = np.zeros((count - 2, 4, 6))
        by_points[:, 0, 2] = by_points[:, 1, 3] = 1.0
        by_points[:, 2], by_points[:, 3] = by_psi, by_kappa
        _scatter_slopes(gradient, np.einsum("ia,iab->ib", near.gradient, by_points))
        if metric is not None:
            _scatter_blocks(metric, np.transpose(by_points, (0, 2, 1)) @ near.metric @ by_points)
        return value, gradient.reshape(count, 2), metric


def bends(points: Array) -> tuple[Array, Array]:
    """Curvature [1/m] at the inner points, shape (M - 2,), and its derivatives by three points, shape (M - 2, 6)."""
    step = np.diff(points, axis=0)
    before, after = step[:-1], step[1:]
    turn = np.arctan2(before[:, 0] * after[:, 1] - before[:, 1] * after[:, 0], np.sum(before * after, axis=1))
    length = np.hypot(*step.T)
    total = length[:-1] + length[1:]
    kappa = 2.0 * turn / total
    quarter = np.stack([-step[:, 1], step[:, 0]], axis=1) / (length**2)[:, None]
    unit = step / length[:, None]
    by_before = -(2.0 * quarter[:-1] + kappa[:, None] * unit[:-1]) / total[:, None]
    by_after = (2.0 * quarter[1:] - kappa[:, None] * unit[1:]) / total[:, None]
    return kappa, np.concatenate([-by_before, by_before - by_after, by_after], axis=1)


def truck_bends(points: Array, kappa: Array, by_kappa: Array, l_t: float) -> tuple[Array, Array]:
    """Curvature of the truck's axle [1/m] between inner points, shape (M - 3,), and derivatives, shape (M - 3, 8).

    kappa, by_kappa: of `bends`.
    """
    step = np.diff(points, axis=0)[1:-1]
    length = np.hypot(*step.T)
    mean, sigma = 0.5 * (kappa[1:] + kappa[:-1]), np.diff(kappa) / length
    u = l_t * mean
    q = 1.0 + u * u
    by_mean, by_sigma = (1.0 - 3.0 * l_t**2 * sigma * u / q) / q**1.5, l_t / q**1.5
    row = np.zeros((len(step), 8))
    row[:, 2:] = (0.5 * by_mean + by_sigma / length)[:, None] * by_kappa[1:]
    row[:, :6] += (0.5 * by_mean - by_sigma / length)[:, None] * by_kappa[:-1]
    stretched = (by_sigma * sigma / length**2)[:, None] * step
    row[:, 2:4] += stretched
    row[:, 4:6] -= stretched
    return (mean + l_t * sigma / q) / np.sqrt(q), row


def headings(points: Array) -> tuple[Array, Array]:
    """Heading [rad] at the inner points, shape (M - 2,), and its derivatives by three points, shape (M - 2, 6)."""
    chord = points[2:] - points[:-2]
    psi = np.arctan2(chord[:, 1], chord[:, 0])
    slope = np.stack([-chord[:, 1], chord[:, 0]], axis=1) / np.sum(chord**2, axis=1)[:, None]
    return psi, np.concatenate([-slope, np.zeros_like(slope), slope], axis=1)


def _add(gradient: Array, metric: Array | None, rows: Array, pull: Array, weight: Array | float) -> None:
    """The terms weight_i r_i^2 with dr_i = rows_i on consecutive points, pull_i = weight_i r_i."""
    _scatter_slopes(gradient, 2.0 * pull[:, None] * rows)
    if metric is not None:
        weighted = 2.0 * np.broadcast_to(weight, pull.shape)[:, None] * rows
        _scatter_blocks(metric, weighted[:, :, None] * rows[:, None, :])


def _scatter_slopes(gradient: Array, slopes: Array) -> None:
    """Add slopes (n, k) that start at the points 0, 1, ..., n - 1."""
    count, width = slopes.shape
    for a in range(width):
        gradient[a : a + 2 * count : 2] += slopes[:, a]


def _scatter_blocks(metric: Array, blocks: Array) -> None:
    """Add blocks (n, k, k) that start at the points 0, 1, ..., n - 1."""
    count, width, _ = blocks.shape
    for a in range(width):
        for b in range(a + 1):
            metric[a - b, b : b + 2 * count : 2] += blocks[:, a, b]
