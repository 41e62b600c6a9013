"""Non-linear optimisation: the problem of `optim.knots.transcription` by an interior point method.

Source: Esteban Cabezos 2020, section 4.4 (its text is missing); collision constraints after Zhang, Liniger, Borrelli
2018 (OBCA). Solved by IPOPT as it comes with CasADi. See `optim.nlp` for the model and `optim.knots.rounds` for
what is done about clearance between knots and needless gear changes.
"""

from dataclasses import dataclass
from typing import TYPE_CHECKING

from optim.knots.rounds import RoundOptions, improve
from optim.model.problem import Problem
from optim.model.result import OnIterate, Result, ignore

if TYPE_CHECKING:
    from optim.methods.nlp.ipopt import Ipopt


@dataclass(frozen=True, kw_only=True)
class Nlp:
    """Non-linear optimisation by interior point with exact collision duals (CasADi, IPOPT)."""

    spacing: float = 0.35
    """Distance between knots [m]; step lengths may become up to twice as long."""
    max_iterations: int = 500
    """IPOPT's iterations in one solution, at most [-]."""
    tolerance: float = 1e-6
    """IPOPT's tolerance on its scaled optimality error [-]."""
    reach: float = 3.0
    """Pairs of body and obstacle enter at the start where their clearance exceeds the required by less [m].

    Others are added when a solution turns out to violate them, and it is solved again until none is. With 3 m all
    twelve sample logs end improved, with 1.5 m eleven; with 0.6 m the first solution cuts through whole obstacles."""
    obstacles_later: bool = False
    """First solve without obstacles, then with (the source author's remark); not worth its time as a rule."""
    removals: int = 0
    """Segments of the converged path whose removal is tried, shortest first [-]; each takes as long as all else."""
    time_limit: float = 120.0
    """Processor time in IPOPT, all solutions together [s]."""

    def __post_init__(self) -> None:
        expected = {
            "spacing": ("more than 0 m", self.spacing > 0.0),
            "max_iterations": ("1 or more", self.max_iterations >= 1),
            "tolerance": ("more than 0", self.tolerance > 0.0),
            "reach": ("0 m or more", self.reach >= 0.0),
            "removals": ("0 or more", self.removals >= 0),
            "time_limit": ("more than 0 s", self.time_limit > 0.0),
        }
        for name, (words, is_valid) in expected.items():
            if not is_valid:
                raise ValueError(f"nlp: {name} is {getattr(self, name)!r}, expected {words}")

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        """Improve `problem.initial`; ends, limits and `problem.required_clearance` are kept."""
        rounds = RoundOptions(spacing=self.spacing, max_removals=self.removals)
        return improve(problem, self.at_knots(problem), rounds, on_iterate)

    def at_knots(self, problem: Problem) -> "Ipopt":
        """What solves the problem at given knots."""
        from optim.methods.nlp.ipopt import Ipopt, IpoptOptions  # CasADi takes a while to load

        options = IpoptOptions(
            max_iterations=self.max_iterations,
            tolerance=self.tolerance,
            time_limit=self.time_limit,
            reach=self.reach,
            obstacles_later=self.obstacles_later,
        )
        return Ipopt(problem, self.spacing, options)
