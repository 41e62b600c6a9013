"""IPOPT at the knots: build, solve, look for pairs that were left out, and say in our words how it ended."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from optim.knots.between import missing_at_knots
from optim.knots.rounds import Outcome, Report, Tell
from optim.knots.transcription import STEP_RANGE, Knots, defects, objective_of
from optim.methods.nlp.duals import Pairs, pairs_within
from optim.methods.nlp.model import Program, Units, build
from optim.model.problem import Problem
from optim.model.result import Stop
from optim.numerics.arrays import Array

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
class IpoptOptions:
    """Constants; what they mean to users is said in `optim.methods.nlp.method`."""

    max_iterations: int
    tolerance: float
    time_limit: float
    reach: float
    obstacles_later: bool


class Ipopt:
    """IPOPT on one problem; call it as `optim.knots.rounds.AtKnots`."""

    def __init__(self, problem: Problem, spacing: float, options: IpoptOptions) -> None:
        self.problem, self.options = problem, options
        self.step_range = np.array(STEP_RANGE) * spacing
        self.units = Units(origin=problem.initial.start[:2].copy(), length=problem.vehicle.wheelbase)
        self.remaining = options.time_limit
        self._last: Knots | None = None

    def __call__(self, knots: Knots, required: Array, tell: Tell) -> Outcome:
        iterations = 0
        if self.options.obstacles_later:
            knots, _, more = self._solve(knots, required, Pairs.of(set()), tell)
            iterations += more
        again = knots is self._last
        pairs = pairs_within(self.problem, knots.states, required, self.options.reach)
        while True:
            solved, word, more = self._solve(knots, required, pairs, tell, warm=again)
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
            if self.violations(solved, required)[1] <= _SHALLOW:
                knots, again = solved, True
        self._last = solved
        reason = f"{sentence}, {len(pairs.knot)} pairs of body and obstacle"
        return Outcome(knots=solved, stop=stop, reason=reason, iterations=iterations)

    def _solve(
        self, knots: Knots, required: Array, pairs: Pairs, tell: Tell, warm: bool = False
    ) -> tuple[Knots, str, int]:
        import casadi as ca

        program = build(self.problem, knots, required, pairs, self.units, self.step_range)
        sizes = (program.start.size, program.low_g.size)
        watch = _watcher(sizes, _Teller(self, program, knots, required, tell))
        options: dict[str, Any] = {
            "print_time": False,
            "record_time": True,
            "iteration_callback": watch,
            "ipopt.print_level": 0,
            "ipopt.sb": "yes",
            "ipopt.max_iter": self.options.max_iterations,
            "ipopt.tol": self.options.tolerance,
            "ipopt.constr_viol_tol": _VIOLATION,
            "ipopt.mu_strategy": "adaptive",  # a third of the iterations of the monotone one, on every log tried
            "ipopt.max_cpu_time": max(self.remaining, 1e-3),
        }
        if warm:
            options |= {"ipopt.mu_init": 1e-4, "ipopt.bound_push": 1e-4, "ipopt.bound_frac": 1e-4}
        solver = watch.solver = ca.nlpsol("nlp", "ipopt", program.nlp, options)
        found = solver(x0=program.start, lbx=program.low, ubx=program.high, lbg=program.low_g, ubg=program.high_g)
        if watch.error is not None:
            raise watch.error
        stats = solver.stats()
        self.remaining -= float(stats["t_proc_total"])
        solved = self.knots_at(np.asarray(found["x"]).ravel(), knots)
        return solved, stats["return_status"], int(stats["iter_count"])

    def knots_at(self, x: Array, like: Knots) -> Knots:
        """The knots in a vector of unknowns."""
        count = len(like.phi)
        states = x[: 4 * count].reshape(count, 4).copy()
        states[:, :2] = states[:, :2] * self.units.length + self.units.origin
        states[0], states[-1] = like.states[0], like.states[-1]
        h = np.zeros(len(like.h))
        for index, run in enumerate(like.runs):
            h[run] = x[5 * count + index] * self.units.length / (run.stop - run.start)
        return Knots(states, x[4 * count : 5 * count], h, like.gear)

    def violations(self, knots: Knots, required: Array) -> tuple[float, float]:
        """Largest defect [m or rad] and missing clearance at the knots [m]."""
        gaps, _ = defects(self.problem.vehicle, knots)
        return float(np.abs(gaps).max()), float(missing_at_knots(self.problem, knots, required).max())


class _Teller:
    """Turns iterates of IPOPT into reports."""

    def __init__(self, ipopt: Ipopt, program: Program, like: Knots, required: Array, tell: Tell) -> None:
        self.ipopt, self.program, self.like, self.required, self.tell = ipopt, program, like, required, tell
        self._before: Array | None = None

    def __call__(self, x: Array, g: Array, stats: dict[str, Any]) -> None:
        knots = self.ipopt.knots_at(x, self.like)
        if not np.isfinite(x).all() or (knots.h[knots.gear != 0] <= 0.0).any():
            return  # an iterate that is no path
        defect, missing = self.ipopt.violations(knots, self.required)
        now = x[: 5 * len(self.like.phi)].copy()
        step = 0.0 if self._before is None else float(np.abs(now - self._before).max())
        self._before = now
        self.tell(
            Report(
                knots=knots,
                objective=objective_of(knots, self.ipopt.problem.weights),
                violation=max(defect, missing),
                step=step,
                residuals=self._residuals(g, stats),
            )
        )

    def _residuals(self, g: Array, stats: dict[str, Any]) -> dict[str, float]:
        """What decides when IPOPT ends: its dual infeasibility, and the constraints as they are stated.

        Its own account of the constraints has that of the slacks in it, which it mends only after the last iterate:
        7e-2 was seen where the constraints held to 3e-10.
        """
        low, high = self.program.low_g, self.program.high_g
        return {
            "optimality": stats["iterations"]["inf_du"][-1] / self.ipopt.options.tolerance,
            "constraints": float(np.maximum(low - g, g - high).max(initial=0.0)) / _VIOLATION,
        }


def _watcher(sizes: tuple[int, int], teller: _Teller) -> Any:
    """CasADi's callback that tells every iterate; sizes: numbers of unknowns and of constraints."""
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
                teller(np.asarray(arguments[0]).ravel(), np.asarray(arguments[2]).ravel(), self.solver.stats())
            except BaseException as error:  # through C++ nothing may fly; an interruption stops IPOPT, then flies on
                self.error = error
                return [1]
            return [0]

    return Watch()
