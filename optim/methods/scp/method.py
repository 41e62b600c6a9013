"""Successive convexification: the problem of `optim.knots.transcription` by a sequence of convex ones.

Source: Esteban Cabezos 2020, section 4.4 (non-linear optimisation); after SCvx (Mao, Szmuk, Acikmese 2018) and SCvx*
(Oguri 2023), with the curvature of the Lagrangian in the model and a second-order correction. The sub-problem is
stated in cvxpy and solved by Clarabel. See `optim.methods.scp.statement` for it, `optim.methods.scp.loop` for the
loop, and `optim.knots.rounds` for what is done about clearance between knots and needless gear changes.
"""

import math
from dataclasses import dataclass
from typing import Literal

from optim.knots.rounds import RoundOptions, improve
from optim.methods.scp.loop import Loop, LoopOptions
from optim.model.problem import Problem
from optim.model.result import OnIterate, Result, ignore


@dataclass(frozen=True, kw_only=True)
class Scp:
    """Non-linear optimisation by successive convexification (cvxpy, Clarabel)."""

    spacing: float = 0.35
    """Distance between knots [m]; step lengths may become up to twice as long."""
    max_iterations: int = 60
    """Sub-problems in one solution, at most [-]."""
    tolerance: float = 1e-5
    """Largest decrease of J, as a share of it, that the convex model still predicts for a converged solution [-]."""
    feasibility: float = 1e-7
    """Largest defect and missing clearance of a converged solution [-], in units of 0.3 wheelbases and 0.2 rad."""
    trust_region: float = 1.0
    """First radius [-]: times 0.3 rad it bounds the change of steering, heading and hitch angle, times half the spacing
    that of step lengths."""
    weight: float = 1e4
    """First weight of the squared virtual control and slack [-]; it grows while the violation does not fall."""
    corrections: int = 3
    """Second-order corrections of a step, at most [-]."""
    removals: int = 3
    """Segments of the converged path whose removal is tried, shortest first [-]."""
    solver: Literal["clarabel", "piqp", "qoco", "osqp"] = "clarabel"
    """Solver of the sub-problems; others than Clarabel must be installed (pip install piqp qoco osqp)."""
    time_limit: float = math.inf
    """Time in the solver by its own account, all sub-problems together [s]. No limit by default: it would make the
    path depend on what else the machine does."""

    def __post_init__(self) -> None:
        expected = {
            "spacing": ("more than 0 m", self.spacing > 0.0),
            "max_iterations": ("1 or more", self.max_iterations >= 1),
            "tolerance": ("more than 0", self.tolerance > 0.0),
            "feasibility": ("more than 0", self.feasibility > 0.0),
            "trust_region": ("more than 0", self.trust_region > 0.0),
            "weight": ("more than 0", self.weight > 0.0),
            "corrections": ("0 or more", self.corrections >= 0),
            "removals": ("0 or more", self.removals >= 0),
            "solver": ("clarabel, piqp, qoco or osqp", self.solver in ("clarabel", "piqp", "qoco", "osqp")),
            "time_limit": ("more than 0 s", self.time_limit > 0.0),
        }
        for name, (words, is_valid) in expected.items():
            if not is_valid:
                raise ValueError(f"scp: {name} is {getattr(self, name)!r}, expected {words}")

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        """Improve `problem.initial`; ends, limits and `problem.required_clearance` are kept."""
        rounds = RoundOptions(spacing=self.spacing, max_removals=self.removals)
        return improve(problem, self.at_knots(problem), rounds, on_iterate)

    def at_knots(self, problem: Problem) -> Loop:
        """What solves the problem at given knots."""
        options = LoopOptions(
            solver=self.solver,
            max_iterations=self.max_iterations,
            tolerance=self.tolerance,
            feasibility=self.feasibility,
            trust_region=self.trust_region,
            weight=self.weight,
            corrections=self.corrections,
            time_limit=self.time_limit,
        )
        return Loop(problem, self.spacing, options)
