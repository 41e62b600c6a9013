"""One case and some methods: run each, measure it, have it audited, and say what came of it."""

import dataclasses
import math
import traceback
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import replace
from typing import Any

from optim.audit.checks import audit_path, audit_recorded
from optim.audit.report import AuditReport
from optim.methods.chain import Chain
from optim.model.method import Method
from optim.model.metrics import Metrics, metrics
from optim.model.objective import objective
from optim.model.path import Path
from optim.model.problem import Problem
from optim.model.result import Iterate, IterateRecord, Result, Stop
from replay.run.case import Case
from replay.run.limits import Limits
from replay.run.outcome import MOST_ITERATES, MethodRun, Run
from replay.run.plain import path_to_document, scene_to_document
from replay.run.solving import OnNamedIterate, OnStart, Solved, SolveEach, solve_in_turn

LEAST_VIOLATION = 1e-4
"""Violation, in the method's own scaling, from which on an iterate is not worth an audit."""
MOST_TRIED = 10
"""Iterates of a method without a result that are audited, at most."""
LEAST_GAIN = 1e-9
"""Relative gain in J that "improved" claims at least where the recorded path passes the audit too [-]: rounding alone
reaches 1e-12."""
CLEARANCE_SLACK = 1e-4
"""Tolerance on the required clearance of an "improved" path [m]; methods keep 1e-6."""


def gains(before: float, after: float) -> bool:
    """Whether J `after` is lower than J `before` by more than rounding."""
    return after < before * (1.0 - LEAST_GAIN)


def lacks_clearance(problem: Problem, measured: Metrics) -> bool:
    """Whether a path with these metrics comes nearer to obstacles than a result may."""
    return measured.min_clearance < problem.required_clearance - CLEARANCE_SLACK


class Interrupted(KeyboardInterrupt):
    """Ctrl-C during a run; carries what was finished by then."""

    def __init__(self, run: Run) -> None:
        super().__init__()
        self.run = run


def run_case(
    case: Case,
    methods: Mapping[str, Method],
    on_iterate: OnNamedIterate | None = None,
    *,
    on_start: OnStart = lambda _: None,
    on_end: Callable[[MethodRun], None] = lambda _: None,
    seed: int = 0,
    limits: Limits | None = None,
    solve: SolveEach = solve_in_turn,
) -> Run:
    """Run methods on a case; one that fails does not stop the others.

    The callbacks get the method's name, before it starts and with each iterate, and at last what came of it. `seed` and
    `limits` are noted, not used: seeds are options of the methods, limits those of `solve`, which runs the methods, by
    default in this process and one after the other (see `replay.run.worker`). Raises Interrupted on Ctrl-C.
    """
    problem = case.problem
    run = Run(
        case=case,
        recorded_metrics=metrics(problem.vehicle, problem.scene, problem.recorded, problem.weights),
        recorded_audit=_audit_recorded(problem),
        methods=(),
        options={name: _options(method) for name, method in methods.items()},
        seed=seed,
        limits=limits,
    )
    iterates = {name: _Iterates(name, on_iterate) for name in methods}
    ended: dict[str, MethodRun] = {}

    def finished() -> Run:
        return replace(run, methods=tuple(ended[name] for name in methods if name in ended))

    try:
        with closing(solve(problem, methods, on_start, lambda name, iterate: iterates[name](iterate))) as outcomes:
            for name, solved in outcomes:
                ended[name] = _method_run(run, name, solved, iterates[name])
                on_end(ended[name])
    except KeyboardInterrupt:
        raise Interrupted(finished()) from None
    return finished()


class _Iterates:
    """Collects iterates: the scalars of all of them, and accepted paths thinned to a bounded number."""

    def __init__(self, name: str, forward: OnNamedIterate | None) -> None:
        self.name = name
        self.forward = forward
        self.history: list[IterateRecord] = []
        self._num_accepted = 0
        self._kept: list[Iterate] = []
        self._last: Iterate | None = None
        self._stride = 1

    def __call__(self, iterate: Iterate) -> None:
        self.history.append(iterate.record)
        if iterate.accepted:
            self._keep(iterate)
        if self.forward is not None:
            self.forward(self.name, iterate)

    def _keep(self, iterate: Iterate) -> None:
        if self._num_accepted % self._stride == 0:
            self._kept.append(iterate)
        if len(self._kept) >= MOST_ITERATES:
            self._kept = self._kept[::2]
            self._stride *= 2
        self._num_accepted += 1
        self._last = iterate

    @property
    def kept(self) -> tuple[Iterate, ...]:
        if self._last is None or self._kept[-1] is self._last:
            return tuple(self._kept)
        return (*self._kept, self._last)


def _method_run(run: Run, name: str, solved: Solved, iterates: _Iterates) -> MethodRun:
    """Measure and audit what a method gave; any exception ends here, in a run that has failed."""
    fallback = MethodRun(
        name=name,
        status="failed",
        stop=Stop.FAILED.value,
        reason="",
        path=run.case.problem.recorded,
        metrics=run.recorded_metrics,
        audit=run.recorded_audit,
        iterations=len(iterates.history),
        wall_s=solved.wall_s,
        compile_s=solved.compile_s,
        history=tuple(iterates.history),
        iterates=iterates.kept,
    )
    try:
        return _outcome(run, fallback, solved)
    except Exception as error:  # a border: what a method gave may be anything
        message = " ".join(str(error).split())
        return replace(fallback, reason=f"{type(error).__name__}: {message}", traceback=traceback.format_exc())


def _outcome(run: Run, fallback: MethodRun, solved: Solved) -> MethodRun:
    """`fallback` has failed with the recorded path; what is known better replaces its fields."""
    if solved.error:
        return replace(fallback, reason=solved.error, traceback=solved.traceback)
    if solved.out_of_time:
        return _best_so_far(run, fallback, f"Its time was up after {solved.wall_s:.1f} s.")
    if solved.result is None:
        return replace(fallback, reason="The method gave no result.")
    return _judge(run, fallback, solved.result)


def _best_so_far(run: Run, fallback: MethodRun, reason: str) -> MethodRun:
    """The best iterate that passes the audit, of a method whose time was up.

    Those without violation are tried in the order of J, at most `MOST_TRIED` of them.
    """
    problem = run.case.problem
    before = objective(problem.recorded, problem.weights) if run.recorded_audit.passed else math.inf
    better = [each for each in fallback.iterates if each.violation <= LEAST_VIOLATION and each.objective < before]
    for iterate in sorted(better, key=lambda each: each.objective)[:MOST_TRIED]:
        result = Result(path=iterate.path, stop=Stop.TIME_LIMIT, reason=reason, iterations=fallback.iterations)
        judged = _judge(run, fallback, result)
        if judged.status == "improved":
            return replace(judged, reason=f"{reason} This is iterate {iterate.iteration}.")
    nothing = f"{reason} No iterate by then was better and passed the audit."
    return replace(fallback, status="kept", stop=Stop.TIME_LIMIT.value, reason=nothing)


def _judge(run: Run, fallback: MethodRun, result: Result) -> MethodRun:
    """Decide what a result is worth: the audit first, then J, never its own word.

    A path that passes the audit is better than a recorded one that does not, whatever its J.
    """
    problem = run.case.problem
    fallback = replace(fallback, stop=result.stop.value, iterations=result.iterations, picture=result.picture)
    if result.stop is Stop.FAILED:
        return replace(fallback, reason=result.reason)
    measured = metrics(problem.vehicle, problem.scene, result.path, problem.weights)
    wrong = _not_finite(measured)
    if wrong:
        return replace(fallback, reason=f"The path has no finite {', '.join(wrong)}.")
    report = _audit(problem, result.path, measured.objective)
    if not report.passed:
        reason = "The audit rejected its path: " + "; ".join(report.failures)
        return replace(fallback, status="kept", reason=reason, rejected=report, rejected_path=result.path)
    if lacks_clearance(problem, measured):
        found, required = measured.min_clearance, problem.required_clearance
        reason = f"Its path has {found:.3f} m of clearance, {required:.3f} m are required."
        return replace(fallback, status="kept", reason=reason)
    before, after = run.recorded_metrics.objective, measured.objective
    reason = result.reason
    if not run.recorded_audit.passed:
        reason = f"It passes the audit (J {after:.6g}), which the recorded path (J {before:.6g}) does not. {reason}"
    elif not gains(before, after):
        nothing = f"Nothing better was found (J {after:.6g}, recorded {before:.6g}): {reason}"
        return replace(fallback, status="kept", reason=nothing)
    return replace(fallback, status="improved", reason=reason, path=result.path, metrics=measured, audit=report)


def _not_finite(measured: Metrics) -> list[str]:
    """Names of metrics that no path may have: NaN, or inf but for the clearance in an empty scene."""
    values = dataclasses.asdict(measured).items()
    return [name for name, value in values if math.isnan(value) or (math.isinf(value) and name != "min_clearance")]


def _audit(problem: Problem, path: Path, objective: float) -> AuditReport:
    """The audit of a method's path, from the same plain data as the results file holds."""
    return audit_path(
        dataclasses.asdict(problem.vehicle),
        scene_to_document(problem.scene),
        path_to_document(problem.recorded),
        path_to_document(path),
        dataclasses.asdict(problem.weights),
        objective,
    )


def _audit_recorded(problem: Problem) -> AuditReport:
    vehicle, scene = dataclasses.asdict(problem.vehicle), scene_to_document(problem.scene)
    return audit_recorded(vehicle, scene, path_to_document(problem.recorded))


def _options(method: Method) -> dict[str, Any]:
    """A method's options; of a chain, each part's by its name; empty for a method that is not a dataclass."""
    if isinstance(method, Chain):
        return {name: _options(part) for name, part in method.parts}
    fields = dataclasses.fields(method) if dataclasses.is_dataclass(method) else ()
    return {field.name: getattr(method, field.name) for field in fields}
