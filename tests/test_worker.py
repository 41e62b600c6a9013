"""Methods in a child process: what goes wrong there costs one method."""

import dataclasses
import faulthandler
import multiprocessing
import os
import pathlib
import signal
import subprocess
import sys
import textwrap
import time

import numpy as np
import pytest
from scenes import random_problem

from optim.methods.ddp.method import Ddp
from optim.methods.shortcut import Shortcut
from optim.model.method import Method
from optim.model.path import Path
from optim.model.problem import Problem
from optim.model.result import Iterate, OnIterate, Result, Stop, ignore
from replay.run.case import Case, ReadReport
from replay.run.judge import Interrupted, run_case
from replay.run.limits import Limits
from replay.run.outcome import MethodRun
from replay.run.solving import Solved, solve
from replay.run.worker import Workers


@dataclasses.dataclass(frozen=True, kw_only=True)
class Bad:
    """A method that goes wrong in a way of choice, after some iterates."""

    how: str
    iterates: tuple[Path, ...] = ()

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        for number, path in enumerate((problem.initial, *self.iterates)):
            on_iterate(Iterate(iteration=number, path=path, objective=100.0 if number == 0 else 30.0 - number))
        if self.how == "crashes":
            faulthandler.disable()  # pytest's would print where each thread was
            os.kill(os.getpid(), signal.SIGSEGV)
        elif self.how == "leaves":
            os._exit(7)
        elif self.how == "hangs":
            time.sleep(600.0)
        elif self.how == "eats":
            np.ones((1 << 31) // 8).sum()
        elif self.how == "goes on":
            while True:
                time.sleep(0.01)
                on_iterate(Iterate(iteration=9, path=problem.initial, objective=100.0))
        raise ValueError("went wrong")


def _case(problem: Problem) -> Case:
    read = ReadReport(poses=2, hitch="trailer path", max_deviation_m=0.0, max_deviation_rad=0.0)
    log = pathlib.Path("yard.mcap")
    return Case(name="yard/0", log=log, sha256="0" * 64, problem=problem, read=read, map=None, frame="map")


def solved_by(workers: Workers, problem: Problem, method: Method, on_iterate: OnIterate) -> Solved:
    """What comes of one method."""
    ((_, solved),) = workers(problem, {"it": method}, lambda _: None, lambda _, iterate: on_iterate(iterate))
    return solved


def _data_mib() -> int:
    """Data of this process, which children inherit [MiB]: hundreds, after other tests."""
    status = pathlib.Path("/proc/self/status").read_text()
    return int(status.partition("VmData:")[2].split()[0]) // 1024


@pytest.mark.parametrize(
    ("how", "words"),
    [
        ("crashes", "its process was ended by SIGSEGV"),
        ("leaves", "its process ended with exit status 7"),
        ("eats", "MemoryError"),
        ("raises", "ValueError: went wrong"),
    ],
)
def test_a_method_that_goes_wrong_in_any_way_has_failed_and_the_next_one_goes_on(how, words):
    problem = random_problem(1)
    with Workers(Limits(memory_mib=_data_mib() + 1000)) as workers:
        run = run_case(_case(problem), {"bad": Bad(how=how), "shortcut": Shortcut(tries=200)}, solve=workers)
    bad, good = run.methods
    assert bad.status == "failed"
    assert words in bad.reason
    assert len(bad.history) == 1
    assert bad.path is problem.recorded
    assert good.status == "improved"


@pytest.mark.parametrize("how", ["hangs", "goes on"])
def test_when_time_is_up_the_best_iterate_that_passes_the_audit_is_the_result(how):
    problem = random_problem(1)
    better = Ddp().solve(problem).path
    bad = Bad(how=how, iterates=(better, problem.recorded))  # the last one says that it is the best
    started = time.monotonic()
    with Workers(Limits(time_s=0.3)) as workers:
        (run,) = run_case(_case(problem), {"bad": bad}, solve=workers).methods
    assert time.monotonic() - started < 20.0
    assert (run.status, run.stop) == ("improved", Stop.TIME_LIMIT.value)
    assert "Its time was up" in run.reason
    assert "iterate 1" in run.reason
    np.testing.assert_array_equal(run.path.samples.states, better.samples.states)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Lasts:
    """A method that sleeps, or works, for some seconds, and announces iterates all the time."""

    sleeps: bool
    seconds: float

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        ends = time.monotonic() + self.seconds
        while time.monotonic() < ends:
            on_iterate(Iterate(iteration=0, path=problem.initial, objective=100.0))
            if self.sleeps:
                time.sleep(0.05)
        return Result(path=problem.initial, stop=Stop.CONVERGED, reason="It has lasted.", iterations=0)


def test_a_limit_of_processor_time_does_not_end_a_method_that_had_to_wait():
    methods = {"waited": Lasts(sleeps=True, seconds=1.5), "worked": Lasts(sleeps=False, seconds=30.0)}
    with Workers(Limits(time_s=1.0, by_processor=True)) as workers:
        waited, worked = run_case(_case(random_problem(1)), methods, solve=workers).methods
    assert (waited.stop, worked.stop) == (Stop.CONVERGED.value, Stop.TIME_LIMIT.value)


def test_a_method_that_hangs_is_ended_though_it_uses_no_processor_time():
    with Workers(Limits(time_s=0.2, by_processor=True)) as workers:
        (run,) = run_case(_case(random_problem(1)), {"bad": Bad(how="hangs")}, solve=workers).methods
    assert run.stop == Stop.TIME_LIMIT.value


def test_without_a_better_iterate_the_recorded_path_is_kept_when_time_is_up():
    with Workers(Limits(time_s=0.1)) as workers:
        (run,) = run_case(_case(random_problem(1)), {"bad": Bad(how="goes on")}, solve=workers).methods
    assert (run.status, run.stop) == ("kept", Stop.TIME_LIMIT.value)


def test_a_child_gives_the_same_result_bit_by_bit_and_arrays_stay_read_only():
    problem, here, there = random_problem(2), [], []
    first = solve(problem, Ddp(), here.append)
    with Workers() as workers:
        second = solved_by(workers, problem, Ddp(), there.append)
    assert first.result is not None
    assert second.result is not None
    np.testing.assert_array_equal(first.result.path.samples.states, second.result.path.samples.states)
    assert [each.objective for each in here] == [each.objective for each in there]
    segment = second.result.path.segments[0]
    assert not segment.states.flags.writeable
    assert not segment.phi.flags.writeable
    assert second.compile_s == 0.0, "the kernels in the cache fit arrays that came through the pipe"


def test_an_exception_of_the_listener_ends_the_child_and_flies_on():
    def listener(_: Iterate) -> None:
        raise KeyboardInterrupt

    with Workers() as workers:
        with pytest.raises(KeyboardInterrupt):
            solved_by(workers, random_problem(1), Bad(how="hangs"), listener)
        again = solved_by(workers, random_problem(1), Shortcut(tries=5), ignore)
        assert again.result is not None, "a new child is started"


@dataclasses.dataclass(frozen=True, kw_only=True)
class Meets:
    """A method that ends when the other one of a folder has begun too."""

    folder: pathlib.Path
    mine: str
    others: str

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        (self.folder / self.mine).touch()
        while not (self.folder / self.others).exists():
            time.sleep(0.01)
        on_iterate(Iterate(iteration=0, path=problem.initial, objective=1.0))
        return Result(path=problem.initial, stop=Stop.CONVERGED, reason=self.mine, iterations=0)


def test_methods_run_at_the_same_time_and_are_reported_in_their_order(tmp_path):
    heard: list[str] = []
    methods = {
        "first": Meets(folder=tmp_path, mine="a", others="b"),
        "second": Meets(folder=tmp_path, mine="b", others="a"),
        "third": Shortcut(tries=5),
    }
    with Workers(Limits(time_s=60.0), 2, lambda: heard.append("meanwhile")) as workers:
        run = run_case(
            _case(random_problem(1)),
            methods,
            on_start=lambda name: heard.append(f"{name} starts"),
            on_end=lambda method: heard.append(f"{method.name} ends"),
            solve=workers,
        )
    assert [method.name for method in run.methods] == list(methods)
    assert {method.status for method in run.methods} <= {"improved", "kept"}
    assert [len(method.history) for method in run.methods[:2]] == [1, 1]
    assert heard[:3] == ["first starts", "second starts", "meanwhile"]
    assert sorted(heard[3:]) == ["first ends", "second ends", "third ends", "third starts"]


def test_methods_side_by_side_give_the_same_paths_as_in_turn():
    problem, methods = random_problem(2), {"ddp": Ddp(), "shortcut": Shortcut(tries=200), "bad": Bad(how="raises")}
    with Workers(Limits(), 3) as workers:
        side_by_side = run_case(_case(problem), methods, solve=workers)
    in_turn = run_case(_case(problem), methods)
    for one, other in zip(side_by_side.methods, in_turn.methods, strict=True):
        assert (one.name, one.status) == (other.name, other.status)
        assert repr(one.history) == repr(other.history)
        np.testing.assert_array_equal(one.path.samples.states, other.path.samples.states)


def test_a_method_that_dies_costs_nothing_to_the_one_beside_it(tmp_path):
    met = Meets(folder=tmp_path, mine="a", others="b")
    methods = {"slow": met, "crashes": Bad(how="crashes"), "frees": Meets(folder=tmp_path, mine="b", others="a")}
    with Workers(Limits(time_s=60.0), 2) as workers:
        slow, crashes, frees = run_case(_case(random_problem(1)), methods, solve=workers).methods
    assert "SIGSEGV" in crashes.reason
    assert (slow.status, frees.status) == ("kept", "kept")


def test_an_interruption_ends_all_methods_and_keeps_what_was_finished():
    def interrupt(method: MethodRun) -> None:
        del method
        raise KeyboardInterrupt

    methods = {"hangs": Bad(how="hangs"), "done": Shortcut(tries=5), "never": Shortcut(tries=5)}
    started = time.monotonic()
    with Workers(Limits(), 2) as workers:
        with pytest.raises(Interrupted) as caught:
            run_case(_case(random_problem(1)), methods, on_end=interrupt, solve=workers)
        assert multiprocessing.active_children() == []
    assert [method.name for method in caught.value.run.methods] == ["done"]
    assert time.monotonic() - started < 20.0


def test_the_child_ends_when_its_parent_is_killed(tmp_path):
    script = """
        import os, pathlib, sys, time
        sys.path.insert(0, sys.argv[1])
        from scenes import random_problem
        from test_worker import Bad, solved_by
        from replay.run.worker import Workers

        def listener(_):
            child, = pathlib.Path(f"/proc/self/task/{os.getpid()}/children").read_text().split()
            print(child, flush=True)
            time.sleep(60.0)

        with Workers() as workers:
            solved_by(workers, random_problem(1), Bad(how="goes on"), listener)
    """
    folder = str(pathlib.Path(__file__).parent)
    command = [sys.executable, "-c", textwrap.dedent(script), folder]
    with subprocess.Popen(command, stdout=subprocess.PIPE, text=True) as parent:
        assert parent.stdout is not None
        child = pathlib.Path("/proc") / parent.stdout.readline().strip()
        assert child.exists()
        parent.kill()
    deadline = time.monotonic() + 20.0
    while _is_alive(child) and time.monotonic() < deadline:
        time.sleep(0.05)
    assert not _is_alive(child)


def _is_alive(process: pathlib.Path) -> bool:
    """Whether a folder of /proc is that of a process that runs; one that nobody waits for stays as a zombie."""
    try:
        return (process / "stat").read_text().rpartition(")")[2].split()[0] != "Z"
    except OSError:
        return False
