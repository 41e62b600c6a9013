"""A viewer that shows a run live. Its failures cost the view, not the run."""

import os
import pathlib
import socket
import subprocess
import sys
import time
import urllib.parse
from collections.abc import Callable, Iterable
from typing import Final, Protocol

from optim.model.result import Iterate
from replay.base.style import styles
from replay.run.case import Case
from replay.run.outcome import Run

START_S: Final = 15.0
"""Time that a new viewer has to answer [s]."""
WINDOW_S: Final = 2.0
"""Time after which one that cannot open its window has ended [s]; it answers before that."""
CONNECT_S: Final = 3.0
"""Time that a running one has [s]."""


class NoViewer(Exception):
    """No viewer can show the run; `str()` is one line that says why and what to do."""


def open_viewer(url: str | None) -> str:
    """The address of a viewer that answers: the one at `url`, or a new one on this machine. Raises NoViewer."""
    if url is None:
        return _started()
    place = urllib.parse.urlsplit(url)
    expected = "expected an address such as rerun+http://127.0.0.1:9876/proxy"
    try:
        host, port = place.hostname, place.port
    except ValueError as error:
        raise NoViewer(f"--viewer {url}: {error}; {expected}") from None
    if place.scheme not in ("rerun", "rerun+http", "rerun+https") or not host or not port:
        raise NoViewer(f"--viewer {url}: {expected}")
    try:
        socket.create_connection((host, port), CONNECT_S).close()
    except OSError as error:
        reason = error.strerror or str(error)
        raise NoViewer(f"--viewer {url}: no viewer answers there ({reason}); start one with `rerun`") from None
    return url


def _started() -> str:
    """Start a viewer on a free port of the loopback interface; it outlives this process."""
    if sys.platform.startswith("linux") and not (os.environ.get("DISPLAY") or os.environ.get("WAYLAND_DISPLAY")):
        raise NoViewer("--view: there is no display for a viewer; --viewer URL shows the run in one elsewhere")
    try:
        import rerun_cli
    except ImportError:
        raise NoViewer("--view: no viewer is installed (package rerun-sdk)") from None
    # not the command `rerun`: that is a launcher, which would stand between us and the viewer
    program = pathlib.Path(rerun_cli.__file__).with_name("rerun.exe" if os.name == "nt" else "rerun")
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        port = probe.getsockname()[1]
    command = [str(program), "--bind", "127.0.0.1", "--port", str(port), "--hide-welcome-screen"]
    try:
        process = subprocess.Popen(
            command,
            stdin=subprocess.DEVNULL,
            stdout=subprocess.DEVNULL,
            stderr=subprocess.DEVNULL,
            start_new_session=True,
        )
    except OSError as error:
        raise NoViewer(f"--view: the viewer cannot be started: {error.strerror}") from None
    _wait_for(process, port)
    process.returncode = 0  # it outlives this process: nobody will wait for it
    return f"rerun+http://127.0.0.1:{port}/proxy"


def _wait_for(process: "subprocess.Popen[bytes]", port: int) -> None:
    """Until the viewer answers, and has its window: without one it ends soon after. Raises NoViewer."""
    deadline, answered = time.monotonic() + START_S, None
    while answered is None or time.monotonic() < answered + WINDOW_S:
        if process.poll() is not None:
            raise NoViewer(f"--view: the viewer ended at once (exit status {process.returncode}); is there a display?")
        if answered is None and time.monotonic() > deadline:
            process.kill()
            process.wait()
            raise NoViewer(f"--view: the viewer did not answer within {START_S:g} s")
        try:
            socket.create_connection(("127.0.0.1", port), 1.0).close()
            answered = answered or time.monotonic()
        except OSError:
            pass
        time.sleep(0.1)


class _Live(Protocol):
    """Interface of `replay.recording.live.LiveRecording` for a view; the class itself takes a second to load."""

    def iterate(self, name: str, iterate: Iterate) -> None: ...

    def finish(self, run: Run) -> None: ...

    def close(self) -> None: ...


class LiveView:
    """Passes what happens on to a viewer, one case after the other. Never raises: the first failure ends the view."""

    def __init__(self, url: str, methods: Iterable[str], say: Callable[[str], None]) -> None:
        self._url, self._say = url, say
        self._looks = styles(methods)
        self._recording: _Live | None = None
        self._failed = False

    def begin(self, case: Case) -> None:
        """A case is about to run."""

        def start() -> None:
            from replay.recording.live import LiveRecording  # Rerun takes a second to load

            self._recording = LiveRecording(self._url, case, self._looks)

        self.end()
        self._guarded(start)

    def iterate(self, name: str, iterate: Iterate) -> None:
        """A method has reported an iterate."""
        recording = self._recording
        if recording is not None:
            self._guarded(lambda: recording.iterate(name, iterate))

    def finish(self, run: Run) -> None:
        """The case is done."""
        recording = self._recording
        if recording is not None:
            self._guarded(lambda: recording.finish(run))

    def end(self) -> None:
        """Nothing more is to come of this case."""
        recording, self._recording = self._recording, None
        if recording is not None:
            self._guarded(recording.close)

    def _guarded(self, step: Callable[[], None]) -> None:
        if self._failed:
            return
        try:
            step()
        except Exception as error:  # a border: what the viewer does must not cost the run
            self._failed = True
            self._recording = None
            reason = " ".join(str(error).split()) or type(error).__name__
            self._say(f"the view has ended, the run continues without it: {reason}")
