"""Handle SIGTERM and SIGHUP like Ctrl-C; exit with 128 + signal."""

import contextlib
import dataclasses
import signal
import threading
from collections.abc import Iterator
from types import FrameType

from replay.cli.usage import ExitStatus

_NAMES = ("SIGTERM", "SIGHUP")


@dataclasses.dataclass
class Ending:
    """Whether a signal came, and which."""

    signal: int | None = None

    def status(self, status: int) -> int:
        """The exit status of a command that would give `status`: 128 and the signal's number where that ended it."""
        return 128 + self.signal if self.signal is not None and status == ExitStatus.INTERRUPTED else status


@contextlib.contextmanager
def like_ctrl_c() -> Iterator[Ending]:
    """While the block runs, these signals raise KeyboardInterrupt. One that is ignored stays so, as under nohup."""
    ending = Ending()

    def end(number: int, frame: FrameType | None) -> None:
        del frame
        ending.signal = number
        raise KeyboardInterrupt

    kept = {}
    if threading.current_thread() is threading.main_thread():  # no other may set handlers
        for number in (getattr(signal, name) for name in _NAMES if hasattr(signal, name)):
            if signal.getsignal(number) == signal.SIG_DFL:
                kept[number] = signal.signal(number, end)
    try:
        yield ending
    finally:
        for number, handler in kept.items():
            signal.signal(number, handler)
