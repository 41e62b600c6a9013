"""Coverage and speed of the local planner: `python tools/bench/steering.py [--pairs N] [--cold]`.

Random pairs of states of the trailer's axle, curvature within 60 % of the limit. `around`: offsets uniform within 40 m
in x and y, any heading; `ahead`: 10 to 45 m ahead, heading and bearing as of a gentle bend. Printed for each vehicle
and gear: the share of pairs that is connected, by turns, by a Bézier curve, and where the latter is the shortest;
the median length by the distance; and CPU time per call: without a bound (every solution wanted), and with a bound
on the length of 1.3 times the distance (as a shortcut asks). Then the time of sampling at 0.05 m, and what
intervals between samples miss when integrated again. --cold adds the time of the first call with an empty cache of
compiled code, in a process of its own.
"""

import argparse
import math
import os
import subprocess
import sys
import tempfile
import time

import numpy as np

from optim.model.kinematics import rk4_step
from optim.model.vehicle import Vehicle
from optim.steering.connect import connections
from optim.steering.flat import Flat
from replay.base.kernels import drop_stale
from tools.script import from_one, run

VEHICLES = {
    "european semi": Vehicle(),
    "long trailer": Vehicle(wheelbase=3.6, hitch_to_axle=12.036, trailer_rear=14.6),
    "yard tractor": Vehicle(wheelbase=3.0, hitch_to_axle=5.0),
}


def random_pairs(vehicle: Vehicle, placing: str, count: int) -> list[tuple[Flat, Flat]]:
    """Start at the origin and end of each pair; `placing` is `around` or `ahead`."""
    rng = np.random.default_rng(0)
    top = 0.6 * vehicle.max_kappa
    pairs = []
    for _ in range(count):
        start = Flat(0.0, 0.0, 0.0, rng.uniform(-top, top), 0.0)
        if placing == "around":
            x, y = rng.uniform(-40.0, 40.0, 2)
            theta = rng.uniform(-math.pi, math.pi)
        else:
            distance, bearing = rng.uniform(10.0, 45.0), rng.uniform(-0.6, 0.6)
            x, y = distance * math.cos(bearing), distance * math.sin(bearing)
            theta = 2.0 * bearing + rng.uniform(-0.5, 0.5)
        pairs.append((start, Flat(float(x), float(y), float(theta), rng.uniform(-top, top), 0.0)))
    return pairs


def share(values: list[bool]) -> str:
    return f"{100.0 * np.mean(values):8.1f}%"


def print_coverage(name: str, vehicle: Vehicle, placing: str, count: int) -> None:
    """Two rows of the table: forward and reverse."""
    pairs = random_pairs(vehicle, placing, count)
    distances = [math.hypot(end.x, end.y) for _, end in pairs]
    for direction in (1, -1):
        if direction < 0:
            pairs = [(end, start) for start, end in pairs] if placing == "ahead" else pairs
        connections(vehicle, *pairs[0], direction)
        begin = time.process_time()
        found = [connections(vehicle, *pair, direction) for pair in pairs]
        free = time.process_time() - begin
        begin = time.process_time()
        for pair, distance in zip(pairs, distances, strict=True):
            connections(vehicle, *pair, direction, max_length=1.3 * distance)
        bound = time.process_time() - begin
        ratio = [some[0].trailer_length / distance for some, distance in zip(found, distances, strict=True) if some]
        print(
            f"{name:14} {placing:7} {'forward' if direction > 0 else 'reverse':8}"
            + share([bool(some) for some in found])
            + share([any(c.kind == "turns" for c in some) for some in found])
            + share([any(c.kind == "bezier" for c in some) for some in found])
            + share([some[0].kind == "bezier" for some in found if some])
            + f"{np.median(ratio):9.2f}{free / count * 1e6:9.0f}{bound / count * 1e6:9.0f}"
        )


def print_sampling(vehicle: Vehicle) -> None:
    """How long sampling takes, and what intervals miss when integrated again."""
    found = [some for pair in random_pairs(vehicle, "ahead", 200) for some in connections(vehicle, *pair, 1)[:1]]
    begin = time.process_time()
    segments = [connection.segment(0.05) for connection in found]
    seconds = time.process_time() - begin
    samples = sum(segment.num_samples for segment in segments)
    worst = np.zeros(4)
    for segment in segments[:10]:
        missed = np.zeros((segment.num_samples - 1, 2))
        for k, ds in enumerate(np.diff(segment.s)):
            phi = segment.phi[k], segment.phi[k + 1]
            end = rk4_step(vehicle, segment.states[k], *phi, ds, segment.direction) - segment.states[k + 1]
            missed[k] = math.hypot(end[0], end[1]), np.abs(end[2:]).max()
        worst = np.maximum(worst, [*missed.max(axis=0), *missed.sum(axis=0) * 60.0 / segment.length])
    each, sample = seconds / len(found) * 1e6, seconds / samples * 1e9
    print(f"\nsampling at 0.05 m: {each:.0f} us a segment, {sample:.0f} ns a sample")
    print(
        f"defects: an interval at most {worst[0]:.1e} m, {worst[1]:.1e} rad;"
        f" over 60 m {worst[2] * 1e3:.3f} mm, {worst[3] * 1e3:.3f} mrad"
    )


def print_cold_start() -> None:
    """How long the first call takes without and with compiled code on disk."""
    program = (
        "import time\n"
        "from optim.steering.connect import connections\n"
        "from optim.steering.flat import Flat\n"
        "from optim.model.vehicle import Vehicle\n"
        "begin = time.process_time()\n"
        "for connection in connections(Vehicle(), Flat(0, 0, 0, 0, 0), Flat(30, -5, 0, 0, 0), 1):\n"
        "    connection.segment()\n"
        "print(f'{time.process_time() - begin:.1f}')\n"
    )
    with tempfile.TemporaryDirectory() as cache:
        environment = os.environ | {"NUMBA_CACHE_DIR": cache}
        seconds = [
            subprocess.run([sys.executable, "-c", program], env=environment, capture_output=True, text=True, check=True)
            for _ in range(2)
        ]
    print(f"first call: {seconds[0].stdout.strip()} s cpu, with compiled code on disk {seconds[1].stdout.strip()} s")


def main() -> None:
    parser = argparse.ArgumentParser(description="Coverage and speed of the local planner.")
    parser.add_argument("--pairs", type=from_one, default=1000, help="random pairs for each row (default: %(default)s)")
    parser.add_argument("--cold", action="store_true", help="time the first call without compiled code, too")
    arguments = parser.parse_args()
    drop_stale()
    columns = ("any", "turns", "bezier", "shortest", "length", "us", "us bound")
    print(f"{'vehicle':14} {'pairs':7} {'gear':8}" + "".join(f"{column:>9}" for column in columns))
    for name, vehicle in VEHICLES.items():
        for placing in ("around", "ahead"):
            print_coverage(name, vehicle, placing, arguments.pairs)
    print_sampling(VEHICLES["european semi"])
    if arguments.cold:
        print_cold_start()


if __name__ == "__main__":
    run(main)
