"""What a `corpus.toml` declares: of which logs, what is refused, and where it is to be changed."""

import pathlib

import pytest
import regress_help as help
import run_maker as maker

from replay.base.errors import ReplayError
from replay.cli import main
from replay.regress.compare import compare_log
from replay.regress.corpus import CorpusLog, find_corpus
from replay.regress.job import Job, run_job
from replay.regress.options import Options
from replay.report.facts import acceptable
from replay.report.run_files import read_run
from replay.run.limits import NO_LIMITS
from replay.run.solving import InTurn


@pytest.fixture
def corpus(tmp_path: pathlib.Path) -> pathlib.Path:
    (tmp_path / "site_b").mkdir()
    for name in ("bay_01.mcap", "site_b/odd_01.mcap"):
        (tmp_path / name).write_bytes(b"never read")
    return tmp_path


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ('[logs."site_b/odd_01"]\nexpect = "E_NO_MAP"\n', "expected [logs.odd_01] in site_b/corpus.toml"),
        ('[logs.bay_01]\nexpct = "improved"\n', "unknown key logs.bay_01.expct. Did you mean 'expect'?"),
        ('[logs.bay_01]\nmethod = ["ddp"]\n', "Did you mean 'methods'?"),
        ('method = ["ddp"]\n', "unknown key method. Did you mean 'methods'?"),
    ],
)
def test_a_slip_in_the_list_is_one_line_and_status_2(corpus, text, words, capsys):
    (corpus / "corpus.toml").write_text(text)
    assert main(["regress", str(corpus)]) == 2
    error = capsys.readouterr().err
    assert words in error
    assert error.count("\n") == 1


def test_other_keys_are_notes(corpus):
    notes = 'sha256 = "00"\ntitle = "a bay"\nspecial = ""\nsource = "x"\ncusps = 1\nseed = 7\nmap = "grid"\n'
    (corpus / "corpus.toml").write_text(f'licence = "MIT"\n[logs.bay_01]\n{notes}class = "bay"\n')
    assert find_corpus(str(corpus)).logs[0].kind == "bay"


def test_a_log_knows_the_line_that_declares_it(corpus):
    text = '[logs.other]\n[logs."bay_01"]  # note\nclass = "bay"\n expect = "kept"\n[[known]]\nlog = "*"\n'
    (corpus / "corpus.toml").write_text(text)
    assert {log.name: log.declared for log in find_corpus(str(corpus)).logs} == {
        "bay_01": f"{corpus}/corpus.toml:4",
        "other": f"{corpus}/corpus.toml:1",
        "site_b/odd_01": "",
    }


def test_a_log_that_is_named_but_not_there_says_who_names_it(tmp_path):
    (tmp_path / "logs").mkdir()
    log = CorpusLog(name="odd", path=str(tmp_path / "odd.mcap"), declared="corpus.toml:3")
    run_job(Job(log=log, folder=str(tmp_path), options=Options(methods={})), InTurn(NO_LIMITS), lambda _: None)
    text = (tmp_path / "logs" / "odd.json").read_text()
    assert "E_NOT_FOUND" in text
    assert "corpus.toml:3 names it" in text


def test_what_the_list_expects_is_changed_there_and_never_accepted(tmp_path):
    document = maker.log("bay_01", 1, ["ddp"], expect="E_NO_MAP", declared="a/corpus.toml:7")
    entries = compare_log(maker.typed(document), None)
    (worse,) = (entry for entry in entries if entry.verdict == "worse")
    assert worse.note == "against what a/corpus.toml:7 expects"
    run = read_run(maker.write_run(tmp_path / "run", [document], entries))
    assert run.failing
    assert not acceptable(run)


def test_the_command_names_the_line_to_change_instead_of_accept(tmp_path):
    folder = help.make_corpus(tmp_path / "corpus", ["bay_01"])
    listed = tmp_path / "corpus" / "corpus.toml"
    listed.write_text(listed.read_text().replace("improved", "E_NO_MAP"))
    listed.write_text('methods = ["shortcut"]\n' + listed.read_text())
    done = help.command("regress", folder, "--shortcut.tries", "3", "--out", str(tmp_path / "runs"))
    assert done.returncode == 1
    assert f"{listed}:4 expects: if the result is correct, change `expect` there" in done.stderr
    assert "regress accept" not in done.stderr


def test_a_list_is_not_about_the_folders_below(corpus):
    (corpus / "corpus.toml").write_text('methods = ["ddp"]\n[[known]]\nlog = "odd_*"\n')
    found = find_corpus(str(corpus))
    assert {log.name: log.methods for log in found.logs} == {"bay_01": ("ddp",), "site_b/odd_01": ()}
    assert not found.known[0].concerns("site_b/odd_01")
    (corpus / "site_b" / "corpus.toml").write_text("[logs.odd_01]\ntag = []\n")
    with pytest.raises(ReplayError, match="E_CORPUS"):
        find_corpus(str(corpus))
