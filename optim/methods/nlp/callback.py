"""CasADi's callback after each iteration of IPOPT."""

from collections.abc import Callable
from typing import Any

import numpy as np

from optim.numerics.arrays import Array


def new_callback(sizes: tuple[int, int], on_iterate: Callable[[Array, Array, dict[str, Any]], None]) -> Any:
    """A CasADi callback that passes unknowns, constraints and statistics of every iterate to `on_iterate`.

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
