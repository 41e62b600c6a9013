"""A run in a viewer while it happens: what arrives there, and that no viewer can cost the run."""

import pathlib
import signal
import socket
import subprocess
import time
import warnings
from collections import Counter
from collections.abc import Iterator

import pytest
import recording_factory as factory
import rerun_cli
from logs_maker import sound_log
from rerun.chunk import RrdReader
from results_maker import results_data

import replay.cli
from optim.model.result import Iterate
from replay.recording.viewer import LiveView, NoViewer, open_viewer

QUICK = ["--method", "shortcut", "--shortcut.tries", "20", "--no-recording"]


class Server:
    """Rerun's own server without a window, which keeps what arrives in a file."""

    def __init__(self, file: pathlib.Path) -> None:
        self.file = file
        with socket.socket() as probe:
            probe.bind(("127.0.0.1", 0))
            port = probe.getsockname()[1]
        self.url = f"rerun+http://127.0.0.1:{port}/proxy"
        program = pathlib.Path(rerun_cli.__file__).with_name("rerun")
        command = [program, "--bind", "127.0.0.1", "--port", str(port), "--save", file]
        self.process = subprocess.Popen(command, stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
        deadline = time.monotonic() + 30.0
        while True:
            try:
                socket.create_connection(("127.0.0.1", port), 1.0).close()
                return
            except OSError:
                assert time.monotonic() < deadline
                time.sleep(0.05)

    def stop(self) -> None:
        if self.process.poll() is None:
            self.process.send_signal(signal.SIGINT)
            try:
                self.process.wait(10)
            except subprocess.TimeoutExpired:
                self.process.kill()
                self.process.wait(10)

    def rows(self) -> Counter[str]:
        """Rows by entity, as soon as they no longer grow."""
        seen: Counter[str] = Counter()
        deadline = time.monotonic() + 20.0
        while time.monotonic() < deadline:
            time.sleep(0.5)
            now: Counter[str] = Counter()
            with warnings.catch_warnings():
                warnings.simplefilter("ignore")  # the file has no end yet
                for chunk in RrdReader(self.file).stream():
                    now[chunk.entity_path] += chunk.num_rows
            if now and now == seen:
                break
            seen = now
        return seen


@pytest.fixture
def server(tmp_path) -> Iterator[Server]:
    server = Server(tmp_path / "arrived.rrd")
    yield server
    server.stop()


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> pathlib.Path:
    return sound_log().write(tmp_path_factory.mktemp("logs") / "yard.mcap")


def run(*arguments: str | pathlib.Path) -> int:
    return replay.cli.main([str(argument) for argument in arguments])


def test_map_path_iterates_and_result_arrive_at_the_viewer(server, log, tmp_path, capsys):
    assert run("optimize", log, *QUICK, "--viewer", server.url, "--out", tmp_path) == 0
    assert capsys.readouterr().err == ""
    rows = server.rows()
    history = results_data(tmp_path / "yard.results.json")["methods"][0]["history"]
    accepted = sum(row["accepted"] for row in history)
    assert accepted > 0
    assert rows["/scene/shortcut/iterate"] >= 2 * accepted, "as they came, and again with the result"
    for entity in ("/scene/map", "/scene/recorded/path", "/scene/shortcut/vehicle/truck", "/report/summary"):
        assert rows[entity], entity


def test_iterates_arrive_before_the_run_is_done(server):
    one = factory.make_run()
    view = LiveView(server.url, ["shortcut"], pytest.fail)
    view.begin(one.case)
    view.iterate("shortcut", Iterate(iteration=1, path=one.methods[0].path, objective=80.0))
    view.iterate("shortcut", Iterate(iteration=2, path=one.methods[0].path, objective=90.0, accepted=False))
    rows = server.rows()
    assert rows["/scene/shortcut/iterate"] == 1 + 1, "its looks, and what was accepted"
    assert rows["/scene/map"]
    assert not rows["/report/summary"]
    view.end()


@pytest.mark.parametrize(
    ("url", "words"),
    [
        ("rerun+http://127.0.0.1:9/proxy", "no viewer answers there"),
        ("http://127.0.0.1:9876", "expected an address such as rerun+http://127.0.0.1:9876/proxy"),
        ("rerun+http://127.0.0.1:99999/proxy", "expected an address such as"),
        ("nonsense", "expected an address such as"),
    ],
)
def test_without_a_viewer_the_run_goes_on_with_one_line(log, tmp_path, capsys, url, words):
    assert run("optimize", log, *QUICK, "--viewer", url, "--quiet", "--out", tmp_path) == 0
    said = capsys.readouterr().err
    assert said.count("\n") == 1
    assert words in said
    assert said.endswith("the run continues without it\n")
    assert (tmp_path / "yard.results.json").exists()


def test_without_a_display_none_is_started(monkeypatch):
    for name in ("DISPLAY", "WAYLAND_DISPLAY"):
        monkeypatch.delenv(name, raising=False)
    monkeypatch.setattr("sys.platform", "linux")
    with pytest.raises(NoViewer, match="there is no display for a viewer"):
        open_viewer(None)


def test_a_viewer_that_cannot_show_a_window_is_one_line(monkeypatch):
    monkeypatch.setenv("DISPLAY", ":987")
    monkeypatch.delenv("WAYLAND_DISPLAY", raising=False)
    with pytest.raises(NoViewer, match="--view: the viewer"):
        open_viewer(None)


def test_a_viewer_that_goes_away_costs_the_view_and_not_the_run(server, log, tmp_path, capsys):
    one = factory.make_run()
    said: list[str] = []
    view = LiveView(server.url, ["shortcut"], said.append)
    view.begin(one.case)
    server.process.kill()
    server.process.wait(10)
    started = time.monotonic()
    for k in range(20):
        view.iterate("shortcut", Iterate(iteration=k, path=one.methods[0].path, objective=80.0))
    view.finish(one)
    view.end()
    view.begin(one.case)
    view.end()
    assert time.monotonic() - started < 30.0
    assert len(said) == 1
    assert said[0].startswith("the view has ended, the run continues without it: ")
