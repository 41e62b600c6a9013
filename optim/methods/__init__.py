"""What a method is, and which there are."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final, Protocol

from optim.methods.cpo.method import Cpo
from optim.methods.ddp.method import Ddp
from optim.methods.nlp.method import Nlp
from optim.methods.scp.method import Scp
from optim.methods.shortcut import Shortcut
from optim.model.problem import Problem
from optim.model.result import OnIterate, Result, ignore


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
