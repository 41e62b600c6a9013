"""Flags of methods and of the objective's weights, which `replay optimize` and `replay regress` share."""

from typing import TYPE_CHECKING, Any, TypeAlias

from optim.methods import METHODS
from optim.model.objective import Weights
from replay.cli.options import flags_of
from replay.cli.settings import WEIGHTS

if TYPE_CHECKING:
    MethodFlags: TypeAlias = Any
    WeightFlags: TypeAlias = Any
else:
    MethodFlags = flags_of(METHODS, "Options of {name}")
    WeightFlags = flags_of({WEIGHTS: Weights()}, "Weights of the objective J")
