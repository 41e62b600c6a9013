"""Corpora in an object store, against a server of its own on the loopback interface."""

import pathlib
from collections.abc import Iterator

import pytest
import regress_help as help

pytest.importorskip("moto", reason="moto[server] is not installed")
pytest.importorskip("s3fs", reason="the extra `s3` is not installed")

import boto3
from moto.server import ThreadedMotoServer

from optim.methods import METHODS
from replay.base.errors import ReplayError
from replay.cli import main
from replay.regress.corpus import find_corpus
from replay.regress.sources import fetched
from replay.regress.supervisor import Supervisor


@pytest.fixture(scope="module")
def server() -> Iterator[str]:
    running = ThreadedMotoServer(ip_address="127.0.0.1", port=0, verbose=False)
    running.start()
    host, port = running.get_host_and_port()
    yield f"http://{host}:{port}"
    running.stop()


@pytest.fixture
def bucket(server, monkeypatch, tmp_path) -> str:
    """A bucket with two logs and something else."""
    for name, value in {
        "AWS_ENDPOINT_URL": server,
        "AWS_ACCESS_KEY_ID": "testing",
        "AWS_SECRET_ACCESS_KEY": "testing",
        "AWS_DEFAULT_REGION": "us-east-1",
        "XDG_CACHE_HOME": str(tmp_path / "cache"),
    }.items():
        monkeypatch.setenv(name, value)
    client = boto3.client("s3")
    client.create_bucket(Bucket="logs")
    for key, name in {"tonight/bay_01.mcap": "bay_01", "tonight/sub/dock_01.mcap": "dock_01"}.items():
        client.put_object(Bucket="logs", Key=key, Body=(help.RECORDINGS / f"{name}.mcap").read_bytes())
    client.put_object(Bucket="logs", Key="tonight/notes.txt", Body=b"no log")
    return "s3://logs/tonight"


def test_a_prefix_is_a_corpus_and_its_results_are_those_of_the_files(bucket, tmp_path):
    found = find_corpus(bucket)
    assert [log.name for log in found.logs] == ["bay_01", "sub/dock_01"]
    assert found.baseline is None
    methods = {"ddp": METHODS["ddp"]}
    with Supervisor() as supervisor:
        run, verdict = help.run(help.make_plan(bucket, methods), tmp_path / "runs", help.through(supervisor))
        folder = help.make_corpus(tmp_path / "corpus", ["bay_01"])
        files, _ = help.run(help.make_plan(folder, methods), tmp_path / "files", help.through(supervisor))
    assert verdict.state == "unjudged"
    assert len(run.done()) == 2
    (there,) = (log for log in run.documents() if log.log == "bay_01")
    (here,) = files.documents()
    assert there.path == f"{bucket}/bay_01.mcap"
    assert help.results(run)["bay_01"]["cases"] == help.results(files)["bay_01"]["cases"]
    assert there.sha256 == here.sha256


def test_an_object_is_fetched_once_and_again_when_it_has_changed(bucket):
    first = fetched(f"{bucket}/bay_01.mcap")
    content, written = first.read_bytes(), first.stat().st_mtime_ns
    assert content == (help.RECORDINGS / "bay_01.mcap").read_bytes()
    assert fetched(f"{bucket}/bay_01.mcap").stat().st_mtime_ns == written
    boto3.client("s3").put_object(Bucket="logs", Key="tonight/bay_01.mcap", Body=b"another")
    assert pathlib.Path(fetched(f"{bucket}/bay_01.mcap")).read_bytes() == b"another"


def test_what_is_not_there_is_one_line(bucket, capsys):
    assert main(["regress", "s3://nowhere/at/all"]) == 2
    error = capsys.readouterr().err
    assert "s3://nowhere/at/all" in error
    assert error.count("\n") == 1
    with pytest.raises(ReplayError, match="gone"):
        fetched(f"{bucket}/gone.mcap")


def test_a_store_that_does_not_answer_is_one_line(bucket, monkeypatch, capsys):
    monkeypatch.setenv("AWS_ENDPOINT_URL", "http://127.0.0.1:9")
    monkeypatch.setenv("AWS_MAX_ATTEMPTS", "1")
    import s3fs

    s3fs.S3FileSystem.clear_instance_cache()
    assert main(["regress", bucket]) == 2
    assert capsys.readouterr().err.count("\n") == 1
    s3fs.S3FileSystem.clear_instance_cache()
