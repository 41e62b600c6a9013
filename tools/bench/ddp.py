"""Differential dynamic programming: speed of its core beside two C++ libraries, and what it makes of logs.

`python tools/bench/ddp.py recordings/*.mcap` prints
- the time of one backward pass over 200 stages of a linear-quadratic problem, of `optim.ddp` and of crocoddyl's
  solver, and how far their gains are apart;
- cost, iterations and time on Tassa's car-parking problem (T = 500), of `optim.ddp` and of pycddp's interior point
  solvers from the same start (its CLDDP, in release 0.5.2, leaves the limits of the controls out: |w| 0.93 of 0.5);
- for each log: J, gear changes, iterations, CPU time (least of three, compiled before), of full DDP and of iLQR.

What is not installed is left out: `pip install crocoddyl pycddp` into any environment that has this project.
"""

import argparse
import functools
import importlib
import pathlib
import sys
import time
from typing import Any

import numpy as np

from optim.methods.ddp.algorithm import InnerOptions, minimise
from optim.methods.ddp.backward import backward_pass, new_expansion, new_policy
from optim.methods.ddp.method import Ddp
from optim.model.objective import objective
from replay.base.kernels import drop_stale
from replay.logs import read_cases
from tools.bench.timing import least
from tools.script import existing, run

sys.path.insert(0, str(pathlib.Path(__file__).resolve().parents[2] / "tests"))

STAGES, N, M = 200, 6, 2


def linear_quadratic() -> None:
    """One backward pass beside crocoddyl's, printed."""
    rng = np.random.default_rng(0)
    a, b = np.eye(N) + 0.1 * rng.standard_normal((N, N)), rng.standard_normal((N, M))
    q, r = np.eye(N), np.eye(M)
    e, policy = new_expansion(STAGES, N, M), new_policy(STAGES, N, M)
    e.fz[:, :, :N], e.fz[:, :, N:], e.lzz[:, :N, :N], e.lzz[:, N:, N:] = a, b, q, r
    backward_pass(e, 0.0, False, policy)
    ours = least(lambda: backward_pass(e, 0.0, False, policy), 500, time.perf_counter)
    print(f"backward pass, {STAGES} stages, {N} states, {M} controls: optim.ddp {1e6 * ours / STAGES:.2f} us a stage")
    try:
        crocoddyl: Any = importlib.import_module("crocoddyl")
    except ImportError:
        print("crocoddyl is not installed")
        return
    model = crocoddyl.ActionModelLQR(a, b, q, r, np.zeros((N, M)), np.zeros(N), np.zeros(N), np.zeros(M))
    problem = crocoddyl.ShootingProblem(np.ones(N), [model] * STAGES, model)
    problem.nthreads = 1
    for solver in (crocoddyl.SolverDDP(problem), crocoddyl.SolverFDDP(problem), crocoddyl.SolverBoxFDDP(problem)):
        solver.setCandidate([np.zeros(N)] * (STAGES + 1), [np.zeros(M)] * STAGES, False)
        solver.preg = solver.dreg = 0.0
        solver.computeDirection(True)
        apart = max(float(np.abs(solver.K[k] + policy.gain[k]).max()) for k in range(STAGES))
        theirs = least(solver.backwardPass, 500, time.perf_counter)
        name = type(solver).__name__
        print(f"  crocoddyl {crocoddyl.__version__} {name}: {1e6 * theirs / STAGES:.2f} us, gains apart by {apart:.1e}")


def car_parking() -> None:
    """Tassa's problem beside pycddp, printed."""
    car: Any = importlib.import_module("car_parking")  # among the tests

    print("\ncar parking, T = 500 (Tassa, Mansard, Todorov 2014):")
    for curvature in (False, True):
        options = InnerOptions(iterations=500, curvature=curvature, gradient=1e-5, first_regularisation=1.0)
        model = car.CarParking(curvature)
        start = model.initial()
        found = minimise(model, start, options)
        again = functools.partial(minimise, model, start, options)
        seconds = least(again, 3, time.perf_counter)
        name = "full DDP" if curvature else "iLQR"
        print(f"  optim.ddp {name}: cost {found.cost:.6f}, {found.iterations} iterations, {seconds:.2f} s")
    try:
        pycddp: Any = importlib.import_module("pycddp")
    except ImportError:
        print("pycddp is not installed")
        return

    class Objective(pycddp.NonlinearObjective):
        def running_cost(self, state: np.ndarray, control: np.ndarray, _: int) -> float:
            return car.running_cost(state, control[0], control[1])

        def terminal_cost(self, state: np.ndarray) -> float:
            return car.final_cost(state)

        def evaluate(self, states: list[np.ndarray], controls: list[np.ndarray]) -> float:
            running = sum(car.running_cost(x, u[0], u[1]) for x, u in zip(states, controls, strict=False))
            return running + self.terminal_cost(states[-1])

    for kind in (pycddp.SolverType.IPDDP, pycddp.SolverType.MSIPDDP):
        options = pycddp.CDDPOptions()
        options.max_iterations, options.verbose, options.print_solver_header = 300, False, False
        solver = pycddp.CDDP(car.START, np.zeros(4), car.STEPS, car.STEP, options)
        solver.set_dynamical_system(pycddp.Car(car.STEP, car.WHEELBASE, "euler"))
        solver.set_objective(Objective(car.STEP))
        solver.add_constraint("ControlConstraint", pycddp.ControlConstraint(-car.LIMITS, car.LIMITS))
        states, controls = car.CarParking(False).initial()
        solver.set_initial_trajectory(list(states), list(controls))
        start = time.perf_counter()
        solution = solver.solve(kind)
        seconds = time.perf_counter() - start
        over = float((np.abs(np.array(solution.control_trajectory)) - car.LIMITS).max())
        print(
            f"  pycddp {pycddp.__version__} {kind.name}: cost {solution.final_objective:.6f}, "
            f"{solution.iterations_completed} iterations, {seconds:.1f} s with its cost in Python, "
            f"controls over their limits by {max(over, 0.0):.1e}, {solution.status_message}"
        )


def logs(paths: list[pathlib.Path]) -> None:
    """What full DDP and iLQR make of logs, and how long they take, printed."""
    methods = {"full": Ddp(), "iLQR": Ddp(hessian="gauss_newton")}
    print("\nJ / gear changes / iterations / CPU [s]\n")
    print("| log | recorded |", " | ".join(methods), "|")
    print("|---|--:|" + "--:|" * len(methods))
    seconds = {name: [] for name in methods}
    for path in paths:
        for case in read_cases(path):
            problem, cells = case.problem, []
            for name, method in methods.items():
                result, spent = method.solve(problem), least(functools.partial(method.solve, problem), 3)
                seconds[name].append(spent)
                value = objective(result.path, problem.weights)
                cells.append(f"{value:.3f} / {result.path.num_cusps} / {result.iterations} / {spent:.3f}")
            print(f"| {case.name} | {objective(problem.recorded, problem.weights):.2f} |", " | ".join(cells), "|")
    print("| median CPU [s] | |", " | ".join(f"{np.median(values):.3f}" for values in seconds.values()), "|")


def main() -> None:
    parser = argparse.ArgumentParser(description="Speed and quality of differential dynamic programming.")
    parser.add_argument("logs", nargs="*", type=existing, metavar="LOG", help="default: none")
    arguments = parser.parse_args()
    drop_stale()
    linear_quadratic()
    car_parking()
    if arguments.logs:
        logs(arguments.logs)


if __name__ == "__main__":
    run(main)
