"""A smoother after Dolgov and others 2010: points, obstacle, curvature and smoothness, conjugate gradients (scipy).

As it is published but for two necessities: the points are those of the trailer's axle, in each gear segment by
itself, and what comes out is made drivable by the fit of our cpo, since its points are no path of a truck with
trailer. No change of curvature in its cost, no orientation in its obstacle term (a point at half a width and half a
metre), plain Polak-Ribiere conjugate gradients in plain coordinates, one pass without anchoring. A segment whose
points become no drivable stretch stays as recorded.
"""

from dataclasses import replace

import numpy as np
from scipy.optimize import minimize

from optim.methods.cpo.drivable import drivable_stretch
from optim.methods.cpo.method import Cpo
from optim.methods.cpo.points import RecordedAxle, spread
from optim.model.path import Path, Segment, segment_from_states
from optim.model.problem import Problem
from optim.numerics.arrays import Array
from tools.bench.peers.common import Answer

MOST_ITERATIONS = 1000
METHOD = Cpo(obstacles="points", weight_change=0.0)


def solve(problem: Problem) -> Answer:
    """Each gear segment smoothed by itself."""
    segments, iterations, words = [], 0, []
    for segment in problem.recorded.segments:
        smoothed, count, word = _smoothed(problem, segment)
        segments.append(smoothed)
        iterations += count
        words.append(word)
    return Answer(path=Path(tuple(segments)), word=", ".join(words), iterations=iterations)


def _smoothed(problem: Problem, segment: Segment) -> tuple[Segment, int, str]:
    """The segment smoothed, iterations, and the word of the minimiser."""
    axle = RecordedAxle.of(problem.vehicle, segment)
    row = spread(axle, axle.flat[:, :2], axle.share, METHOD.spacing, np.empty((0, 2)))
    terms = replace(METHOD.terms(problem, METHOD.spacing), spacing=row.spacing)
    points, free = row.xy.copy(), ~row.anchored

    def cost(unknowns: Array) -> tuple[float, Array]:
        points[free] = unknowns.reshape(-1, 2)
        value, slope, _ = terms.evaluate(points, with_metric=False)
        return value, slope[free].ravel()

    done = minimize(cost, row.xy[free].ravel(), jac=True, method="CG", options={"maxiter": MOST_ITERATIONS})
    points[free] = done.x.reshape(-1, 2)
    ends = (axle.flat[0], axle.flat[-1])
    stretch = drivable_stretch(problem.vehicle, axle.direction, points[1:-1], *ends, METHOD.sample_spacing)
    if stretch is None:
        return segment, int(done.nit), "no stretch"
    states = stretch.segment.states.copy()
    states[0], states[-1] = segment.states[0], segment.states[-1]
    exact = segment_from_states(segment.direction, stretch.segment.s, states, stretch.segment.phi)
    return exact, int(done.nit), "rests" if done.success else "iterations were not enough"
