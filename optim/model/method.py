"""The protocol of a method: options as fields, one verb."""

from typing import Protocol

from optim.model.problem import Problem
from optim.model.result import OnIterate, Result, ignore


class Method(Protocol):
    """A path optimiser: its options are its fields, `solve` is its only verb.

    A method is a frozen keyword-only dataclass; every field has a default and a docstring. `solve` is a pure
    function of options and problem, calls `on_iterate` for every accepted iterate and for rejected trials
    (`accepted=False`), and does not raise for numerical reasons: it returns the best path it has, and the reason
    why it stopped.
    """

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        """Improve `problem.initial`."""
        ...
