"""The functions of the public API: reading, choosing methods, running them, and what a run offers."""

import dataclasses
import json
import os
import pathlib
import sys
import time
from typing import Any

import numpy as np
import pytest
from logs_maker import LogMaker, drive, grid, path, sound_log, yard

import replay
from optim.methods import METHODS
from optim.methods.chain import Chain
from optim.model.problem import Problem
from optim.model.result import OnIterate, Result, Stop, ignore
from replay.base.errors import UsageError
from replay.pipeline import chosen_methods
from replay.run.judge import Interrupted

# Reading.


@pytest.fixture(scope="module")
def log(tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    return sound_log().write(tmp_path_factory.mktemp("logs") / "yard.mcap")


@pytest.fixture(scope="module")
def case(log: pathlib.Path) -> replay.Case:
    return replay.read(log)[0]


@pytest.fixture(scope="module")
def run(case: replay.Case) -> replay.Run:
    return replay.optimize(case, "ddp", replay.Shortcut(tries=60), weights=replay.Weights(cusp=4.0))


def test_a_log_is_read_with_options_as_keywords(log: pathlib.Path, tmp_path: pathlib.Path) -> None:
    (tmp_path / "truck.toml").write_text("trailer_rear = 11.5\n")
    (found,) = replay.read(log, margin=0.2, vehicle=tmp_path / "truck.toml", start_direction="reverse")
    assert found.problem.margin == 0.2
    assert found.problem.vehicle == replay.Vehicle(trailer_rear=11.5)
    assert found.reading is not None
    assert (found.reading["margin"], found.reading["start_direction"]) == (0.2, -1)
    (found,) = replay.read(str(log), vehicle=replay.Vehicle(trailer_rear=11.0))
    assert found.problem.vehicle.trailer_rear == 11.0


@pytest.mark.parametrize(
    ("options", "said"),
    [
        ({"margn": 0.2}, "unknown option 'margn' of read. Did you mean 'margin'?"),
        ({"margin": -1.0}, "reading: margin is -1.0 m, expected 0 to 10"),
        ({"vehicle": "none.toml"}, "vehicle none.toml: No such file"),
    ],
)
def test_an_option_of_reading_that_is_no_good_is_one_line(log: pathlib.Path, options: Any, said: str) -> None:
    with pytest.raises(replay.ReplayError) as caught:
        replay.read(log, **options)
    assert said in str(caught.value)


# Methods.


def test_methods_are_given_by_name_as_objects_or_as_a_mapping() -> None:
    assert list(chosen_methods(())) == list(METHODS)
    assert list(chosen_methods(("DDP", "shortcut+scp"))) == ["ddp", "shortcut+scp"]
    own = replay.Ddp(spacing=0.2)
    assert chosen_methods((own, "scp")) == {"ddp": own, "scp": METHODS["scp"]}
    assert chosen_methods(({"fine": own, "coarse": replay.Ddp()},)) == {"fine": own, "coarse": replay.Ddp()}
    chain = Chain(parts=(("shortcut", replay.Shortcut()), ("ddp", own)))
    assert chosen_methods((chain,)) == {"shortcut+ddp": chain}


def test_the_seed_is_that_of_methods_by_name_alone() -> None:
    found: Any = chosen_methods(("shortcut", "shortcut+ddp"), seed=3)
    assert found["shortcut"].seed == 3
    assert found["shortcut+ddp"].parts[0][1].seed == 3
    assert chosen_methods((replay.Shortcut(seed=5),), seed=3) == {"shortcut": replay.Shortcut(seed=5)}


@pytest.mark.parametrize(
    ("given", "said"),
    [
        (("dpp",), "unknown method 'dpp'. Did you mean 'ddp'? There are: shortcut, cpo, ddp, nlp, scp"),
        (("shortcut+spc",), "unknown method 'spc' in 'shortcut+spc'. Did you mean 'scp'?"),
        ((replay.Ddp(), replay.Ddp(spacing=0.2)), "two methods are called 'ddp': give them names of their own"),
        ((replay.Ddp,), "expected the name of a method or a method, as in 'ddp' or Ddp(), not <class"),
        ((3,), "expected the name of a method or a method, as in 'ddp' or Ddp(), not 3"),
    ],
)
def test_what_is_no_method_is_refused_in_one_line(given: Any, said: str) -> None:
    with pytest.raises(UsageError) as caught:
        chosen_methods(given)
    assert said in str(caught.value)
    assert "\n" not in str(caught.value)


def test_a_list_of_cases_is_no_case(case: replay.Case) -> None:
    with pytest.raises(UsageError, match=r"expected one case, as in read\(log\)\[0\], and it is a list"):
        replay.optimize([case])  # pyright: ignore[reportArgumentType]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Says:
    """Says which process it runs in, after some time."""

    seconds: float = 0.0

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        time.sleep(self.seconds)
        return Result(path=problem.recorded, stop=Stop.STALLED, reason=f"process {os.getpid()}", iterations=0)


@dataclasses.dataclass(frozen=True, kw_only=True)
class Interrupts:
    """As if somebody pressed Ctrl-C; runs in this process alone."""

    def solve(self, problem: Problem, on_iterate: OnIterate = ignore) -> Result:
        raise KeyboardInterrupt


def process_of(run: replay.Run) -> int:
    return int(run.methods[0].reason.rpartition("process ")[2])


def test_each_method_runs_in_a_process_of_its_own_which_open_workers_keep(case: replay.Case) -> None:
    alone = {process_of(replay.optimize(case, Says())) for _ in range(2)}
    assert len(alone) == 2
    with replay.open_workers(replay.Limits(time_s=30.0), jobs=1) as workers:
        kept = [replay.optimize(case, Says(), workers=workers) for _ in range(2)]
    assert len({process_of(run) for run in kept}) == 1
    assert not {os.getpid()} & {*alone, *map(process_of, kept)}
    assert kept[0].limits == replay.Limits(time_s=30.0)
    assert "says" in kept[0]


def test_a_method_that_exceeds_its_time_limit_is_stopped(case: replay.Case) -> None:
    run = replay.optimize(case, Says(seconds=60.0), limits=replay.Limits(time_s=0.1))
    assert (run["says"].status, run["says"].stop) == ("kept", "time limit")


def test_callbacks_hear_of_each_method_and_each_iterate(case: replay.Case) -> None:
    heard: list[tuple[str, Any]] = []
    run = replay.optimize(
        case,
        "ddp",
        on_start=lambda name: heard.append(("start", name)),
        on_iterate=lambda name, iterate: heard.append((name, iterate.iteration)),
        on_end=lambda method: heard.append(("end", method.name)),
        progress=False,
    )
    assert heard[0] == ("start", "ddp")
    assert [number for name, number in heard[1:-1]] == [record.iteration for record in run["ddp"].history]
    assert heard[-1] == ("end", "ddp")


def test_ctrl_c_carries_what_was_finished(case: replay.Case, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("replay.pipeline.can_fork", lambda: False)
    with pytest.raises(Interrupted) as caught:
        replay.optimize(case, Says(), Interrupts())
    assert [method.name for method in caught.value.run] == ["says"]
    assert caught.value.run.limits == replay.Limits(memory_mib=4096)


# What a run offers.


def test_what_is_printed_is_one_short_line(case: replay.Case, run: replay.Run) -> None:
    assert run.best is not None
    problem = run.case.problem
    shown = [run, case, run.best, run.best.path, run.best.audit, run.best.audit.clearance, problem.scene]
    shown += [run.best.iterates[0], run.best.path.segments[0], problem]
    for each in shown:
        assert "\n" not in repr(each)
        assert len(repr(each)) < 200, repr(each)
    assert repr(case) == "Case('yard/0': 26.00 m, 1 gear change, 8 convex obstacles)"
    assert repr(run).startswith("Run('yard/0': J 30.45 → ")
    assert repr(run["shortcut"]).startswith("MethodRun('shortcut': ")


def test_methods_of_a_run_are_found_by_name(run: replay.Run) -> None:
    assert run["ddp"] is run.methods[0]
    assert [method.name for method in run] == ["ddp", "shortcut"]
    assert "ddp" in run
    assert "nlp" not in run
    with pytest.raises(KeyError, match=r"unknown method 'dpp'\. Did you mean 'ddp'"):
        run["dpp"]


def test_a_run_comes_back_from_its_file_and_is_recorded_and_exported(run: replay.Run, tmp_path: pathlib.Path) -> None:
    replay.save(run, tmp_path / "yard.results.json")
    again = replay.load(str(tmp_path / "yard.results.json"))
    assert again.best is not None
    assert run.best is not None
    assert again.best.metrics == run.best.metrics
    assert again.case.problem.weights == replay.Weights(cusp=4.0)
    assert (again.limits, again.case.reading) == (run.limits, run.case.reading)
    replay.save(again, tmp_path / "again.results.json")
    first, second = (json.loads((tmp_path / f"{name}.results.json").read_text()) for name in ("yard", "again"))
    for each in (first, second):
        for method in each["methods"]:
            for row in method["history"]:
                row["step"] = None  # infinite for the first iterate, which JSON does not have
    assert first == second
    replay.record(again, tmp_path / "yard.rrd")
    assert (tmp_path / "yard.rrd").stat().st_size > 10_000
    replay.export(run, tmp_path / "yard.optimised.mcap")
    assert (tmp_path / "yard.optimised.mcap").read_bytes().startswith(b"\x89MCAP")


def test_a_file_that_is_no_results_file_is_one_line(log: pathlib.Path) -> None:
    with pytest.raises(replay.ReplayError, match="not JSON: it is an MCAP log; expected a results file"):
        replay.load(log)


def test_the_plot_has_units_on_its_axes_and_every_path_once_in_its_legend(run: replay.Run) -> None:
    pyplot = pytest.importorskip("matplotlib.pyplot")
    pyplot.switch_backend("agg")
    figure = run.plot("ddp", "shortcut")
    titles = [axes.get_ylabel() for axes in figure.axes] + [figure.axes[0].get_xlabel(), figure.axes[-1].get_xlabel()]
    assert titles == [
        *("y [m]", "steering angle φ [°]", "hitch angle α [°]", "clearance [m]"),
        *("x [m]", "distance driven s [m]"),
    ]
    (legend,) = (legend for part in figure.subfigs for legend in part.legends)
    names = [text.get_text().partition(":")[0] for text in legend.get_texts()]
    assert names == ["recorded", "ddp", "shortcut", "start", "goal"]
    figure.canvas.draw()
    pyplot.close(figure)


def test_paths_and_runs_become_data_frames(run: replay.Run) -> None:
    assert run.best is not None
    samples = run.best.path.to_dataframe()
    assert list(samples.columns) == ["segment", "direction", "s", "x", "y", "theta", "alpha", "phi"]
    np.testing.assert_array_equal(samples["phi"].to_numpy(), run.best.path.samples.phi)
    np.testing.assert_array_equal(samples["alpha"].to_numpy(), run.best.path.samples.states[:, 3])
    table = run.to_dataframe()
    assert table["path"].to_list() == ["recorded", "ddp", "shortcut"]
    assert table["objective"].to_list()[0] == run.recorded_metrics.objective
    assert table["audit_passed"].to_list()[:2] == [True, True]


def test_without_the_packages_for_it_one_line_says_what_to_install(
    run: replay.Run, monkeypatch: pytest.MonkeyPatch
) -> None:
    for name in ("pandas", "polars", "matplotlib"):
        monkeypatch.setitem(sys.modules, name, None)
    with pytest.raises(ImportError, match="needs pandas or polars, and neither is installed: pip install pandas"):
        run.to_dataframe()
    with pytest.raises(ImportError, match="plot needs matplotlib, and it is not installed: pip install matplotlib"):
        run.plot()


def test_several_requests_of_a_log_are_several_cases(tmp_path: pathlib.Path) -> None:
    truck, _ = drive()
    maker = LogMaker().vehicle().add("/map", grid(yard()), 1)
    for k in range(2):
        maker.add("/truck", path(truck[: 70 + 20 * k]), 2 + k)
    cases = replay.read(maker.write(tmp_path / "two.mcap"))
    assert [case.name for case in cases] == ["two/0", "two/1"]
