"""Regression runs on a cluster that speaks TLS: only who has its certificate gets in."""

import os
import pathlib
import subprocess

import pytest
import regress_help as help

pytest.importorskip("distributed", reason="the extra `cluster` is not installed")

from tools.attacks.local_cluster import Certificates, LocalCluster
from tools.attacks.small_logs import write_corpus
from tools.processes import REPLAY

COUNT = 4
PATHS = os.pathsep.join([str(help.ROOT), str(help.ROOT / "tests")])


@pytest.fixture(scope="module")
def cluster(tmp_path_factory):
    folder = tmp_path_factory.mktemp("tls")
    certificates = Certificates.made(folder / "certificates")
    with LocalCluster(folder / "cluster", 1, PATHS, certificates) as cluster:
        yield cluster.address, certificates


def _regress(folder: pathlib.Path, address: str, environment: dict[str, str]) -> subprocess.CompletedProcess[str]:
    write_corpus(folder / "corpus", COUNT)
    options = ["--out", str(folder / "runs"), "--method", "ddp", "--recordings", "none", "--scheduler", address]
    command = [*REPLAY, "regress", str(folder / "corpus"), *options]
    return subprocess.run(command, env=os.environ | environment, cwd=help.ROOT, capture_output=True, text=True)


@pytest.mark.slow
def test_a_client_with_the_certificate_has_all_logs_done(cluster, tmp_path):
    address, certificates = cluster
    assert address.startswith("tls://127.0.0.1:")
    done = _regress(tmp_path, address, certificates.environment())
    assert done.returncode == 0, done.stderr
    assert len(list((tmp_path / "runs").rglob("logs/*.json"))) == COUNT


@pytest.mark.slow
def test_a_client_without_a_certificate_or_with_another_is_told_so_in_one_line(cluster, tmp_path):
    address, _ = cluster
    other = Certificates.made(tmp_path / "certificates").environment()
    for name, environment, reason in [("none", {}, "no certificate to show"), ("other", other, "no connection")]:
        refused = _regress(tmp_path / name, address, environment)
        assert refused.returncode == 2, refused.stderr
        *notes, line = refused.stderr.strip().splitlines()
        assert line.startswith(f"replay: --scheduler {address}: {reason}: "), line
        assert all("connecting" in note for note in notes), "what is waited for"
        assert not (tmp_path / name / "runs").exists()
