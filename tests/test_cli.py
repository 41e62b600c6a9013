"""What the command line promises: exit statuses, files, one line for each error, JSON and nothing else when asked."""

import dataclasses
import json
import pathlib
import shutil
import subprocess
import sys
from typing import Any

import pytest
from logs_maker import LogMaker, drive, grid, path, sound_log, yard
from mcap.writer import CompressionType

import replay.cli
from optim.methods import METHODS
from tools.processes import REPLAY

ROOT = pathlib.Path(__file__).resolve().parent.parent
BAY = ROOT / "recordings" / "bay_01.mcap"
QUICK = ["--shortcut.tries", "20", "--no-recording"]
ONE = ["--method", "shortcut", *QUICK]


@dataclasses.dataclass(frozen=True, kw_only=True)
class Spoken:
    """What a command said."""

    status: int
    out: str
    err: str

    @property
    def document(self) -> dict[str, Any]:
        return json.loads(self.out)


@pytest.fixture
def run(capsys, tmp_path, monkeypatch):
    """Runs a command in this process, in an empty folder."""
    monkeypatch.chdir(tmp_path)

    def call(*arguments: str | pathlib.Path) -> Spoken:
        capsys.readouterr()
        status = replay.cli.main([str(argument) for argument in arguments])
        said = capsys.readouterr()
        return Spoken(status=status, out=said.out, err=said.err)

    return call


@pytest.fixture(scope="module")
def log(tmp_path_factory) -> pathlib.Path:
    return sound_log().write(tmp_path_factory.mktemp("logs") / "yard.mcap")


def names(folder: pathlib.Path) -> list[str]:
    return sorted(file.name for file in folder.iterdir())


def in_a_process(*arguments: str, **options: Any) -> subprocess.CompletedProcess[str]:
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, timeout=120, **options)


# ---- help and usage


@pytest.mark.parametrize("command", replay.cli.COMMANDS)
def test_every_command_explains_itself(run, command):
    said = run(command, "--help")
    assert said.status == 0
    assert replay.cli.COMMANDS[command].partition(";")[0] in " ".join(said.out.split())


@pytest.mark.parametrize(
    ("arguments", "words"),
    [
        (["optmize", BAY], ["optmize", "Did you mean 'optimize'?", "audit"]),
        (["optimize"], ["expected one or more logs", "`replay optimize recordings/bay_01.mcap"]),
        (["optimize", BAY, "--shortcut.trie", "5"], ["--shortcut.trie", "Did you mean --shortcut.tries?"]),
        (["optimize", BAY, "--shortcut.tries", "many"], ["--shortcut.tries", "many"]),
        (["optimize", BAY, "--shortcut.tries", "-4"], ["shortcut: tries is -4"]),
        (["optimize", BAY, "--method", "shortct"], ["'shortct'", "Did you mean 'shortcut'?"]),
        (
            ["optimize", BAY, "--method", "shortcut+shortct"],
            ["'shortct' in 'shortcut+shortct'", "Did you mean 'shortcut'?"],
        ),
        (["optimize", BAY, "--method", "shortcut+"], ["unknown method '' in 'shortcut+'. There are: shortcut"]),
        (["optimize", BAY, "--weights.cusp", "-1"], ["weights: cusp is -1"]),
        (["optimize", BAY, "--margin", "40"], ["margin is 40"]),
        (["optimize", BAY, "--unknown", "maybe"], ["--unknown", "obstacle", "free"]),
        (["optimize", BAY, "--vehicle", "none.toml"], ["vehicle none.toml", "No such file"]),
        (["optimize", BAY, "--out", BAY], ["--out", "it is a file"]),
        (["info", BAY, "--no-such"], ["--no-such"]),
        (["info", "none.mcap"], ["none.mcap", "E_NOT_FOUND"]),
        (["optimize", "none.mcap"], ["none.mcap", "E_NOT_FOUND"]),
        (["audit", "none.json"], ["none.json", "No such file"]),
        (["audit", BAY], ["bay_01.mcap", "E_RESULTS"]),
    ],
)
def test_wrong_usage_and_unusable_input_are_one_line_and_status_2(run, arguments, words):
    said = run(*arguments)
    assert said.status == 2
    assert said.out == ""
    assert said.err.startswith("replay: ")
    assert said.err.count("\n") == 1
    for word in words:
        assert word in said.err


# ---- optimize


def test_a_log_becomes_a_table_a_recording_and_a_results_file(run, tmp_path):
    said = run("optimize", BAY, "--method", "shortcut", "--shortcut.tries", "40", "--out", "new/folder")
    assert said.status == 0
    lines = said.out.splitlines()
    assert lines[0].startswith("bay_01/0: shortcut is ")
    assert max(map(len, lines)) <= 100
    assert "\x1b" not in said.out + said.err
    assert all("kernels were compiled" in line for line in said.err.splitlines()), (
        "at most how long the first run compiled"
    )
    assert names(tmp_path / "new" / "folder") == [
        "bay_01.results.json",
        "bay_01.rrd",
    ]
    for word in ("recorded", "shortcut", "improved", "wrote new/folder/bay_01.rrd"):
        assert word in said.out


def test_json_is_one_document_and_nothing_else(run, log, tmp_path):
    said = run("optimize", log, *ONE, "--json")
    document = said.document
    assert (said.status, document["schema"], document["exit_status"]) == (0, "replay.optimize/1", 0)
    (log,) = document["logs"]
    (case,) = log["cases"]
    (method,) = case["methods"]
    assert (log["error"], case["case"], method["name"], method["status"]) == (None, "yard/0", "shortcut", "improved")
    assert method["metrics"]["objective"] < case["recorded"]["metrics"]["objective"]
    assert case["files"] == ["yard.results.json"]
    assert names(tmp_path) == ["yard.results.json"]


def test_flags_reach_the_method_the_weights_and_the_reader(run, log, tmp_path):
    (tmp_path / "truck.toml").write_text("trailer_rear = 11.5\n")
    flags = ["--seed", "5", "--weights.cusp", "7", "--margin", "0.2", "--vehicle", "truck.toml", "--method", "shortcut"]
    assert run("optimize", log, *QUICK, *flags).status == 0
    document = json.loads((tmp_path / "yard.results.json").read_text())
    assert document["tool"]["options"]["shortcut"]["tries"] == 20
    assert document["tool"]["options"]["shortcut"]["seed"] == document["tool"]["seed"] == 5
    assert document["weights"]["cusp"] == 7.0
    assert document["scene"]["margin"] == 0.2
    assert document["vehicle"]["trailer_rear"] == 11.5


def test_a_methods_own_seed_wins_over_the_common_one(run, log, tmp_path):
    assert run("optimize", log, *ONE, "--seed", "5", "--shortcut.seed", "6").status == 0
    assert json.loads((tmp_path / "yard.results.json").read_text())["tool"]["options"]["shortcut"]["seed"] == 6


def test_names_joined_by_a_plus_run_one_after_the_other_with_their_flags(run, log, tmp_path):
    said = run("optimize", log, *QUICK, "--method", "shortcut", "--method", "shortcut+shortcut", "--seed", "5")
    assert said.status == 0
    assert max(map(len, said.out.splitlines())) <= 100
    document = json.loads((tmp_path / "yard.results.json").read_text())
    alone, chain = document["methods"]
    assert (alone["name"], chain["name"]) == ("shortcut", "shortcut+shortcut")
    assert (alone["iterations"], chain["iterations"]) == (20, 40)
    assert chain["metrics"]["objective"] <= alone["metrics"]["objective"]
    part = document["tool"]["options"]["shortcut+shortcut"]["shortcut"]
    assert (part["tries"], part["seed"]) == (20, 5)
    assert run("audit", "yard.results.json").status == 0


def test_a_log_that_fails_does_not_stop_the_others(run, log, tmp_path):
    (tmp_path / "broken.mcap").write_bytes(b"no log")
    said = run("optimize", "broken.mcap", log, *ONE)
    assert said.status == 3
    assert (tmp_path / "yard.results.json").exists()
    assert said.err.count("broken.mcap") == 2, "once where it failed, once in the summary"


def test_status_2_when_every_log_fails(run, log, tmp_path):
    for name in ("a.mcap", "b.mcap"):
        (tmp_path / name).write_bytes(b"no log")
    said = run("optimize", "a.mcap", "b.mcap", "--json")
    assert said.status == said.document["exit_status"] == 2
    assert all("E_" in log["error"] for log in said.document["logs"])


def test_a_log_that_lost_its_end_is_used_and_status_is_3(run, tmp_path):
    maker = sound_log(compression=CompressionType.NONE, chunk_size=1)  # a chunk for each message
    content = maker.add_raw("/more", "std_msgs/msg/String", b"the last words", 9).bytes()
    (tmp_path / "cut.mcap").write_bytes(content[: content.find(b"the last words") + 5])
    said = run("optimize", "cut.mcap", *ONE)
    assert said.status == 3
    assert (tmp_path / "cut.results.json").exists()
    assert "replay: cut/0: the file is cut off" in said.err


def test_each_of_several_requests_gets_its_number(run, log, tmp_path):
    truck, _ = drive()
    maker = LogMaker().vehicle().add("/map", grid(yard()), 1)
    for k in range(2):
        maker.add("/truck", path(truck[: 70 + 20 * k]), 2 + k)
    maker.write(tmp_path / "two.mcap")
    said = run("optimize", "two.mcap", *ONE)
    assert said.status == 0
    assert sorted(tmp_path.glob("two-*")) == [tmp_path / "two-0.results.json", tmp_path / "two-1.results.json"]


def test_logs_that_would_share_their_files_are_refused_before_any_work(run, log, tmp_path):
    (tmp_path / "other").mkdir()
    shutil.copy(log, tmp_path / "other" / "yard.mcap")
    said = run("optimize", log, "other/yard.mcap", *QUICK)
    assert said.status == 2
    assert "yard.*" in said.err
    assert names(tmp_path) == ["other"]


def test_an_input_is_never_overwritten(run, log, tmp_path):
    shutil.copy(log, tmp_path / "log.rrd")
    said = run("optimize", "log.rrd", *QUICK)
    assert said.status == 2
    assert "input" in said.err
    assert (tmp_path / "log.rrd").read_bytes() == log.read_bytes()
    assert names(tmp_path) == ["log.rrd"]


def test_notes_are_quiet_when_asked_and_errors_are_not(run, log, tmp_path):
    sound_log(trailer=False).write(tmp_path / "plain.mcap")
    assert run("optimize", "plain.mcap", *ONE, "--quiet").err == ""
    (tmp_path / "broken.mcap").write_bytes(b"no log")
    assert run("optimize", "broken.mcap", "--quiet").err.count("\n") == 1


# ---- info, methods, audit


def test_info_shows_what_was_understood(run):
    said = run("info", BAY)
    assert (said.status, said.err) == (0, "")
    for words in ("nav_msgs/msg/Path", "case", "bay_01/0", "gear change", "from the trailer's path", "wheelbase 3.6"):
        assert words in said.out
    assert max(map(len, said.out.splitlines()[1:])) <= 100


def test_info_as_json_has_the_same_facts(run, log, tmp_path):
    (tmp_path / "broken.mcap").write_bytes(b"no log")
    said = run("info", "--json", log, "broken.mcap")
    assert said.status == said.document["exit_status"] == 3
    sound, broken = said.document["logs"]
    assert {channel["topic"] for channel in sound["channels"]} == {"/map", "/truck", "/trailer"}
    (case,) = sound["cases"]
    assert case["path"]["cusps"] == 1
    assert case["read"]["hitch"] == "trailer path"
    assert case["vehicle"]["wheelbase"] == 3.6
    assert "E_NOT_MCAP" in broken["error"]


def test_info_shows_the_channels_of_a_log_without_a_path(run, log, tmp_path):
    LogMaker().vehicle().add("/map", grid(yard()), 1).write(tmp_path / "map.mcap")
    said = run("info", "map.mcap")
    assert said.status == 2
    assert "nav_msgs/msg/OccupancyGrid" in said.out
    assert "E_NO_PATH" in said.err


def test_methods_lists_every_option_with_its_flag(run):
    listed, document = run("methods"), run("methods", "--json").document
    assert "joined by +" in listed.out
    assert [method["name"] for method in document["methods"]] == list(METHODS)
    for method in document["methods"]:
        assert method["summary"]
        for option in method["options"]:
            assert option["doc"], f"{option['flag']} has no docstring"
            assert option["flag"] in listed.out
    assert max(map(len, listed.out.splitlines())) <= 100


@pytest.fixture(scope="module")
def results(log, tmp_path_factory) -> pathlib.Path:
    folder = tmp_path_factory.mktemp("results")
    assert replay.cli.main(["optimize", str(log), *QUICK, "--out", str(folder), "--json"]) == 0
    return folder / "yard.results.json"


def test_audit_confirms_a_results_file(run, results):
    said = run("audit", results)
    assert (said.status, said.err) == (0, "")
    assert f"all {len(METHODS) + 1} paths pass" in said.out
    for word in ("clearance", "defect_sum", "recorded", "shortcut"):
        assert word in said.out
    assert max(map(len, said.out.splitlines()[1:])) <= 100


def test_audit_finds_what_was_changed_in_a_results_file(run, results, tmp_path):
    document = json.loads(results.read_text())
    document["methods"][0]["path"]["segments"][0]["x"][100] += 0.01
    (tmp_path / "changed.json").write_text(json.dumps(document))
    said = run("audit", "changed.json", results)
    assert said.status == 1
    assert "FAILED" in said.out
    assert "replay: changed.json: shortcut: defect" in said.err
    said = run("audit", "changed.json", "--json")
    assert said.document["results"][0]["passed"] is False


def test_audit_of_files_of_which_one_cannot_be_read_gives_status_3(run, results):
    assert run("audit", "none.json", results).status == 3


@pytest.mark.skipif(not pathlib.Path("/dev/full").exists(), reason="a device of Linux")
@pytest.mark.parametrize("command", [("info",), ("info", "--json"), ("optimize", "--method", "ddp", "--no-recording")])
def test_a_full_disk_behind_standard_output_is_one_line_and_status_1(log, tmp_path, command):
    with pathlib.Path("/dev/full").open("w") as full:
        arguments = [*REPLAY, *command, str(log), "--quiet"]
        done = subprocess.run(arguments, stdout=full, stderr=subprocess.PIPE, text=True, cwd=tmp_path, timeout=120)
    assert done.returncode == 1
    assert done.stderr == "replay: standard output cannot be written: No space left on device\n"
