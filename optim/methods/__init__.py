"""The protocol of a method, and the list of methods."""

from collections.abc import Mapping
from types import MappingProxyType
from typing import Final

from optim.methods.cpo.method import Cpo
from optim.methods.ddp.method import Ddp
from optim.methods.nlp.method import Nlp
from optim.methods.scp.method import Scp
from optim.methods.shortcut import Shortcut
from optim.model.method import Method

METHODS: Final[Mapping[str, Method]] = MappingProxyType(
    {"shortcut": Shortcut(), "cpo": Cpo(), "ddp": Ddp(), "nlp": Nlp(), "scp": Scp()}
)
"""Every method by the name that users type, with its default options."""
