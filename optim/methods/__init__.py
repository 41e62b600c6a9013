"""What a method is, and which there are."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, Protocol

from optim.methods.cpo import Cpo
from optim.methods.ddp import Ddp
from optim.methods.nlp import Nlp
from optim.methods.scp import Scp
from optim.methods.shortcut import Shortcut
from optim.problem import Problem
from optim.result import OnIterate, Result, ignore


class Method(Protocol):
    """A path optimiser: its options are its fields, `solve` is its only verb.

    A method is a frozen keyword-only dataclass; every field has a default and a docstring. `solve` is a pure
    function of options and problem, calls `on_iterate` for every accepted iterate and for trials turned down
    (`accepted=False`), and does not raise for numerical reasons: it gives back the best path it has, and says why
    it stopped.
    """

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result: ...


METHODS: Final[Mapping[str, Method]] = MappingProxyType(
    {"shortcut": Shortcut(), "cpo": Cpo(), "ddp": Ddp(), "nlp": Nlp(), "scp": Scp()}
)
"""Every method by the name that users type, with its default options."""
