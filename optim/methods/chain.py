"""Chain: methods one after the other, each beginning where the one before ended; itself a method.

The requirement stays that of the problem: the ends of the recorded path, and the clearance that the recorded path
asks for (`Problem.required_clearance`). Only `Problem.start` changes from part to part. Iterates are told as of one
method, numbered on from part to part.
"""

import dataclasses
from collections.abc import Mapping
from dataclasses import dataclass

from optim.model.method import Method
from optim.model.objective import objective
from optim.model.path import Path
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
        """The path of least J among those that the parts gave; it stops where a part fails."""
        told, best, reasons, stop = _Told(on_iterate), problem.initial, [], Stop.CONVERGED
        for name, method in self.parts:
            told.begin_part()
            result = method.solve(problem, told)
            told.end_part(result.iterations)
            reasons.append(f"{name}: {result.reason} ({result.stop.value})")
            best = min(best, result.path, key=lambda path: objective(path, problem.weights))
            stop = result.stop
            if stop is Stop.FAILED:
                break
            if result.path is not problem.initial:  # else the log's nodes are still those of the path
                problem = dataclasses.replace(problem, start=result.path)
        told.end_with(best, objective(best, problem.weights))
        return Result(path=best, stop=stop, reason="; ".join(reasons), iterations=told.iterations)


class _Told:
    """Passes iterates on, numbered over all parts; what a part begins with has been told as the end of the last."""

    def __init__(self, on_iterate: OnIterate) -> None:
        self._on_iterate = on_iterate
        self._before = 0  # iterations of the parts that are done
        self.iterations = 0
        self._path: Path | None = None  # of the last accepted iterate

    def begin_part(self) -> None:
        self._before = self.iterations

    def end_part(self, iterations: int) -> None:
        self.iterations = max(self.iterations, self._before + iterations)

    def __call__(self, iterate: Iterate) -> None:
        if iterate.iteration == 0 and self._path is not None:
            return
        self._tell(dataclasses.replace(iterate, iteration=self._before + iterate.iteration))

    def end_with(self, path: Path, value: float) -> None:
        """Tell the path of the result unless it is what was accepted last: a later part may have made it worse."""
        if path is not self._path:
            self._tell(Iterate(iteration=self.iterations + (self._path is not None), path=path, objective=value))

    def _tell(self, iterate: Iterate) -> None:
        self.iterations = max(self.iterations, iterate.iteration)
        if iterate.accepted:
            self._path = iterate.path
        self._on_iterate(iterate)


def named(name: str, methods: Mapping[str, Method]) -> Method:
    """The method of that name, or the chain of those whose names it joins. KeyError with a name that is unknown."""
    if name in methods:
        return methods[name]
    parts = tuple((part, methods[part]) for part in name.split(JOINT))
    return Chain(parts=parts)
