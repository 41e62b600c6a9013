"""Regression runs on a Dask cluster of this machine: what is refused, what is killed, what comes out."""

import os
import pathlib
import signal

import pytest
import regress_help as help

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")

from optim.methods import METHODS
from replay.base.errors import ReplayError
from replay.cli import main
from replay.regress.baseline import EMPTY
from replay.regress.cluster import _do, check_address, connected, run_on_cluster
from replay.regress.plan import Plan, carry_out, jobs_of, start
from replay.regress.sources import digest
from replay.regress.supervisor import run_here
from tools.attacks.local_cluster import LocalCluster
from tools.attacks.small_logs import write_corpus
from tools.attacks.worker_storm import growth
from tools.processes import is_running

COUNT = 16


@pytest.mark.parametrize(
    "address", ["tcp://127.0.0.1:8786", "tcp://localhost:1", "tcp://[::1]:8786", "tls://far.example:8786"]
)
def test_this_machine_and_tls_are_accepted(address):
    check_address(address)


@pytest.mark.parametrize(
    ("address", "words"),
    [
        ("tcp://10.0.0.5:8786", "lets everybody who can connect run code"),
        ("tcp://0.0.0.0:8786", "run code"),
        ("tcp://127.0.0.1.example:8786", "run code"),
        ("tcp://localhost.example:8786", "run code"),
        ("tcp://127.0.0.1@far.example:8786", "run code"),
        ("far.example:8786", "expected tcp://127.0.0.1:PORT"),
        ("tcp://127.0.0.1", "expected"),
        ("tcp://127.0.0.1:99999999", "expected"),
        ("ws://127.0.0.1:8786", "expected"),
        ("inproc://1/2/3", "expected"),
        ("", "expected"),
    ],
)
def test_every_other_address_is_refused_with_one_sentence(address, words):
    with pytest.raises(ReplayError) as caught:
        check_address(address)
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_where_nobody_answers_is_one_line(monkeypatch):
    monkeypatch.setattr("replay.regress.cluster._CONNECT_S", 1)
    with pytest.raises(ReplayError, match="no connection"):
        next(run_on_cluster([], "tcp://127.0.0.1:9"))


def test_what_is_waited_for_is_noted_before_it_is_given_up(monkeypatch):
    noted: list[str] = []
    monkeypatch.setattr("replay.regress.cluster._CONNECT_S", 2)
    monkeypatch.setattr("replay.regress.cluster._PATIENCE_S", 0.05)
    with pytest.raises(ReplayError, match="no connection"), connected("tcp://127.0.0.1:9", noted.append):
        pass
    assert noted == ["connecting to tcp://127.0.0.1:9, for at most 2 s"]


def test_a_scheduler_is_asked_before_the_folder_of_the_run_is_made(tmp_path, monkeypatch):
    monkeypatch.setattr("replay.regress.cluster._CONNECT_S", 1)
    folder = help.make_corpus(tmp_path / "corpus", ["bay_01"])
    assert main(["regress", folder, "--out", str(tmp_path / "runs"), "--scheduler", "tcp://127.0.0.1:9"]) == 2
    assert not (tmp_path / "runs").exists()


def test_relative_paths_are_found_by_workers_elsewhere_and_a_log_that_they_do_not_see_ends_the_run(
    tmp_path, monkeypatch
):
    help.make_corpus(tmp_path / "corpus", ["bay_01"])
    monkeypatch.chdir(tmp_path)
    plan = help.make_plan("corpus", {"shortcut": METHODS["shortcut"]})
    (job,) = jobs_of(plan, start(plan, tmp_path / "runs"), plan.logs, EMPTY)
    assert job.log.path == "corpus/bay_01.mcap"
    elsewhere = job.anywhere()
    (tmp_path / "elsewhere").mkdir()
    monkeypatch.chdir(tmp_path / "elsewhere")
    assert elsewhere.log == job.log
    assert digest(elsewhere.file)
    assert not digest(job.file)
    (tmp_path / "corpus" / "bay_01.mcap").unlink()
    told = _do(elsewhere, [elsewhere.folder, elsewhere.file])
    assert told == {"unseen": str(tmp_path / "corpus" / "bay_01.mcap"), "state": ""}


def test_growth_is_that_of_the_coordinator_after_a_number_of_results():
    assert growth([(0, 90.0), (10, 100.0), (20, 103.0), (30, 101.0), (30, 0.0)], 10) == 3.0


@pytest.fixture
def plan(tmp_path) -> Plan:
    write_corpus(tmp_path / "corpus", COUNT)
    return help.make_plan(str(tmp_path / "corpus"), {"ddp": METHODS["ddp"]})


@pytest.mark.slow
def test_killed_workers_cost_no_log_nothing_runs_on_and_results_are_those_of_this_machine(plan, tmp_path):
    paths = os.pathsep.join([str(help.ROOT), str(help.ROOT / "tests")])
    run = start(plan, tmp_path / "runs")
    with LocalCluster(tmp_path / "cluster", 2, paths) as cluster:
        killed: list[int] = []
        below: list[int] = []

        def kill_some(outcome: object, done: int, _: int) -> None:
            if outcome is not None and done in (3, 8):
                killed.append(cluster.workers()[0])
                below.extend(help.below(killed[-1]))
                os.kill(killed[-1], signal.SIGKILL)

        carry_out(plan, run, lambda jobs: run_on_cluster(jobs, cluster.address), kill_some)
        assert len(set(killed)) == 2
        assert below
        assert not [pid for pid in (*killed, *below) if is_running(pid)]
        assert cluster.workers()
    documents = help.results(run)
    assert len(documents) == len(run.done()) == COUNT
    assert len(help.attempts(run)) <= COUNT + 2 * 4
    other = start(plan, tmp_path / "here")
    carry_out(plan, other, lambda jobs: run_here(jobs, 2), lambda *_: None)
    assert help.results(other) == documents


@pytest.mark.slow
def test_a_scheduler_that_dies_ends_the_run_with_one_line_and_the_rest_can_be_done_here(plan, tmp_path):
    run = start(plan, tmp_path / "runs")
    paths = os.pathsep.join([str(help.ROOT), str(help.ROOT / "tests")])
    with LocalCluster(tmp_path / "cluster", 1, paths) as cluster:

        def kill_scheduler(outcome: object, done: int, _: int) -> None:
            if outcome is not None and done == 3:
                cluster.scheduler.kill()

        with pytest.raises(ReplayError, match="the scheduler has gone"):
            carry_out(plan, run, lambda jobs: run_on_cluster(jobs, cluster.address), kill_scheduler)
    before = len(run.done())
    assert 3 <= before < COUNT
    tried = len(help.attempts(run))
    carry_out(plan, run, lambda jobs: run_here(jobs, 2), lambda *_: None)
    assert len(run.done()) == COUNT
    assert len(help.attempts(run)) - tried == COUNT - before
    assert not list(pathlib.Path(run.logs).glob(".*.tmp"))
