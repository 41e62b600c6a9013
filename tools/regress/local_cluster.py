"""A Dask cluster on this machine's loopback interface: a scheduler and workers, each a process that can be killed."""

import json
import os
import pathlib
import signal
import subprocess
import sys
import time
from types import TracebackType
from typing import Any, Self

START_S = 120.0
"""Time for scheduler and workers to come up [s]."""


class LocalCluster:
    """A context manager: its processes end with it. Workers are watched over: one that dies is started again."""

    def __init__(self, folder: pathlib.Path, num_workers: int = 2, python_path: str = "") -> None:
        self.folder = folder
        self.num_workers = num_workers
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

        with Client(self.address, set_as_default=False, timeout=START_S) as client:
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
