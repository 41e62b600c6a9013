"""The process in which logs are worked on, one after the other; `replay.regress.slot` starts it and may end it.

It gets jobs through a socket and says at which stage it is and what came of each. It leads a process group of its own,
and ends with it when its parent is gone: a thread waits for the end of a pipe that only the parent holds open.
"""

import contextlib
import os
import pickle
import signal
import sys
import threading
from multiprocessing.connection import Connection


def main() -> None:
    """Serve until the socket closes. Arguments: descriptors of the socket and of the pipe."""
    socket, lifeline = (int(word) for word in sys.argv[1:3])
    signal.signal(signal.SIGINT, signal.SIG_IGN)  # Ctrl-C is the parent's business
    threading.Thread(target=_end_with_parent, args=(lifeline,), daemon=True).start()
    pipe = Connection(socket)
    with contextlib.suppress(EOFError, OSError):
        path, time_limit, memory_limit = pickle.loads(pipe.recv_bytes())
        sys.path[:] = path
        _serve(pipe, time_limit, memory_limit)


def _serve(pipe: Connection, time_limit: float, memory_limit: int) -> None:
    from replay.regress.work import work
    from replay.run.limits import Limits
    from replay.run.worker import Workers, limit_memory

    limit_memory(memory_limit)
    with Workers(Limits(time_s=time_limit, by_processor=True, memory_mib=memory_limit)) as workers:
        pipe.send(("ready", None))
        while True:
            job = pickle.loads(pipe.recv_bytes())
            pipe.send(("done", work(job, workers, lambda stage: pipe.send(("at", stage)))))


def _end_with_parent(lifeline: int) -> None:
    os.read(lifeline, 1)  # returns when the other end is closed
    os.killpg(0, signal.SIGKILL)


if __name__ == "__main__":
    main()
