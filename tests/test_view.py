"""Recordings served as one dataset: listed with their results, linked, arranged, on this machine alone."""

import contextlib
import json
import os
import pathlib
import shlex
import shutil
import signal
import subprocess
import sys
import urllib.parse
from collections.abc import Iterator

import pytest
from rerun.catalog import CatalogClient

import replay.cli
from replay.base.errors import ReplayError
from replay.recording.dataset import served
from tools.processes import REPLAY


@pytest.fixture(scope="module")
def folder(one_file: pathlib.Path, five_file: pathlib.Path, tmp_path_factory: pytest.TempPathFactory) -> pathlib.Path:
    """A run's folder with two recordings, and a file that is none."""
    run = tmp_path_factory.mktemp("run")
    (run / "recordings").mkdir()
    shutil.copy(one_file, run / "recordings" / "one.rrd")
    shutil.copy(five_file, run / "recordings" / "five.rrd")
    (run / "recordings" / "cut.rrd").write_bytes(five_file.read_bytes()[:5000])
    return run


def test_a_dataset_lists_every_whole_recording_with_its_results(folder):
    with served("night", sorted((folder / "recordings").glob("*.rrd"))) as dataset:
        assert len(dataset.entries) == 2
        assert [line.split(":")[0] for line in dataset.skipped] == ["cut.rrd"]
        address, _, _ = dataset.url.partition("/entry/")
        assert urllib.parse.urlsplit(address).hostname == "127.0.0.1"
        found = CatalogClient(address).get_dataset("night")
        table = found.segment_table().to_pylist()
        assert {row["property:replay:status"][0] for row in table} == {e.properties["status"] for e in dataset.entries}
        before = sorted(row["property:replay:objective_before"][0] for row in table)
        assert before == sorted(e.properties["objective_before"] for e in dataset.entries)
        assert {urllib.parse.unquote(e.url.partition("?segment_id=")[2]) for e in dataset.entries} == set(
            found.segment_ids()
        )
        assert found.default_blueprint() is not None
        assert found.default_blueprint() in found.blueprints()


def test_a_port_that_is_taken_is_one_line(folder):
    files = [folder / "recordings" / "one.rrd"]
    with served("a", files) as dataset:
        port = urllib.parse.urlsplit(dataset.url.partition("+")[2]).port
        assert port is not None
        with pytest.raises(ReplayError, match=f"port {port} of 127.0.0.1") as refused, served("b", files, port):
            pass
    assert "\n" not in str(refused.value)


def test_a_folder_in_which_no_recording_is_whole_is_refused(folder):
    with (
        pytest.raises(ReplayError, match="none of 1 recordings can be read"),
        served("a", [folder / "recordings" / "cut.rrd"]),
    ):
        pass


@contextlib.contextmanager
def serving(command: list[str]) -> Iterator[subprocess.Popen[str]]:
    """A command that serves until it is told to end; it has ended when the block is left, whatever happens there."""
    with subprocess.Popen(command, stdout=subprocess.PIPE, stderr=subprocess.PIPE, text=True) as process:
        try:
            yield process
        finally:
            process.kill()


def test_the_command_serves_until_ctrl_c_and_ends_at_once(folder):
    with serving([*REPLAY, "view", str(folder), "--json"]) as process:
        assert process.stdout is not None
        text = ""
        while not text.endswith("\n}\n"):
            line = process.stdout.readline()
            assert line, process.communicate()[1]
            text += line
        document = json.loads(text)
        address, _, _ = document["url"].partition("/entry/")
        assert len(CatalogClient(address).get_dataset(folder.name).segment_ids()) == 2
        process.send_signal(signal.SIGINT)
        _, err = process.communicate(timeout=10)
    assert process.returncode == 130
    assert "Traceback" not in err
    assert len(document["recordings"]) == 2


def test_every_recording_has_a_command_on_one_line_that_opens_it(folder):
    with serving([*REPLAY, "view", str(folder)]) as process:
        assert process.stdout is not None
        lines = []
        while not lines or "the table of all" not in lines[-1]:
            lines.append(process.stdout.readline())
            assert lines[-1], process.communicate()[1]
    commands = [shlex.split(line, comments=True) for line in lines if line.startswith("rerun ")]
    assert len(commands) == 3
    for _, url in commands[:-1]:
        assert urllib.parse.urlsplit(url.partition("+")[2]).query.startswith("segment_id=")


def test_without_the_extra_one_line_names_it(folder):
    program = (
        "import sys; sys.modules['datafusion'] = None\n"
        "from replay.cli import main; sys.exit(main(['view', sys.argv[1]]))"
    )
    done = subprocess.run(
        [sys.executable, "-c", program, str(folder)], capture_output=True, text=True, timeout=60, env=os.environ
    )
    assert done.returncode == 2
    assert "truck-trailer-replay[view]" in done.stderr
    assert done.stderr.count("\n") == 1


@pytest.mark.parametrize("arguments", [["."], ["absent"], [".", "--port", "99999"]])
def test_what_cannot_be_viewed_is_one_line_and_status_2(arguments, capsys, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    assert replay.cli.main(["view", *arguments]) == 2
    said = capsys.readouterr()
    assert not said.out
    assert said.err.count("\n") == 1
