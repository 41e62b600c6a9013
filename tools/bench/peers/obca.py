"""Plain OBCA (Zhang, Liniger, Borrelli 2018) for truck and trailer: CasADi, IPOPT, dual variables for **all** pairs.

What the published formulation does, on our problem: every pair of a body at a knot and an obstacle has its dual
variables from the start to the end, whether near or not; one time scale for all knots, here one length for each gear
segment; one solution, nothing is added, merged, laid out anew or checked between the knots. The weights of its cost
are those of J, its reference is the recorded path, which is its warm start as well, and the dual variables start from
the exact witness normals, which is what its convex warm-start problem aims at. Tolerance 1e-6, adaptive barrier: with
IPOPT's own defaults it takes longer.
"""

import time
from typing import Any

import numpy as np

from optim.knots.transcription import STEP_RANGE, Knots, knots_of
from optim.methods.nlp.duals import Pairs
from optim.methods.nlp.model import Units, build, knots_at
from optim.model.problem import Problem
from optim.numerics.arrays import Array
from tools.bench.peers.common import SPACING, Answer, path_at

TIME_LIMIT = 100.0
"""CPU time of a solution [s]."""


def all_pairs(problem: Problem, knots: Knots) -> Pairs:
    """Both bodies at every knot but the ends, which are fixed, with every obstacle."""
    inside = range(1, len(knots.phi) - 1)
    count = len(problem.scene.polygons)
    return Pairs.of({(k, body, m) for k in inside for body in range(2) for m in range(count)})


def ipopt_options() -> dict[str, Any]:
    """Of `casadi.nlpsol`, for all who hand IPOPT the whole problem at once."""
    return {
        "print_time": False,
        "ipopt.print_level": 0,
        "ipopt.sb": "yes",
        "ipopt.max_iter": 1000,
        "ipopt.tol": 1e-6,
        "ipopt.mu_strategy": "adaptive",
        "ipopt.max_cpu_time": TIME_LIMIT,
    }


def solve(problem: Problem) -> Answer:
    """One solution from the recorded path."""
    import casadi as ca

    began = time.process_time()
    knots = knots_of(problem.vehicle, problem.recorded, SPACING)
    required: Array = np.full((len(knots.phi), 2), problem.required_clearance)
    units, step_range = Units.of(problem), np.array(STEP_RANGE) * SPACING
    program = build(problem, knots, required, all_pairs(problem, knots), units, step_range)
    solver = ca.nlpsol("obca", "ipopt", program.nlp, ipopt_options())
    build_s = time.process_time() - began
    found = solver(x0=program.start, lbx=program.low, ubx=program.high, lbg=program.low_g, ubg=program.high_g)
    stats = solver.stats()
    solved = knots_at(np.asarray(found["x"]).ravel(), knots, units)
    return Answer(
        path=path_at(problem, solved),
        word=str(stats["return_status"]),
        iterations=int(stats["iter_count"]),
        build_s=build_s,
        size=f"{program.start.size} unknowns, {program.low_g.size} constraints",
    )
