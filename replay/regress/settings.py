"""What a run does with each log, and with which program: what decides its figures."""

import contextlib
import dataclasses
import hashlib
import json
import os
import pathlib
import platform
import subprocess
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Any, Literal

from optim.methods.chain import Chain
from optim.model.method import Method
from optim.model.objective import Weights
from replay.base.versions import DISTRIBUTION, PACKAGES, installed_version
from replay.logs import ReadOptions

Recordings = Literal["all", "changed", "none"]
DIRTY = "-dirty"
"""In the revision of a program whose files are not those of a commit."""
_SOURCES = pathlib.Path(__file__).resolve().parents[2]
"""Folder of the packages."""


@dataclass(frozen=True, kw_only=True)
class Settings:
    """What is done with each log."""

    methods: Mapping[str, Method]
    read: ReadOptions = field(default_factory=ReadOptions)
    weights: Weights = field(default_factory=Weights)
    seed: int = 0
    """Noted; the seeds themselves are options of the methods."""
    time_limit: float = 120.0
    """Of a method on a case, compiling not counted [s]. A watchdog: what it ends depends on the machine's load."""
    memory_limit: int = 4096
    """Of a log's process, and of the methods' process below it [MiB]."""
    recordings: Recordings = "changed"
    """Of which cases recordings are written; changed: compared with the baseline, and not the same."""

    def plain(self) -> dict[str, Any]:
        """Everything that decides the figures, as plain data."""
        methods = {name: _options(method) for name, method in self.methods.items()}
        kept = {"seed": self.seed, "time_limit_s": self.time_limit, "memory_limit_mib": self.memory_limit}
        weights, read = dataclasses.asdict(self.weights), dataclasses.asdict(self.read)
        return kept | {"methods": methods, "weights": weights, "read": read}


def _options(method: Method) -> Any:
    if isinstance(method, Chain):
        return [[name, _options(part)] for name, part in method.parts]
    fields = dataclasses.fields(method) if dataclasses.is_dataclass(method) else ()
    return {each.name: getattr(method, each.name) for each in fields}


def fingerprint(data: Any) -> str:
    """The same for the same plain data."""
    return hashlib.sha256(json.dumps(data, sort_keys=True, default=str).encode()).hexdigest()[:16]


def revision(sources: pathlib.Path = _SOURCES) -> str:
    """Of the program: the commit of its checkout, else its version.

    Where files differ from the commit, -dirty follows, and a hash of how they do, as far as they are of the program:
    also files that git does not track yet, as a further method's.
    """
    commit = _git(sources, "describe", "--always", "--dirty", "--exclude", "*", "--abbrev=12").decode().strip()
    difference = _difference(sources) if commit else b""
    if not difference:
        return commit or _version()
    return f"{commit.removesuffix(DIRTY)}{DIRTY}-{hashlib.sha256(difference).hexdigest()[:8]}"


def _difference(sources: pathlib.Path) -> bytes:
    """How the packages differ from the commit; empty where they do not."""
    packages = ("--", "optim", "replay")
    parts = [_git(sources, "diff", "--binary", "--no-ext-diff", "HEAD", *packages)]
    for name in filter(None, _git(sources, "ls-files", "--others", "--exclude-standard", "-z", *packages).split(b"\0")):
        with contextlib.suppress(OSError):  # gone meanwhile
            parts += [name, (sources / os.fsdecode(name)).read_bytes()]
    return b"\0".join(filter(None, parts))


def _git(folder: pathlib.Path, *arguments: str) -> bytes:
    """What git says; nothing where it cannot be run, or fails."""
    environment = {name: value for name, value in os.environ.items() if not name.startswith("GIT_")}
    try:
        done = subprocess.run(["git", *arguments], cwd=folder, capture_output=True, timeout=10.0, env=environment)
    except (OSError, subprocess.TimeoutExpired):
        return b""
    return done.stdout if done.returncode == 0 else b""


def _version() -> str:
    return installed_version(DISTRIBUTION) or "unknown"


def about_program() -> dict[str, Any]:
    """Versions and machine, for the head of a run."""
    versions = {name: installed_version(name) for name in (*PACKAGES, "casadi", "cvxpy", "clarabel")}
    machine = {"system": platform.system(), "processor": platform.machine(), "cores": os.cpu_count()}
    return {"versions": {"python": platform.python_version()} | versions, "machine": machine}
