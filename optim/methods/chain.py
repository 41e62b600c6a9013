"""Chain: methods one after the other, each beginning where the one before ended; itself a method.

The requirement stays that of the problem: the ends of the recorded path, and the clearance that the recorded path
asks for (`Problem.required_clearance`). Only `Problem.start` changes from part to part. Iterates are announced as
those of one method, numbered through all parts.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

from optim.model.iterates import IterateStream
from optim.model.method import Method
from optim.model.objective import objective
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore

JOINT = "+"
"""Between the names of a chain's parts: `shortcut+scp`."""


@dataclass(frozen=True, kw_only=True)
class Chain:
    """Run methods one after the other, each from the path that the one before gave."""

    parts: tuple[tuple[str, Method], ...]
    """Name and method of each part, in order; a method may come more than once."""

    def __post_init__(self) -> None:
        if len(self.parts) < 2:
            raise ValueError(f"chain: parts is {[name for name, _ in self.parts]!r}, expected two or more")

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        """Run the parts; the path of least J among theirs. A part that fails is the last one."""
        iterates, best, reasons, stop = IterateStream(on_iterate), problem.initial, [], Stop.CONVERGED
        for name, method in self.parts:
            before = iterates.number
            result = method.solve(problem, partial(_forward, iterates, before))
            iterates.advance(before + result.iterations)
            reasons.append(f"{name}: {result.reason} ({result.stop.value})")
            best = min(best, result.path, key=lambda path: objective(path, problem.weights))
            stop = result.stop
            if stop is Stop.FAILED:
                break
            if result.path is not problem.initial:  # else the log's nodes are still those of the path
                problem = dataclasses.replace(problem, start=result.path)
        if best is not iterates.latest:  # a later part may have made it worse
            iterates.emit_path(problem, best)
        return Result(path=best, stop=stop, reason="; ".join(reasons), iterations=iterates.number)


def _forward(iterates: IterateStream, before: int, iterate: Iterate) -> None:
    """Pass on the iterate of a part, numbered after those of the parts before; the path it begins with only once."""
    if iterate.iteration == 0 and iterates.latest is not None:
        return
    iterates.forward(dataclasses.replace(iterate, iteration=before + iterate.iteration))


def named(name: str, methods: Mapping[str, Method]) -> Method:
    """The method of this name, or the chain of the methods whose names it joins. Raises KeyError for unknown names."""
    if name in methods:
        return methods[name]
    parts = tuple((part, methods[part]) for part in name.split(JOINT))
    return Chain(parts=parts)
