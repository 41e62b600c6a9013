"""Non-linear optimisation: the problem of `optim.knots.transcription` by an interior point method.

Source: Esteban Cabezos 2020, section 4.4 (its text is missing); collision constraints after Zhang, Liniger, Borrelli
2018 (OBCA). Solved by IPOPT as it comes with CasADi. See `optim.methods.nlp.model` for the model and
`optim.knots.rounds` for what is done about clearance between knots and redundant gear changes.
"""

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import Any

import numpy as np

from optim.knots.between import missing_at_knots
from optim.knots.rounds import Announce, KnotSolution, improve
from optim.knots.transcription import STEP_RANGE, Knots, defects, objective_of
from optim.methods.nlp.duals import Pairs, pairs_within
from optim.methods.nlp.model import Program, Units, build, knots_at
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from optim.numerics.arrays import Array
from optim.numerics.checks import require

_WORDS = {
    "Solve_Succeeded": (Stop.CONVERGED, "converged"),
    "Solved_To_Acceptable_Level": (Stop.CONVERGED, "converged to IPOPT's acceptable level only"),
    "Maximum_Iterations_Exceeded": (Stop.ITERATION_LIMIT, "the iterations were not enough"),
    "Maximum_CpuTime_Exceeded": (Stop.TIME_LIMIT, "out of time"),
    "Infeasible_Problem_Detected": (Stop.INFEASIBLE, "no clear and drivable path near this one"),
    "Restoration_Failed": (Stop.STALLED, "IPOPT's restoration found no way back to the constraints"),
    "Search_Direction_Becomes_Too_Small": (Stop.STALLED, "IPOPT's steps became too small"),
}
_SHALLOW = 0.3  # [m]: a solution that overlaps by less may be warm-started from
_VIOLATION = 1e-8  # IPOPT's tolerance on the constraints as they are stated
_NEAR = 1.0  # [m]: pairs that near to a solution join those that it violates


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
        require(
            self,
            "nlp",
            spacing=("more than 0 m", self.spacing > 0.0),
            max_iterations=("1 or more", self.max_iterations >= 1),
            tolerance=("more than 0", self.tolerance > 0.0),
            reach=("0 m or more", self.reach >= 0.0),
            removals=("0 or more", self.removals >= 0),
            time_limit=("more than 0 s", self.time_limit > 0.0),
        )

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        """Improve `problem.initial`; ends, limits and `problem.required_clearance` are kept."""
        at_knots = self.at_knots(problem)
        return improve(problem, at_knots, spacing=self.spacing, removals=self.removals, on_iterate=on_iterate)

    def at_knots(self, problem: Problem) -> "Ipopt":
        """The optimiser of the problem at given knots."""
        return Ipopt(problem, self)


class Ipopt:
    """IPOPT on one problem from given knots, an `optim.knots.rounds.KnotOptimizer`."""

    def __init__(self, problem: Problem, options: Nlp) -> None:
        self.problem, self.options = problem, options
        self.step_range = np.array(STEP_RANGE) * options.spacing
        self.units = Units.of(problem)
        self.remaining = options.time_limit
        self._last: Knots | None = None

    def __call__(self, knots: Knots, required: Array, announce: Announce) -> KnotSolution:
        """Solve with the pairs that are near, and again with those that the solution violates, until there are none."""
        iterations = 0
        if self.options.obstacles_later:
            knots, _, more = self._solve(knots, required, Pairs.of(set()), announce)
            iterations += more
        is_warm = knots is self._last
        pairs = pairs_within(self.problem, knots.states, required, self.options.reach)
        while True:
            solved, word, more = self._solve(knots, required, pairs, announce, is_warm)
            iterations += more
            stop, sentence = _WORDS.get(word, (Stop.FAILED, f"IPOPT says {word}"))
            found = pairs_within(self.problem, solved.states, required, 0.0)
            new = found.keys() - pairs.keys()
            if stop is not Stop.CONVERGED or not new:
                break
            # pairs that nobody thought of. Deep inside an obstacle the witness normal may point out of its far side,
            # so only a solution that nearly clears them is a better start than the path that does
            more_pairs = pairs_within(self.problem, solved.states, required, _NEAR)
            pairs = Pairs.of(pairs.keys() | more_pairs.keys())
            if float(missing_at_knots(self.problem, solved, required).max()) <= _SHALLOW:
                knots, is_warm = solved, True
        self._last = solved
        reason = f"{sentence}, {len(pairs.knot)} pairs of body and obstacle"
        return KnotSolution(knots=solved, stop=stop, reason=reason, iterations=iterations)

    def _solve(
        self, knots: Knots, required: Array, pairs: Pairs, announce: Announce, is_warm: bool = False
    ) -> tuple[Knots, str, int]:
        """One run of IPOPT: where it ended, its own word for that, and its iterations."""
        import casadi as ca

        program = build(self.problem, knots, required, pairs, self.units, self.step_range)
        watched = _Announcer(self, program, knots, required, announce)
        callback = _callback((program.start.size, program.low_g.size), watched)
        options: dict[str, Any] = {
            "print_time": False,
            "record_time": True,
            "iteration_callback": callback,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.max_iter": self.options.max_iterations,
            "ipopt.tol": self.options.tolerance,
            "ipopt.constr_viol_tol": _VIOLATION,
            "ipopt.mu_strategy": "adaptive",  # a third of the iterations of the monotone one, on every log tried
            "ipopt.max_cpu_time": max(self.remaining, 1e-3),
        }
        if is_warm:
            options |= {"ipopt.mu_init": 1e-4, "ipopt.bound_push": 1e-4, "ipopt.bound_frac": 1e-4}
        solver = callback.solver = ca.nlpsol("nlp", "ipopt", program.nlp, options)
        found = solver(x0=program.start, lbx=program.low, ubx=program.high, lbg=program.low_g, ubg=program.high_g)
        if callback.error is not None:
            raise callback.error
        stats = solver.stats()
        self.remaining -= float(stats["t_proc_total"])
        solved = knots_at(np.asarray(found["x"]).ravel(), knots, self.units)
        return solved, stats["return_status"], int(stats["iter_count"])


class _Announcer:
    """Announces the iterates of one run of IPOPT."""

    def __init__(self, ipopt: Ipopt, program: Program, like: Knots, required: Array, announce: Announce) -> None:
        self.ipopt, self.program, self.like, self.required, self.announce = ipopt, program, like, required, announce
        self._before: Array | None = None

    def __call__(self, x: Array, g: Array, stats: dict[str, Any]) -> None:
        """Announce the knots in the unknowns `x`, unless they do not form a path."""
        problem, knots = self.ipopt.problem, knots_at(x, self.like, self.ipopt.units)
        if not np.isfinite(x).all() or (knots.h[knots.gear != 0] <= 0.0).any():
            return
        gaps, _ = defects(problem.vehicle, knots)
        missing = missing_at_knots(problem, knots, self.required)
        now = x[: 5 * len(self.like.phi)].copy()
        step = 0.0 if self._before is None else float(np.abs(now - self._before).max())
        self._before = now
        self.announce(
            knots,
            partial(
                Iterate,
                objective=objective_of(knots, problem.weights),
                violation=max(float(np.abs(gaps).max()), float(missing.max())),
                step=step,
                residuals=self._residuals(g, stats),
            ),
        )

    def _residuals(self, g: Array, stats: dict[str, Any]) -> dict[str, float]:
        """Residuals that decide when IPOPT ends: its dual infeasibility, and the constraints as stated.

        Its own figure for the constraints includes the slacks, which it mends only after the last iterate: 7e-2 was
        seen where the constraints held to 3e-10.
        """
        low, high = self.program.low_g, self.program.high_g
        return {
            "optimality": stats["iterations"]["inf_du"][-1] / self.ipopt.options.tolerance,
            "constraints": float(np.maximum(low - g, g - high).max(initial=0.0)) / _VIOLATION,
        }


def _callback(sizes: tuple[int, int], on_iterate: Callable[[Array, Array, dict[str, Any]], None]) -> Any:
    """The callback for CasADi that passes unknowns, constraints and statistics of every iterate to `on_iterate`.

    Its attribute `solver` must be set to the solver that it watches; `error` is what `on_iterate` has raised, or None.
    sizes: numbers of unknowns and of constraints.
    """
    import casadi as ca

    class Watch(ca.Callback):
        def __init__(self) -> None:
            ca.Callback.__init__(self)
            self.error: BaseException | None = None
            self.solver: Any = None
            self.construct("watch", {})

        def get_n_in(self) -> int:
            return ca.nlpsol_n_out()

        def get_n_out(self) -> int:
            return 1

        def get_name_in(self, i: int) -> str:
            return ca.nlpsol_out(i)

        def get_sparsity_in(self, i: int) -> Any:
            name = ca.nlpsol_out(i)
            if name == "f":
                return ca.Sparsity.scalar()
            size = {"x": sizes[0], "lam_x": sizes[0], "g": sizes[1], "lam_g": sizes[1]}.get(name, 0)
            return ca.Sparsity.dense(size, 1) if size else ca.Sparsity(0, 0)

        def eval(self, arguments: Any) -> list[int]:
            try:
                on_iterate(np.asarray(arguments[0]).ravel(), np.asarray(arguments[2]).ravel(), self.solver.stats())
            except BaseException as error:  # must not cross the C++ boundary: IPOPT stops, then it is raised again
                self.error = error
                return [1]
            return [0]

    return Watch()
