"""One case and some methods: run each, measure it, have it audited, and say what came of it."""

import dataclasses
import math
import traceback
from collections.abc import Callable, Mapping
from contextlib import closing
from dataclasses import dataclass
from typing import Any, Literal

from optim.audit.checks import AuditReport, audit_path, audit_recorded
from optim.methods.chain import Chain
from optim.model.method import Method
from optim.model.metrics import metrics
from optim.model.objective import objective
from optim.model.path import Path
from optim.model.problem import Problem
from optim.model.result import Iterate, Picture, Result, Stop
from replay.run.case import Case
from replay.run.results import LEAST_GAIN, lacks_clearance, path_to_document, scene_to_document
from replay.run.solving import OnNamedIterate, OnStart, Solved, SolveEach, solve_in_turn

Status = Literal["improved", "kept", "failed"]

MOST_ITERATES = 400
"""Iterates kept for playing back, at most; the first and the last accepted one always are."""
LEAST_VIOLATION = 1e-4
"""Violation, in the method's own scaling, from which on an iterate is not worth an audit."""
EQUAL = 1e-6
"""Relative difference in J by which no path is better than another [-]."""
AS_GOOD = 1e-3
"""Relative difference in J that nobody would notice [-]."""
MOST_TRIED = 10
"""Iterates of a method without a result that are audited, at most."""


@dataclass(frozen=True, eq=False, kw_only=True)
class MethodRun:
    """What one method made of a case. `path` is the recorded one unless `status` is "improved"."""

    name: str
    status: Status
    """improved: passed by the audit, and of less J than a recorded path that passes it too; kept: nothing better was
    found; failed: an error."""
    stop: str
    """The method's own word, a value of `optim.model.result.Stop`."""
    reason: str
    """One sentence for the user; of whatever decided the status."""
    path: Path
    metrics: dict[str, float]
    """Of `path`; the keys and units of `optim.model.metrics.UNITS`."""
    audit: dict[str, Any]
    """Of `path`; as `AuditReport.to_dict`."""
    iterations: int
    wall_s: float
    """Time that the method took [s]; neither the audit nor compilation is included."""
    history: list[dict[str, Any]]
    """Of every iterate, also of trials turned down: each field of `Iterate` but the path, by its name."""
    iterates: tuple[Iterate, ...]
    """The accepted ones, for playing back; thinned evenly to at most `MOST_ITERATES`."""
    rejected: dict[str, Any] | None = None
    """The audit of the path that the method gave, if that audit did not pass."""
    rejected_path: Path | None = None
    """That path, for drawing where it fails."""
    picture: Picture | None = None
    """What the method works on besides the path, for drawing."""
    compile_s: float = 0.0
    """Time that went into compiling kernels [s]; once on each machine, and again after a change of the code."""
    traceback: str = ""
    """Of an exception, for developers."""


@dataclass(frozen=True, eq=False, kw_only=True)
class Run:
    """A case and what each method made of it."""

    case: Case
    recorded_metrics: dict[str, float]
    recorded_audit: dict[str, Any]
    methods: tuple[MethodRun, ...]
    options: dict[str, Any]
    """Of each method by its name: option -> value."""
    seed: int = 0

    @property
    def best(self) -> MethodRun | None:
        """The improved path of least J, of equal ones that of the method named first; None if none improved."""
        improved = [run for run in self.methods if run.status == "improved"]
        least = min((run.metrics["objective"] for run in improved), default=math.inf)
        return next((run for run in improved if run.metrics["objective"] <= least * (1.0 + EQUAL)), None)

    @property
    def as_good(self) -> list[MethodRun]:
        """Other improved paths, whose J is the best one's but for what nobody would notice."""
        best, improved = self.best, [run for run in self.methods if run.status == "improved"]
        most = math.inf if best is None else best.metrics["objective"] * (1.0 + AS_GOOD)
        return [run for run in improved if run is not best and run.metrics["objective"] <= most]

    @property
    def fell_short(self) -> bool:
        """Whether a method failed, or gave a path that the audit turned down."""
        return any(run.status == "failed" or run.rejected is not None for run in self.methods)


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
    solve: SolveEach = solve_in_turn,
) -> Run:
    """Run methods on a case; one that fails does not stop the others.

    The callbacks get the method's name, before it starts and with each iterate, and at last what came of it. `seed` is
    noted, not used: seeds are options of the methods; `solve` runs the methods, by default in this process and one
    after the other (see `replay.run.worker`). Raises Interrupted on Ctrl-C.
    """
    problem = case.problem
    run = Run(
        case=case,
        recorded_metrics=metrics(problem.vehicle, problem.scene, problem.recorded, problem.weights),
        recorded_audit=_audit_recorded(problem),
        methods=(),
        options={name: _options(method) for name, method in methods.items()},
        seed=seed,
    )
    iterates = {name: _Iterates(name, on_iterate) for name in methods}
    ended: dict[str, MethodRun] = {}

    def finished() -> Run:
        return dataclasses.replace(run, methods=tuple(ended[name] for name in methods if name in ended))

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
        self.history: list[dict[str, Any]] = []
        self._num_accepted = 0
        self._kept: list[Iterate] = []
        self._last: Iterate | None = None
        self._stride = 1

    def __call__(self, iterate: Iterate) -> None:
        self.history.append(_scalars(iterate))
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


def _scalars(iterate: Iterate) -> dict[str, Any]:
    """Everything of an iterate but its path."""
    fields = (field.name for field in dataclasses.fields(iterate) if field.name != "path")
    return {name: getattr(iterate, name) for name in fields} | {"residuals": dict(iterate.residuals)}


def _method_run(run: Run, name: str, solved: Solved, iterates: _Iterates) -> MethodRun:
    """Measure and audit what a method gave; any exception ends here, in a run that has failed."""
    try:
        verdict = _verdict(run, solved, iterates)
    except Exception as error:  # a border: what a method gave may be anything
        message = " ".join(str(error).split())
        verdict = _failed(run, f"{type(error).__name__}: {message}", iterates, traceback.format_exc())
    times = {"wall_s": solved.wall_s, "compile_s": solved.compile_s}
    return MethodRun(name=name, history=iterates.history, iterates=iterates.kept, **times, **verdict)


def _verdict(run: Run, solved: Solved, iterates: _Iterates) -> dict[str, Any]:
    if solved.error:
        return _failed(run, solved.error, iterates, solved.traceback)
    if solved.out_of_time:
        return _best_so_far(run, iterates, f"Its time was up after {solved.wall_s:.1f} s.")
    if solved.result is None:
        return _failed(run, "The method gave no result.", iterates, "")
    return _judge(run, solved.result)


def _failed(run: Run, reason: str, iterates: _Iterates, trace: str) -> dict[str, Any]:
    end = {"stop": Stop.FAILED.value, "iterations": len(iterates.history), "traceback": trace}
    return _recorded(run, "failed", reason) | end


def _best_so_far(run: Run, iterates: _Iterates, reason: str) -> dict[str, Any]:
    """Of a method whose time was up: its best iterate that passes the audit.

    Those without violation are tried in the order of J, at most `MOST_TRIED` of them.
    """
    problem = run.case.problem
    before = objective(problem.recorded, problem.weights) if run.recorded_audit["passed"] else math.inf
    better = [each for each in iterates.kept if each.violation <= LEAST_VIOLATION and each.objective < before]
    iterations = len(iterates.history)
    for iterate in sorted(better, key=lambda each: each.objective)[:MOST_TRIED]:
        result = Result(path=iterate.path, stop=Stop.TIME_LIMIT, reason=reason, iterations=iterations)
        verdict = _judge(run, result)
        if verdict["status"] == "improved":
            return verdict | {"reason": f"{reason} This is iterate {iterate.iteration}."}
    end = {"stop": Stop.TIME_LIMIT.value, "iterations": iterations}
    return _recorded(run, "kept", f"{reason} No iterate by then was better and passed the audit.") | end


def _judge(run: Run, result: Result) -> dict[str, Any]:
    """The fields of a `MethodRun` that say what a result is worth: the audit first, then J, never its own word.

    A path that passes the audit is better than a recorded one that does not, whatever its J.
    """
    problem = run.case.problem
    end = {"stop": result.stop.value, "iterations": result.iterations, "picture": result.picture}
    if result.stop is Stop.FAILED:
        return end | _recorded(run, "failed", result.reason)
    measured = metrics(problem.vehicle, problem.scene, result.path, problem.weights)
    wrong = [
        key for key, value in measured.items() if math.isnan(value) or (math.isinf(value) and key != "min_clearance")
    ]
    if wrong:
        return end | _recorded(run, "failed", f"The path has no finite {', '.join(wrong)}.")
    report = _audit(problem, result.path, measured["objective"])
    if not report.passed:
        reason = "The audit turned its path down: " + "; ".join(report.failures)
        return end | _recorded(run, "kept", reason) | {"rejected": report.to_dict(), "rejected_path": result.path}
    if lacks_clearance(problem, measured):
        found, required = measured["min_clearance"], problem.required_clearance
        reason = f"Its path has {found:.3f} m of clearance, {required:.3f} m are required."
        return end | _recorded(run, "kept", reason)
    before, after = run.recorded_metrics["objective"], measured["objective"]
    reason = result.reason
    if not run.recorded_audit["passed"]:
        reason = f"It passes the audit (J {after:.6g}), which the recorded path (J {before:.6g}) does not. {reason}"
    elif not after < before * (1.0 - LEAST_GAIN):
        return end | _recorded(
            run, "kept", f"Nothing better was found (J {after:.6g}, recorded {before:.6g}): {reason}"
        )
    better = {"status": "improved", "reason": reason, "path": result.path}
    return end | better | {"metrics": measured, "audit": report.to_dict()}


def _recorded(run: Run, status: Status, reason: str) -> dict[str, Any]:
    """The fields of a `MethodRun` that falls back on the recorded path."""
    path = run.case.problem.recorded
    return {
        "status": status,
        "reason": reason,
        "path": path,
        "metrics": run.recorded_metrics,
        "audit": run.recorded_audit,
    }


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


def _audit_recorded(problem: Problem) -> dict[str, Any]:
    vehicle, scene = dataclasses.asdict(problem.vehicle), scene_to_document(problem.scene)
    return audit_recorded(vehicle, scene, path_to_document(problem.recorded)).to_dict()


def _options(method: Method) -> dict[str, Any]:
    """A method's options; of a chain, each part's by its name; empty for a method that is no dataclass."""
    if isinstance(method, Chain):
        return {name: _options(part) for name, part in method.parts}
    fields = dataclasses.fields(method) if dataclasses.is_dataclass(method) else ()
    return {field.name: getattr(method, field.name) for field in fields}
