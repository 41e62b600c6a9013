"""One solution of the convex sub-problem: parameters in, step and multipliers out."""

import warnings
from dataclasses import dataclass, field
from typing import Any, Final

import numpy as np
from scipy import sparse

from optim.knots.transcription import Knots
from optim.methods.scp.linearisation import Linearisation, Scales
from optim.methods.scp.statement import DEPENDS, OWN, SLOTS, VACUOUS, Statement, bucket, statement
from optim.model.vehicle import Vehicle
from optim.numerics.arrays import Array, Float64, frozen

_NOTHING: Final = frozen(np.zeros(0))
_ANGLE_SHARE, _STEP_SHARE = 1.5, 0.5
"""Scaled angles and step lengths may change by this share of the radius."""


@dataclass(frozen=True, eq=False)
class KnotLimits:
    """Limits of a step."""

    required: Float64[Array, "K 2"]
    """Clearance to keep at each knot by truck and trailer [m]. Shape (K, 2)."""
    shortest: float
    """Least step length [m]."""
    longest: float
    """Largest step length [m]."""


@dataclass(frozen=True, eq=False)
class Penalty:
    """Augmented Lagrangian of the scaled dynamics and clearances."""

    weight: float
    """w [-]."""
    dynamics: Float64[Array, "K-1 4"]
    """lambda. Shape (K - 1, 4)."""
    clearance: Float64[Array, "K 2"]
    """mu >= 0. Shape (K, 2)."""


@dataclass(frozen=True, eq=False)
class SubproblemSolution:
    """The solution of a sub-problem, in scaled units."""

    status: str
    """"optimal", or the solver's word for what went wrong; only then are the numbers below of use."""
    solver_s: float
    """Time in the solver, by its own account [s]."""
    q: Float64[Array, "K 4"] | Float64[Array, " 0"] = field(default_factory=lambda: _NOTHING)
    """Change of the states. Shape (K, 4)."""
    phi: Float64[Array, " K"] | Float64[Array, " 0"] = field(default_factory=lambda: _NOTHING)
    """Shape (K,)."""
    h: Float64[Array, " K-1"] | Float64[Array, " 0"] = field(default_factory=lambda: _NOTHING)
    """Shape (K - 1,)."""
    nu: Float64[Array, "K-1 4"] | Float64[Array, " 0"] = field(default_factory=lambda: _NOTHING)
    """Virtual control times sqrt(w). Shape (K - 1, 4)."""
    zeta: Float64[Array, "K 2"] | Float64[Array, " 0"] = field(default_factory=lambda: _NOTHING)
    """Slack of the clearances times sqrt(w). Shape (K, 2)."""
    r: Float64[Array, "K-1 5"] | Float64[Array, " 0"] = field(default_factory=lambda: _NOTHING)
    """F times the step; half its square is the curvature's part of the model. Shape (K - 1, 5)."""
    multipliers: Float64[Array, "K-1 4"] | Float64[Array, " 0"] = field(default_factory=lambda: _NOTHING)
    """Multipliers of the scaled dynamics. Shape (K - 1, 4)."""

    @property
    def size(self) -> float:
        """Largest change of an unknown, in scaled units."""
        return max(float(np.abs(part).max()) for part in (self.q, self.phi, self.h))

    @property
    def reach(self) -> float:
        """The radius of the smallest trust region that holds the step."""
        angles = max(float(np.abs(self.q[:, 2:]).max()), float(np.abs(self.phi).max()))
        return max(angles / _ANGLE_SHARE, float(np.abs(self.h).max()) / _STEP_SHARE)


def solve_subproblem(
    vehicle: Vehicle,
    near: Linearisation,
    scales: Scales,
    limits: KnotLimits,
    penalty: Penalty,
    radius: float,
    solver: str,
    time_limit: float,
) -> SubproblemSolution:
    """The step that minimises the convex model within the trust region.

    Args:
        near: the model, and the knots that it is of.
        radius: of the trust region [-]; angles and step lengths in scaled units may change by a share of it each.
        solver: as `optim.methods.scp.method.Scp.solver` names it.
        time_limit: what Clarabel may take [s]; other solvers end by themselves.
    """
    stated = statement(bucket(len(near.knots.phi)))
    values = parameter_values(stated.num_knots, vehicle, near, scales, limits, penalty, radius)
    if solver == "clarabel":
        return _solve_clarabel(stated, values, len(near.knots.phi), time_limit)
    return _solve_cvxpy(stated, values, len(near.knots.phi), solver)


def parameter_values(
    size: int,
    vehicle: Vehicle,
    near: Linearisation,
    scales: Scales,
    limits: KnotLimits,
    penalty: Penalty,
    radius: float,
) -> dict[str, Array]:
    """The value of every parameter; padding knots and intervals get what keeps them where they are."""
    knots = near.knots
    count, steps = len(knots.phi), len(knots.h)
    drives = knots.gear != 0
    values: dict[str, Array] = {}

    def pad(name: str, value: Array, fill: float, total: int) -> None:
        out = np.full((total, *value.shape[1:]), fill)
        out[: len(value)] = value
        values[name] = out

    jac = near.jacobian
    for c in range(4):
        for j in DEPENDS[c]:
            pad(f"A{c}{j}", jac[:, c, j], 0.0 if OWN[c] else 1.0, size - 1)
        for name, j in (("B", 4), ("B'", 5), ("C", 6)):
            pad(f"{name}{c}", np.where(drives, jac[:, c, j], 0.0), 0.0, size - 1)
        pad(f"defect{c}", near.defects[:, c], 0.0, size - 1)
    factor = near.factor.copy()
    in_cost = np.zeros((5, 5))
    in_cost[2:4, 2:4] = 1.0  # of a gear change: only the jump of the steering
    factor[~drives] *= in_cost
    factor[~drives, 4, 4] = 1.0
    for i in range(5):
        for j in range(i, 5):
            pad(f"F{i}{j}", factor[:, i, j], float(i == j), size - 1)
    if steps < size - 1:
        values["F22"][steps] = 0.0  # the first padding interval shares its steering with the last real knot
    root = 1.0 / np.sqrt(penalty.weight)
    pad("nu", np.full(steps, root), 0.0, size - 1)
    pad("lambda", penalty.dynamics * root, 0.0, size - 1)
    pad("mu", penalty.clearance * root, 0.0, size)
    for body in range(2):
        pad(f"zeta{body}", np.full(count, root), 1.0, size)
    pad("g_phi", near.g_phi, 0.0, size)
    pad("g_h", np.where(drives, near.g_h, 0.0), 0.0, size - 1)
    _fill_bounds(pad, vehicle, knots, scales, limits, radius, size)
    _fill_rows(values, near, scales, limits, size)
    return values


def _fill_bounds(
    pad: Any, vehicle: Vehicle, knots: Knots, scales: Scales, limits: KnotLimits, radius: float, size: int
) -> None:
    """Trust region and limits, together one interval for each unknown."""
    drives = knots.gear != 0
    change = np.diff(knots.phi)
    rate = np.where(drives, vehicle.max_steer_rate, 0.0)
    pad("rate", rate * scales.step / scales.angle, 0.0, size - 1)
    for name, sign in (("rate_up", 1.0), ("rate_down", -1.0)):
        room = (rate * knots.h - sign * change) / scales.angle
        pad(name, np.where(drives, room, VACUOUS), VACUOUS, size - 1)
    for name, value, low, high, unit, trust in (
        ("alpha", knots.states[:, 3], -vehicle.max_hitch, vehicle.max_hitch, scales.angle, _ANGLE_SHARE),
        ("phi", knots.phi, -vehicle.max_steer, vehicle.max_steer, scales.angle, _ANGLE_SHARE),
        ("h", knots.h, limits.shortest, limits.longest, scales.step, _STEP_SHARE),
    ):
        reach = trust * radius
        up = np.clip((high - value) / unit, -reach, reach)
        down = np.clip((value - low) / unit, -reach, reach)
        if name == "h":
            # step lengths of a segment are equal: the bounds of the first are those of all
            first = drives & np.concatenate([[True], ~drives[:-1]])
            up, down = np.where(first, up, VACUOUS), np.where(first, down, VACUOUS)
        if name == "alpha":
            up[[0, -1]] = down[[0, -1]] = VACUOUS
        total = size - 1 if name == "h" else size
        pad(f"{name}_up", up, VACUOUS, total)
        pad(f"{name}_down", down, VACUOUS, total)
    pad("same", (drives[1:] & drives[:-1]).astype(float), 0.0, size - 2)
    theta = np.full(len(knots.phi), _ANGLE_SHARE * radius)
    theta[[0, -1]] = VACUOUS
    pad("theta_up", theta, VACUOUS, size)
    pad("theta_down", theta, VACUOUS, size)


def _fill_rows(values: dict[str, Array], near: Linearisation, scales: Scales, limits: KnotLimits, size: int) -> None:
    """Distances into their slots: of each knot and body the nearest `SLOTS` rows."""
    rows = near.rows
    gradient = rows.gradient * scales.state / scales.length
    room = (rows.distance - limits.required[rows.knot, rows.body]) / scales.length
    order = np.lexsort((room, rows.body, rows.knot))
    group = 2 * rows.knot[order] + rows.body[order]
    first = np.concatenate([[True], np.diff(group) != 0]) if len(group) else np.zeros(0, bool)
    place = np.arange(len(group)) - np.maximum.accumulate(np.where(first, np.arange(len(group)), 0))
    ends = (rows.knot[order] == 0) | (rows.knot[order] == len(near.knots.phi) - 1)
    keep = (place < SLOTS) & ~ends  # nothing can be done about the ends
    order, place = order[keep], place[keep]
    for body in range(2):
        mine = rows.body[order] == body
        at = (rows.knot[order][mine], place[mine])
        for j in range(3 + body):
            values[f"G{body}{j}"] = np.zeros((size, SLOTS))
            values[f"G{body}{j}"][at] = gradient[order][mine, j]
        values[f"room{body}"] = np.full((size, SLOTS), VACUOUS)
        values[f"room{body}"][at] = room[order][mine]


def _solve_clarabel(stated: Statement, values: dict[str, Array], count: int, time_limit: float) -> SubproblemSolution:
    """Solve with Clarabel itself on the data of cvxpy's compiled problem, vacuous rows left out.

    cvxpy's own way to Clarabel keeps these rows and unpacks every variable and multiplier.
    """
    import clarabel  # its module is compiled: type checkers cannot see into it

    solver: Any = clarabel
    data = stated.data(values)
    matrix = sparse.csr_matrix(data.A)
    matrix.eliminate_zeros()
    says_something = (np.diff(matrix.indptr) > 0) & (data.b < 0.5 * VACUOUS)
    keep, equalities = np.flatnonzero(says_something), int(says_something[: data.equalities].sum())
    matrix = sparse.csc_matrix(matrix[keep])
    settings = solver.DefaultSettings()
    settings.verbose = False
    settings.max_threads = 1
    settings.presolve_enable = False
    settings.time_limit = time_limit
    cones = [solver.ZeroConeT(equalities), solver.NonnegativeConeT(len(keep) - equalities)]
    upper = sparse.csc_matrix(sparse.triu(data.P))
    solution = solver.DefaultSolver(upper, data.q, matrix, data.b[keep], cones, settings).solve()
    status = "optimal" if solution.status == solver.SolverStatus.Solved else str(solution.status)
    if status != "optimal":
        return SubproblemSolution(status, solution.solve_time)
    multipliers = np.asarray(solution.z)[: 4 * (stated.num_knots - 1)].reshape(4, -1).T
    unpacked = stated.unpack(np.asarray(solution.x))
    return _step(unpacked, multipliers, count, solution.solve_time)


def _solve_cvxpy(stated: Statement, values: dict[str, Array], count: int, solver: str) -> SubproblemSolution:
    """Solve with any QP solver that cvxpy knows."""
    import cvxpy as cp

    for name, parameter in stated.parameters.items():
        parameter.value = values[name]
    try:
        with warnings.catch_warnings():
            warnings.simplefilter("ignore")  # an inaccurate solution counts as none: its status shows it
            stated.problem.solve(solver=solver.upper(), enforce_dpp=True)
    except cp.SolverError as error:
        return SubproblemSolution(f"solver error: {' '.join(str(error).split())}", 0.0)
    solver_s = float(stated.problem.solver_stats.solve_time or 0.0)
    if stated.problem.status != cp.OPTIMAL:
        return SubproblemSolution(stated.problem.status, solver_s)
    solved = {name: np.asarray(variable.value) for name, variable in stated.variables.items()}
    multipliers = np.stack([np.asarray(stated.problem.constraints[c].dual_value) for c in range(4)], axis=1)
    return _step(solved, multipliers, count, solver_s)


def _step(values: dict[str, Array], multipliers: Array, count: int, solver_s: float) -> SubproblemSolution:
    """The solution without the padding."""
    return SubproblemSolution(
        "optimal",
        solver_s,
        q=values["q"][:count],
        phi=values["phi"][:count],
        h=values["h"][: count - 1],
        nu=values["nu"][: count - 1],
        zeta=values["zeta"][:count],
        r=values["r"][: count - 1],
        multipliers=multipliers[: count - 1],
    )
