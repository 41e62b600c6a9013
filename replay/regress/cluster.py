"""Working on many logs on a Dask cluster. Needs the extra `cluster`.

Tasks return the outcome of a job, never its results, which are files by then: a worker that dies loses nothing but the
job it was doing, and Dask gives that to another one. Futures are released as they end, and only some are outstanding at
a time, so that neither scheduler nor coordinator grows with the number of logs. The run's folder must be on storage
that all workers see.
"""

import atexit
import contextlib
import ipaddress
import logging
import os
import threading
import urllib.parse
import uuid
from collections.abc import Callable, Generator, Iterable, Iterator, Sequence
from typing import Any

from replay.base.errors import ReplayError
from replay.regress.job import Job, Outcome, publish_error
from replay.regress.supervisor import Supervisor

CLUSTER_ERROR = "E_CLUSTER"
"""The cluster failed during a run."""
SCHEDULER_ERROR = "E_SCHEDULER"
"""There is no usable cluster."""
OUTSTANDING = 4
"""Tasks for each thread of the cluster that are submitted at a time."""
_CONNECT_S = 15
_WORKERS_S = 60
_PATIENCE_S, _WORKER_PATIENCE_S = 3.0, 5.0
"""Time after which waiting for a connection, and for a worker, is reported [s]."""


def check_address(address: str) -> None:
    """Check that a scheduler is of this machine alone or speaks TLS. Raises ReplayError (E_SCHEDULER), one line.

    Whoever can connect to a scheduler can run code there and on every worker, and plain TCP does not authenticate.
    """
    scheme, host = _parts(address)
    if scheme == "tls" and host:
        return
    if scheme == "tcp" and _is_loopback(host):
        return
    expected = "expected tcp://127.0.0.1:PORT (this machine alone) or tls://HOST:PORT"
    why = "; plain TCP lets everybody who can connect run code" if scheme == "tcp" and host else ""
    raise ReplayError(SCHEDULER_ERROR, f"--scheduler {address}: {expected}{why}")


def _parts(address: str) -> tuple[str, str]:
    """Scheme and host; empty where the address has none, or no port that can be one."""
    try:
        parts = urllib.parse.urlsplit(address)
        return (parts.scheme, parts.hostname or "") if parts.port else ("", "")
    except ValueError:
        return "", ""


def _is_loopback(host: str) -> bool:
    with contextlib.suppress(ValueError):
        return ipaddress.ip_address(host).is_loopback
    return host == "localhost"


def run_on_cluster(jobs: Iterable[Job], address: str) -> Generator[Outcome]:
    """Do jobs on the workers of a scheduler; outcomes come in the order in which jobs end. Raises as `connected`."""
    with connected(address) as execute:
        yield from execute(jobs)


@contextlib.contextmanager
def connected(
    address: str, note: Callable[[str], None] = lambda _: None
) -> Iterator[Callable[[Iterable[Job]], Generator[Outcome]]]:
    """Connect to a scheduler with at least one worker; the function given does jobs there. `note` gets remarks.

    Raises ReplayError (E_SCHEDULER) where the address is refused, nobody answers there or no worker comes, and during
    the work where a worker does not see a file that this machine sees; E_CLUSTER where the scheduler goes away.
    """
    check_address(address)
    distributed = _distributed()
    for name in [name for name in logging.root.manager.loggerDict if name.partition(".")[0] == "distributed"]:
        logging.getLogger(name).setLevel(logging.CRITICAL)  # our own lines say what matters
    with _connected(distributed, address, note) as client:
        yield lambda jobs: _run(distributed, client, jobs)


def _run(distributed: Any, client: Any, jobs: Iterable[Job]) -> Generator[Outcome]:
    waiting = iter(jobs)
    ended = distributed.as_completed(loop=client.loop)
    at: dict[str, Job] = {}

    def submit() -> None:
        job = next(waiting, None)
        if job is not None:
            job = job.anywhere()
            key = f"replay-{uuid.uuid4().hex}"
            seen = [place for place in (job.folder, job.place) if place and os.path.exists(place)]  # noqa: PTH110
            future = client.submit(_do, job, seen, key=key, pure=False)
            at[key] = job
            ended.add(future)

    for _ in range(OUTSTANDING * max(1, sum(client.nthreads().values()))):
        submit()
    while at:
        future = next(ended)
        outcome = _outcome(future, at.pop(future.key))
        future.release()
        del future
        submit()
        yield outcome


def _outcome(future: Any, job: Job) -> Outcome:
    error = future.exception()  # waits where the worker died after it reported the end: Dask has the job done again
    if future.status == "cancelled":
        raise ReplayError(CLUSTER_ERROR, "the scheduler has gone; what was finished is kept, --resume does the rest")
    if error is None and (unseen := future.result()["unseen"]):
        needed = "expected logs and --out on storage that all workers see, under the same path"
        raise ReplayError(SCHEDULER_ERROR, f"{unseen}: this machine sees it and a worker does not; {needed}")
    if error is None:
        return Outcome(name=job.log.name, state=future.result()["state"])
    if type(error).__name__ == "KilledWorker":
        return publish_error(job, "E_CRASHED", "the workers that had this log have died, several in a row")
    words = " ".join(str(error).split())
    raise ReplayError(CLUSTER_ERROR, f"{job.log.name}: a worker failed: {type(error).__name__}: {words}")


def _connected(distributed: Any, address: str, note: Callable[[str], None]) -> Any:
    """A client, once there is a worker."""
    security = _security(distributed, address) if address.startswith("tls:") else None
    try:
        with _noted_after(_PATIENCE_S, note, f"connecting to {address}, for at most {_CONNECT_S} s"):
            client = distributed.Client(address, timeout=_CONNECT_S, set_as_default=False, security=security)
    except (OSError, ValueError, TypeError, RuntimeError) as error:
        words = " ".join(str(error).split())
        raise ReplayError(SCHEDULER_ERROR, f"--scheduler {address}: no connection: {words}") from error
    try:
        with _noted_after(_WORKER_PATIENCE_S, note, f"no worker has joined {address} yet, waiting {_WORKERS_S} s"):
            client.wait_for_workers(1, timeout=_WORKERS_S)
    except TimeoutError as error:
        client.close()
        raise ReplayError(SCHEDULER_ERROR, f"--scheduler {address}: no worker came in {_WORKERS_S} s") from error
    return client


@contextlib.contextmanager
def _noted_after(seconds: float, note: Callable[[str], None], line: str) -> Iterator[None]:
    """Note a line if the block takes longer."""
    timer = threading.Timer(seconds, note, (line,))
    timer.daemon = True
    timer.start()
    try:
        yield
    finally:
        timer.cancel()


def _security(distributed: Any, address: str) -> Any:
    """Certificates of this client, from Dask's configuration."""
    security = distributed.Security(require_encryption=True)
    names = ("ca-file", "client.cert", "client.key")
    missing = [
        f"distributed.comm.tls.{name}"
        for name in names
        if not getattr(security, "tls_" + name.replace("-", "_").replace(".", "_"))
    ]
    try:
        if not missing:
            security.get_connection_args("client")
            return security
        reason = f"Dask's configuration has no {', '.join(missing)}"
    except (OSError, ValueError) as error:
        reason = " ".join(str(error).split())
    raise ReplayError(SCHEDULER_ERROR, f"--scheduler {address}: no certificate to show: {reason}")


def _distributed() -> Any:
    try:
        import distributed
    except ImportError as error:
        hint = "pip install 'truck-trailer-replay[cluster]'"
        raise ReplayError(SCHEDULER_ERROR, f"--scheduler needs the extra cluster: {hint}") from error
    return distributed


# ---- on a worker

_here = threading.local()


def _do(job: Job, seen: Sequence[str]) -> dict[str, str]:
    """Do a job in the process that this thread of a Dask worker supervises; its state.

    Nothing is done where a path that the client has `seen` does not exist here. Another run gets another process, since
    the program may have changed in the meantime.
    """
    unseen = next((place for place in seen if not os.path.exists(place)), "")  # noqa: PTH110
    if unseen:
        return {"unseen": unseen, "state": ""}
    supervisor = getattr(_here, "supervisor", None)
    if supervisor is None:
        supervisor = _here.supervisor = Supervisor()
        atexit.register(supervisor.end)
    elif _here.folder != job.folder:
        supervisor.end()
    _here.folder = job.folder
    return {"unseen": "", "state": supervisor.run(job).state}
