"""The convex sub-problem, stated once in cvxpy for each size; only its parameters change between solutions.

Unknowns are the changes (dq, dphi, dh) of the knots of `optim.knots.transcription`, the virtual control nu of each
interval, and the slack zeta of each knot and body, all scaled to order one:

    min   g . (dphi, dh) + 1/2 sum |r_k|^2 + lambda . nu + 1/2 |nu|^2 + mu . zeta + 1/2 |zeta|^2
    s.t.  r_k = F_k (dtheta_k, dalpha_k, dphi_k, dphi_{k+1}, dh_k)        curvature of the Lagrangian, F'F
          A_k dq_k + B_k dphi_k + B'_k dphi_{k+1} + C_k dh_k - dq_{k+1} + defect_k = nu_k / sqrt(w)
          |phi_{k+1} - phi_k| <= max_steer_rate h_k,    dq = 0 at start and goal,    dh equal in each segment
          trust region and limits as one interval for each of dtheta, dalpha, dphi, dh
          distance + gradient . dq + zeta / sqrt(w) >= required,    zeta >= 0

Sizes are rounded up (`bucket`), so that logs of similar length share a compiled problem; padding intervals move
nothing, and rows that say nothing carry `VACUOUS` on their right-hand side.
"""

from collections.abc import Mapping
from dataclasses import dataclass
from functools import cached_property, lru_cache
from typing import TYPE_CHECKING, Any, Final, NamedTuple

import numpy as np

from optim.numerics.arrays import Array, Float64

if TYPE_CHECKING:
    import cvxpy as cp

VACUOUS: Final = 1e6
"""Right-hand side of rows that say nothing; in scaled units, where everything else is of order one."""
SLOTS: Final = 6
"""Collision rows of each knot and body."""
BUCKET: Final = 32
"""Numbers of knots are rounded up to a multiple of this."""
LINEAR: Final = {"phi": "g_phi", "h": "g_h", "nu": "lambda", "zeta": "mu"}
"""The parameter that each variable is multiplied with in the objective."""

DEPENDS: Final = ((2,), (2,), (), (3,))
"""On which states of its start each state of an interval's end depends by a factor of its own; see `OWN`."""
OWN: Final = (True, True, True, False)
"""Whether a state's own value enters with the factor one as well: x, y and theta are what they were plus a change."""


def bucket(num_knots: int) -> int:
    """The number of knots that a problem is compiled for."""
    return max(BUCKET, -(-num_knots // BUCKET) * BUCKET)


class ConeData(NamedTuple):
    """min 1/2 x'Px + q'x  s.t.  A x + s = b, the first `equalities` of s zero, the others not negative."""

    P: Any
    q: Float64[Array, " n"]
    A: Any
    b: Float64[Array, " m"]
    equalities: int


@dataclass(frozen=True, eq=False)
class Statement:
    """A sub-problem in cvxpy, with its parameters and variables by name."""

    problem: "cp.Problem"
    curved: "cp.Problem"
    """The same without the linear terms of the objective, which `LINEAR` names."""
    parameters: dict[str, "cp.Parameter"]
    variables: dict[str, "cp.Variable"]
    num_knots: int

    @cached_property
    def compiled(self) -> Any:
        """cvxpy's affine map from parameters to the data of a conic solver; made once, of `curved`.

        With parameters in the objective, cvxpy makes a dense table of variables by parameters on its way: 0.3 GiB for
        200 knots, 27 GiB for 2000.
        """
        import cvxpy as cp

        return self.curved.get_problem_data(cp.CLARABEL)[0]

    def data(self, values: Mapping[str, Array]) -> ConeData:
        """The solver's data for values of the parameters.

        The same as giving the values to the parameters and asking `get_problem_data`, without cvxpy's validation of
        each of 60 parameters, which takes 8 ms where the map itself takes 1 ms.
        """
        stuffed = self.compiled["param_prob"]
        by_id = {parameter.id: values[name] for name, parameter in self.parameters.items()}
        P, q, _, A, b = stuffed.apply_parameters(by_id, quad_obj=True)
        for name, slope in LINEAR.items():
            start = stuffed.var_id_to_col[self.variables[name].id]
            q[start : start + values[slope].size] += values[slope].ravel(order="F")
        return ConeData(P, q, -A, b, self.compiled["dims"].zero)

    def unpack(self, x: Array) -> dict[str, Array]:
        """The variables' values in a solution of the solver."""
        start = self.compiled["param_prob"].var_id_to_col
        return {
            name: x[start[variable.id] : start[variable.id] + variable.size].reshape(variable.shape, order="F")
            for name, variable in self.variables.items()
        }


@lru_cache(maxsize=16)
def statement(num_knots: int) -> Statement:
    """The sub-problem for `num_knots` knots, compiled at its first solution."""
    import cvxpy as cp

    parameters: dict[str, Any] = {}

    def given(name: str, *shape: int) -> Any:
        parameters[name] = cp.Parameter(shape, name=name, value=np.zeros(shape))
        return parameters[name]

    K, M = num_knots, num_knots - 1
    q, phi, h = cp.Variable((K, 4), name="q"), cp.Variable(K, name="phi"), cp.Variable(M, name="h")
    nu, zeta, r = cp.Variable((M, 4), name="nu"), cp.Variable((K, 2), name="zeta"), cp.Variable((M, 5), name="r")
    left, right, before, after = q[:-1], q[1:], phi[:-1], phi[1:]

    def reached(c: int) -> Any:
        """Row c of the linearised end of each interval."""
        inputs = [(f"A{c}{j}", left[:, j]) for j in DEPENDS[c]]
        inputs += [(f"B{c}", before), (f"B'{c}", after), (f"C{c}", h)]
        own = left[:, c] if OWN[c] else 0.0
        return sum((cp.multiply(given(name, M), value) for name, value in inputs), own)

    def clear(body: int) -> Any:
        """Change of the rows of a body's distances by the step. Shape (K, SLOTS)."""
        spread = np.ones((1, SLOTS))
        terms = [cp.multiply(given(f"G{body}{j}", K, SLOTS), q[:, j : j + 1] @ spread) for j in range(3 + body)]
        slack = cp.multiply(given(f"zeta{body}", K), zeta[:, body])
        return sum(terms[1:], terms[0]) + cp.reshape(slack, (K, 1), order="F") @ spread

    # the dynamics come first: their multipliers are the first of the solver's
    control = given("nu", M)
    constraints = [
        reached(c) - right[:, c] - cp.multiply(control, nu[:, c]) == -given(f"defect{c}", M) for c in range(4)
    ]
    inputs = [left[:, 2], left[:, 3], before, after, h]
    for i in range(5):
        row = [cp.multiply(given(f"F{i}{j}", M), inputs[j]) for j in range(i, 5)]
        constraints.append(sum(row[1:], row[0]) == r[:, i])
    constraints += [q[0] == 0.0, q[K - 1] == 0.0]
    constraints.append(cp.multiply(given("same", M - 1), h[1:] - h[:-1]) == 0.0)
    # collision rows follow first among the inequalities, for the same reason
    constraints += [-clear(body) <= given(f"room{body}", K, SLOTS) for body in range(2)]
    turn = cp.multiply(given("rate", M), h)
    constraints += [after - before - turn <= given("rate_up", M), before - after - turn <= given("rate_down", M)]
    for name, value in (("theta", q[:, 2]), ("alpha", q[:, 3]), ("phi", phi), ("h", h)):
        size = M if name == "h" else K
        constraints += [value <= given(f"{name}_up", size), -value <= given(f"{name}_down", size)]
    constraints.append(zeta >= 0.0)
    variables = {variable.name(): variable for variable in (q, phi, h, nu, zeta, r)}
    squares = 0.5 * (cp.sum_squares(r) + cp.sum_squares(nu) + cp.sum_squares(zeta))
    squares = 0.0 * (cp.sum(phi) + cp.sum(h)) + squares  # nothing, but cvxpy orders variables as it meets them
    slopes = [
        cp.sum(cp.multiply(given(slope, *variables[name].shape), variables[name])) for name, slope in LINEAR.items()
    ]
    curved = cp.Problem(cp.Minimize(squares), constraints)
    problem = cp.Problem(cp.Minimize(squares + sum(slopes)), constraints)
    return Statement(problem=problem, curved=curved, parameters=parameters, variables=variables, num_knots=K)
