"""The program that makes a run: its revision, the versions of what it uses, and the machine."""

import contextlib
import hashlib
import os
import pathlib
import platform
import subprocess

from replay.base.schemas.values import Scalar
from replay.base.versions import DISTRIBUTION, PACKAGES, installed_version

DIRTY = "-dirty"
"""Part of the revision of a program whose files are not those of a commit."""
SOURCES = pathlib.Path(__file__).resolve().parents[2]
"""Folder of the packages."""


def revision(sources: pathlib.Path = SOURCES) -> str:
    """Revision of the program: the commit of its checkout, else its version.

    Where files differ from the commit, -dirty follows, and a digest of the differences within the packages. Files that
    git does not track yet are part of the program.
    """
    commit = _git(sources, "describe", "--always", "--dirty", "--exclude", "*", "--abbrev=12").decode().strip()
    difference = _difference(sources) if commit else b""
    if not difference:
        return commit or installed_version(DISTRIBUTION) or "unknown"
    return f"{commit.removesuffix(DIRTY)}{DIRTY}-{hashlib.sha256(difference).hexdigest()[:8]}"


def _difference(sources: pathlib.Path) -> bytes:
    """Differences of the packages from the commit; empty where there are none."""
    packages = ("--", "optim", "replay")
    parts = [_git(sources, "diff", "--binary", "--no-ext-diff", "HEAD", *packages)]
    for name in filter(None, _git(sources, "ls-files", "--others", "--exclude-standard", "-z", *packages).split(b"\0")):
        with contextlib.suppress(OSError):  # removed in the meantime
            parts += [name, (sources / os.fsdecode(name)).read_bytes()]
    return b"\0".join(filter(None, parts))


def _git(folder: pathlib.Path, *arguments: str) -> bytes:
    """Output of git; empty where it cannot be run, or fails."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, timeout=10.0, env=environment)
    except (OSError, subprocess.TimeoutExpired):
        return b""
    return done.stdout if done.returncode == 0 else b""


def versions() -> dict[str, Scalar]:
    """Versions of Python and of the packages that can change a figure; None for one that is not installed."""
    packages: dict[str, Scalar] = {name: installed_version(name) for name in (*PACKAGES, "casadi", "cvxpy", "clarabel")}
    return packages | {"python": platform.python_version()}


def machine() -> dict[str, Scalar]:
    """Operating system, processor and number of cores."""
    return {"system": platform.system(), "processor": platform.machine(), "cores": os.cpu_count()}
