"""A Dask cluster on this machine's loopback interface: a scheduler and workers, each a process that can be killed."""

import json
import os
import pathlib
import signal
import subprocess
import sys
import time
from dataclasses import dataclass
from types import TracebackType
from typing import Any, Self

START_S = 120.0
"""Time for scheduler and workers to come up [s]."""


@dataclass(frozen=True, kw_only=True)
class Certificates:
    """Files (PEM) of one certificate, which signs itself, for all who take part."""

    certificate: pathlib.Path
    key: pathlib.Path

    @classmethod
    def made(cls, folder: pathlib.Path) -> "Certificates":
        """New ones, valid for a day or more."""
        from distributed.security import Security

        folder.mkdir(parents=True)
        made, files = Security.temporary(), cls(certificate=folder / "certificate.pem", key=folder / "key.pem")
        files.certificate.write_text(str(made.tls_client_cert), encoding="utf-8")
        files.key.write_text(str(made.tls_client_key), encoding="utf-8")
        return files

    def flags(self) -> list[str]:
        """Flags of Dask's scheduler and workers."""
        certificate = str(self.certificate)
        return ["--tls-ca-file", certificate, "--tls-cert", certificate, "--tls-key", str(self.key)]

    def security(self) -> Any:
        """Security settings of a client."""
        from distributed.security import Security

        certificate, key = str(self.certificate), str(self.key)
        return Security(
            require_encryption=True, tls_ca_file=certificate, tls_client_cert=certificate, tls_client_key=key
        )

    def environment(self) -> dict[str, str]:
        """Dask's configuration of a client, as variables."""
        certificate, prefix = str(self.certificate), "DASK_DISTRIBUTED__COMM__TLS__"
        client = {"CLIENT__CERT": certificate, "CLIENT__KEY": str(self.key)}
        return {f"{prefix}{name}": value for name, value in ({"CA_FILE": certificate} | client).items()}


class LocalCluster:
    """A context manager: its processes end with it. Workers are watched over: one that dies is started again."""

    def __init__(
        self,
        folder: pathlib.Path,
        num_workers: int = 2,
        python_path: str = "",
        certificates: Certificates | None = None,
    ) -> None:
        """Speaks TLS where there are certificates, else plain TCP."""
        self.folder = folder
        self.num_workers = num_workers
        self._certificates = certificates
        self._environment = os.environ | {
            "PYTHONPATH": python_path,
            "OMP_NUM_THREADS": "1",
            "OPENBLAS_NUM_THREADS": "1",
        }
        self._processes: list[subprocess.Popen[bytes]] = []
        self.address = ""

    def __enter__(self) -> Self:
        self.folder.mkdir(parents=True, exist_ok=True)
        file = self.folder / "scheduler.json"
        try:
            common = ["--host", "127.0.0.1", "--no-dashboard"]
            if self._certificates is not None:
                common += ["--protocol", "tls", *self._certificates.flags()]
            self.scheduler = self._start("dask_scheduler", "--port", "0", "--scheduler-file", str(file), *common)
            self.address = _wait_for(lambda: _address(file))
            one = ["--nworkers", "1", "--nthreads", "1", "--death-timeout", "60", "--local-directory", str(self.folder)]
            for _ in range(self.num_workers):
                self._start("dask_worker", self.address, *common, *one)
            self.workers()
        except BaseException:
            self._end()
            raise
        return self

    def __exit__(
        self, kind: type[BaseException] | None, error: BaseException | None, trace: TracebackType | None
    ) -> None:
        self._end()

    def workers(self) -> list[int]:
        """Process ids of the workers, once all of them are there."""
        from distributed import Client

        security = None if self._certificates is None else self._certificates.security()
        with Client(self.address, set_as_default=False, timeout=START_S, security=security) as client:
            client.wait_for_workers(self.num_workers, timeout=START_S)
            found: Any = client.run(os.getpid)  # by the worker's address
            return sorted(found.values())

    def _start(self, module: str, *arguments: str) -> subprocess.Popen[bytes]:
        log = (self.folder / f"{module}-{len(self._processes)}.log").open("wb")
        command = [sys.executable, "-m", f"distributed.cli.{module}", *arguments]
        with log:
            process = subprocess.Popen(
                command, stdout=log, stderr=log, env=self._environment, cwd=self.folder, process_group=0
            )
        self._processes.append(process)
        return process

    def _end(self) -> None:
        """First the workers, kindly; what is left after some seconds is killed with all that is in its group."""
        for process in reversed(self._processes):
            process.send_signal(signal.SIGTERM)
        for process in reversed(self._processes):
            try:
                process.wait(10.0)
            except subprocess.TimeoutExpired:
                os.killpg(process.pid, signal.SIGKILL)
                process.wait()
        self._processes.clear()


def _address(file: pathlib.Path) -> str:
    try:
        return str(json.loads(file.read_text())["address"])
    except (OSError, ValueError, KeyError):
        return ""


def _wait_for(found: Any) -> Any:
    deadline = time.monotonic() + START_S
    while time.monotonic() < deadline:
        if value := found():
            return value
        time.sleep(0.05)
    raise TimeoutError("the scheduler did not come up")
