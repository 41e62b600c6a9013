"""The head of the report: machine class, versions, and what the comparison does not show."""

import importlib.metadata
import os
import pathlib
import platform
import time

OURS = ("numpy", "scipy", "numba", "casadi", "cvxpy", "clarabel")
PEERS = ("shapely", "python-fcl", "coal", "crocoddyl", "pycddp", "openscvx")

LIMITS = """\
## What this comparison does not show

- All peers solve *our* problem, stated by us. Who knows a peer better may state it better; every option that was
  tried and helped is in `tools/bench/peers/`, and what was tried is said there.
- One machine, shared with others, two cores: seconds are good to some ten percent, ratios on one log better, since
  the contenders take turns. CPU time is compared, not wall time, and every library is held to one thread.
- Our kernels are compiled before (see "First impressions" for what that costs); building a peer's symbolic problem
  is part of its time, since each log needs it anew.
- Recorded paths come from a random planner. A better start would shorten every method's time, not all by the same.
- What keeps clearance between the knots asks more of itself than a peer that keeps it at the knots only: ours come out
  at a slightly higher J where obstacles touch, and pass the audit.
- fatrop and the culled hyperplanes choose their pairs once, before solving, as a script would; that is why the audit
  turns their paths down, not the formulation.
- OMPL's path simplifier (2.0.1) is missing since its Python package cannot take the state space of a truck with
  trailer: `StateSpace` cannot be derived from there ("no constructor defined"), and `distance` and `interpolate` of a
  class derived from `RealVectorStateSpace` are not called by the library.
- OpenSCvx states all of it in one problem, gear changes included, but only with functions of one's own in JAX. As it
  comes, the cost of its sub-problem is linear, states at the ends and a proximal term: with J as such a state it is a
  method of first order. It gives constraints at nodes the number 0 for every node, so that the required clearance
  cannot differ from node to node, and what is missing between nodes cannot be asked for anew."""


def head(rows: pathlib.Path) -> str:
    """Title, machine, versions, date."""
    names = {name: _version(name) for name in (*OURS, *PEERS)}
    versions = ", ".join(f"{name} {version}" for name, version in names.items() if version)
    missing = ", ".join(name for name, version in names.items() if not version)
    files = sorted(rows.glob("*/*.json"))
    newest = max((path.stat().st_mtime for path in files), default=time.time())
    lines = [
        "# Beside other software",
        "",
        f"Written by `python tools/bench/run_all.py`. {_machine()}. Measured by {_day(newest)}.",
        f"{versions}. Load when this was written: {os.getloadavg()[0]:.0f} processes; wall times are as long as that.",
    ]
    if missing:
        lines.append(f"Not installed, hence left out: {missing}.")
    return "\n".join([*lines, "", LIMITS])


def _version(name: str) -> str:
    try:
        return importlib.metadata.version(name)
    except importlib.metadata.PackageNotFoundError:
        return ""


def _machine() -> str:
    cpuinfo = pathlib.Path("/proc/cpuinfo")
    model = ""
    if cpuinfo.exists():
        names = [line.partition(":")[2].strip() for line in cpuinfo.read_text().splitlines() if "model name" in line]
        model = f", {names[0]}" if names else ""
    cores = len(os.sched_getaffinity(0)) if hasattr(os, "sched_getaffinity") else os.cpu_count()
    return f"Virtual machine with {cores} cores{model}, {platform.machine()}, Python {platform.python_version()}"


def _day(seconds: float) -> str:
    return time.strftime("%Y-%m-%d", time.gmtime(seconds))
