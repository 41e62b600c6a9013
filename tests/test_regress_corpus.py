"""Which logs a corpus has, what is declared of them, and which of them are selected."""

import pathlib

import pytest

from replay.base.errors import ReplayError
from replay.regress.corpus import find_corpus, select


@pytest.fixture
def corpus(tmp_path) -> pathlib.Path:
    for name in ("a.mcap", "b.mcap", "sub/c.mcap", "sub/deep/d.mcap", ".hidden/e.mcap", "notes.txt"):
        (tmp_path / name).parent.mkdir(parents=True, exist_ok=True)
        (tmp_path / name).write_bytes(b"")
    (tmp_path / "corpus.toml").write_text(
        '[logs.a]\nclass = "bay"\nexpect = "kept"\ntags = ["grid"]\nmethods = ["ddp"]\nseed = 7\n[logs.gone]\n'
    )
    (tmp_path / "sub" / "corpus.toml").write_text('methods = ["scp"]\n[[known]]\nlog = "c"\nnote = "why"\n')
    return tmp_path


def test_a_folder_is_a_corpus_with_all_below_it_and_what_its_lists_say(corpus):
    made = find_corpus(str(corpus))
    assert [log.name for log in made.logs] == ["a", "b", "gone", "sub/c", "sub/deep/d"]
    a, _, lost, c, d = made.logs
    assert (a.kind, a.expect, a.tags, a.methods) == ("bay", "kept", ("grid",), ("ddp",))
    assert lost.path == str(corpus / "gone.mcap")
    assert (c.methods, d.methods) == (("scp",), ())
    (issue,) = made.known
    assert issue.covers("sub/c", "scp", "objective")
    assert not issue.covers("c", "scp", "objective")


def test_a_glob_a_list_and_a_single_log_are_corpora_too(corpus):
    assert [log.name for log in find_corpus(str(corpus / "**" / "*.mcap")).logs] == ["a", "b", "sub/c", "sub/deep/d"]
    (corpus / "list.txt").write_text("# some\n\nsub/c.mcap\na.mcap\n")
    listed = find_corpus(str(corpus / "list.txt"))
    assert [(log.name, log.kind) for log in listed.logs] == [("a", "bay"), ("sub/c", "")]
    assert [log.name for log in find_corpus(str(corpus / "a.mcap")).logs] == ["a"]
    (corpus / "list.txt").write_text("hi\n")
    with pytest.raises(ReplayError, match=r"none of its lines \(1\) is the path of a file"):
        find_corpus(str(corpus / "list.txt"))


@pytest.mark.parametrize(
    ("text", "words"),
    [
        ("[logs.a]\nclass = 3", "logs.a.class is 3, expected a text"),
        ("[logs]\na = 3", "logs.a is 3, expected an object"),
        ("methods = [3]", "methods[0] is 3, expected a text"),
        ("[[known]]\nnote = 'x'", "known[0].log is missing"),
        ("[[known]]\nlog = 'x'\nmethods = 'x'", "unknown key 'methods' in known[0]. Did you mean 'method'?"),
        ("schema = 'other/1'", "schema is"),
        ("[logs", "not TOML"),
    ],
)
def test_a_list_that_is_wrong_is_one_line_that_says_where(corpus, text, words):
    (corpus / "corpus.toml").write_text(text)
    with pytest.raises(ReplayError, match=r"corpus\.toml") as caught:
        find_corpus(str(corpus))
    assert words in str(caught.value)
    assert "\n" not in str(caught.value)


def test_no_corpus_is_one_line_that_names_the_choices(tmp_path):
    for where in ("nowhere", str(tmp_path), str(tmp_path / "*.mcap")):
        with pytest.raises(ReplayError):
            find_corpus(where)


def test_logs_are_selected_by_method_tag_class_and_name(corpus):
    made = find_corpus(str(corpus))

    def names(**more):
        logs, words = select(made, **({"methods": (), "tags": (), "patterns": ()} | more))
        return [log.name for log in logs], words

    assert names() == (["a", "b", "gone", "sub/c", "sub/deep/d"], "")
    assert names(methods=["ddp"]) == (["a", "b", "gone", "sub/deep/d"], "methods ddp")
    assert names(tags=["grid"])[0] == names(tags=["bay"])[0] == ["a"]
    assert names(patterns=["sub/*"]) == (["sub/c", "sub/deep/d"], "logs sub/*")
    with pytest.raises(ReplayError, match="there are: bay, grid"):
        names(tags=["nonsense"])
    (corpus / "corpus.toml").unlink()
    with pytest.raises(ReplayError, match=r"none, corpus\.toml gives them"):
        select(find_corpus(str(corpus)), (), ("nonsense",), ())
