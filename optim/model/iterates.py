"""Numbering of the iterates that a method announces, in one place for all methods."""

from collections.abc import Callable

from optim.model.objective import objective
from optim.model.path import Path
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, ignore


class IterateStream:
    """Number iterates and pass them to a listener; the first one has the number 0."""

    def __init__(self, on_iterate: OnIterate) -> None:
        self.latest: Path | None = None
        """Path of the last iterate that was passed on, accepted or not."""
        self.number = 0
        """Number of the last iterate."""
        self._has_begun = False
        self._on_iterate = on_iterate

    @staticmethod
    def begin(problem: Problem, on_iterate: OnIterate) -> "IterateStream":
        """A stream whose first iterate is the path that the method begins with."""
        stream = IterateStream(on_iterate)
        stream.emit_path(problem, problem.initial)
        return stream

    def emit(self, make: Callable[[int], Iterate], number: int | None = None) -> None:
        """Pass on the iterate that `make` gives for its number, by default the next one.

        Where nobody listens the iterate is counted, and not made.
        """
        self.number = self.number + self._has_begun if number is None else number
        self._has_begun = True
        if self._on_iterate is not ignore:
            self.forward(make(self.number))

    def emit_path(self, problem: Problem, path: Path) -> None:
        """Pass on a path with its J alone, such as that of the result."""
        self.emit(lambda number: Iterate(iteration=number, path=path, objective=objective(path, problem.weights)))

    def forward(self, iterate: Iterate) -> None:
        """Pass on an iterate with the number that it has."""
        self.number, self.latest, self._has_begun = iterate.iteration, iterate.path, True
        self._on_iterate(iterate)

    def advance(self, number: int) -> None:
        """Count up to `number`: what a method has done since the last iterate without announcing it."""
        self.number = max(self.number, number)
