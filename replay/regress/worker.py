"""The main function of a worker: a process that does jobs, one after the other; its supervisor starts and ends it.

The worker gets jobs through a socket, and reports each stage and each outcome there. It leads a process group of its
own, and ends with it once its supervisor is gone: a thread waits for the end of the socket.
"""

import contextlib
import os
import pickle
import select
import signal
import sys
import threading
from multiprocessing.connection import Connection

from replay.base.threads import use_one_thread
from replay.run.limits import Limits


def main() -> None:
    """Serve until the socket closes. Argument: its file descriptor."""
    pipe = Connection(int(sys.argv[1]))
    use_one_thread()  # before any library is loaded
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is for the supervisor
    threading.Thread(target=_end_with_supervisor, args=(pipe.fileno(),), daemon=True).start()
    with contextlib.suppress(EOFError, OSError):
        path, limits = pickle.loads(pipe.recv_bytes())
        sys.path[:] = path
        _serve(pipe, limits)


def _serve(pipe: Connection, limits: Limits) -> None:
    from replay.pipeline import open_workers  # with the path of the supervisor
    from replay.regress.job import run_job
    from replay.run.child import limit_memory

    limit_memory(limits.memory_mib)
    with open_workers(limits, jobs=1) as workers:
        pipe.send(("ready", None))
        while True:
            job = pickle.loads(pipe.recv_bytes())
            pipe.send(("done", run_job(job, workers, lambda stage: pipe.send(("at", stage)))))


def _end_with_supervisor(descriptor: int) -> None:
    hangup = select.poll()
    hangup.register(descriptor, 0)
    hangup.poll()  # returns when the other end is closed
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    main()
