"""Pictures of every tab of a recording, taken without a display; fails where the viewer complains.

    python tools/screenshot.py REC.rrd OUTDIR [--size 1920x1080] [--tab NAME]... [--check]
        [--timeline progress --at 700] [--theme light]

Needs a Vulkan driver; Debian's mesa-vulkan-drivers holds one that runs on the processor. Starts a viewer of its own
on a free port of the loopback interface and ends it again; with a theme, behind Xvfb, since only a viewer with a window
has one (Debian's xvfb and libxkbcommon-x11-0). With --check, every view must show something. Exit status:
0 all well; 1 a view reported an error or shows nothing, the viewer logged a warning, or it stopped; 2 wrong usage.
"""

import argparse
import contextlib
import io
import os
import pathlib
import re
import socket
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Iterator
from typing import Any, TypeVar

import numpy as np
import rerun_cli
from PIL import Image
from rerun.experimental import ViewerClient

from tools.script import existing, run

_Answer = TypeVar("_Answer")
_TRIES = 5
TOASTS_S = 8.0  # the notices about software rendering cover a corner for so long
SETTLE_S = 1.0  # for a tab's first frames; text and plots arrive one or two frames late
SETTLE_BEHIND_S = 3.0  # of a window, which draws slower
LOAD_S = 30.0
EXCUSED = re.compile(r"Software rasteri[sz]er|Docker|[Ww]ayland|XSETTINGS|XRandR|parse locale")
"""What the machine lacks is no fault of the recording."""

LEAST_SHOWN = 0.02
"""Share of a view's pixels that stand out from its background, below which it shows nothing: at 1280 x 800, views
without data came to at most 0.015 (grid, axes, a hint), views of sample recordings to at least 0.033."""
_STANDS_OUT = 30  # in any of red, green, blue, 0 to 255: grid lines do not
_EDGE = 8  # pixels: the frame of a view that is hovered over or selected


@contextlib.contextmanager
def viewer(size: str, theme: str | None = None) -> Iterator[ViewerClient]:
    """A viewer that nobody sees, connected; ended when the block is left."""
    # not venv/bin/rerun: that is a launcher, and ending it would leave the viewer behind
    program = pathlib.Path(rerun_cli.__file__).with_name("rerun")
    with tempfile.TemporaryDirectory() as scratch, display(size if theme else None) as screen:
        environment = {"XDG_RUNTIME_DIR": scratch, **os.environ, **screen}
        if theme:
            environment |= settings(program, pathlib.Path(scratch), screen, theme)
        port = free_port()
        with (pathlib.Path(scratch) / "log").open("w+b") as log:
            command = [str(program), "--bind", "127.0.0.1", "--port", str(port), "--window-size", size]
            command += ["--hide-welcome-screen", *([] if theme else ["--headless"])]
            process = subprocess.Popen(command, stdout=log, stderr=subprocess.STDOUT, env=environment)
            try:
                yield connected(process, port)
            except ConnectionError:
                with contextlib.suppress(subprocess.TimeoutExpired):
                    process.wait(5)
                log.seek(0)
                text = log.read().decode(errors="replace")
                panic = re.search(r"panicked at.*(\n.*)?", text)
                raise SystemExit(f"the viewer stopped: {panic.group() if panic else text[-2000:]}") from None
            finally:
                end(process)


@contextlib.contextmanager
def display(size: str | None) -> Iterator[dict[str, str]]:
    """A screen in memory, as the environment of what is to draw there; nothing without a size."""
    if size is None:
        yield {}
        return
    read, write = os.pipe()
    # three times as large: the pointer is in the middle of it, where it hovers over nothing
    screen = "x".join(str(3 * int(side)) for side in size.split("x"))
    command = ["Xvfb", "-displayfd", str(write), "-screen", "0", f"{screen}x24", "-nolisten", "tcp"]
    try:
        process = subprocess.Popen(command, pass_fds=[write], stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL)
    except FileNotFoundError:
        raise SystemExit("--theme needs Xvfb, which is not installed") from None
    os.close(write)
    try:
        with os.fdopen(read) as pipe:
            number = pipe.readline().strip()
        if not number:
            raise SystemExit("Xvfb did not start")
        yield {"DISPLAY": f":{number}", "WAYLAND_DISPLAY": ""}
    finally:
        end(process)


def settings(program: pathlib.Path, folder: pathlib.Path, screen: dict[str, str], theme: str) -> dict[str, str]:
    """The environment in which the viewer finds a theme: among the settings that it has written itself."""
    environment = {"XDG_RUNTIME_DIR": str(folder), "XDG_DATA_HOME": str(folder), "XDG_CONFIG_HOME": str(folder)}
    port = free_port()
    with (folder / "first log").open("wb") as log:
        command = [str(program), "--bind", "127.0.0.1", "--port", str(port)]
        process = subprocess.Popen(
            command, stdout=log, stderr=subprocess.STDOUT, env={**os.environ, **environment, **screen}
        )
        try:
            connected(process, port).run_command("ui.quit")
            process.wait(20)
        finally:
            end(process)
    file = folder / "rerun" / "app.ron"
    text = file.read_text()
    if "theme_preference:System" not in text:
        raise SystemExit(f"no theme among the viewer's settings in {file}")
    file.write_text(text.replace("theme_preference:System", f"theme_preference:{theme.capitalize()}"))
    return environment


def free_port() -> int:
    """A port of the loopback interface that nobody uses now."""
    with socket.socket() as probe:
        probe.bind(("127.0.0.1", 0))
        return probe.getsockname()[1]


def end(process: subprocess.Popen[bytes]) -> None:
    """End a process that was started here."""
    process.terminate()
    try:
        process.wait(10)
    except subprocess.TimeoutExpired:
        process.kill()
        process.wait(10)


def connected(process: subprocess.Popen[bytes], port: int) -> ViewerClient:
    """A client of the viewer once that answers; ConnectionError if it does not."""
    for _ in range(150):
        if process.poll() is not None:
            break
        with contextlib.suppress(ConnectionError):
            client = ViewerClient.connect(f"rerun+http://127.0.0.1:{port}/proxy")
            client.get_state()
            return client
        time.sleep(0.1)
    raise ConnectionError("no answer")


def answered(call: Callable[..., _Answer], *arguments: object) -> _Answer:
    """What the viewer answers; on a busy machine not always in the time that its client gives it."""
    for _ in range(_TRIES - 1):
        with contextlib.suppress(TimeoutError):
            return call(*arguments)
    return call(*arguments)


def open_recording(client: ViewerClient, path: pathlib.Path) -> None:
    """Open a recording and wait until all of it is there."""
    answered(client.open, str(path.resolve()))
    deadline = time.monotonic() + LOAD_S
    while time.monotonic() < deadline:
        state = answered(client.get_state)
        if not state.loading and state.recordings and all(recording.timelines for recording in state.recordings):
            return
        time.sleep(0.1)
    raise SystemExit(f"{path} was not loaded within {LOAD_S:g} s")


def tabs(client: ViewerClient) -> dict[str, str]:
    """Name and identifier of each tab of the blueprint, in order."""
    plan = client.get_blueprint().blueprint
    found = {}
    for part in _root(plan)["contents"]:
        entry = plan["/" + part.lstrip("/")]
        kind = "ContainerBlueprint" if "ContainerBlueprint" in entry else "ViewBlueprint"
        found[entry[kind].get("display_name", part)] = part
    return found


def show(client: ViewerClient, tab: str) -> None:
    """Bring a tab to the front."""
    plan = client.get_blueprint().blueprint
    _root(plan)["active_tab"] = tab
    client.set_blueprint(plan, of="recording")


def views_of(client: ViewerClient, tab: str) -> dict[str, str]:
    """Identifier and name of each view on a tab."""
    plan = client.get_blueprint().blueprint
    found, parts = {}, [tab]
    while parts:
        part = parts.pop()
        entry = plan["/" + part.lstrip("/")]
        if "ContainerBlueprint" in entry:
            parts += entry["ContainerBlueprint"]["contents"]
        else:
            identifier = part.rpartition("/")[2]
            found[identifier] = entry["ViewBlueprint"].get("display_name", identifier)
    return found


def share_shown(png: bytes) -> float:
    """Share of a picture's pixels that stand out from its most frequent colour, its edge left out [-]."""
    pixels = np.asarray(Image.open(io.BytesIO(png)).convert("RGB")).astype(np.int16)
    inner = pixels[_EDGE:-_EDGE, _EDGE:-_EDGE].reshape(-1, 3)
    if not len(inner):
        return 0.0
    colours, counts = np.unique(inner, axis=0, return_counts=True)
    background = colours[counts.argmax()]
    return float((np.abs(inner - background).max(axis=1) > _STANDS_OUT).mean())


def empty_views(client: ViewerClient, tab: str, least: float) -> list[str]:
    """One line for each view on the tab in front that shows nothing."""
    found = []
    for identifier, name in views_of(client, tab).items():
        share = share_shown(answered(client.take_screenshot, identifier))
        print(f"  {share:.3f} of {name!r} stands out")
        if share < least:
            found.append(f"view {name}: only {share:.3f} of it stands out from its background, expected {least:g}")
    return found


def _root(plan: dict[str, Any]) -> dict[str, Any]:
    root = plan["/viewport"]["ViewportBlueprint"]["root_container"]
    return plan[f"/container/{root}"]["ContainerBlueprint"]


def complaints(client: ViewerClient) -> list[str]:
    """Reports of the views on screen, and what the viewer warned of."""
    found = [
        f"view {view.name}: {report.severity}: {report.summary} {report.details or ''}"
        for view in client.get_state().views
        for report in view.reports
    ]
    found += [
        f"log {entry.level}: {entry.target}: {entry.message}"
        for entry in client.get_logs()
        if entry.level in ("WARN", "ERROR") and not EXCUSED.search(entry.message)
    ]
    return found


def _size(text: str) -> str:
    if not re.fullmatch(r"[1-9]\d*x[1-9]\d*", text, re.ASCII):
        raise argparse.ArgumentTypeError(f"{text!r} is not WIDTHxHEIGHT, as in 1920x1080")
    return text


def main() -> int:
    parser = argparse.ArgumentParser(description=(__doc__ or "").splitlines()[0])
    parser.add_argument("recording", type=existing, metavar="REC")
    parser.add_argument("out", type=pathlib.Path, metavar="OUTDIR")
    parser.add_argument(
        "--size", type=_size, default="1920x1080", help="of the window, in pixels (default: %(default)s)"
    )
    parser.add_argument("--tab", action="append", help="only this one; may be repeated")
    parser.add_argument("--theme", choices=["light", "dark"], help="of the viewer; default: dark, without a window")
    parser.add_argument("--timeline", default="progress", help="default: %(default)s")
    parser.add_argument("--at", type=int, help="place of the cursor on the timeline; default: its start")
    parser.add_argument(
        "--check",
        type=float,
        nargs="?",
        const=LEAST_SHOWN,
        metavar="SHARE",
        help=f"fail where less of a view than this stands out from its background ({LEAST_SHOWN})",
    )
    arguments = parser.parse_args()
    arguments.out.mkdir(parents=True, exist_ok=True)
    found: list[str] = []
    with viewer(arguments.size, arguments.theme) as client:
        open_recording(client, arguments.recording)
        if arguments.at is not None:
            client.set_time(arguments.timeline, sequence=arguments.at, play_state="paused")
        time.sleep(TOASTS_S)
        known = tabs(client)
        if unknown := set(arguments.tab or ()) - set(known):
            parser.error(f"no tab {', '.join(sorted(unknown))}; there are {', '.join(known)}")
        for name in arguments.tab or known:
            show(client, known[name])
            time.sleep(SETTLE_S if arguments.theme is None else SETTLE_BEHIND_S)
            picture = arguments.out / (re.sub(r"\W+", "_", name).strip("_").lower() + ".png")
            picture.write_bytes(answered(client.take_screenshot))
            print(picture)
            if arguments.check is not None:
                found += empty_views(client, known[name], arguments.check)
            found += [line for line in complaints(client) if line not in found]
    for line in found:
        print(line, file=sys.stderr)
    return 1 if found else 0


if __name__ == "__main__":
    run(main)
