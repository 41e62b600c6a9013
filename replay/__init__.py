"""Shorten recorded parking manoeuvres of a truck with one trailer, check every result, and show the comparison.

    import replay

    case = replay.read("log.mcap")[0]
    run = replay.optimize(case, "ddp", "shortcut+scp")
    run.best.path, run.best.audit.clearance.value
    run.plot()
    replay.record(run, "log.rrd")
    replay.save(run, "log.results.json")

Everything is loaded when it is first used: importing this package takes no time.
"""

import importlib
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:  # for type checkers and editors; at run time `__getattr__` loads the same
    from optim.methods.cpo.method import Cpo
    from optim.methods.ddp.method import Ddp
    from optim.methods.nlp.method import Nlp
    from optim.methods.scp.method import Scp
    from optim.methods.shortcut import Shortcut
    from optim.model.objective import Weights
    from optim.model.vehicle import Vehicle
    from replay.base.errors import ReplayError
    from replay.pipeline import export, load, open_workers, optimize, read, record, save
    from replay.run.case import Case
    from replay.run.limits import Limits
    from replay.run.outcome import Run

_PLACES = {
    **dict.fromkeys(("read", "optimize", "record", "save", "load", "export", "open_workers"), "replay.pipeline"),
    "Case": "replay.run.case",
    "Run": "replay.run.outcome",
    "Limits": "replay.run.limits",
    "ReplayError": "replay.base.errors",
    "Vehicle": "optim.model.vehicle",
    "Weights": "optim.model.objective",
    "Shortcut": "optim.methods.shortcut",
    "Cpo": "optim.methods.cpo.method",
    "Ddp": "optim.methods.ddp.method",
    "Nlp": "optim.methods.nlp.method",
    "Scp": "optim.methods.scp.method",
}
"""The module of each public name."""

__all__ = [
    "Case",
    "Cpo",
    "Ddp",
    "Limits",
    "Nlp",
    "ReplayError",
    "Run",
    "Scp",
    "Shortcut",
    "Vehicle",
    "Weights",
    "export",
    "load",
    "open_workers",
    "optimize",
    "read",
    "record",
    "save",
]


def __getattr__(name: str) -> Any:
    if name not in _PLACES:
        raise AttributeError(f"module {__name__!r} has no attribute {name!r}")
    value = getattr(importlib.import_module(_PLACES[name]), name)
    globals()[name] = value
    return value


def __dir__() -> list[str]:
    return sorted({*globals(), *__all__})
