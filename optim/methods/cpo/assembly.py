"""The path put together from its segments, improved or as they were."""

from optim.methods.cpo.trial import TOLERATED, SegmentTrial, limit_checks
from optim.model.iterates import IterateStream
from optim.model.objective import objective
from optim.model.path import Path, Segment
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Picture, Result, Stop

_LEAST_GAIN = 1e-6  # of J, relative: less is rounding


class Assembly:
    """The path so far; announces each trial of a segment, and says in the end what became of the segments."""

    def __init__(self, problem: Problem, on_iterate: OnIterate) -> None:
        self.problem = problem
        self.path = problem.initial
        self.objective = objective(self.path, problem.weights)
        self.iterations, self.deviation = 0, 0.0
        self.kept: list[tuple[int, str, bool]] = []  # segment, why it stays as recorded, whether it failed a check
        self.iterates = IterateStream.begin(problem, on_iterate)

    def reject(self, index: int, trial: SegmentTrial) -> None:
        """Announce a trial that is not taken."""
        if trial.stretch is not None:
            path = self._with(index, trial.stretch.segment)
            self._announce(trial, path, is_accepted=False)

    def judge(self, index: int, trial: SegmentTrial) -> bool:
        """Take the segment's last trial if it is sound and lowers J; else note why it stays as it was."""
        self.iterations += trial.iterations
        if trial.stretch is None:
            self.kept.append((index, "no drivable curve was found beside its points", True))
        elif not trial.is_sound:
            failed = [str(check) for check in trial.checks if not check.is_kept]
            self.kept.append((index, f"{', '.join(failed)} after round {trial.round}", True))
        else:
            path = self._with(index, trial.stretch.segment)
            value = objective(path, self.problem.weights)
            if value < self.objective * (1.0 - _LEAST_GAIN):
                self.path, self.objective = path, value
                self.deviation = max(self.deviation, trial.stretch.deviation)
                self._announce(trial, path, is_accepted=True)
                return True
            more = value - self.objective
            why = f"J would rise by {more:.2g}" if more > _LEAST_GAIN * self.objective else "there is nothing to gain"
            self.kept.append((index, why, False))
            self.reject(index, trial)
        return False

    def result(self, picture: Picture) -> Result:
        """The result: the path so far, or the initial one where a stretch that stays is itself unsound."""
        unsound = [
            f"{self._name(index)}: {check}"
            for index, _, _ in self.kept
            for check in limit_checks(self.problem, self.path.segments[index])
            if check.residual > TOLERATED
        ]
        improved = len(self.path.segments) - len(self.kept)
        reason, stop = self._reason(improved), Stop.CONVERGED
        if unsound:
            self.path = self.problem.initial
            reason = f"What stays as recorded is not sound ({'; '.join(unsound)}); {reason}"
            stop = Stop.INFEASIBLE
        elif any(failed for _, _, failed in self.kept):
            stop = Stop.STALLED
        if self.iterates.latest is not self.path:
            self.iterates.emit_path(self.problem, self.path)
        return Result(path=self.path, stop=stop, reason=reason, iterations=self.iterations, picture=picture)

    def _reason(self, improved: int) -> str:
        parts = [f"{improved} of {len(self.path.segments)} segments improved"]
        if improved:
            parts.append(f"the path is within {self.deviation:.3f} m of the points")
        parts += [f"{self._name(index)} stays as recorded: {why}" for index, why, _ in self.kept]
        return "; ".join(parts)

    def _name(self, index: int) -> str:
        gear = "forward" if self.path.segments[index].direction > 0 else "reverse"
        return f"segment {index + 1} ({gear})"

    def _with(self, index: int, segment: Segment) -> Path:
        return Path((*self.path.segments[:index], segment, *self.path.segments[index + 1 :]))

    def _announce(self, trial: SegmentTrial, path: Path, is_accepted: bool) -> None:
        self.iterates.emit(
            lambda number: Iterate(
                iteration=number,
                path=path,
                objective=objective(path, self.problem.weights),
                violation=max(0.0, *(check.residual - 1.0 for check in trial.checks)),
                step=trial.step,
                residuals={check.name: check.residual for check in trial.checks},
                accepted=is_accepted,
            )
        )
