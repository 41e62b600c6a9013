"""How changes are put together and named: what is missing, new, renamed, crashed."""

import json
import pathlib

import run_maker as maker

from replay.base.schemas.baseline import BASELINE_SCHEMA, Baseline
from replay.regress.baseline import write_baseline
from replay.regress.compare import baseline_entry
from replay.regress.finish import judge
from replay.regress.folder import RunFolder
from replay.report.facts import headline
from replay.report.groups import failing_lines, groups, notable
from replay.report.run_files import read_run
from replay.run.solving import solve


def lines(folder: pathlib.Path, verdicts: list) -> list[str]:
    return [group.sentence for group in groups(read_run(maker.write_run(folder, maker.logs(8), verdicts)))]


def missing(name: str) -> dict:
    return maker.verdict(name, "", "log", "missing", "there", None, case="")


def test_what_is_missing_is_named_and_counted_among_all_logs(tmp_path):
    found = [
        missing("gone_01"),
        missing("gone_02"),
        maker.verdict("open_00", "nlp", "result", "missing", "there", None),
    ]
    found += maker.unchanged(maker.logs(8))
    assert lines(tmp_path / "run", found) == ["2 logs missing: gone_01, gone_02", "nlp on open_00/0 is missing"]
    assert headline(read_run(tmp_path / "run")).endswith("3 of 10 logs affected")


def test_a_long_list_of_names_is_cut(tmp_path):
    (line,) = lines(tmp_path / "run", [missing(f"gone_{i:02d}") for i in range(20)])
    assert line.endswith("gone_06, gone_07 and 12 more")


def test_new_logs_are_one_line_and_so_is_a_new_method(tmp_path):
    keys = ("status", "objective", "cusps")
    found = [maker.verdict(f"open_9{i}", "ddp", key, "new", None) for i in range(3) for key in keys]
    found += [maker.verdict(f"narrow_0{i}", "mine", key, "new", None) for i in (1, 5) for key in keys]
    found += maker.unchanged(maker.logs(8))
    run = read_run(maker.write_run(tmp_path / "run", maker.logs(8), found))
    assert [group.sentence for group in groups(run)] == [
        "3 logs new: open_90, open_91, open_92",
        "mine new on 2 cases of class narrow: narrow_01/0, narrow_05/0",
    ]
    assert len(notable(run)) == 5


def test_errors_of_logs_have_a_subject(tmp_path):
    found = [maker.verdict(f"open_0{i}", "", "error", "worse", "read", "E_CUT", case="") for i in (0, 4)]
    (line,) = lines(tmp_path / "run", found)
    assert line.startswith("logs: error worse on 2 cases of class open; most: log open_0")


def test_a_crash_tells_why_and_where(tmp_path):
    class Broken:
        def solve(self, *_: object) -> None:
            raise RuntimeError("boom")

    found = solve(None, Broken(), lambda _: None)  # pyright: ignore[reportArgumentType]
    assert found.error.startswith("RuntimeError: boom (tests/test_report_groups.py:")
    crash = maker.verdict("open_00", "ddp", "status", "crashed", "improved", "failed", note=found.error)
    assert lines(tmp_path / "run", [crash]) == [f"ddp on open_00/0 crashed: {found.error}"]


def test_a_log_under_another_name_is_told_as_renamed_and_compared(tmp_path):
    old, other = maker.log("bay_01", 1, ["ddp"]), maker.log("bay_02", 2, ["ddp"])
    baseline = tmp_path / "baseline.json"
    entries = {entry["log"]: baseline_entry(maker.typed(entry)) for entry in (old, other)}
    write_baseline(baseline, Baseline(schema=BASELINE_SCHEMA, logs=entries))
    new = json.loads(json.dumps(old).replace("bay_01", "dock_09"))
    folder = maker.write_run(tmp_path / "run", [other, new], baseline=str(baseline), planned=["bay_02", "dock_09"])
    judge(RunFolder(folder))
    run = read_run(folder)
    assert failing_lines(groups(run)) == (["renamed: bay_01 → dock_09"], 0)
    assert {change.verdict for change in run.changes} == {"missing", "same"}
    new["cases"][0]["methods"][0]["metrics"]["objective"] *= 1.1
    (folder / "logs" / "00001.json").write_text(json.dumps(new))
    judge(RunFolder(folder))
    assert any("ddp on dock_09/0: objective" in line for line in failing_lines(groups(read_run(folder)))[0])
