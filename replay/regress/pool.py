"""Working on many logs at a time on this machine: a fixed number of processes, each with one log at a time."""

import queue
import threading
from collections.abc import Generator, Iterable

from replay.regress.slot import Slot, Stopped
from replay.regress.work import Job, Outcome

_WAIT_S = 0.2


def run_here(jobs: Iterable[Job], num_slots: int) -> Generator[Outcome]:
    """Do jobs in processes of this machine; outcomes come as they come.

    Jobs are taken when there is a process for them, so that their number does not matter for memory. Closing the
    iterator, or an exception in whoever reads it, ends all processes. Raises what a job's bookkeeping raises (OSError
    where results cannot be written).
    """
    waiting = iter(jobs)
    taking = threading.Lock()
    stop = threading.Event()
    done: queue.SimpleQueue[Outcome | BaseException | None] = queue.SimpleQueue()

    def serve() -> None:
        try:
            with Slot(stop) as slot:
                while not stop.is_set():
                    with taking:
                        job = next(waiting, None)
                    if job is None:
                        break
                    done.put(slot.run(job))
        except Stopped:
            pass
        except BaseException as error:
            done.put(error)
        done.put(None)

    threads = [threading.Thread(target=serve, daemon=True) for _ in range(num_slots)]
    for thread in threads:
        thread.start()
    try:
        working = num_slots
        while working:
            try:
                outcome = done.get(timeout=_WAIT_S)  # with a timeout, so that Ctrl-C is noticed
            except queue.Empty:
                continue
            if isinstance(outcome, BaseException):
                raise outcome
            if outcome is None:
                working -= 1
            else:
                yield outcome
    finally:
        stop.set()
        for thread in threads:
            thread.join()
